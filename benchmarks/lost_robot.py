"""How many readings agree with the map where a filter takes the robot to be: with good input, and with bad.

Real and simulated logs run through our own filter and through nav2's as it ships, emulated: as they are, with odometry
whose turns or direction are reversed or that stands still, and from anywhere in the maps of other buildings (ours).
Printed, per log and kind of input: the lowest and the highest median agreement over filters, maps and seeds, and how
many runs `beamfield localize` calls lost.

Run: python benchmarks/lost_robot.py [FOLDER [SEEDS]]     (../shared/data, 5; only good input has more than one seed)
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from beamfield.geometry import FloatArray, between, chained
from beamfield.localization.replay import PoseBelief, ReplayedFilter, reference_start
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import LEAST_AGREEMENT, scan_agreement
from beamfield.sensors import SensorLog
from beamfield.stacks.files.filter_file import FilterSettings, read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file
from followed_logs import LOGS, localizer_of, offices
from real_logs import read_log_and_map
from tables import print_table

WRONG = {"turns reversed": (1.0, -1.0, -1.0), "direction reversed": (-1.0, -1.0, 1.0), "stands still": (0.0, 0.0, 0.0)}
NAV2 = "amcl:\n  ros__parameters:\n    laser_model_type: likelihood_field\n"
Logs = dict[str, tuple[SensorLog, OccupancyGrid]]


def main(folder: Path, seeds: int) -> None:
    """Print one row per log and kind of input."""
    logs: Logs = {name: read_log_and_map(folder, *paths) for name, paths in LOGS.items()}
    logs.update(offices())
    nav2, rows = nav2_settings(), []
    for name, (log, grid) in logs.items():
        first, start = reference_start(log)
        part = log[first:]
        tried: dict[str, list[float]] = {}
        for followed, replayed in (("ours", localizer_of("likelihood field", grid)), ("nav2", nav2.filter(grid))):
            tried[f"as it is, {followed}"] = [agreement(replayed, part, grid, start, seed) for seed in range(seeds)]
            for wrong, signs in WRONG.items():
                mistaken = replace(part, odometry=odometry_with(part.odometry, np.array(signs)))
                tried.setdefault(f"odometry {wrong}", []).append(agreement(replayed, mistaken, grid, start, 0))
        tried["other buildings"] = [
            agreement(localizer_of("likelihood field", elsewhere), part, elsewhere, None, 0)
            for elsewhere in other_maps(name, logs)
        ]
        for what, found in tried.items():
            rows.append({
                "log": name, "input": what, "runs": len(found), "lowest": min(found), "highest": max(found),
                "called lost": sum(one < LEAST_AGREEMENT for one in found),
            })  # fmt: skip
            print(rows[-1], file=sys.stderr)
    print_table(rows, digits=2)


def agreement(replayed: ReplayedFilter, log: SensorLog, grid: OccupancyGrid, start: PoseBelief | None, seed: int
              ) -> float:  # fmt: skip
    """Return the median agreement of one run."""
    found = replayed.run(log, start, np.random.default_rng(seed))
    return float(np.nanmedian(scan_agreement(log, grid, found.poses)))


def odometry_with(odometry: FloatArray, signs: FloatArray) -> FloatArray:
    """Return odometry whose steps have other signs; NaN where there is none."""
    known = np.isfinite(odometry).all(axis=1)
    changed: FloatArray = np.full_like(odometry, np.nan)
    steps = between(odometry[known][:-1], odometry[known][1:])
    changed[known] = chained(np.zeros(3), signs * steps)
    return changed


def other_maps(name: str, logs: Logs) -> Iterator[OccupancyGrid]:
    """Yield the maps of other buildings, each once."""
    for other in ("Wean Hall 1", "TurtleBot 4", "simulated Pioneer", "simulated office 11", "simulated office 12"):
        if other != name and not (name.startswith("Wean") and other.startswith("Wean")):
            yield logs[other][1]


def nav2_settings() -> FilterSettings:
    """Return nav2's defaults."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "nav2.yaml"
        path.write_text(NAV2)
        return read_filter_settings(read_stack_file(path, stack="nav2"))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2] / "shared" / "data",
         int(sys.argv[2]) if len(sys.argv) > 2 else 5)  # fmt: skip
