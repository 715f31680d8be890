"""Fit trajectories to logs, and compare with exact truth (simulations) or with references (real logs).

Run: python benchmarks/trajectory.py [simulated|real|halves|wheels|crowds|all] [FOLDER WITH DATA]

- Simulations have exact truth: offices, a corridor 60 m long without ends in sight, and a Pioneer's sensor in the map
  that the real Stage log was recorded in. Odometry drifts with the noise of `OdometryNoise`.
- Stage's own log has exact poses too, but the map that comes with the data is about 0.3% too small for them, and its
  true poses are up to one sample (0.1 s) beside the scans. The second row has the map 0.36% larger.
- Wean Hall and TurtleBot 4 have references that were fitted to the same maps, good to about 0.05 m.
- "halves" fits the poses of the real logs by every other beam, as ``beamfield calibrate`` does for a log without poses.
- "wheels" fits the real logs, three simulated offices, and intel in a map of its own, with odometry that is wrong
  throughout: in its distances, in its turns, or turning per metre. Half a metre off is wrong.

- "crowds" fits the same logs but intel with people drawn around the robot, who go with it; two crowds of each size.

"in 95%" is the share of scans whose true position lies in the ellipse; "NEES" the mean square of its error in standard
deviations, per axis: 1 if the ellipses are right, less if they are too large. "seconds" are the process's own.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from beamfield.errors import TrajectoryNotFoundError
from beamfield.geometry import FloatArray, between, chained, wrap_angle
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.localization.fitted_poses import cross_fit_poses
from beamfield.localization.trajectory import TrajectoryFit, fit_trajectory, position_deviations
from beamfield.maps.mapping import build_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import drawn_readings, simulate_log
from beamfield.simulation.odometry import OdometryNoise, noisy_odometry
from crowd import with_crowd
from fitted_poses import walls_moved
from followed_logs import offices
from half_maps import LOGS as MAPLESS
from tables import print_table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
CHI_SQUARE_95 = 5.991
# Metres that a pose of a course that was found may be off.
RIGHT = 0.5
PEOPLE_ABOUT = (0, 4, 10, 20, 40)
SENSOR = BeamParameters(0.80, 0.10, 0.03, 0.07, 0.05, 0.6)
PEOPLE = BeamParameters(0.55, 0.30, 0.05, 0.10, 0.05, 0.4)
FINE = BeamParameters(0.85, 0.06, 0.03, 0.06, 0.015, 0.6)
POOR_WHEELS = OdometryNoise(0.03, 0.025, 0.04, 0.02, -0.03)
Case = tuple[str, SensorLog, OccupancyGrid]


def main(which: str, data: Path) -> None:
    if which == "halves":
        print_table([halved(*case) for case in real(data)], digits=3)
        return
    if which in ("wheels", "crowds"):
        {"wheels": wheels, "crowds": crowds}[which](data)
        return
    cases = {"simulated": simulated, "real": real}
    for name in cases if which == "all" else (which,):
        rows = []
        for case in cases[name](data):
            rows.append(measured(*case))
            print(rows[-1], file=sys.stderr)
        print_table(rows, digits=3)
        averages = (f"{key} {np.mean([row[key] for row in rows]):.3f}" for key in ("NEES", "in 95%"))
        print("on average:", ", ".join(averages))


def measured(name: str, log: SensorLog, grid: OccupancyGrid) -> dict[str, Any]:
    """Return how far a fit is from the poses of the log."""
    before = time.process_time()
    fit = fit_trajectory(log, grid, start=log.poses[0] if "start given" in name else None)
    return {"log": name, "scans": len(log), **errors(fit, log), "seconds": round(time.process_time() - before, 1)}


def halved(name: str, log: SensorLog, grid: OccupancyGrid) -> dict[str, Any]:
    """Return how far poses fitted by halves of the beams are from the poses of the log."""
    before = time.process_time()
    fitted = cross_fit_poses(log.with_poses(np.full((len(log), 3), np.nan)), grid)
    off = np.hypot(*(fitted.log.poses - log.poses)[:, :2].T)
    off = off[np.isfinite(off)]
    return {
        "log": name, "scans": len(log), "trusted": fitted.n_trusted / len(log), "mean m": float(off.mean()),
        "median m": float(np.median(off)), "95% m": float(np.quantile(off, 0.95)), "largest m": float(off.max()),
        "stated, per axis m": fitted.deviation, "seconds": round(time.process_time() - before, 1),
    }  # fmt: skip


def wheels(data: Path) -> None:
    """Print how many logs are found, by how wrong their odometry is."""
    cases = followed(data)
    intel = MAPLESS["intel"](data)
    cases.append(("intel", intel, build_map(intel)))
    rows = []
    for wrong in WRONG_WHEELS:
        bent = [(name, replace(log, odometry=wrong.applied_to(log.odometry)), grid) for name, log, grid in cases]
        rows.append({"distances": wrong.distance, "turns": wrong.turn, "deg per metre": wrong.degrees_per_metre}
                    | outcomes(bent))  # fmt: skip
        print(rows[-1], file=sys.stderr)
    print_table(rows, digits=3)


def crowds(data: Path) -> None:
    """Print how many logs are found, by how many people go with the robot."""
    rows = []
    for n_people in PEOPLE_ABOUT:
        drawn = [
            (name, *with_crowd(log, n_people, seed), grid) for name, log, grid in followed(data) for seed in (0, 1)
        ]
        rows.append({"people": n_people, "hidden": float(np.mean([share for _, _, share, _ in drawn]))}
                    | outcomes([(name, log, grid) for name, log, _, grid in drawn]))  # fmt: skip
        print(rows[-1], file=sys.stderr)
    print_table(rows, digits=3)


def followed(data: Path) -> list[Case]:
    """Return the real logs, Stage's in its map as it comes, and three simulated offices."""
    cases = [case for case in real(data) if "larger" not in case[0]]
    return cases + [(name, log, grid) for name, (log, grid) in offices().items()]


def outcomes(cases: list[Case]) -> dict[str, Any]:
    """Return how many logs are found, the largest error of these, and which are not."""
    names: dict[str, list[str]] = {"found": [], "wrong": [], "refused": []}
    largest = 0.0
    for name, log, grid in cases:
        try:
            fit = fit_trajectory(log, grid)
        except TrajectoryNotFoundError:
            names["refused"].append(name)
            continue
        off = float(np.nanmax(np.hypot(*(fit.poses - log.poses)[fit.trusted, :2].T)))
        names["found" if off <= RIGHT else "wrong"].append(name)
        largest = max(largest, off)
    return {"found": len(names["found"]), "largest error m": largest,
            "wrong": ", ".join(names["wrong"]) or "-", "refused": ", ".join(names["refused"]) or "-"}  # fmt: skip


class WrongWheels(NamedTuple):
    """Odometry whose distances and turns are so many times the true ones, and that turns without the robot."""

    distance: float = 1.0
    turn: float = 1.0
    degrees_per_metre: float = 0.0

    def applied_to(self, odometry: FloatArray) -> FloatArray:
        """Return odometry (t, 3) with these errors; NaN where there is none."""
        known = np.isfinite(odometry).all(axis=1)
        steps = between(odometry[known][:-1], odometry[known][1:])
        turns = self.turn * steps[:, 2] + np.radians(self.degrees_per_metre) * steps[:, 0]
        changed: FloatArray = np.full_like(odometry, np.nan)
        changed[known] = chained(np.zeros(3), np.column_stack([self.distance * steps[:, :2], turns]))
        return changed


WRONG_WHEELS = (
    WrongWheels(),
    *(WrongWheels(distance=factor) for factor in (0.7, 0.8, 0.9, 1.1, 1.25, 1.4)),
    *(WrongWheels(turn=factor) for factor in (0.6, 0.8, 0.9, 1.1, 1.25, 1.5)),
    *(WrongWheels(degrees_per_metre=degrees) for degrees in (-12.0, -8.0, -3.5, 2.0, 5.0, 15.0)),
    WrongWheels(0.85, 1.15, 4.0), WrongWheels(1.15, 0.85, -4.0),
)  # fmt: skip


def errors(fit: TrajectoryFit, log: SensorLog) -> dict[str, Any]:
    """Return errors over the scans with a reference pose."""
    known = np.isfinite(log.poses).all(axis=1)
    error = (fit.poses - log.poses)[known]
    error[:, 2] = wrap_angle(error[:, 2])
    distance, covariance = np.hypot(error[:, 0], error[:, 1]), fit.covariances[known]
    square = np.einsum("ni,nij,nj->n", error[:, :2], np.linalg.inv(covariance[:, :2, :2]), error[:, :2])
    return {
        "mean m": float(distance.mean()), "median m": float(np.median(distance)),
        "95% m": float(np.quantile(distance, 0.95)), "largest m": float(distance.max()),
        "heading deg": float(np.degrees(np.abs(error[:, 2]).mean())),
        "sd m": float(np.median(position_deviations(covariance))),
        "NEES": float(0.5 * square.mean()), "in 95%": float(np.mean(square < CHI_SQUARE_95)),
        "trusted": float(fit.trusted.mean()),
        "findings": ", ".join(sorted({one.name for one in fit.findings})),
    }  # fmt: skip


def simulated(data: Path) -> Iterator[Case]:
    finder = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 181), 10.0)
    full = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 180, endpoint=False), 12.0)
    for seed in (3, 4, 5, 6):
        grid = draw_floor_plan(seed=seed)
        yield f"office {seed}", _simulated(grid, finder, SENSOR, seed), grid
    grid = draw_floor_plan(seed=7)
    yield "office 7, poor wheels", _simulated(grid, finder, SENSOR, 7, odometry_noise=POOR_WHEELS), grid
    yield "office 7, many people, start given", _simulated(grid, full, PEOPLE, 8), grid
    bursts = Dependence(angle=np.radians(5.0), time=1.0)
    yield "office 7, errors in bursts", _simulated(grid, full, SENSOR, 9, dependence=bursts), grid
    coarse = draw_floor_plan(seed=8, resolution=0.1)
    yield "office 8, cells of 0.1 m", _simulated(coarse, full, SENSOR, 10), coarse
    for seed in (11, 12):
        grid = draw_floor_plan(seed=seed)
        yield f"office {seed}, noise 0.015 m", _simulated(grid, full, FINE, seed), grid
    grid = draw_floor_plan(seed=13)
    yield (
        "office 13, walls up to 0.05 m off",
        _simulated(grid, full, FINE, 13),
        walls_moved(grid, np.random.default_rng(13)),
    )
    for seed in (1, 2, 3, 4):
        corridor, log = _corridor(seed)
        yield f"corridor of 60 m {seed}, start given", log, corridor
    path = data / "uob_stage_sim" / "derived_meeting_stageframe.yaml"
    if path.exists():
        grid = read_map(path)
        pioneer = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 250), 5.6, mount=(0.135, 0.0, 0.0))
        for seed in (1, 2, 3, 4):
            yield f"Pioneer in Stage's map {seed}", _simulated(grid, pioneer, SENSOR, seed), grid


def _corridor(seed: int) -> tuple[OccupancyGrid, SensorLog]:
    """Return a corridor with an alcove, whose ends are seen from 6 m, and a drive along it with poor odometry."""
    cells = np.full((90, 1200), np.nan, np.float32)
    cells[:48] = cells[46:68, 18:62] = 1.0
    cells[2:46, 2:-2] = cells[46:66, 20:60] = 0.0
    grid = OccupancyGrid(cells, 0.05)
    finder = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 121), 6.0)
    x = np.linspace(2.0, 57.0, 400)
    poses = np.column_stack([x, 1.2 + 0.2 * np.sin(x / 3.0), 0.2 / 3.0 * np.cos(x / 3.0)])
    random = np.random.default_rng(seed)
    ranges = drawn_readings(RayCaster(grid).expected_ranges(poses, finder), finder, SENSOR, random)
    odometry = noisy_odometry(poses, random, OdometryNoise(0.03, 0.008, 0.015, 0.03, 0.0))
    return grid, SensorLog(finder, 0.2 * np.arange(len(x)), ranges, poses, odometry)


def _simulated(grid: OccupancyGrid, finder: RangeFinder, sensor: BeamParameters, seed: int, **how: Any) -> SensorLog:
    return simulate_log(grid, finder, sensor, duration=120.0, scan_rate=5.0, seed=seed, **how).only_sensor()


def real(data: Path) -> Iterator[Case]:
    log, grid = read_log(data / "uob_stage_sim/simpath2.bag"), _stage_map(data)
    yield "Stage, map as it comes", log.only_sensor(), grid
    larger = replace(grid, resolution=1.0036 * grid.resolution, origin=1.0036 * grid.origin)
    yield "Stage, map 0.36% larger", log.only_sensor(), larger
    grid = read_map(data / "wean_hall/derived_wean.yaml")
    for i in (1, 3, 5):
        track = read_trajectory(data / f"wean_hall/reference_robotdata{i}.csv.gz")
        log = attach_poses(read_log(data / f"wean_hall/robotdata{i}.log.gz"), track)
        yield f"Wean Hall {i}", log.only_sensor(), grid
    folder = data / "olin_mac_tb4"
    log = attach_poses(
        read_log(folder / "macfirst_floor_take_2"), read_trajectory(folder / "derived_ref_take_2.csv.gz")
    )
    yield "TurtleBot 4", log.only_sensor(), read_map(next((folder / "map").glob("*.yaml")))


def _stage_map(data: Path) -> OccupancyGrid:
    return read_map(data / "uob_stage_sim" / "derived_meeting_stageframe.yaml")


if __name__ == "__main__":
    words = sys.argv[1:]
    main(words[0] if words else "all", Path(words[1]) if len(words) > 1 else DATA)
