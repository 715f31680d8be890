"""Translate parameters: values that give another stack's model the same relative weights, where there are such."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from beamfield.arguments import require
from beamfield.errors import InvalidInputError
from beamfield.models.beam_parameters import WEIGHTS
from beamfield.stacks.files.calibration_record import MOVED_MAP, goes_with_moved_map
from beamfield.stacks.files.parameter_file import StackFile
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.formula import Formula
from beamfield.stacks.registry import stack_named
from beamfield.stacks.stack import SQRT_2PI, Model, Stack, counterpart
from beamfield.stacks.syntax.parameter_text import Value
from beamfield.stacks.translation.neutral_field import chapter_values, field_values, needed_limit, read_field
from beamfield.stacks.translation.translation import (
    CHAPTER,
    CHAPTER_WEIGHTS,
    Translation,
    above_one,
    as_written,
    check_metres,
    map_notes,
    random_poses,
)
from beamfield.stacks.translation.weight_comparison import (
    ChapterField,
    Comparison,
    compare,
    compare_fields,
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
    check_metres(max_range=max_range, resolution=resolution)
    require(n_beams is None or n_beams >= 1, "n_beams", "at least 1", n_beams)
    stack = None if to == CHAPTER else stack_named(to)
    name = _target(file, stack, to, model)
    source = Formula(file.program, file.described_model, checked_values(file))
    notes = [*_ignored(file), *([] if stack is None else random_poses(stack, name)), *_moved_map(file, stack)]
    if stack is not None and source.stack.has_same_formulas(stack):
        values = _renamed(source, stack.model(name))
        return _translated(source, stack, name, values, max_range, resolution, (), notes)
    assumptions = _assumed_limit(source, stack, max_range)
    if stack is None:
        values = chapter_values(read_field(source, max_range, n_beams, notes), notes)
    elif source.model.weight.of_field:
        field, target = read_field(source, max_range, n_beams, notes), stack.model(name)
        keeps_scale = not target.factor_cancels
        values = field_values(stack, target, field, max_range, n_beams, notes, keeps_scale=keeps_scale)
    else:
        values = _beam_values(source, stack, stack.model(name), max_range, notes)
    notes += source.model.notes
    notes += () if stack is None else stack.model(name).notes
    notes += map_notes(source.stack, stack)
    return _translated(source, stack, name, values, max_range, resolution, assumptions, notes)


def _moved_map(file: StackFile, stack: Stack | None) -> list[str]:
    """Report which map goes with values that were chosen for the moved one."""
    if not goes_with_moved_map(file.section.text):
        return []
    if stack is not None and stack.half_cell_low:
        return [f"chosen for the map {MOVED_MAP}"]
    right = "beamfield" if stack is None else stack.title
    return [
        f"chosen with {MOVED_MAP}, which is for {file.program.title} alone: give {right} the map that it was made from"
    ]


def _target(file: StackFile, stack: Stack | None, to: str, model: str | None) -> str:
    """Return the model to translate into, or say why there is none."""
    weights = CHAPTER_WEIGHTS if stack is None else {name: item.weight for name, item in stack.models.items()}
    if stack is not None and model is not None:
        stack.model(model)
    how, own = file.described_model.weight, f"{file.stack}'s {file.model}"
    # beam_model.yaml is not written from a stack's parameters.
    same = [name for name, weight in weights.items() if weight == how and (stack is not None or how.of_field)]
    if not same:
        fit = "" if stack is None else f" --stack {to}"
        raise InvalidInputError(
            f"{to} has no model that weighs as {own} does: {own} takes {how.text}, and no parameters of another model "
            f"imitate that; fit one to a log instead: beamfield calibrate LOG --map MAP{fit}"
        )
    if model is not None and same[0] != model:
        other = weights[model].text if model in weights else "something else"
        raise InvalidInputError(
            f"{own} takes {how.text}, {to}'s {model} takes {other}: no parameters make these the same"
        )
    return same[0]


def _ignored(file: StackFile) -> list[str]:
    """Report names of other stacks in the file that were not read."""
    own = {file.name_in_file(name) for name in file.program.parameter_names}
    return [
        f"{name} was not read: {file.stack} has no such parameter and uses its own value instead"
        for name in file.section.entries if name not in own and counterpart(name, own)
    ]  # fmt: skip


def _renamed(source: Formula, target: Model) -> dict[str, Value]:
    """Return the same values under the names of a program with the same formulas."""
    common = {own: name for name, own in source.model.names.items()}
    values = {common.get(name, name): value for name, value in asdict(source.parameters).items()}
    return target.own_names(values)


def _assumed_limit(source: Formula, stack: Stack | None, max_range: float | None) -> tuple[str, ...]:
    """Report what was assumed of the sensor if its longest range was not given."""
    lesser = [item.name for item in (source.stack, stack) if item is not None and item.takes_lesser_limit]
    limit = source.value("laser_max_range")
    if max_range is not None or not lesser or limit is None or limit <= 0.0:
        return ()
    said = (
        f"assumed that the sensor's longest range is {limit:g} m or more: {lesser[0]} divides z_rand by the lesser of "
        "it and laser_max_range (give it with --max-range)"
    )
    return (said,)


def _beam_values(
    source: Formula, stack: Stack, target: Model, max_range: float | None, notes: list[str]
) -> dict[str, Value]:
    """Translate between beam models whose hits have the constant of a normal density (Beluga) and not (AMCL)."""
    limit = needed_limit(source, max_range)
    own: dict[str, Any] = {name: source.value(name) for name in WEIGHTS}
    if source.model.hit_is_density != target.hit_is_density:
        constant = SQRT_2PI * source.value("sigma_hit")
        own["z_hit"] *= constant if target.hit_is_density else 1.0 / constant
    if target.factor_cancels:
        total = sum(own.values())
        own = {name: weight / total for name, weight in own.items()}
        notes.append("the weights are rescaled to sum to 1, because a common factor cancels in a bare sum of cubes")
    notes += above_one(stack, own["z_hit"])
    own |= {name: source.value(name) for name in ("sigma_hit", "lambda_short", "max_beams")}
    own["laser_max_range"] = limit
    return {**stack.choice(target.name), **target.own_names(own)}


# --- comparing --------------------------------------------------------------------------------------------------------


def _translated(
    source: Formula, stack: Stack | None, name: str, values: dict[str, Value], max_range: float | None,
    resolution: float | None, assumptions: tuple[str, ...], notes: list[str],
) -> Translation:  # fmt: skip
    """Return the values with the worst comparison over the sides of cells."""
    cells = CELLS if resolution is None else (resolution,)
    written = as_written(values)
    if stack is None:
        limit = needed_limit(source, max_range)
        other: Formula | ChapterField = ChapterField(**written, max_range=limit)
    else:
        other = Formula(stack, stack.model(name), stack.model(name).parameters(**written))
    if source.model.weight.of_field:
        found = [_field_comparison(source, other, max_range, cell) for cell in cells]
        if isinstance(other, ChapterField) or not source.stack.has_same_formulas(other.stack):
            notes = notes + _cut_note(source, other, max_range, dict(zip(cells, found, strict=True)))
    else:
        found = [_ray_comparison(source, other, max_range, cell) for cell in cells]
    worst = max(found, key=lambda made: made.difference)
    return Translation(CHAPTER if stack is None else stack.name, name, values, worst, assumptions, tuple(notes))


def _field_comparison(
    source: Formula, other: Formula | ChapterField, max_range: float | None, cell: float | None
) -> Comparison:
    # What has no limit anywhere is compared as if the sensor had one.
    limits = [of.longest_range(max_range) or SAMPLED_RANGE for of in (source, other)]
    sample = read_field(source, max_range or SAMPLED_RANGE, None, [])
    distances = sample_distances(sample.sigma, sample.max_distance)
    return compare_fields(source, other, distances, (limits[0], limits[1]), cell)


def _ray_comparison(source: Formula, other: Any, max_range: float | None, cell: float) -> Comparison:
    limit = source.longest_range(max_range) or 3.0 * SAMPLED_RANGE
    sigma = source.model.sigma(source.parameters, cell)
    ranges, expected = sample_ranges(sigma or 0.0, SAMPLED_RANGE, limit)
    return compare(*(of.ray_weights(ranges, expected, limit, cell) for of in (source, other)))


def _cut_note(
    source: Formula, other: Formula | ChapterField, max_range: float | None, found: dict[float, Comparison]
) -> list[str]:
    """Report the effect of cutting distances off at whole cells, where only one of the stacks does."""
    if not _field_comparison(source, other, max_range, None).is_same:
        return []
    cell, made = max(found.items(), key=lambda item: item[1].difference)
    cutting = [of.stack.name for of in (source, other) if isinstance(of, Formula) and of.stack.cuts_at_cells]
    if made.is_same or not cutting:
        return []
    said = (
        f"{cutting[0]} cuts distances off at a whole number of cells, below laser_likelihood_max_dist: with cells of "
        f"{cell:g} m that alone is worth up to {made.difference:.2g} nats a scan (the larger that distance is next to "
        "sigma_hit, the less)"
    )
    return [said]
