"""Find robots in maps that nothing was tuned on: fitted trajectories, from anywhere and from a start, and `localize`.

Simulated drives of two minutes through maps that come with other programs, with three sensors and odometry that drifts;
the map of "changed" cases lacks half of the small things and has boxes that the drive has not met. A start is given
to half a metre and 11 degrees (standard deviations). A fit that is refused and a filter that says that the robot is
lost are neither "found" nor "wrong": a fit is wrong if more than 1% of its trusted poses are more than half a metre
off, the filter if it is in the median of the second half of the log.

With "elsewhere", each drive is fitted to the maps of the five other buildings instead, which is to be refused. With
"carried", filters that know the start run a minute of one drive and then another one of two minutes, to which the robot
is carried unnoticed: "found" is within half a metre in the median of the last 10 s, and "said" that the robot is lost.

Run: python benchmarks/other_maps.py [FOLDER [SEEDS [elsewhere|carried]]]     (../shared/data, 3)
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from beamfield.errors import BeamfieldError
from beamfield.geometry import FloatArray, between, compose
from beamfield.io.read_map import read_map
from beamfield.localization.lost_robot import find_lost_robot
from beamfield.localization.replay import PoseBelief
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.localization.trajectory import fit_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.log import simulate_log
from beamfield.simulation.trajectory import DriveOptions
from followed_logs import localizer_of
from tables import print_table

MAPS = ("aws_small_house", "berlin", "levine_lobby", "nav2_depot", "nav2_warehouse", "willow_garage_010")
# First and last bearing in degrees, beams, longest range in metres; true parameters of the beam model.
SENSORS = {
    "270 deg, 12 m": ((-135.0, 135.0, 180), 12.0, BeamParameters(0.82, 0.09, 0.03, 0.06, 0.04, 0.5)),
    "360 deg, 3.5 m": ((-179.0, 179.0, 180), 3.5, BeamParameters(0.82, 0.09, 0.03, 0.06, 0.02, 0.5)),
    "180 deg, 8 m, many people": ((-90.0, 90.0, 90), 8.0, BeamParameters(0.62, 0.25, 0.05, 0.08, 0.06, 0.5)),
}
# Metres that a right place is off at most, and the share of a fit's poses that may be more.
RIGHT, FEW = 0.5, 0.01
# How far off starts are, metres and radians.
START = (0.5, 0.5, 0.2)
# Square metres of what is small, of floor for each new box, and half the sides of these, metres.
SMALL, FLOOR, BOX = 1.0, 40.0, (0.2, 0.5)


def main(folder: Path, seeds: int) -> None:
    """Print how many of the drives are found, by map and by sensor."""
    runs: list[dict[str, Any]] = []
    for name in MAPS:
        grid = read_map(next((folder / "ros_maps" / name).glob("*.yaml")))
        for sensor in SENSORS:
            for seed in range(1, seeds + 1):
                log = drive(grid, sensor, seed)
                for changed in (False, True):
                    runs.append({"map": name, "sensor": sensor, "changed": "changed" if changed else "as it is"})
                    runs[-1] |= outcomes(log, changed_map(grid, seed) if changed else grid, seed)
                    print(runs[-1], file=sys.stderr, flush=True)
    for by in (("map", "changed"), ("sensor", "changed")):
        groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
        for run in runs:
            groups.setdefault(tuple(run[key] for key in by), []).append(run)
        print_table([dict(zip(by, group, strict=True)) | counts(rows) for group, rows in groups.items()])
        print()


def elsewhere(folder: Path, seeds: int) -> None:
    """Print how many drives are fitted to maps of other buildings."""
    grids = {name: read_map(next((folder / "ros_maps" / name).glob("*.yaml"))) for name in MAPS}
    rows = []
    for sensor in SENSORS:
        fits = [
            fitted(drive(grids[name], sensor, seed), grids[other])
            for name in MAPS for seed in range(1, seeds + 1) for other in MAPS if other != name
        ]  # fmt: skip
        rows.append({"sensor": sensor, "fits": len(fits), "refused": fits.count("refused")})
        print(rows[-1], file=sys.stderr, flush=True)
    print_table(rows)


def carried(folder: Path, seeds: int) -> None:
    """Print how many robots that are carried elsewhere are found, how soon, and what is said of the others."""
    groups: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for name in MAPS:
        grid = read_map(next((folder / "ros_maps" / name).glob("*.yaml")))
        for sensor in SENSORS:
            for seed in range(1, seeds + 1):
                whole = drive(grid, sensor, seed)
                log, n = joined(whole[: len(whole) // 2], drive(grid, sensor, seed + 20))
                for changed in ("as it is", "changed"):
                    filters = localizer_of(
                        "likelihood field", changed_map(grid, seed) if changed == "changed" else grid
                    )
                    for kind, part in (("carried", log), ("followed", whole)):
                        row = ending(filters, part, seed, n if part is log else 0)
                        groups.setdefault((kind, changed), []).append(row)
                        print(name, sensor, seed, changed, kind, row, file=sys.stderr, flush=True)
    print_table([
        {"robot": kind, "map": changed, "drives": len(rows), "found": sum(row["found"] for row in rows),
         "after [s], median": round(float(np.median([row["after"] for row in rows if row["found"]])), 1),
         "found, and said to be lost": sum(row["found"] and row["said"] for row in rows),
         "lost, and not said": sum(not row["found"] and not row["said"] for row in rows)}
        for (kind, changed), rows in groups.items()
    ])  # fmt: skip


def joined(first: SensorLog, then: SensorLog) -> tuple[SensorLog, int]:
    """Return two drives as one log whose odometry has not noticed the way between them, and where the second begins."""
    odometry = compose(first.odometry[-1], between(then.odometry[0], then.odometry))
    stamps = first.stamps[-1] + 0.2 + then.stamps - then.stamps[0]
    parts = {"ranges": then.ranges, "poses": then.poses, "odometry": odometry, "stamps": stamps}
    return replace(first, **{key: np.concatenate([getattr(first, key), part]) for key, part in parts.items()}), len(
        first
    )


def ending(localizer: ScanLocalizer, log: SensorLog, seed: int, n: int) -> dict[str, Any]:
    """Return whether the robot is at its place at the end, how long after scan n for good, and if it is said lost."""
    start = PoseBelief.around(log.poses[0] + np.random.default_rng(seed).normal(size=3) * START)
    found = localizer.run(log, start, np.random.default_rng(0))
    off, said = off_by(found.poses, log), find_lost_robot(log, localizer.grid, found.poses)
    far = np.flatnonzero(off > RIGHT)
    after = 0.0 if not len(far) else float(log.stamps[far[-1]] - log.stamps[n])
    lost = said is not None and said.name != "map-out-of-date"
    return {"found": bool(np.median(off[-50:]) <= RIGHT), "after": max(after, 0.0), "said": lost}


def drive(grid: OccupancyGrid, sensor: str, seed: int) -> SensorLog:
    """Return a log with exact poses, and odometry."""
    (first, last, n), max_range, truth = SENSORS[sensor]
    finder = RangeFinder.from_bearings(np.radians(np.linspace(first, last, n)), max_range, mount=(0.1, 0.0, 0.0))
    return simulate_log(
        grid, finder, truth, duration=120.0, scan_rate=5.0, seed=seed, drive=DriveOptions(speed=0.7),
        dependence=Dependence(np.radians(4.0), 1.0),
    ).only_sensor()  # fmt: skip


def changed_map(grid: OccupancyGrid, seed: int) -> OccupancyGrid:
    """Return the map without half of its small things, and with boxes on the floor."""
    rng, cells = np.random.default_rng(seed), grid.probability.copy()
    things, n = ndimage.label(grid.occupied, np.ones((3, 3)))
    areas = ndimage.sum(grid.occupied, things, range(1, n + 1)) * grid.resolution**2
    small = np.flatnonzero(areas < SMALL) + 1
    cells[np.isin(things, rng.permutation(small)[: len(small) // 2])] = 0.0
    free = np.argwhere(grid.free)
    for row, col in free[rng.integers(len(free), size=int(len(free) * grid.resolution**2 / FLOOR))]:
        half = int(rng.uniform(*BOX) / grid.resolution)
        box = np.s_[max(row - half, 0) : row + half, max(col - half, 0) : col + half]
        cells[box] = np.where(grid.free[box], 1.0, cells[box])
    return OccupancyGrid(cells, grid.resolution, grid.origin, grid.occupied_thresh, grid.free_thresh)


def outcomes(log: SensorLog, grid: OccupancyGrid, seed: int) -> dict[str, str]:
    """Return what becomes of a log in a map: of the fits, and of the filter."""
    rng = np.random.default_rng(seed)
    start = log.poses[0] + rng.normal(size=3) * START
    found = localizer_of("likelihood field", grid).run(log, None, np.random.default_rng(0))
    names = {one.name for one in found.findings}
    since = len(log) // 2
    said = find_lost_robot(log[since:], grid, found.poses[since:])
    lost = "not-found" in names or (said is not None and said.name == "robot-lost")
    off = off_by(found.poses[since:], log[since:])
    return {
        "fit": fitted(log, grid),
        "fit from a start": fitted(log, grid, start),
        "filter": "refused" if lost else "wrong" if np.median(off) > RIGHT else "found",
    }


def fitted(log: SensorLog, grid: OccupancyGrid, start: FloatArray | None = None) -> str:
    """Return "found", "wrong" or "refused"."""
    try:
        fit = fit_trajectory(log, grid, start=start)
    except BeamfieldError:
        return "refused"
    return "wrong" if np.mean(off_by(fit.poses, log)[fit.trusted] > RIGHT) > FEW else "found"


def off_by(poses: FloatArray, log: SensorLog) -> FloatArray:
    """Return how far poses are from the truth, metres."""
    off: FloatArray = np.hypot(*(poses - log.poses)[:, :2].T)
    return off


def counts(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return how many runs ended in which way."""
    return {"drives": len(rows)} | {
        f"{how}, {ended}": sum(row[how] == ended for row in rows)
        for how in ("fit", "fit from a start", "filter")
        for ended in ("found", "wrong")
    }


if __name__ == "__main__":
    run = elsewhere if "elsewhere" in sys.argv else carried if "carried" in sys.argv else main
    run(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[2] / "shared" / "data",
        int(sys.argv[2]) if len(sys.argv) > 2 else 3)  # fmt: skip
