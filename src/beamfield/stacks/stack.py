"""What there is to know about a program that localises, beside its formulas: its models, its names, its files.

Everything outside a program's own folder asks its `Stack`, never for its name. To add a program, describe it in a
folder of its own and add a line to `beamfield.stacks.registry`.

Parameters go by nav2's names here: z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short, laser_max_range,
laser_min_range, laser_likelihood_max_dist, max_beams, and beam_step (every so many-th beam). `Model.names` says what a
program calls them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Set
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal

from beamfield.calibration.odometry.result import OdometryCalibration
from beamfield.errors import InvalidInputError
from beamfield.finding import Finding
from beamfield.localization.replay import ReplayedFilter
from beamfield.models.beam_parameters import WEIGHTS, BeamParameters
from beamfield.stacks.coordinates import FitInputs, FitSpace
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.syntax.parameter_text import ParameterSection, Syntax, Value

SQRT_2PI = math.sqrt(2.0 * math.pi)
# Stacks' short readings vanish at rate 0 instead of becoming uniform.
LEAST_RATE = 0.01
# Where a stack leaves out the normaliser of short readings, it is that of an expected range of this share of max_range.
TYPICAL_SHARE = 0.4
# How sure `Stack.likeness` is of a section that no other program can have.
SURE = float("inf")


def with_sum_one(values: Mapping[str, float]) -> dict[str, float]:
    """Return values whose `WEIGHTS` are divided by their sum."""
    total = sum(values[name] for name in WEIGHTS)
    return {name: value / total if name in WEIGHTS else value for name, value in values.items()}


@dataclass(frozen=True)
class Weight:
    """How a scan's weight comes from the values p of its beams. Parameters translate within one kind, not across.

    Parameters
    ----------
    text
        In words.
    of_field
        Whether p comes from the distance between end point and obstacle; otherwise from ranges along rays.
    is_product
        Whether one p of 0 makes the weight 0; otherwise p's cubes are added up.
    has_exponent
        Whether a parameter makes up for beams that err together.
    """

    text: str
    of_field: bool
    is_product: bool
    has_exponent: bool = False


FIELD_CUBES = Weight("1 + the sum of p^3 over end points", of_field=True, is_product=False)
FIELD_PRODUCT = Weight("the product of p over end points", of_field=True, is_product=True)
RAY_CUBES = Weight("a sum of p^3 over ray casts", of_field=False, is_product=False)
RAY_LOGS = Weight("1 + the sum of log p over ray casts", of_field=False, is_product=True)
RAY_PRODUCT = Weight("the product of p over ray casts", of_field=False, is_product=True)


@dataclass(frozen=True, kw_only=True)
class Model:
    """One measurement model of a program.

    Parameters
    ----------
    emulator, parameters
        The class that computes its weights, and the dataclass of its parameters, under the names of its files.
    formula
        What a scan multiplies a particle's weight by, in one line.
    weight
        The kind of weight.
    fit_space
        What a fit moves.
    names
        What the program calls a parameter, where it differs from nav2.
    in_file
        Values of `Stack.model_key` that choose this model; the first is the one to write.
    hit_is_density
        Whether z_hit weighs a normal density; otherwise it is the height of the hit's peak.
    adds_one
        Whether 1 is added to a sum of cubes, so that a common factor of all p does not cancel.
    averages
        A switch with which the weight is the mean over beams; "" for none.
    off_values
        Switches that other programs lack, with the values that take no effect; they are written into translated files.
    left_out, refused
        Switches that other programs lack, with what is said where they are left out, or why nothing is translated.
    notes
        How it differs from other models with the same kind of weight, whatever the parameters.
    unknown_cells
        What unknown cells are to it: they "stop" rays, let them "pass", give them the "longest" range, or are "free".
    unknown_attracts
        A switch with which end points in unknown cells are worth more than in free ones; "" for none.
    only_surfaces
        A switch with which only the surfaces of solids are obstacles; "" for none.
    z_max_needs
        Why z_max may have no effect, and what to do then.
    from_chapter
        From the chapter's beam model, an expected range at which short readings keep their share, metres, and the side
        of the map's cells, metres, to this model's parameters under nav2's names; None if there is no way.
    chapter_notes
        What that loses, from the model, the chapter's parameters, the expected range and the side of cells.
    """

    emulator: type[StackModel[Any, Any]]
    parameters: type[Any]
    formula: str
    weight: Weight
    fit_space: Callable[[Model, FitInputs], FitSpace]
    names: Mapping[str, str] = field(default_factory=dict)
    in_file: tuple[Value, ...] = ()
    hit_is_density: bool = False
    adds_one: bool = False
    averages: str = ""
    off_values: Mapping[str, Value] = field(default_factory=dict)
    left_out: Mapping[str, str] = field(default_factory=dict)
    refused: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    unknown_cells: Literal["stop", "pass", "longest", "free"] = "free"
    unknown_attracts: str = ""
    only_surfaces: str = ""
    z_max_needs: tuple[str, str] | None = None
    from_chapter: Callable[[BeamParameters, float, float], dict[str, float]] | None = None
    chapter_notes: Callable[[Model, BeamParameters, float, float], list[str]] | None = None

    @property
    def name(self) -> str:
        """What users call it."""
        return self.emulator.model

    @property
    def factor_cancels(self) -> bool:
        """Whether a common factor of all p changes no ratio of weights."""
        return self.weight.is_product or not self.adds_one

    def own_name(self, name: str) -> str:
        """Return what the program calls a parameter."""
        return self.names.get(name, name)

    def own_names(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return values under the program's names."""
        return {self.own_name(name): value for name, value in values.items()}

    def has(self, name: str) -> bool:
        """Whether it has a parameter."""
        return self.own_name(name) in {item.name for item in fields(self.parameters)}

    def value(self, parameters: Any, name: str) -> Any:
        """Return the value of a parameter; None if it has none such."""
        return getattr(parameters, self.own_name(name), None)

    def sigma(self, parameters: Any, cell: float | None) -> float | None:
        """Return sigma_hit in metres; None if there is none, or it is in cells of a map whose side is not known."""
        sigma = self.value(parameters, "sigma_hit")
        side = cell if self.counts_in_cells else 1.0
        return None if sigma is None or side is None else float(sigma) * side

    @property
    def counts_in_cells(self) -> bool:
        """Whether sigma_hit is in cells of the map, not in metres."""
        name = self.own_name("sigma_hit")
        return any(item.name == name and item.metadata.get("unit") == "cells" for item in fields(self.parameters))

    def multiplies(self, parameters: Any) -> bool:
        """Whether the weight is a product over beams, with these parameters."""
        return self.weight.is_product and not (self.averages and getattr(parameters, self.averages))

    def solids_attract(self, parameters: Any) -> bool:
        """Whether end points inside solids are worth as much as on a wall, with these parameters."""
        return self.weight.of_field and not (self.only_surfaces and getattr(parameters, self.only_surfaces))

    def beam_values(self, learned: BeamParameters, typical_range: float, cell: float) -> dict[str, float]:
        """Return the chapter's beam model in the program's parameters; see `from_chapter`."""
        if self.from_chapter is None:
            raise InvalidInputError(f"{self.name}: none of its parameter values approximates the chapter's beam model")
        return self.own_names(self.from_chapter(learned, typical_range, cell))

    def with_learned(self, parameters: Any, inputs: FitInputs) -> tuple[Any, bool]:
        """Return parameters that give beams the learned densities up to a common factor, and whether there are any."""
        if inputs.learned is None:
            return parameters, False
        typical = TYPICAL_SHARE * inputs.finder.max_range
        return replace(parameters, **self.beam_values(inputs.learned, typical, inputs.grid.resolution)), True


@dataclass(frozen=True, kw_only=True)
class OtherNode:
    """A second node of a program that takes the same parameters under other names, with other defaults.

    Parameters
    ----------
    names
        What it calls a parameter of the dataclass.
    defaults
        By the dataclass's names.
    """

    names: Mapping[str, str]
    defaults: Mapping[str, Value]


@dataclass(frozen=True, kw_only=True)
class StackFilter:
    """The particle filter of a program.

    Parameters
    ----------
    motion, parameters
        Dataclasses of what its files say about the odometry and about the particles, under its names; `motion` is a
        `MotionModel`.
    build
        Returns the filter, from a measurement model, a motion model and parameters of these classes.
    section
        From the section of the measurement model to one with the parameters of these classes, under their names and in
        their units, where a file has them elsewhere; None where they stand in the same section.
    """

    motion: type[Any]
    parameters: type[Any]
    build: Callable[[StackModel[Any, Any], Any, Any], ReplayedFilter]
    section: Callable[[ParameterSection], ParameterSection] | None = None


@dataclass(frozen=True, kw_only=True)
class Stack:
    """A program that localises.

    Parameters
    ----------
    name, title
        What commands call it, and what sentences do.
    models
        By name; the first is the one it runs if its file names none.
    likeness
        How much a section of a file looks like this program's: about the number of its own names in it, 0 for not at
        all. It is taken for that of the stacks with the largest number.
    signs
        Names of parameters; a section with one of them holds parameters of a measurement model.
    nodes, packages
        Its node in launch and YAML files, and the ROS packages of it.
    syntax
        Of its files.
    layout
        The lines above the parameters in a new file, each one level deeper.
    in_launch_files
        Whether its parameters may stand in a launch file.
    model_key
        The parameter that chooses the model; "" if there is only one.
    unknown_model
        What it does with the name of a model that it does not have, in which the default is examined; "" refuses such
        files.
    declares
        Further parameters that it declares, with values of their types.
    limits
        Least and largest value of parameters for which it declares them; with others it does not start.
    is_typed
        Whether it declares each parameter's type and stops if the file has another: nodes of ROS 2 do.
    is_roscpp
        Whether ROS 1's C++ library reads its parameters: that rounds a number with a fraction where it wants a whole
        one, and takes no number for a truth value.
    wrong_type, too_few_beams
        What it does with a value of a wrong type, and with too small a max_beams.
    other_node
        A second node of it.
    formulas
        Stacks with the same word here have the same formulas under other names; "" for its own.
    half_cell_low
        Whether it centres cell (0, 0) on the map's origin, so that walls lie half a cell low.
    turned_map
        What it makes of a map whose origin has a yaw; "" if it honours that.
    wants_extremes
        Whether cells of the map message that are neither 0 nor 100 are unknown to it.
    takes_lesser_limit
        Whether the sensor's longest range holds where it is less than laser_max_range, or that is not positive.
    drops_beyond
        Whether readings beyond laser_max_range are cut down or count for nothing.
    short_is_longest
        Whether it turns readings below laser_min_range into the longest range.
    cuts_at_cells
        Whether it cuts distances off at a whole number of cells.
    asserts_p
        Whether it asserts that no beam scores more than 1.
    averages_scans
        Whether the averages that say how many poses to draw at random are of weights before they are normalised, which
        differ from scan to scan as well.
    beams_taken
        Which beams it takes, for readers; "" for no word on it.
    off_map
        What an end point off the map is worth, if not what the maximum distance is.
    flatter
        What makes its weights flatter.
    filter
        Its particle filter; None if that is not emulated.
    motion_key
        The parameter that chooses the motion model; "" if there is only one.
    motions
        By the values of `motion_key`, the default first: the motion model's parameters from calibrated odometry.
    omni_motion
        By the values of `motion_key`: that of the motion model whose alphas are those of `OmniMotion`, the same one
        where it is that already; none for models that are not to be left.
    motion_elsewhere
        Where the motion model's parameters belong, for people, if not beside the measurement model's: they are then
        said, not written.
    checks
        Findings of its own: called with what `beamfield.stacks.doctor` looks at.
    """

    name: str
    title: str
    models: Mapping[str, Model]
    likeness: Callable[[ParameterSection], float]
    signs: frozenset[str]
    nodes: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    syntax: Syntax = "yaml"
    layout: tuple[str, ...] = ()
    in_launch_files: bool = False
    model_key: str = ""
    unknown_model: str = ""
    declares: Mapping[str, Value] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    is_typed: bool = False
    is_roscpp: bool = False
    wrong_type: str = "the program stops, or uses another value without a message"
    too_few_beams: str = "the model's formula is meaningless with it"
    other_node: OtherNode | None = None
    formulas: str = ""
    half_cell_low: bool = False
    turned_map: str = ""
    wants_extremes: bool = False
    takes_lesser_limit: bool = False
    drops_beyond: bool = True
    short_is_longest: bool = False
    cuts_at_cells: bool = False
    asserts_p: bool = False
    averages_scans: bool = False
    beams_taken: str = ""
    off_map: str = ""
    flatter: str = "fewer beams or a wider sigma_hit"
    filter: StackFilter | None = None
    motion_key: str = ""
    motions: Mapping[str, Callable[[OdometryCalibration], dict[str, float]]] = field(default_factory=dict)
    omni_motion: Mapping[str, str] = field(default_factory=dict)
    motion_elsewhere: str = ""
    checks: tuple[Callable[[Any], Iterator[Finding]], ...] = ()

    @property
    def default_model(self) -> str:
        """The model it runs if its file names none."""
        return next(iter(self.models))

    @property
    def parameter_names(self) -> frozenset[str]:
        """The names of all parameters that its models have."""
        return frozenset(item.name for model in self.models.values() for item in fields(model.parameters))

    def model(self, name: str) -> Model:
        """Return the model of this name; raise with the known names."""
        if name not in self.models:
            raise InvalidInputError(f"model: {self.name} has {', '.join(self.models)}, got {name!r}")
        return self.models[name]

    def choice(self, model: str) -> dict[str, Value]:
        """Return the parameter that chooses a model, with its value; none if there is only one model."""
        return {self.model_key: self.model(model).in_file[0]} if self.model_key else {}

    def start(self, model: str) -> Any:
        """Return the program's default parameters for a model."""
        return self.model(model).parameters(**self.choice(model))

    def motion_from(self, chosen: str | None) -> Callable[[OdometryCalibration], dict[str, float]] | None:
        """Return what turns calibrated odometry into parameters of the motion model; None if it has no noise to set.

        `chosen` is the value of `motion_key`; None for the default.
        """
        return self.motions.get(next(iter(self.motions), "") if chosen is None or not self.motion_key else chosen)

    def has_same_formulas(self, other: Stack) -> bool:
        """Whether values keep their meaning in the other program, under its names."""
        return self.name == other.name or (self.formulas != "" and self.formulas == other.formulas)


def models(*described: Model) -> dict[str, Model]:
    """Return models by name, for `Stack.models`."""
    return {model.name: model for model in described}


def counterpart(name: str, own: Set[str]) -> str:
    """Return which of a program's names means what another's name does, but for laser_ in front; "" if none does."""
    other = name.removeprefix("laser_") if name.startswith("laser_") else f"laser_{name}"
    return other if other in own else ""
