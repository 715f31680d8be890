"""How near `calibrate` comes to the truth without a map: bias and coverage on simulated logs with exact poses.

Each log is calibrated with the true map and with the maps that its halves draw. A parameter's bias is the mean of
estimate minus truth, over logs; its coverage the share of logs whose 95% interval holds the truth. Where the interval
of lambda_short is (0, inf), it counts as holding it.

Run: python benchmarks/cross_fit.py [--worlds N] [--first SEED] [--real FOLDER WITH DATA]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.calibration.cross_fit import CrossFitMaps, build_cross_fit_maps
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log

NAMES = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
DEGREES = np.radians(np.arange(-90.0, 90.5))
PEOPLE = Dependence(angle=0.1, time=1.0)
OPTIONS = CalibrationOptions(refine=False)


@dataclass(frozen=True)
class Case:
    """A kind of log: the sensor, how long it drives, and whether wrong readings come in bursts."""

    name: str
    truth: BeamParameters
    duration: float
    dependence: Dependence | None = None
    bearings: tuple[float, ...] = tuple(DEGREES)


SHARP = BeamParameters(0.82, 0.08, 0.04, 0.06, 0.03, 0.5)
BLURRED = BeamParameters(0.70, 0.15, 0.05, 0.10, 0.06, 1.0)
CASES = (
    Case("2 min", SHARP, 120.0),
    Case("5 min", SHARP, 300.0),
    Case("10 min", SHARP, 600.0),
    Case("2 min, bursts", SHARP, 120.0, PEOPLE),
    Case("5 min, bursts", SHARP, 300.0, PEOPLE),
    Case("10 min, bursts", SHARP, 600.0, PEOPLE),
    Case("5 min, much noise", BLURRED, 300.0),
    Case("5 min, 61 beams", SHARP, 300.0, None, tuple(DEGREES[::3])),
)
# Log, map (None: only without), poses.
REAL = {
    "Stage, exact poses": (
        "uob_stage_sim/simpath2.bag", "uob_stage_sim/derived_meeting_stageframe.yaml", None,
    ),
    "Wean Hall 1": (
        "wean_hall/robotdata1.log.gz", "wean_hall/derived_wean.yaml", "wean_hall/reference_robotdata1.csv.gz",
    ),
    "TurtleBot": (
        "olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/map/mac_1st_floor_final.yaml",
        "olin_mac_tb4/derived_ref_take_2.csv.gz",
    ),
    "Intel": ("carmen_radish_corrected/intel-corrected.log.gz", None, None),
    "Freiburg 079": ("carmen_radish_corrected/freiburg-079-corrected.log.gz", None, None),
}  # fmt: skip


def simulated(case: Case, world: int) -> tuple[SensorLog, OccupancyGrid]:
    grid = draw_floor_plan(seed=world)
    finder = RangeFinder.from_bearings(case.bearings, 12.0, name="laser")
    log = simulate_log(
        grid, finder, case.truth, duration=case.duration, scan_rate=2.0, seed=world, dependence=case.dependence
    )
    return log.only_sensor(), grid


def fits(log: SensorLog, grid: OccupancyGrid | None) -> Iterator[tuple[str, Calibration, float]]:
    """Calibrate with and without the map; yield the way, the result, and seconds of this process."""
    for way in ("map", "no map"):
        if way == "no map" or grid is not None:
            start = time.process_time()
            maps: OccupancyGrid | CrossFitMaps = build_cross_fit_maps(log) if way == "no map" else grid  # type: ignore[assignment]
            yield way, calibrate(log, maps, OPTIONS), time.process_time() - start


def share_used(result: Calibration) -> float:
    """Return the share of the used scans' beams that the result rests on."""
    table = result.table
    notes = [f.values["share_used"] for f in result.findings if f.name == "cross-fitted-map"]
    return notes[0] if notes else len(table) / (len(table) + table.n_unknown)


def simulate(worlds: range) -> None:
    print("| log | judged by | beams used | " + " | ".join(NAMES) + " |\n|---|---|---|" + "---|" * len(NAMES))
    held = {"map": [], "no map": []}
    for case in CASES:
        truth = np.array([getattr(case.truth, name) for name in NAMES])
        estimates, inside, used = ({"map": [], "no map": []} for _ in range(3))
        for world in worlds:
            log, grid = simulated(case, world)
            for way, result, _ in fits(log, grid):
                estimates[way].append([getattr(result.parameters, name) for name in NAMES])
                intervals = [result.intervals.intervals[name] for name in NAMES]
                inside[way].append([low <= t <= high for t, (low, high) in zip(truth, intervals, strict=True)])
                used[way].append(share_used(result))
        for way in ("map", "no map"):
            bias, covered = np.mean(estimates[way], axis=0) - truth, np.mean(inside[way], axis=0)
            held[way] += inside[way]
            cells = " | ".join(f"{b:+.4f} ({c:.0%})" for b, c in zip(bias, covered, strict=True))
            print(f"| {case.name} | {way} | {np.mean(used[way]):.0%} | {cells} |", flush=True)
    for way in ("map", "no map"):
        print(
            f"| all {len(held[way])} | {way} | | " + " | ".join(f"{c:.0%}" for c in np.mean(held[way], axis=0)) + " |"
        )


def real(data: Path) -> None:
    print("| log | judged by | beams used | " + " | ".join(NAMES) + " | range_offset | seconds |")
    print("|---|---|---|" + "---|" * (len(NAMES) + 2))
    for name, (path, map_path, poses) in REAL.items():
        read = read_log(data / path)
        log = (read if poses is None else attach_poses(read, read_trajectory(data / poses))).only_sensor()
        for way, result, seconds in fits(log, None if map_path is None else read_map(data / map_path)):
            p = result.parameters
            ends = [(getattr(p, name), *result.intervals.intervals[name]) for name in NAMES]
            values = " | ".join(f"{value:.3f} [{low:.3f}, {high:.3f}]" for value, low, high in ends)
            rest = f"{p.range_offset:.3f} | {seconds:.1f}"
            print(f"| {name} | {way} | {share_used(result):.0%} | {values} | {rest} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--first", type=int, default=0, help="seed of the first world")
    parser.add_argument("--real", type=Path)
    arguments = parser.parse_args()
    if arguments.real is None:
        simulate(range(arguments.first, arguments.first + arguments.worlds))
    else:
        real(arguments.real)


if __name__ == "__main__":
    main()
