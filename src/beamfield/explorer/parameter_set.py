"""Sets of parameters that the explorer shows side by side: each a model, its values, and how far its sliders go."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from beamfield import __version__
from beamfield.calibration.context.exponent import ExponentLearning
from beamfield.calibration.field.learning import FieldLearning
from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.parameters.beam_model_file import beam_model_text, read_beam_model
from beamfield.io.parameters.likelihood_field_file import (
    likelihood_field_text,
    read_likelihood_field,
)
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import hollowed
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import WEIGHT_SUM_TOLERANCE, WEIGHTS, BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.files.new_file import new_file_text
from beamfield.stacks.files.other_files import own_model
from beamfield.stacks.files.parameter_file import StackFile, read_stack_file
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.registry import STACKS, build_model, model_named

Kind = Literal["beam", "field", "stack"]
# Name and writer of the file of each of the chapter's models.
_FILES: dict[str, tuple[str, Callable[..., str]]] = {
    "beam": ("beam_model.yaml", beam_model_text),
    "field": ("likelihood_field.yaml", likelihood_field_text),
}
# In the files of other programs a field looks at none of the first, and rays do not look at the second.
OF_RAYS, OF_FIELDS = {"z_short", "z_max", "lambda_short"}, {"laser_likelihood_max_dist"}


@dataclass(frozen=True)
class Slider:
    """One number that can be moved.

    Parameters
    ----------
    name, unit
        As the model calls it.
    low, high
        Ends of the slider.
    logarithmic
        Whether equal steps are equal ratios.
    """

    name: str
    unit: str
    low: float
    high: float
    logarithmic: bool = False


# Of each number that any of the models has, by its name. What is not here is shown but not moved.
SLIDERS = {
    one.name: one
    for one in (
        *(Slider(name, "", 0.0, 1.0) for name in WEIGHTS),
        Slider("sigma_hit", "m", 0.005, 2.0, logarithmic=True),
        Slider("lambda_short", "1/m", 0.01, 10.0, logarithmic=True),
        Slider("range_offset", "m", -0.2, 0.2),
        Slider("sigma_slope", "", 0.0, 0.2),
        Slider("laser_likelihood_max_dist", "m", 0.1, 5.0, logarithmic=True),
        Slider("exponent", "", 0.001, 1.0, logarithmic=True),
    )
}


@dataclass(frozen=True, eq=False)
class ParameterSet:
    """A model with its values.

    Parameters
    ----------
    label
        For people: "nav2.yaml: nav2 likelihood_field_prob".
    kind
        "beam" and "field" are the chapter's models, "stack" is another program's.
    family
        Sets of one family have the same parameters: "beam", "field", or program and model.
    sliders
        What can be moved.
    values
        The same numbers, by name; `exponent` among them for the chapter's models.
    make, make_for_filter
        Return the model of given values: for one scan on its own, and for a filter.
    write
        Returns name and content of a file of given values.
    """

    label: str
    kind: Kind
    family: str
    sliders: tuple[Slider, ...]
    values: Mapping[str, float]
    make: Callable[[Mapping[str, float]], Any] = field(repr=False)
    make_for_filter: Callable[[Mapping[str, float]], Any] = field(repr=False)
    write: Callable[[Mapping[str, float]], tuple[str, str]] = field(repr=False)

    def checked(self, values: Mapping[str, Any]) -> dict[str, float]:
        """Return the set's values with some of them changed; the chapter's weights scaled to their sum.

        Raises
        ------
        InvalidInputError
            If a name is unknown, or a value is no number within its slider.
        """
        result = dict(self.values)
        sliders = {slider.name: slider for slider in self.sliders}
        for name, value in values.items():
            if name not in sliders:
                raise InvalidInputError(f"parameters: expected names among {', '.join(sliders)}, got {name!r}")
            slider = sliders[name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not slider.low <= value <= slider.high:
                raise InvalidInputError(f"{name}: expected a number from {slider.low:g} to {slider.high:g}")
            result[name] = float(value)
        return self._scaled(result)

    def _scaled(self, values: dict[str, float]) -> dict[str, float]:
        """Return values whose weights sum to 1 (beam model), or to no more (field)."""
        if self.kind == "stack":
            return values
        names = [name for name in WEIGHTS if name in values]
        total = sum(values[name] for name in names)
        if total <= 0.0:
            raise InvalidInputError(f"{', '.join(names)}: expected a weight above 0")
        if abs(total - 1.0) > WEIGHT_SUM_TOLERANCE and (self.kind == "beam" or total > 1.0):
            values.update({name: values[name] / total for name in names})
        return values


def with_common_ends(sets: Sequence[ParameterSet]) -> list[ParameterSet]:
    """Return sets whose sliders take the values of every other set of their family."""
    result = []
    for one in sets:
        family = [other.values for other in sets if other.family == one.family]
        sliders = tuple(_holding(slider, [values[slider.name] for values in family]) for slider in one.sliders)
        result.append(replace(one, sliders=sliders))
    return result


def typical_sets(grid: OccupancyGrid, finder: RangeFinder, beside: Sequence[ParameterSet] = ()) -> list[ParameterSet]:
    """Return what there is without a file: a typical beam model, its field, and programs' defaults.

    There is a default of each model of the sets `beside` them, or of the first program's if there are none.
    """
    beam = BeamParameters(z_hit=0.8, z_short=0.08, z_max=0.02, z_rand=0.1, sigma_hit=0.15, lambda_short=0.4)
    field_parameters = LikelihoodFieldParameters(z_hit=0.8, z_rand=0.1, sigma_hit=0.15)
    counting = _Counting(in_filter=0.03, single=0.1, n_beams=None)
    first = next(
        (program.name, model.name)
        for program in STACKS.values()
        for model in program.models.values()
        if model.weight.of_field and model.weight.is_product
    )
    models = {f"{stack} {model}": (stack, model) for stack, program in STACKS.items() for model in program.models}
    asked = {models[one.family]: None for one in beside if one.kind == "stack"} or {first: None}
    defaults = [_default_set(stack, model, grid) for stack, model in asked]
    return [
        _chapter_set("typical beam model", "beam", beam, counting, grid, finder),
        _chapter_set("typical likelihood field", "field", field_parameters, counting, grid, finder),
        *(one for one in defaults if _refusal(one, finder) is None),
    ]


def fitted_sets(
    beam: BeamParameters, beams_count: ExponentLearning | None, learned: FieldLearning, grid: OccupancyGrid,
    finder: RangeFinder,
) -> list[ParameterSet]:  # fmt: skip
    """Return what was learned from a log: a beam model, and a likelihood field.

    Without an exponent of the beam model, it takes the field's.
    """
    single = learned.exponent if learned.exponents is None else learned.exponents.single.value
    field_counts = _Counting(learned.exponent, single, learned.n_beams)
    beam_counts = field_counts if beams_count is None else _Counting(
        beams_count.drive.value, beams_count.single.value, beams_count.n_beams
    )  # fmt: skip
    return [
        _chapter_set("beam model, fitted", "beam", beam, beam_counts, grid, finder),
        _chapter_set("likelihood field, fitted", "field", learned.parameters, field_counts, grid, finder),
    ]


def read_set(
    path: Path, grid: OccupancyGrid, finder: RangeFinder, stack: str | None = None, section: str | None = None
) -> ParameterSet:
    """Read a beam_model.yaml, a likelihood_field.yaml, or another program's file; FormatError if it cannot be used.

    The stack and the section are of another program's file; None finds out.
    """
    if own := own_model(path):
        is_field = own == "likelihood_field"
        saved = read_likelihood_field(path) if is_field else read_beam_model(path)
        counting = _Counting(saved.exponent, saved.single_scan_exponent, saved.n_beams)
        label = f"{path.name}: {'likelihood field' if is_field else 'beam model'}"
        return _chapter_set(label, "field" if is_field else "beam", saved.parameters, counting, grid, finder)
    file = read_stack_file(path, stack=stack, section=section)
    label = f"{path.name}: {file.program.title} {file.model}"
    one = _stack_set(label, file.stack, file.model, checked_values(file), grid, file)
    if (refusal := _refusal(one, finder)) is not None:
        raise FormatError(path, f"cannot be used with this log: {refusal}")
    return one


def _refusal(one: ParameterSet, finder: RangeFinder) -> str | None:
    """Return why a program would not run on scans of a sensor, such as more beams asked for than there are."""
    try:
        one.make(one.values).log_likelihood(Scan(np.full(finder.n_beams, finder.max_range), finder), np.zeros(3))
    except InvalidInputError as error:
        return str(error)
    return None


def _default_set(stack: str, model: str, grid: OccupancyGrid) -> ParameterSet:
    label = f"{STACKS[stack].title}'s default {model}"
    return _stack_set(label, stack, model, STACKS[stack].start(model), grid, None)


def _sliders(values: Mapping[str, float], names: Mapping[str, str] | None = None) -> tuple[Slider, ...]:
    """Return a slider for each value, with ends that hold it; `names` has those that `SLIDERS` knows."""
    return tuple(
        replace(_holding(SLIDERS[name if names is None else names[name]], [value]), name=name)
        for name, value in values.items()
    )


def _holding(slider: Slider, values: Sequence[float]) -> Slider:
    """Return a slider whose ends hold values."""
    lowest = min(values)
    low = min(slider.low, lowest) if lowest > 0.0 or not slider.logarithmic else slider.low
    return replace(slider, low=low, high=max(slider.high, *values))


class _Counting(NamedTuple):
    """How much beams count: in a filter, and in one scan on its own, which is what the page shows; None: all beams."""

    in_filter: float
    single: float
    n_beams: int | None


def _chapter_set(
    label: str, kind: Literal["beam", "field"], parameters: Any, counting: _Counting, grid: OccupancyGrid,
    finder: RangeFinder,
) -> ParameterSet:  # fmt: skip
    """Return a set of the beam model or the likelihood field; its slider `exponent` is that of one scan."""
    model: type[Any] = BeamModel if kind == "beam" else LikelihoodFieldModel
    seen = grid if kind == "beam" else hollowed(grid)
    name, text_of = _FILES[kind]

    def split(changed: Mapping[str, float]) -> tuple[Any, float]:
        numbers = dict(changed)
        exponent = numbers.pop("exponent")
        return type(parameters)(**numbers), exponent

    def make(changed: Mapping[str, float], share: float = 1.0) -> Any:
        own, exponent = split(changed)
        return model(seen, own, exponent=share * exponent, n_beams=counting.n_beams)

    # A filter's exponent is smaller, as scan after scan err alike: it keeps its ratio to one scan's.
    in_filter = counting.in_filter / counting.single

    def write(changed: Mapping[str, float]) -> tuple[str, str]:
        own, exponent = split(changed)
        n_beams = counting.n_beams or finder.n_beams
        origin = {"program": f"beamfield {__version__}", "command": "explore"}
        exponents = {"exponent": in_filter * exponent, "single_scan_exponent": exponent}
        return name, text_of(own, finder, provenance=origin, n_beams=n_beams, **exponents)

    values = {item.name: float(getattr(parameters, item.name)) for item in fields(parameters)}
    values["exponent"] = counting.single
    return ParameterSet(label, kind, kind, _sliders(values), values, make, partial(make, share=in_filter), write)


def _stack_set(
    label: str, stack: str, model: str, parameters: Any, grid: OccupancyGrid, file: StackFile | None
) -> ParameterSet:
    described = model_named(stack, model)
    built = build_model(stack, model, grid, parameters)
    idle = OF_RAYS if described.weight.of_field else OF_FIELDS
    names = {described.own_name(name): name for name in SLIDERS if described.has(name) and name not in idle}
    values = {own: float(getattr(parameters, own)) for own in names}
    reach = described.own_name("laser_likelihood_max_dist")

    def make(changed: Mapping[str, float]) -> Any:
        new = replace(parameters, **changed)
        # Tables of distances go only as far as they have to.
        if changed.get(reach) == values.get(reach):
            return built.with_parameters(new)
        return build_model(stack, model, grid, new)

    def write(changed: Mapping[str, float]) -> tuple[str, str]:
        moved = {name: value for name, value in changed.items() if value != values[name]}
        if file is not None:
            return file.section.path.name, file.section.with_values(file.by_names_in_file(moved))
        return f"{stack}.{STACKS[stack].syntax}", new_file_text(stack, asdict(replace(parameters, **changed)))

    family = f"{stack} {model}"
    return ParameterSet(label, "stack", family, _sliders(values, names), values, make, make, write)
