"""A field's parameters in no stack's words, from and to those of each stack."""

from __future__ import annotations

import math
from dataclasses import dataclass

from beamfield.errors import InvalidInputError
from beamfield.stacks.formula import Formula
from beamfield.stacks.stack import SQRT_2PI, Model, Stack
from beamfield.stacks.syntax.parameter_text import Value
from beamfield.stacks.translation.translation import above_one


@dataclass(frozen=True)
class NeutralField:
    """p(d) = peak exp(-d^2 / 2 sigma^2) + floor, with d cut off at max_distance.

    Parameters
    ----------
    peak, floor
        Heights of a hit and of random readings.
    sigma, max_distance
        Metres.
    max_range
        What random readings are divided by, metres.
    max_beams
        Number of beams; None if it is not known.
    """

    peak: float
    floor: float
    sigma: float
    max_distance: float
    max_range: float
    max_beams: int | None = None


def read_field(source: Formula, max_range: float | None, n_beams: int | None, notes: list[str]) -> NeutralField:
    """Return a stack's field, and add to the notes what is left out."""
    model = source.model
    for name, what in model.refused.items():
        if getattr(source.parameters, name):
            raise InvalidInputError(f"{name}: {what}, which no other stack does")
    notes += [said for name, said in model.left_out.items() if getattr(source.parameters, name)]
    limit, sigma, hit = needed_limit(source, max_range), source.value("sigma_hit"), source.value("z_hit")
    beams, step = source.value("max_beams"), source.value("beam_step")
    if beams is None and step is not None and n_beams is not None:
        beams = math.ceil(n_beams / step)
    elif beams is None and step is not None:
        own = model.own_name("beam_step")
        notes.append(f"max_beams is left out: converting {own} needs the number of beams in a scan (--beams)")
    return NeutralField(
        hit / (SQRT_2PI * sigma) if model.hit_is_density else hit,
        source.value("z_rand") / limit, sigma, source.value("laser_likelihood_max_dist"), limit, beams,
    )  # fmt: skip


def needed_limit(source: Formula, max_range: float | None) -> float:
    """Return what a model divides z_rand by, metres; InvalidInputError if that is not known."""
    limit = source.longest_range(max_range)
    if limit is None:
        raise InvalidInputError(
            "max_range: the sensor's longest range is needed, as the file leaves laser_max_range to the sensor"
        )
    return limit


def field_values(
    stack: Stack, model: Model, source: NeutralField, max_range: float | None, n_beams: int | None, notes: list[str],
    *, keeps_scale: bool,
) -> dict[str, Value]:  # fmt: skip
    """Return a stack's parameters of a field, and add to the notes what is left out.

    max_range and n_beams are the sensor's, if they are known. Without `keeps_scale`, z_hit and z_rand are scaled to a
    sum of 1.
    """
    # Some divide by the lesser of the two, whatever the file says.
    limit = source.max_range
    by_sensor = stack.takes_lesser_limit and max_range is not None and max_range < limit
    divisor = max_range if by_sensor and max_range is not None else limit
    hit, rand = source.peak * (SQRT_2PI * source.sigma if model.hit_is_density else 1.0), source.floor * divisor
    if not keeps_scale:
        hit, rand = hit / (hit + rand), rand / (hit + rand)
    else:
        notes.append("z_hit and z_rand are not rescaled to sum to 1, because this model adds 1 to every weight")
    values: dict[str, Value] = {"z_hit": hit, "z_rand": rand, "sigma_hit": source.sigma}
    if source.max_beams is not None and model.has("max_beams"):
        values["max_beams"] = source.max_beams
    elif source.max_beams is not None and n_beams is not None:
        values["beam_step"] = max(1, round(n_beams / source.max_beams))
    elif source.max_beams is not None:
        own = model.own_name("beam_step")
        notes.append(f"{own} is left out: converting max_beams needs the number of beams in a scan (--beams)")
    values |= {"laser_likelihood_max_dist": source.max_distance, "laser_max_range": limit}
    if by_sensor:
        notes.append(f"z_rand is for a sensor whose longest range is {max_range:g} m")
    notes += above_one(stack, hit)
    return {**stack.choice(model.name), **model.own_names(values), **model.off_values}


def chapter_values(source: NeutralField, notes: list[str]) -> dict[str, Value]:
    """Return the parameters of the chapter's field, and add to the notes how to use them."""
    hit, rand = source.peak * SQRT_2PI * source.sigma, source.floor * source.max_range
    notes.append(f"p_rand is z_rand / max_range: use scans whose max_range is {source.max_range:g} m")
    notes.append("the exponent stays 1, and beams are chosen with n_beams")
    weights: dict[str, Value] = {"z_hit": hit / (hit + rand), "z_rand": rand / (hit + rand)}
    return {**weights, "sigma_hit": source.sigma, "max_distance": source.max_distance}
