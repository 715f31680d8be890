"""Translate parameters: values that give another stack's model the same relative weights, where there are such."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from beamfield.errors import InvalidInputError
from beamfield.stacks.files.parameter_file import StackFile, check_model, check_stack
from beamfield.stacks.files.parameter_text import Value
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.registry import parameter_class, parameter_names
from beamfield.stacks.ros1.parameters import Ros1Parameters, ros1_name
from beamfield.stacks.translation.neutral_field import SQRT_2PI, NeutralField, field_values, read_field, sensor_limit
from beamfield.stacks.translation.translation import (
    AMCL,
    CHAPTER,
    FAMILIES,
    Translation,
    above_one,
    as_written,
    family,
    map_notes,
)
from beamfield.stacks.translation.weight_comparison import (
    ChapterField,
    Comparison,
    compare_fields,
    compare_rays,
    sample_distances,
    sample_ranges,
)

# Sides of cells, metres, that maps have where nobody says.
CELLS = (0.025, 0.05, 0.1)
# Root mean square of the expected ranges on which beam models are compared, metres.
SAMPLED_RANGE = 4.0


def translate(
    file: StackFile,
    to: str,
    *,
    model: str | None = None,
    max_range: float | None = None,
    n_beams: int | None = None,
    resolution: float | None = None,
) -> Translation:
    """Translate a stack's parameters into another's.

    Parameters
    ----------
    file
        From `read_stack_file`.
    to
        The other stack: nav2, ros1, beluga, mrpt, f1tenth; or "chapter" for beamfield's own likelihood field.
    model
        The other stack's model; None takes the one that combines beams in the same way.
    max_range
        The sensor's longest range, metres: nav2 and ROS 1 divide z_rand by it if it is less than laser_max_range.
    n_beams
        Beams in a scan, to translate a number of beams into a decimation or back.
    resolution
        Side of the map's cells, metres: nav2 and ROS 1 cut distances off at a whole number of them. None tries usual
        ones.

    Returns
    -------
    The values, and how far weights differ, computed by both formulas.

    Raises
    ------
    InvalidInputError
        If there are no such parameters, with the reason in one line; or if a number makes no sense.
    FormatError
        If the file has a value that its stack cannot use.
    """
    for name, value in (("max_range", max_range), ("resolution", resolution)):
        if value is not None and not 0.0 < value < math.inf:
            raise InvalidInputError(f"{name}: expected a positive number of metres, got {value}")
    if n_beams is not None and n_beams < 1:
        raise InvalidInputError(f"n_beams: expected at least 1, got {n_beams}")
    target = _target(file, to, model)
    parameters = checked_values(file)
    source = file.stack, file.model, parameters
    cells = CELLS if resolution is None else (resolution,)
    notes = _ignored(file)
    if {file.stack, to} <= AMCL or file.stack == to:
        values = _renamed(file.stack, to, parameters)
        comparison = _comparison(source, (*target, parameter_class(*target)(**as_written(values))), max_range, cells)
        return Translation(*target, values, comparison, (), tuple(notes))
    assumptions = _assumed_limit(file.stack, to, parameters, max_range)
    if file.model == "beam":
        values = _beam_values(file.stack, to, parameters, max_range, notes)
        other: Any = parameter_class(*target)(**as_written(values))
    else:
        field = read_field(*source, max_range, n_beams, notes)
        keeps_scale = file.model == "likelihood_field"
        values = field_values(target, field, max_range, n_beams, notes, keeps_scale=keeps_scale)
        if keeps_scale:
            notes.append("z_hit and z_rand are not rescaled to sum to 1, because this model adds 1 to every weight")
        other = _field_parameters(target, as_written(values), field)
        notes += _cut_note(source, (*target, other), max_range, cells)
    comparison = _comparison(source, (*target, other), max_range, cells)
    return Translation(*target, values, comparison, assumptions, tuple(notes + map_notes(file.stack, to)))


def _target(file: StackFile, to: str, model: str | None) -> tuple[str, str]:
    """Return stack and model to translate into, or say why there is none."""
    if to != CHAPTER:
        check_stack(to)
        if model is not None:
            check_model(to, model)
    how = family(file.stack, file.model)
    same = [member for member in FAMILIES[how] if member[0] == to]
    if not same:
        raise InvalidInputError(
            f"{to} has no model that can weigh as {file.stack}'s {file.model} does: that takes {how}, and no values of "
            "other parameters imitate it"
        )
    if model is not None and same[0][1] != model:
        other = next((name for name, members in FAMILIES.items() if (to, model) in members), "something else")
        raise InvalidInputError(
            f"{file.stack}'s {file.model} takes {how}, {to}'s {model} takes {other}: no parameters make these the same"
        )
    return same[0]


def _ignored(file: StackFile) -> list[str]:
    """Say which names of other stacks in the file were not read."""
    own = {file.name_in_file(name) for name in parameter_names(file.stack)}
    others = {ros1_name(name) for name in own} | {name.removeprefix("laser_") for name in own}
    return [
        f"{name} was not read: {file.stack} has no such parameter and uses its own value for what is meant"
        for name in file.section.entries if name in others - own
    ]  # fmt: skip


def _renamed(stack: str, to: str, parameters: Any) -> dict[str, Value]:
    if stack == to:
        return asdict(parameters)
    return asdict(parameters.as_nav2() if to == "nav2" else Ros1Parameters.from_nav2(parameters))


def _assumed_limit(stack: str, to: str, parameters: Any, max_range: float | None) -> tuple[str, ...]:
    """Say what was assumed of the sensor if nobody said its longest range."""
    if max_range is not None or not {stack, to} & AMCL:
        return ()
    limit = parameters.LF_maxRange if stack == "mrpt" else parameters.laser_max_range
    if limit <= 0.0:
        return ()
    amcl = stack if stack in AMCL else to
    said = (
        f"assumed that the sensor's longest range is {limit:g} m or more: {amcl} divides z_rand by the lesser of it "
        "and laser_max_range (give it with --max-range)"
    )
    return (said,)


# --- comparing --------------------------------------------------------------------------------------------------------


def _comparison(
    source: tuple[str, str, Any], other: tuple[str, str, Any], max_range: float | None, cells: tuple[float, ...]
) -> Comparison:
    """Return the worst comparison over the sides of cells."""
    if source[1] in ("likelihood_field", "likelihood_field_prob", "LF_Thrun"):
        found = [_field_comparison(source, other, max_range, cell) for cell in cells]
    else:
        found = [_ray_comparison(source, other, max_range, cell) for cell in cells]
    return max(found, key=lambda made: made.difference)


def _field_comparison(
    source: tuple[str, str, Any], other: tuple[str, str, Any], max_range: float | None, cell: float | None
) -> Comparison:
    # What has no limit anywhere is compared as if the sensor had one.
    limits = [_limit(*named, max_range, at_least=SAMPLED_RANGE) for named in (source, other)]
    sample = read_field(*source, max_range or SAMPLED_RANGE, None, [])
    distances = sample_distances(sample.sigma, sample.max_distance)
    return compare_fields(source, other, distances, (limits[0], limits[1]), cell)


def _ray_comparison(
    source: tuple[str, str, Any], other: tuple[str, str, Any], max_range: float | None, cell: float
) -> Comparison:
    limit = _limit(*source, max_range, at_least=3.0 * SAMPLED_RANGE)
    stack, model, parameters = source
    if model == "rayTracing":
        sigma = parameters.rayTracing_stdHit
    else:
        sigma = parameters.laser_sigma_hit if stack == "ros1" else parameters.sigma_hit
    ranges, expected = sample_ranges(sigma * cell if stack == "f1tenth" else sigma, SAMPLED_RANGE, limit)
    return compare_rays(source, other, ranges, expected, limit, cell)


def _limit(stack: str, model: str, parameters: Any, max_range: float | None, *, at_least: float) -> float:
    """Return the longest range that a model counts with, metres."""
    if isinstance(parameters, ChapterField) or stack == "f1tenth":
        return float(parameters.max_range)
    if stack == "mrpt":
        return float(parameters.LF_maxRange) if model == "LF_Thrun" else max_range or at_least
    if stack == "beluga":
        return float(parameters.laser_max_range)
    unknown = parameters.laser_max_range <= 0.0 and max_range is None
    return at_least if unknown else sensor_limit(parameters.laser_max_range, max_range)


def _field_parameters(target: tuple[str, str], values: dict[str, Any], field: NeutralField) -> Any:
    if target[0] == CHAPTER:
        return ChapterField(**values, max_range=field.max_range)
    return parameter_class(*target)(**values)


def _cut_note(
    source: tuple[str, str, Any], other: tuple[str, str, Any], max_range: float | None, cells: tuple[float, ...]
) -> list[str]:
    """Say what cutting distances off at whole cells changes, where only one of the stacks does."""
    if not _field_comparison(source, other, max_range, None).is_same:
        return []
    worst = max(cells, key=lambda cell: _field_comparison(source, other, max_range, cell).difference)
    made = _field_comparison(source, other, max_range, worst)
    if made.is_same:
        return []
    amcl = source[0] if source[0] in AMCL else other[0]
    said = (
        f"{amcl} cuts distances off at a whole number of cells, below laser_likelihood_max_dist: with cells of "
        f"{worst:g} m that alone is worth up to {made.difference:.2g} nats a scan (the larger that distance is next to "
        "sigma_hit, the less)"
    )
    return [said]


# --- beam models ------------------------------------------------------------------------------------------------------


def _beam_values(stack: str, to: str, parameters: Any, max_range: float | None, notes: list[str]) -> dict[str, Value]:
    """Translate between AMCL's beam model (no constants, 1 + sum) and Beluga's (constants, sum alone)."""

    def value(name: str) -> Any:
        return getattr(parameters, ros1_name(name) if stack == "ros1" else name)

    limit = value("laser_max_range") if stack == "beluga" else sensor_limit(value("laser_max_range"), max_range)
    constant = SQRT_2PI * value("sigma_hit")
    own: dict[str, Any] = {name: value(name) for name in ("z_hit", "z_short", "z_max", "z_rand")}
    own["z_hit"] *= constant if to == "beluga" else 1.0 / constant
    notes += [
        "nav2 and ROS 1 add 1 to the sum of cubes, Beluga does not: its weights differ more between poses",
        "Beluga normalises z_short by 1 - exp(-lambda_short z*), nav2 and ROS 1 do not: the same only far from walls",
        "Beluga casts rays from the robot's centre, the others from the sensor",
    ]
    if to == "beluga":
        total = sum(own.values())
        own = {name: weight / total for name, weight in own.items()}
        notes.append("the weights are rescaled to sum to 1, because a common factor cancels in a bare sum of cubes")
    notes += above_one(to, own["z_hit"])
    own |= {name: value(name) for name in ("sigma_hit", "lambda_short", "max_beams")}
    named = {ros1_name(name) if to == "ros1" else name: weight for name, weight in own.items()}
    return {"laser_model_type": "beam", **named, "laser_max_range": limit}
