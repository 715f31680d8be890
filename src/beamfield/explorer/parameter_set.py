"""Sets of parameters that the explorer shows side by side: each a model, its values, and how far its sliders go."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal

from beamfield import __version__
from beamfield.errors import InvalidInputError
from beamfield.io.parameters.beam_model_file import beam_model_text, read_beam_model
from beamfield.io.parameters.likelihood_field_file import (
    is_likelihood_field,
    likelihood_field_text,
    read_likelihood_field,
)
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import WEIGHT_SUM_TOLERANCE, BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder
from beamfield.stacks.files.new_file import new_file_text
from beamfield.stacks.files.other_files import is_beam_model
from beamfield.stacks.files.parameter_file import StackFile, read_stack_file
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.registry import STACKS, build_model, model_named

Kind = Literal["beam", "field", "stack"]
WEIGHTS = ("z_hit", "z_short", "z_max", "z_rand")


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
    sliders
        What can be moved.
    values
        The same numbers, by name; `exponent` among them for the chapter's models.
    make
        Returns the model of given values.
    write
        Returns name and content of a file of given values.
    """

    label: str
    kind: Kind
    sliders: tuple[Slider, ...]
    values: Mapping[str, float]
    make: Callable[[Mapping[str, float]], Any] = field(repr=False)
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


def typical_sets(grid: OccupancyGrid, finder: RangeFinder) -> list[ParameterSet]:
    """Return what there is without a file: a typical beam model, its field, and the first program's default."""
    beam = {"z_hit": 0.8, "z_short": 0.08, "z_max": 0.02, "z_rand": 0.1, "sigma_hit": 0.15, "lambda_short": 0.4}
    program, model = next(
        (program, model)
        for program in STACKS.values()
        for model in program.models.values()
        if model.weight.of_field and model.weight.is_product
    )
    return [
        _beam_set("typical beam model", beam, 0.1, grid, finder),
        _field_set("typical likelihood field", {"z_hit": 0.8, "z_rand": 0.1, "sigma_hit": 0.15}, 0.1, grid, finder),
        _stack_set(f"{program.title}'s default", program.name, model.name, model.parameters(), grid, None),
    ]


def fitted_sets(
    beam: BeamParameters,
    field_parameters: LikelihoodFieldParameters,
    exponent: float,
    grid: OccupancyGrid,
    finder: RangeFinder,
) -> list[ParameterSet]:
    """Return what was learned from a log; the exponent is for one scan."""
    return [
        _beam_set("beam model, fitted", _numbers(beam), exponent, grid, finder),
        _field_set("likelihood field, fitted", _numbers(field_parameters), exponent, grid, finder),
    ]


def read_set(path: Path, grid: OccupancyGrid, finder: RangeFinder) -> ParameterSet:
    """Read a parameter file: a beam_model.yaml, a likelihood_field.yaml, or another program's.

    Raises
    ------
    FormatError
        If the file cannot be used.
    """
    if is_likelihood_field(path):
        saved_field = read_likelihood_field(path)
        values, exponent = _numbers(saved_field.parameters), saved_field.single_scan_exponent
        return _field_set(f"{path.name}: likelihood field", values, exponent, grid, finder)
    if is_beam_model(path):
        saved = read_beam_model(path)
        label = f"{path.name}: beam model"
        return _beam_set(label, _numbers(saved.parameters), saved.single_scan_exponent, grid, finder)
    file = read_stack_file(path)
    label = f"{path.name}: {file.program.title} {file.model}"
    return _stack_set(label, file.stack, file.model, checked_values(file), grid, file)


def _sliders(values: Mapping[str, float], names: Mapping[str, str] | None = None) -> tuple[Slider, ...]:
    """Return a slider for each value, with ends that hold it; `names` has those that `SLIDERS` knows."""
    found = []
    for name, value in values.items():
        slider = SLIDERS[name if names is None else names[name]]
        low = min(slider.low, value) if value > 0.0 or not slider.logarithmic else slider.low
        found.append(replace(slider, name=name, low=low, high=max(slider.high, value)))
    return tuple(found)


def _numbers(parameters: Any) -> dict[str, float]:
    return {item.name: float(getattr(parameters, item.name)) for item in fields(parameters)}


def _beam_set(
    label: str, values: Mapping[str, float], exponent: float, grid: OccupancyGrid, finder: RangeFinder
) -> ParameterSet:
    def make(changed: Mapping[str, float]) -> BeamModel:
        numbers = dict(changed)
        power = numbers.pop("exponent")
        return BeamModel(grid, BeamParameters(**numbers), exponent=power)

    def write(changed: Mapping[str, float]) -> tuple[str, str]:
        numbers = dict(changed)
        power = numbers.pop("exponent")
        text = beam_model_text(
            BeamParameters(**numbers), finder, provenance=_origin(), exponent=power, single_scan_exponent=power,
            n_beams=finder.n_beams,
        )  # fmt: skip
        return "beam_model.yaml", text

    all_values = {**values, "exponent": exponent}
    return ParameterSet(label, "beam", _sliders(all_values), all_values, make, write)


def _field_set(
    label: str, values: Mapping[str, float], exponent: float, grid: OccupancyGrid, finder: RangeFinder
) -> ParameterSet:
    def make(changed: Mapping[str, float]) -> LikelihoodFieldModel:
        numbers = dict(changed)
        power = numbers.pop("exponent")
        return LikelihoodFieldModel(grid, LikelihoodFieldParameters(**numbers), exponent=power)

    def write(changed: Mapping[str, float]) -> tuple[str, str]:
        numbers = dict(changed)
        power = numbers.pop("exponent")
        text = likelihood_field_text(
            LikelihoodFieldParameters(**numbers), finder, provenance=_origin(), exponent=power, n_beams=finder.n_beams
        )
        return "likelihood_field.yaml", text

    all_values = {**values, "exponent": exponent}
    return ParameterSet(label, "field", _sliders(all_values), all_values, make, write)


def _stack_set(
    label: str, stack: str, model: str, parameters: Any, grid: OccupancyGrid, file: StackFile | None
) -> ParameterSet:
    described = model_named(stack, model)
    built = build_model(stack, model, grid, parameters)
    names = {described.own_name(name): name for name in SLIDERS if described.has(name)}
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
        return f"{stack}.yaml", new_file_text(stack, changed)

    return ParameterSet(label, "stack", _sliders(values, names), values, make, write)


def _origin() -> dict[str, Any]:
    return {"program": f"beamfield {__version__}", "command": "explore"}
