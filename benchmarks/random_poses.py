"""What poses drawn at random do in the programs' filters: ``python benchmarks/random_poses.py [SEEDS]``.

The filters of nav2, ROS 1 and Beluga, emulated, with their defaults and four pairs of rates (recovery_alpha_slow and
recovery_alpha_fast) run over logs from a start 0.5 m and 15 degrees wide, and over the same logs without their middle
third, whose motion the odometry has not noticed: how far a filter is off, how many runs are lost, and how many find the
robot again. 20 seeds; ten minutes. Logs and maps are in ../shared/data beside the checkout, no part of this repository.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.localization.found import kidnapped, time_to_find
from beamfield.localization.parallel_runs import run_each
from beamfield.localization.replay import reference_start
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.filters.emulated_filter import EmulatedFilter
from beamfield.stacks.registry import STACKS
from fitted_poses import LASER
from real_logs import LOGS, read_log_and_map
from tables import print_table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
PROGRAMS = ("nav2", "ros1", "beluga")
MODELS = ("likelihood_field", "likelihood_field_prob")
TRUTH = BeamParameters(0.82, 0.09, 0.03, 0.06, 0.04, 0.5)
RATES = ((0.0, 0.0), (0.001, 0.1), (0.005, 0.2), (0.02, 0.5))


def logs() -> dict[str, tuple[SensorLog, OccupancyGrid]]:
    """Return logs with their maps: a poor map, one that a robot drew, and one that is right."""
    office = draw_floor_plan(seed=11)
    drive = simulate_log(office, LASER, TRUTH, duration=120.0, scan_rate=5.0, seed=11)
    hall = partial(read_log_and_map, DATA, map_path="wean_hall/derived_wean.yaml")
    places = {
        f"Wean Hall {i}": hall(f"wean_hall/robotdata{i}.log.gz", poses_path=f"wean_hall/reference_robotdata{i}.csv.gz")
        for i in (1, 3)
    }
    pioneer = read_log_and_map(DATA, *LOGS[3][1:])
    return {**places, "simulated office": (drive.only_sensor(), office), "simulated Pioneer": pioneer}


def seconds_to_find(replayed: EmulatedFilter, log: SensorLog, first: int, seed: int) -> float | None:
    """Return when one run finds the robot again."""
    return time_to_find(replayed.run(log, reference_start(log)[1], np.random.default_rng(seed)), log, first)


def main(n: int) -> None:
    """Print a row for each program, model and pair of rates."""
    places, rows = logs(), []
    for program in PROGRAMS:
        described = STACKS[program]
        assert described.filter is not None
        for model in MODELS:
            for slow, fast in RATES:
                settings = FilterSettings(
                    program, model, described.start(model), described.filter.motion(),
                    described.filter.parameters(recovery_alpha_slow=slow, recovery_alpha_fast=fast),
                )  # fmt: skip
                row: dict[str, Any] = {"program": program, "model": model, "slow, fast": f"{slow:g}, {fast:g}"}
                for name, (log, grid) in places.items():
                    replayed = settings.filter(grid)
                    trials = run_trials(replayed, log, range(n))
                    part, after = kidnapped(log[reference_start(log)[0] :])
                    found = run_each(partial(seconds_to_find, replayed, part, after), range(n))
                    row[name] = f"{trials.mean('mean'):.3f}, {trials.n_lost}, {sum(s is not None for s in found)}"
                rows.append(row)
                print(row, file=sys.stderr, flush=True)
    print_table(rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
