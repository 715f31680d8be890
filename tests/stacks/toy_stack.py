"""A sixth program that localises, as its one folder would hold it: ``w = prod(peak exp(-d^2 / 2 width^2) + floor)``."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.coordinates import SIGMAS, FitInputs, FitSpace, log_of, share
from beamfield.stacks.emulation.emulator import FieldModel, ScanEnds
from beamfield.stacks.emulation.field_table import AMCL_BRUSHFIRE, FieldTable, end_points, field_table
from beamfield.stacks.emulation.parameter_checks import check_counts, check_numbers
from beamfield.stacks.emulation.stack_map import read_as_stack
from beamfield.stacks.stack import FIELD_PRODUCT, Model, Stack, models


@dataclass(frozen=True)
class ToyParameters:
    toy_peak: float = 0.9
    toy_floor: float = 0.1
    toy_width: float = field(default=0.1, metadata={"unit": "m"})
    toy_far: float = field(default=1.0, metadata={"unit": "m"})
    toy_range: float = field(default=8.0, metadata={"unit": "m"})
    toy_step: int = 2

    def __post_init__(self) -> None:
        check_numbers(self, at_least_zero=("toy_peak", "toy_floor"), positive=("toy_width", "toy_far", "toy_range"))
        check_counts(self, toy_step=1)


@dataclass(frozen=True, eq=False)
class ToyField(FieldModel[ToyParameters]):
    stack: ClassVar[str] = "toy"
    model: ClassVar[str] = "toy_field"
    evidence_settings: ClassVar[tuple[str, ...]] = ("toy_step",)
    fitted_parameters: ClassVar[tuple[str, ...]] = ("toy_peak", "toy_floor", "toy_width")

    grid: OccupancyGrid
    parameters: ToyParameters
    _table: FieldTable = field(init=False, repr=False)

    def __post_init__(self):
        seen = read_as_stack(self.grid)
        object.__setattr__(self, "_table", field_table(seen, seen.occupied, "exact", AMCL_BRUSHFIRE, 1.0))

    def scan_ends(self, z):
        beams = np.arange(0, len(z.ranges), self.parameters.toy_step)
        beams = beams[np.isfinite(z.ranges[beams])]
        return ScanEnds(beams, self.parameters.toy_range, end_points(z.finder.mounts[beams], z.ranges[beams]))

    def beam_values(self, evidence, parameters=None):
        values = self._parameters_for(evidence, parameters)
        d = np.minimum(evidence.distances, values.toy_far, dtype=np.float64)
        return values.toy_peak * np.exp(-0.5 * (d / values.toy_width) ** 2) + values.toy_floor / values.toy_range

    def beam_terms(self, evidence, parameters=None):
        return np.log(self.beam_values(evidence, parameters))

    def log_of_sums(self, sums, n_beams, parameters):  # noqa: ARG002
        return sums


def _fit_space(model: Model, inputs: FitInputs) -> FitSpace:
    coordinates = share(("toy_peak", "toy_floor"), "toy_floor"), log_of("toy_width", 0.4, 0.01, 1.0, SIGMAS)
    settings = tuple({model.own_name("beam_step"): step} for step in inputs.steps(inputs.counts))
    return FitSpace(coordinates, settings, inputs.start, inputs.start)


SIGNS = frozenset(("toy_peak", "toy_floor", "toy_width"))
TOY = Stack(
    name="toy",
    title="the toy",
    models=models(
        Model(
            emulator=ToyField,
            parameters=ToyParameters,
            formula="Π p over beams",
            weight=FIELD_PRODUCT,
            fit_space=_fit_space,
            names={
                "z_hit": "toy_peak", "z_rand": "toy_floor", "sigma_hit": "toy_width", "laser_max_range": "toy_range",
                "laser_likelihood_max_dist": "toy_far", "beam_step": "toy_step",
            },
        )
    ),
    likeness=lambda section: 2.0 * section.count(SIGNS),
    signs=SIGNS,
    layout=("toy_localizer:",),
)  # fmt: skip
