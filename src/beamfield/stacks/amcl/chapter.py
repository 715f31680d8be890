"""The chapter's beam model in AMCL's parameters, and what AMCL's models are fitted by."""

from __future__ import annotations

import math
from dataclasses import replace

from beamfield.models.beam_parameters import WEIGHTS, BeamParameters
from beamfield.stacks.coordinates import REACHES, SHORTEST_REACH, SIGMAS, FitInputs, FitSpace, log_of, share
from beamfield.stacks.stack import LEAST_RATE, SQRT_2PI, Model, with_sum_one


def amcl_from_chapter(learned: BeamParameters, typical_range: float, cell: float) -> dict[str, float]:  # noqa: ARG001
    """Return parameters that give AMCL's beams the learned densities up to a factor; see `Model.from_chapter`.

    Its hit has no constant, so that the weight is the height of its peak; its z_short lacks the normaliser
    1 / (1 - exp(-lambda_short z*)). The weights are scaled to sum to 1.
    """
    values = plain_from_chapter(learned)
    values["z_hit"] /= SQRT_2PI * values["sigma_hit"]
    values["z_short"] /= -math.expm1(-values["lambda_short"] * typical_range)
    return with_sum_one(values)


def plain_from_chapter(learned: BeamParameters) -> dict[str, float]:
    """Return the chapter's parameters with a width and a rate that programs can compute with."""
    values = dict(zip(WEIGHTS, learned.weights, strict=True))
    return {**values, "sigma_hit": max(learned.sigma_hit, 1e-3), "lambda_short": max(learned.lambda_short, LEAST_RATE)}


def amcl_chapter_notes(model: Model, plain: BeamParameters, typical_range: float, cell: float) -> list[str]:
    """Return what the chapter's beam model loses in AMCL's."""
    said = (
        "amcl normalises neither hits nor short readings: z_hit is the height of the peak, and z_short keeps its share "
        f"where {typical_range:.3g} m are expected"
    )
    return [said, *beam_notes(model, plain, typical_range, cell)]


def beam_notes(model: Model, plain: BeamParameters, typical_range: float, cell: float) -> list[str]:  # noqa: ARG001
    """Return what the chapter's beam model loses in AMCL's and Beluga's."""
    notes = []
    if plain.lambda_short < LEAST_RATE and plain.z_short > 0.0:
        notes.append(
            f"lambda_short {plain.lambda_short:.2g} becomes {LEAST_RATE}: at 0 this model has no short readings"
        )
    if plain.z_max > 0.0:
        notes.append(
            f"z_max ({plain.z_max:.1%} of the readings) counts only if the driver reports missing returns as "
            "range_max, not +inf"
        )
    return notes


def amcl_fit_space(model: Model, inputs: FitInputs) -> FitSpace:
    """Return what to fit of AMCL's and Beluga's models; see `Model.fit_space`."""
    beams, sigma = model.own_name("max_beams"), model.own_name("sigma_hit")
    usable = inputs.start
    # A scan of one beam is refused by the emulators of what never returns from it.
    if getattr(usable, beams) > max(2, inputs.finder.n_beams):
        usable = replace(usable, **{beams: max(2, inputs.finder.n_beams)})
    settings = tuple({beams: max(2, n)} for n in inputs.counts)
    width = log_of(sigma, 0.4, inputs.narrowest, 1.0, SIGMAS)
    rand = model.own_name("z_rand")
    if model.weight.of_field:
        reach = log_of("laser_likelihood_max_dist", -0.7, SHORTEST_REACH, 20.0, REACHES, per=sigma)
        coordinates = share((model.own_name("z_hit"), rand), rand), width, reach
        return FitSpace(coordinates, settings, usable, usable)
    first, learned = model.with_learned(usable, inputs)
    weights = tuple(map(model.own_name, WEIGHTS))
    return FitSpace(() if learned else (share(weights, rand), width), settings, first, usable, learned)
