"""Translate beamfield's own beam_model.yaml into a stack's parameters, and say what that loses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.files.yaml_file import read_yaml
from beamfield.io.parameters.beam_model_file import read_beam_model
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.stacks.files.parameter_file import MODELS, check_model, check_stack
from beamfield.stacks.files.parameter_text import Value
from beamfield.stacks.fit.likelihood_values import LEAST_RATE, SQRT_2PI, beam_values
from beamfield.stacks.mrpt.parameters import RAY_TRACING
from beamfield.stacks.registry import parameter_class
from beamfield.stacks.translation.neutral_field import NeutralField, field_values
from beamfield.stacks.translation.translation import AMCL, CHAPTER, Translation, above_one, as_written, family
from beamfield.stacks.translation.weight_comparison import (
    ChapterField,
    Comparison,
    beam_log_values,
    compare,
    field_weights,
    ray_weights,
    sample_ranges,
)

# Indoors ranges have a root mean square of 2 to 6 m: 3.8 m in the median of nine logs.
TYPICAL_RANGE, TYPICAL_SHARE = 4.0, 0.4
# A field's distances are cut off at nav2's default, or beyond the hits.
MAX_DISTANCE, MAX_SIGMAS = 2.0, 5.0
N_SAMPLES = 20_000
_FIELDS = ("likelihood_field", "likelihood_field_prob", "LF_Thrun")


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
    for name, value in (("typical_range", typical_range), ("resolution", resolution)):
        if value is not None and not 0.0 < value < math.inf:
            raise InvalidInputError(f"{name}: expected a positive number of metres, got {value}")
    chosen, notes = _choose(to, model)
    own = _read(Path(path), typical_range)
    target = to, chosen
    if to == "f1tenth" and resolution is None:
        raise InvalidInputError(
            "resolution: F1TENTH measures sigma_hit in cells of the map; give their side in metres, or calibrate in "
            "its own formula (beamfield calibrate LOG --map MAP --stack f1tenth)"
        )
    cell = resolution or 0.05
    notes += _folded(own)
    values = _as_field(target, own, notes) if chosen in _FIELDS else _as_beams(target, own, cell, notes)
    comparison = _compared(target, as_written(values), own, cell)
    if to != CHAPTER:
        notes.append(
            f"for the values that are best in {to}'s own formula: beamfield calibrate LOG --map MAP --stack {to}"
        )
    return Translation(*target, values, comparison, (), tuple(notes))


def _choose(to: str, model: str | None) -> tuple[str, list[str]]:
    """Return the model to write, and why, if it was not asked for."""
    if to == CHAPTER:
        if model not in (None, "beam", "likelihood_field"):
            raise InvalidInputError(f"model: {CHAPTER} has beam, likelihood_field, got {model!r}")
        return model or "beam", []
    models = MODELS[check_stack(to)]
    if model is not None:
        return check_model(to, model), []
    if to == "mrpt":
        return "LF_Thrun", ["LF_Thrun was chosen, because rayTracing has one width and fixed weights"]
    chosen = "beam" if "beam" in models else models[0]
    others = [name for name in models if name != chosen]
    instead = f" (--to-model: {', '.join(others)})" if others else ""
    why = f"{chosen} was chosen, because it is {to}'s model of ranges along rays, as yours is{instead}"
    return chosen, [why]


def _read(path: Path, typical_range: float | None) -> _Own:
    saved = read_beam_model(path)
    sensor = read_yaml(path).values.get("sensor")
    if isinstance(sensor, Mapping) and sensor.get("opening_angle"):
        raise FormatError(path, "is the model of cones (opening_angle), such as a sonar's; no stack has such a model")
    full = saved.parameters
    typical = typical_range or min(TYPICAL_RANGE, TYPICAL_SHARE * saved.max_range)
    sigma = math.sqrt(full.sigma_hit**2 + full.range_offset**2 + (full.sigma_slope * typical) ** 2)
    plain = replace(full, sigma_hit=sigma, range_offset=0.0, sigma_slope=0.0)
    return _Own(full, plain, saved.min_range, saved.max_range, typical)


# --- what is lost -----------------------------------------------------------------------------------------------------


def _folded(own: _Own) -> list[str]:
    """Say what each parameter that no stack has costs."""
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


def _compared(target: tuple[str, str], values: Mapping[str, Any], own: _Own, cell: float) -> Comparison:
    """Compare weights: beamfield's product of densities, and the stack's of the same readings.

    A field gets the differences between reading and expected range for distances: beams meet walls at right angles.
    """
    ranges, expected = sample_ranges(own.plain.sigma_hit, own.typical_range, own.max_range)
    before = _densities(own.full, own.min_range, own.max_range, ranges, expected)
    if target == (CHAPTER, "beam"):
        after = _densities(BeamParameters(**_normalised(values)), 0.0, own.max_range, ranges, expected)
    elif target[1] in _FIELDS:
        parameters = (
            ChapterField(**values, max_range=own.max_range)
            if target[0] == CHAPTER
            else parameter_class(*target)(**values)
        )
        after = field_weights(*target, parameters, np.abs(ranges - expected), own.max_range)
    else:
        after = ray_weights(*target, parameter_class(*target)(**values), ranges, expected, own.max_range, cell)
    return compare(before, after)


def _densities(
    parameters: BeamParameters, min_range: float, max_range: float, ranges: FloatArray, expected: FloatArray
) -> FloatArray:
    return np.asarray(beam_log_density(ranges, expected, max_range, parameters, min_range=min_range).sum(axis=1))


def _normalised(values: Mapping[str, float]) -> dict[str, float]:
    """Return values whose weights sum to 1 again after rounding."""
    names = ("z_hit", "z_short", "z_max", "z_rand")
    total = sum(values[name] for name in names)
    return {name: value / total if name in names else value for name, value in values.items()}


# --- values -----------------------------------------------------------------------------------------------------------


def _as_field(target: tuple[str, str], own: _Own, notes: list[str]) -> dict[str, Value]:
    plain = own.plain
    if plain.z_hit + plain.z_rand <= 0.0:
        raise InvalidInputError("z_hit, z_rand: both are 0, which leaves nothing for a field")
    reach = max(MAX_DISTANCE, MAX_SIGMAS * plain.sigma_hit)
    field = NeutralField(
        plain.z_hit / (SQRT_2PI * plain.sigma_hit), plain.z_rand / own.max_range, plain.sigma_hit, reach, own.max_range
    )
    left = plain.z_short + plain.z_max
    notes.append(
        "a field takes the distance from the end point to the nearest obstacle, not the error along the ray: the "
        "comparison above is of beams that meet walls at right angles"
    )
    notes.append(f"z_short and z_max are lost, {left:.1%} of the readings: a field has neither")
    notes += _cubes(target)
    return field_values(target, field, own.max_range, None, notes, keeps_scale=False)


def _as_beams(target: tuple[str, str], own: _Own, cell: float, notes: list[str]) -> dict[str, Value]:
    to, model = target
    plain = own.plain
    if to == CHAPTER:
        return {name: value for name, value in asdict(plain).items() if name not in ("range_offset", "sigma_slope")}
    if to == "mrpt":
        values: dict[str, Value] = {"likelihoodMethod": RAY_TRACING, "rayTracing_stdHit": plain.sigma_hit}
        notes.append("z_hit, z_short, z_max and z_rand are lost: MRPT's weights are fixed, 0.9 of them for hits")
    elif to == "f1tenth":
        values = {**beam_values(to, plain, own.typical_range, cell), "max_range": own.max_range}
        notes.append(
            f"lambda_short {plain.lambda_short:.3g} is lost: F1TENTH's short readings fall off linearly; z_short keeps "
            f"its share where {own.typical_range:.3g} m are expected"
        )
        notes.append(f"sigma_hit is in cells of {cell:g} m; squash_factor stays as it is")
    else:
        named = beam_values(to, plain, own.typical_range, cell)
        values = {"laser_model_type": model, **named, "laser_max_range": own.max_range}
        notes += _amcl_notes(to, plain, own, named["laser_z_hit" if to == "ros1" else "z_hit"])
    notes.append(_formula_note(target, as_written(values), own, cell))
    return values


def _amcl_notes(to: str, plain: BeamParameters, own: _Own, hit: float) -> list[str]:
    notes = []
    if to in AMCL:
        notes.append(
            f"{to} normalises neither hits nor short readings: z_hit is the height of the peak, and z_short keeps its "
            f"share where {own.typical_range:.3g} m are expected"
        )
    if plain.lambda_short < LEAST_RATE and plain.z_short > 0.0:
        notes.append(f"lambda_short {plain.lambda_short:.2g} becomes {LEAST_RATE}: at 0 {to} has no short readings")
    if plain.z_max > 0.0:
        notes.append(
            f"z_max ({plain.z_max:.1%} of the readings) counts only if the driver reports missing returns as "
            "range_max, not +inf"
        )
    return [*notes, *above_one(to, hit), *_cubes((to, "beam"))]


def _formula_note(target: tuple[str, str], values: Mapping[str, Any], own: _Own, cell: float) -> str:
    """Say how far one beam's value is from the density that it stands for, with what was folded in left out."""
    rng = np.random.default_rng(1)
    expected = np.minimum(rng.rayleigh(own.typical_range / math.sqrt(2.0), N_SAMPLES // 10), own.max_range)
    ranges = sample_beams(expected, own.max_range, own.plain, rng)
    expected, ranges = expected[ranges < own.max_range], ranges[ranges < own.max_range]
    log_p = beam_log_values(*target, parameter_class(*target)(**values), ranges, expected, own.max_range, cell)
    off = log_p - beam_log_density(ranges, expected, own.max_range, own.plain)
    off = off[np.isfinite(off)]
    return (
        f"with these values the logarithm of one beam's p is off by {float(off.std()):.2g} nats (root mean square, up "
        "to a constant) by the program's formula alone"
    )


def _cubes(target: tuple[str, str]) -> list[str]:
    """Say that a stack adds cubes where beamfield multiplies."""
    if target[0] not in ("nav2", "ros1", "beluga") or target[1] == "likelihood_field_prob":
        return []
    how = family(*target)
    return [f"{target[0]} takes {how}, beamfield the product of p: no values make these the same"]
