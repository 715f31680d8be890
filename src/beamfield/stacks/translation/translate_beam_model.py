"""Translate beamfield's own beam_model.yaml into a stack's parameters, and report what that loses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.files.yaml_file import read_yaml
from beamfield.io.parameters.beam_model_file import read_beam_model
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import EXTENSIONS, BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.stacks.formula import Formula
from beamfield.stacks.registry import stack_named
from beamfield.stacks.stack import SQRT_2PI, TYPICAL_SHARE, Model, Stack, with_sum_one
from beamfield.stacks.syntax.parameter_text import Value
from beamfield.stacks.translation.neutral_field import NeutralField, chapter_values, field_values
from beamfield.stacks.translation.translation import (
    CHAPTER,
    CHAPTER_WEIGHTS,
    Translation,
    above_one,
    as_written,
    check_metres,
)
from beamfield.stacks.translation.weight_comparison import ChapterField, Comparison, compare, sample_ranges

# Indoors ranges have a root mean square of 2 to 6 m: 3.8 m in the median of nine logs.
TYPICAL_RANGE = 4.0
# A field's distances are cut off at nav2's default, or beyond the hits.
MAX_DISTANCE, MAX_SIGMAS = 2.0, 5.0
N_SAMPLES = 20_000


@dataclass(frozen=True)
class _Own:
    """A beam_model.yaml: its parameters and sensor, and the same without what no stack has."""

    full: BeamParameters
    plain: BeamParameters
    min_range: float
    max_range: float
    typical_range: float


def translate_beam_model(
    path: str | Path,
    to: str,
    *,
    model: str | None = None,
    typical_range: float | None = None,
    resolution: float | None = None,
) -> Translation:
    """Translate a beam_model.yaml into a stack's parameters that come nearest to it.

    Parameters
    ----------
    path
        The file, as `beamfield calibrate` writes it.
    to
        nav2, ros1, beluga, mrpt, f1tenth; or "chapter" for the six parameters of the chapter or its field.
    model
        The stack's model; None takes its beam model, or MRPT's field, whose rayTracing has one parameter only.
    typical_range
        Root mean square of the ranges, metres, for which sigma_hit stands where the noise grows with the range. None
        takes 4 m, or 0.4 of the sensor's longest range if that is less.
    resolution
        Side of the map's cells, metres, in which F1TENTH counts.

    Returns
    -------
    The values; every loss is a note with its size.

    Raises
    ------
    InvalidInputError
        If there is no such stack or model, or it cannot be done, with the reason in one line.
    FormatError
        If the file is not as it should be.

    Notes
    -----
    range_offset b and sigma_slope s go into sigma_hit: with expected ranges z* the Gaussian without them that has the
    greatest expected log density has the variance sigma_hit^2 + b^2 + s^2 E[z*^2]. A loss in nats a beam is the mean
    difference of the log densities of readings drawn from the model.
    """
    check_metres(typical_range=typical_range, resolution=resolution)
    own = _read(Path(path), typical_range)
    cell = resolution or 0.05
    if to == CHAPTER:
        name = model or "beam"
        if name not in CHAPTER_WEIGHTS:
            raise InvalidInputError(f"model: {CHAPTER} has {', '.join(CHAPTER_WEIGHTS)}, got {name!r}")
        notes = _folded(own)
        values = _chapter_beam(own) if name == "beam" else chapter_values(_field(own, notes), notes)
        written = as_written(values)
        made = (
            BeamParameters(**with_sum_one(written))
            if name == "beam"
            else ChapterField(**written, max_range=own.max_range)
        )
        return Translation(CHAPTER, name, values, _compared(made, own, cell), (), tuple(notes))
    stack = stack_named(to)
    chosen, notes = _choose(stack, model)
    if chosen.counts_in_cells and resolution is None:
        raise InvalidInputError(
            f"resolution: {stack.title} measures sigma_hit in cells of the map; give their side in metres, or "
            f"calibrate in its own formula (beamfield calibrate LOG --map MAP --stack {to})"
        )
    notes += _folded(own)
    if chosen.weight.of_field:
        field = _field(own, notes)
        notes += _cubes(stack, chosen)
        values = field_values(stack, chosen, field, own.max_range, None, notes, keeps_scale=False)
        notes += chosen.notes
    else:
        values = _beam_values(stack, chosen, own, cell, notes)
    formula = Formula(stack, chosen, chosen.parameters(**as_written(values)))
    if not chosen.weight.of_field:
        notes.append(_formula_note(formula, own, cell))
    notes.append(
        f"for the values that are best in {stack.title}'s own formula: beamfield calibrate LOG --map MAP --stack {to}"
    )
    return Translation(to, chosen.name, values, _compared(formula, own, cell), (), tuple(notes))


def _choose(stack: Stack, model: str | None) -> tuple[Model, list[str]]:
    """Return the model to write, and why, if it was not asked for."""
    if model is not None:
        return stack.model(model), []
    rays = [item for item in stack.models.values() if not item.weight.of_field]
    settable = [item for item in rays if item.has("z_hit")]
    if rays and not settable:
        chosen = stack.model(stack.default_model)
        return chosen, [f"{chosen.name} was chosen, because {rays[0].name} has one width and fixed weights"]
    chosen = settable[0] if settable else stack.model(stack.default_model)
    others = [name for name in stack.models if name != chosen.name]
    instead = f" (--to-model: {', '.join(others)})" if others else ""
    like = ", as yours is" if settable else ""
    what = "ranges along rays" if settable else "distances to obstacles"
    return chosen, [f"{chosen.name} was chosen, because it is {stack.title}'s model of {what}{like}{instead}"]


def _read(path: Path, typical_range: float | None) -> _Own:
    saved = read_beam_model(path)
    sensor = read_yaml(path).values.get("sensor")
    if isinstance(sensor, Mapping) and sensor.get("opening_angle"):
        raise FormatError(path, "is a model of cones (opening_angle), such as a sonar's; no stack has one")
    full = saved.parameters
    typical = typical_range or min(TYPICAL_RANGE, TYPICAL_SHARE * saved.max_range)
    sigma = math.sqrt(full.sigma_hit**2 + full.range_offset**2 + (full.sigma_slope * typical) ** 2)
    plain = replace(full, sigma_hit=sigma, range_offset=0.0, sigma_slope=0.0)
    return _Own(full, plain, saved.min_range, saved.max_range, typical)


# --- what is lost -----------------------------------------------------------------------------------------------------


def _folded(own: _Own) -> list[str]:
    """Report the cost of each parameter that no stack has."""
    rng = np.random.default_rng(0)
    expected = np.clip(rng.rayleigh(own.typical_range / math.sqrt(2.0), N_SAMPLES), own.min_range, own.max_range)
    ranges = sample_beams(expected, own.max_range, own.full, rng, min_range=own.min_range)
    full = own.full

    def cost(parameters: BeamParameters, min_range: float) -> str:
        before = beam_log_density(ranges, expected, own.max_range, full, min_range=own.min_range)
        after = beam_log_density(ranges, expected, own.max_range, parameters, min_range=min_range)
        return f"costs {float((before - after).mean()):.2g} nats a beam"

    notes = []
    if full.range_offset:
        sigma = math.hypot(full.sigma_hit, full.range_offset)
        loss = cost(replace(full, range_offset=0.0, sigma_hit=sigma), own.min_range)
        notes.append(f"range_offset {full.range_offset:.3g} m is lost: it counts as noise in sigma_hit, which {loss}")
    if full.sigma_slope:
        sigma = math.hypot(full.sigma_hit, full.sigma_slope * own.typical_range)
        far = math.hypot(full.sigma_hit, full.sigma_slope * 10.0)
        loss = cost(replace(full, sigma_slope=0.0, sigma_hit=sigma), own.min_range)
        notes.append(
            f"sigma_slope {full.sigma_slope:.3g} is lost: the noise, {full.sigma_hit:.2g} m near and {far:.2g} m at 10 "
            f"m, becomes {sigma:.2g} m, that of ranges of {own.typical_range:.3g} m (root mean square; for others give "
            f"--typical-range), which {loss}"
        )
    if own.min_range > 0.0:
        loss = cost(full, 0.0)
        notes.append(f"min_range {own.min_range:.3g} m is lost: densities begin at 0, which {loss}")
    return notes


def _compared(made: Formula | ChapterField | BeamParameters, own: _Own, cell: float) -> Comparison:
    """Compare weights: beamfield's product of densities, and the stack's of the same readings.

    A field gets the differences between reading and expected range for distances: beams meet walls at right angles.
    """
    ranges, expected = sample_ranges(own.plain.sigma_hit, own.typical_range, own.max_range)
    before = _densities(own.full, own.min_range, own.max_range, ranges, expected)
    if isinstance(made, BeamParameters):
        return compare(before, _densities(made, 0.0, own.max_range, ranges, expected))
    if isinstance(made, ChapterField) or made.model.weight.of_field:
        return compare(before, made.field_weights(np.abs(ranges - expected), own.max_range))
    return compare(before, made.ray_weights(ranges, expected, own.max_range, cell))


def _densities(
    parameters: BeamParameters, min_range: float, max_range: float, ranges: FloatArray, expected: FloatArray
) -> FloatArray:
    return np.asarray(beam_log_density(ranges, expected, max_range, parameters, min_range=min_range).sum(axis=1))


# --- values -----------------------------------------------------------------------------------------------------------


def _chapter_beam(own: _Own) -> dict[str, Value]:
    return {name: value for name, value in asdict(own.plain).items() if name not in EXTENSIONS}


def _field(own: _Own, notes: list[str]) -> NeutralField:
    plain = own.plain
    if plain.z_hit + plain.z_rand <= 0.0:
        raise InvalidInputError("z_hit, z_rand: both are 0, which leaves no weight for a field")
    left = plain.z_short + plain.z_max
    notes.append(
        "a field takes the distance from the end point to the nearest obstacle, not the error along the ray: the "
        "comparison above is of beams that meet walls at right angles"
    )
    notes.append(f"z_short and z_max are lost, {left:.1%} of the readings: a field has neither")
    reach = max(MAX_DISTANCE, MAX_SIGMAS * plain.sigma_hit)
    return NeutralField(
        plain.z_hit / (SQRT_2PI * plain.sigma_hit), plain.z_rand / own.max_range, plain.sigma_hit, reach, own.max_range
    )


def _beam_values(stack: Stack, model: Model, own: _Own, cell: float, notes: list[str]) -> dict[str, Value]:
    values: dict[str, Value] = {**stack.choice(model.name), **model.beam_values(own.plain, own.typical_range, cell)}
    if model.has("laser_max_range"):
        values[model.own_name("laser_max_range")] = own.max_range
    if model.chapter_notes is not None:
        notes += model.chapter_notes(model, own.plain, own.typical_range, cell)
    if model.has("z_hit"):
        notes += above_one(stack, float(values[model.own_name("z_hit")]))
    notes += _cubes(stack, model)
    return values


def _formula_note(formula: Formula, own: _Own, cell: float) -> str:
    """Report how far one beam's value is from the density that it stands for, apart from what was folded in."""
    rng = np.random.default_rng(1)
    expected = np.minimum(rng.rayleigh(own.typical_range / math.sqrt(2.0), N_SAMPLES // 10), own.max_range)
    ranges = sample_beams(expected, own.max_range, own.plain, rng)
    expected, ranges = expected[ranges < own.max_range], ranges[ranges < own.max_range]
    log_p = formula.beam_log_values(ranges, expected, own.max_range, cell)
    off = log_p - beam_log_density(ranges, expected, own.max_range, own.plain)
    off = off[np.isfinite(off)]
    return (
        f"with these values the logarithm of one beam's p is off by {float(off.std()):.2g} nats (root mean square, up "
        "to a constant) by the program's formula alone"
    )


def _cubes(stack: Stack, model: Model) -> list[str]:
    """Report a stack that adds cubes where beamfield multiplies."""
    if model.weight.is_product:
        return []
    return [f"{stack.title} takes {model.weight.text}, beamfield the product of p: no values make these the same"]
