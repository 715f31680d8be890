"""How many particles nav2's filter needs: its error with fewer and fewer, by what the motion noise is.

The emulated filter runs over whole logs from one start, 20 seeds, with as many particles in every update. One log is a
simulated office (exact poses, wheels 2 and 3% off), the others are real or Stage's.

Run: python benchmarks/particle_counts.py FOLDER     (the logs and maps, ../../shared/data; a minute)
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from beamfield.cli.demo import DEFAULTS
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file
from other_robots import PRODUCT, USUAL
from real_logs import LOGS, read_log_and_map
from tables import print_table

SEEDS = range(20)
COUNTS = (50, 100, 500, 2000)
NOISE = "    alpha1: 0.1\n    alpha2: 0.1\n    alpha3: 0.02\n    alpha4: 0.02\n"
FILES = {
    "likelihood_field": DEFAULTS,
    "likelihood_field_prob": PRODUCT,
    "likelihood_field_prob, alphas 0.1 and 0.02": PRODUCT + NOISE,
}


def logs(folder: Path) -> dict[str, tuple[SensorLog, OccupancyGrid]]:
    """Return logs with reference poses, and their maps."""
    office = draw_floor_plan(seed=12)
    named = {"simulated office": (USUAL.drive(office, 90.0, 5).only_sensor(), office)}
    for name, (_, *paths) in zip(("Wean Hall 1", "TurtleBot 4", "Stage Pioneer"), (LOGS[0], *LOGS[2:]), strict=True):
        named[name] = read_log_and_map(folder, *paths)
    return named


def main(folder: Path) -> None:
    """Run the filters and print the table."""
    rows, known = [], logs(folder)
    for what, text in FILES.items():
        for count in COUNTS:
            row = {"nav2 with": what, "particles": str(count)}
            with tempfile.TemporaryDirectory() as scratch:
                path = Path(scratch) / "nav2.yaml"
                path.write_text(f"{text}    min_particles: {count}\n    max_particles: {count}\n")
                settings = read_filter_settings(read_stack_file(path, stack="nav2"))
            for name, (log, grid) in known.items():
                trials = run_trials(settings.filter(grid), settings.at_ticks(log), SEEDS)
                row[name] = f"{trials.mean('mean'):.3f}" + (f", {trials.n_lost} lost" if trials.n_lost else "")
            rows.append(row)
    print_table(rows)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
