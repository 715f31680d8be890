"""Describe a program of your own, so that `calibrate --stack`, `doctor` and `translate` know it.

The toy localizer weighs poses by ``w = prod(peak exp(-d^2 / 2 width^2) + floor / range)``. In beamfield this
file would be a folder in `beamfield.stacks`, with one line in the registry; here the line is in `main`. With a
`StackFilter` in the Stack's `filter`, `evaluate` would know it, too.

Run: python examples/own_stack.py
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

import beamfield as bf
from beamfield.stacks.coordinates import SIGMAS, FitInputs, FitSpace, log_of, share
from beamfield.stacks.emulation.emulator import FieldModel, ScanEnds
from beamfield.stacks.emulation.field_table import AMCL_BRUSHFIRE, FieldTable, end_points, field_table
from beamfield.stacks.emulation.parameter_checks import check_counts, check_numbers
from beamfield.stacks.emulation.stack_map import read_as_stack
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.registry import STACKS, build_model
from beamfield.stacks.stack import FIELD_PRODUCT, Model, Stack
from beamfield.stacks.translation.translate import translate


@dataclass(frozen=True)
class ToyParameters:
    """What its files hold, under their names, with its defaults."""

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
    """Its weight of a scan, in its own arithmetic."""

    stack: ClassVar[str] = "toy"
    model: ClassVar[str] = "toy_field"
    evidence_settings: ClassVar[tuple[str, ...]] = ("toy_step",)
    fitted_parameters: ClassVar[tuple[str, ...]] = ("toy_peak", "toy_floor", "toy_width")

    grid: bf.OccupancyGrid
    parameters: ToyParameters
    _table: FieldTable = field(init=False, repr=False)

    def __post_init__(self):
        seen = read_as_stack(self.grid)
        object.__setattr__(self, "_table", field_table(seen, seen.occupied, "exact", AMCL_BRUSHFIRE, 1.0))

    def scan_ends(self, z):
        """Return which beams it looks at, and where they end."""
        beams = np.arange(0, len(z.ranges), self.parameters.toy_step)
        beams = beams[np.isfinite(z.ranges[beams])]
        return ScanEnds(beams, self.parameters.toy_range, end_points(z.finder.mounts[beams], z.ranges[beams]))

    def beam_values(self, evidence, parameters=None):
        """Return its value p of each beam."""
        values = self._parameters_for(evidence, parameters)
        d = np.minimum(evidence.distances, values.toy_far, dtype=np.float64)
        return values.toy_peak * np.exp(-0.5 * (d / values.toy_width) ** 2) + values.toy_floor / values.toy_range

    def beam_terms(self, evidence, parameters=None):
        """Return what it adds up over beams."""
        return np.log(self.beam_values(evidence, parameters))

    def log_of_sums(self, sums, n_beams, parameters):  # noqa: ARG002
        """Return the logarithm of the weight from those sums."""
        return sums


def _fit_space(model: Model, inputs: FitInputs) -> FitSpace:
    coordinates = share(("toy_peak", "toy_floor"), "toy_floor"), log_of("toy_width", 0.4, 0.01, 1.0, SIGMAS)
    settings = tuple({model.own_name("beam_step"): step} for step in inputs.steps(inputs.counts))
    return FitSpace(coordinates, settings, inputs.start, inputs.start)


SIGNS = frozenset(("toy_peak", "toy_floor", "toy_width"))
TOY = Stack(
    name="toy",
    title="the toy",
    models={"toy_field": Model(
            emulator=ToyField,
            parameters=ToyParameters,
            formula="Π p over beams",
            weight=FIELD_PRODUCT,
            fit_space=_fit_space,
            names={
                "z_hit": "toy_peak", "z_rand": "toy_floor", "sigma_hit": "toy_width", "laser_max_range": "toy_range",
                "laser_likelihood_max_dist": "toy_far", "beam_step": "toy_step",
            },
        )},
    likeness=lambda section: 2.0 * section.count(SIGNS),
    signs=SIGNS,
    layout=("toy_localizer:",),
)  # fmt: skip


def main() -> None:
    """Register the program, read a file of it, weigh poses as it does, and translate its values for nav2."""
    STACKS["toy"] = TOY
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "toy.yaml"
        path.write_text("toy_localizer:\n  toy_peak: 0.8\n  toy_floor: 0.2\n  toy_width: 0.15\n")
        file = read_stack_file(path)
        grid = bf.draw_floor_plan(seed=1)
        laser = bf.RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.0, 3.0)), max_range=8.0)
        sensor = bf.BeamParameters(z_hit=0.8, z_short=0.1, z_max=0.05, z_rand=0.05, sigma_hit=0.05, lambda_short=0.5)
        log = bf.simulate_log(grid, laser, sensor, duration=5.0).only_sensor()
        model = build_model("toy", file.model, grid, checked_values(file))
        here, beside = model.log_likelihood(log[3], [log.poses[3], log.poses[3] + [0.5, 0.0, 0.0]])
        print(f"{path.name} is a file of {file.program.title}")
        print(f"log weight at the true pose {here:.1f}, half a metre beside it {beside:.1f}")
        print(f"for nav2: {translate(file, 'nav2', max_range=8.0, n_beams=60).values}")
    del STACKS["toy"]


if __name__ == "__main__":
    main()
