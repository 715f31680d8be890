"""Measure what the demo's values do in other simulated worlds: ``python benchmarks/demo_worlds.py DEMO``.

DEMO is the folder that `beamfield demo` wrote. nav2's filter, emulated, runs with its defaults and with the values that
the demo's calibration chose, on drives through worlds that differ from the demo's in one thing.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from beamfield.cli import demo
from beamfield.localization.replay_trials import run_trials
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.simulation.odometry import OdometryNoise
from beamfield.simulation.trajectory import DriveOptions
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.fit.replay_runs import shifted_map
from tables import print_table

SEEDS = range(10)
# Building and drive, neither of them the demo's.
WORLD_SEED = 3
FEW_PEOPLE = BeamParameters(0.82, 0.09, 0.03, 0.06, 0.04, 0.5)
MANY_PEOPLE = BeamParameters(0.71, 0.20, 0.03, 0.06, 0.04, 0.5)


@dataclass(frozen=True)
class World:
    """A world, by default the demo's."""

    size: tuple[float, float] = (40.0, 24.0)
    truth: BeamParameters = FEW_PEOPLE
    bursts: tuple[float, float] = (4.0, 1.0)
    odometry: OdometryNoise = field(default_factory=OdometryNoise)
    speed: float = 1.0
    bearings: tuple[float, float, int] = (-135.0, 135.0, 180)
    max_range: float = 12.0


WORLDS = {
    "as the demo's": World(),
    "readings cut short: 20% instead of 9%": World(truth=MANY_PEOPLE),
    "the same, in bursts of 8 degrees and 3 s": World(truth=MANY_PEOPLE, bursts=(8.0, 3.0)),
    "corridors of 70 m": World(size=(70.0, 20.0)),
    "wheels twice as noisy, scales off by 1 and 2%": World(odometry=OdometryNoise(0.02, 0.02, 0.03, 0.01, -0.02)),
    "360 degrees, 8 m": World(bearings=(-180.0, 179.0, 360), max_range=8.0),
    "half as fast": World(speed=0.5),
}


def main(folder: Path) -> None:
    """Run all worlds and print the table."""
    files = folder / demo.BEFORE, folder / "calibration" / demo.AFTER
    settings = [read_filter_settings(read_stack_file(path, stack="nav2")) for path in files]
    rows = []
    for name, world in WORLDS.items():
        grid = draw_floor_plan(seed=WORLD_SEED, width=world.size[0], height=world.size[1])
        first, last, n = world.bearings
        finder = RangeFinder.from_bearings(np.radians(np.linspace(first, last, n)), world.max_range, mount=(0.1, 0, 0))
        log = simulate_log(
            grid, finder, world.truth, duration=180.0, scan_rate=5.0, seed=WORLD_SEED,
            drive=DriveOptions(speed=world.speed), odometry_noise=world.odometry,
            dependence=Dependence(np.radians(world.bursts[0]), world.bursts[1]),
        ).only_sensor()  # fmt: skip
        maps = grid, shifted_map(grid, 0.5 * grid.resolution)
        trials = [run_trials(one.filter(its), log, SEEDS) for one, its in zip(settings, maps, strict=True)]
        row = {"world": name}
        for when, one in zip(("before", "after"), trials, strict=True):
            row |= {f"{when} [m]": f"{one.mean('mean'):.3f}", f"lost {when}": f"{one.n_lost} of {len(one)}"}
        rows.append(row)
    print_table(rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
