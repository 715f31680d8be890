"""Sonars: cones beside dense fans of rays, simulated rings, real logs: `python benchmarks/sonar.py [DATA]`.

DATA is a folder with `sonar_corridor` and `crazyflie_multiranger`; without it, the third table is left out.

1. Time per cone, on the building of `benchmarks/raycast.py`. The baseline is what one does without cones: a fan of rays
   as dense as the cells are at max_range, the nearest of which counts. One thread; the least of many runs counts.
2. Rings of sonars drawn from `SonarModel` in a room, calibrated by the main job.
3. Logs without a map, each half judged in the map of the other half, as beams and as cones of several widths. All
   readings of the held-out blocks are scored, whatever their expected range, so that rows of one log compare.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.cross_fit import build_cross_fit_maps, cross_fit_table
from beamfield.calibration.evaluation import uniform_parameters
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.time_split import held_out_mask
from beamfield.io.read_log import read_log
from beamfield.kernels.threads import set_threads
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.sonar import SonarModel
from beamfield.sensors import RangeFinder, SensorLog

if __package__:
    from benchmarks.measure import take_turns
    from benchmarks.raycast import building
    from benchmarks.tables import print_table
else:
    from measure import take_turns
    from raycast import building
    from tables import print_table

RESOLUTION = 0.05
MAX_RANGE = 10.0
N_CONES = 3000
TRUTH = BeamParameters(z_hit=0.7, z_short=0.1, z_max=0.12, z_rand=0.08, sigma_hit=0.06, lambda_short=0.6)
# The drone's flow odometry is all the poses there are; later its drift blurs the map.
SCANS_BEFORE_DRIFT = 1500
WIDTHS_DEG = {"sonar_corridor": (0, 10, 15, 20, 30, 40), "crazyflie": (0, 10, 20, 27, 35, 45)}


def main(arguments: list[str]) -> None:
    """Print the tables in Markdown."""
    print_table(cone_times())
    print()
    print_table(simulated_rings())
    if arguments:
        print()
        print_table(real_logs(Path(arguments[0])))


def cone_times() -> list[dict[str, Any]]:
    """Time cones and fans; one row per map and width."""
    rng = np.random.default_rng(1)
    occupied = building(rng)
    hall = np.pad(np.zeros((998, 998), bool), 1, constant_values=True)
    rows = []
    for name, cells, middle in (("building", occupied, False), ("empty hall", hall, True)):
        grid = OccupancyGrid(cells.astype(np.float32), RESOLUTION)
        cones, rays = ConeCaster(grid), RayCaster(grid)
        free = np.argwhere(~cells)[:, ::-1]
        if middle:  # nothing within max_range: the whole cone is searched
            free = free[(np.abs(free - 500) < 250).all(axis=1)]
        places = (free[rng.integers(0, len(free), N_CONES)] + rng.random((N_CONES, 2))) * RESOLUTION
        poses = np.column_stack([places, rng.uniform(-np.pi, np.pi, N_CONES)])
        for width_deg in (15.0, 30.0, 60.0):
            width = np.radians(width_deg)
            n_rays = 1 + int(np.ceil(width * MAX_RANGE / RESOLUTION))
            fan = RangeFinder.from_bearings(np.linspace(-width / 2, width / 2, n_rays), MAX_RANGE)
            calls = {
                "cones": partial(cones.cast, poses, width, MAX_RANGE),
                "fan": partial(rays.expected_ranges, poses, fan),
            }
            ns = {what: seconds.min() / N_CONES * 1e9 for what, seconds in take_turns(calls, 25).items()}
            exact = calls["cones"]()
            too_long = calls["fan"]().min(axis=1) - exact
            rows.append(
                {
                    "map": name,
                    "cone [deg]": f"{width_deg:g}",
                    "mean range [m]": f"{exact.mean():.2f}",
                    "cone [ns]": f"{ns['cones']:.0f}",
                    "rays in the fan": n_rays,
                    "fan [ns]": f"{ns['fan']:.0f}",
                    "times as fast": f"{ns['fan'] / ns['cones']:.1f}",
                    "fan too long by [m]: 99%, most": f"{np.quantile(too_long, 0.99):.4f}, {too_long.max():.3f}",
                }
            )
    return rows


def simulated_rings() -> list[dict[str, Any]]:
    """Calibrate rings drawn from the model; one row per ring."""
    grid = room()
    rows = []
    for n_sensors in (8, 16, 24):
        log = drawn_log(grid, ring(n_sensors), 400, seed=n_sensors)
        options = CalibrationOptions(refine=False)
        result = calibrate(log, grid, options)
        row: dict[str, Any] = {"sensors": n_sensors, "readings fitted": result.n_fit}
        for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short"):
            low, high = result.intervals.intervals[name]
            inside = "" if low <= getattr(TRUTH, name) <= high else " (!)"
            title = f"{name} (true {getattr(TRUTH, name):g})"
            row[title] = f"{getattr(result.parameters, name):.3f} [{low:.3f}, {high:.3f}]{inside}"
        as_beams = calibrate(replace(log, finder=replace(log.finder, opening_angle=0.0)), grid, options)
        row["nats per reading: cones, beams"] = (
            f"{result.scores[0].log_likelihood:.2f}, {as_beams.scores[0].log_likelihood:.2f}"
        )
        rows.append(row)
    return rows


def real_logs(data: Path) -> list[dict[str, Any]]:
    """Score logs without a map as beams and as cones; one row per log and width."""
    logs = {"sonar_corridor": read_log(data / "sonar_corridor").only_sensor()}
    for name in ("olsson-3loop", "olsson-demo", "rice"):
        logs[f"crazyflie {name}"] = crazyflie(data / "crazyflie_multiranger" / f"{name}.bag")
    rows = []
    for name, log in logs.items():
        declared = np.degrees(log.finder.opening_angle)
        for width_deg in WIDTHS_DEG[name.split()[0]]:
            found = held_out_score(log, np.radians(width_deg))
            fit: BeamParameters = found["parameters"]
            rows.append(
                {
                    "log": name,
                    "cone [deg]": f"{width_deg:g}" + (" (declared)" if abs(width_deg - declared) < 0.1 else ""),
                    "held-out readings": found["n"],
                    "nats per reading": f"{found['fit']:.3f}",
                    "ahead of a uniform": f"{found['gain']:.3f}",
                    "expect nothing": f"{found['nothing']:.0%}",
                    "z_hit": f"{fit.z_hit:.2f}",
                    "z_max": f"{fit.z_max:.2f}",
                    "sigma at 2 m [m]": f"{np.hypot(fit.sigma_hit, 2.0 * fit.sigma_slope):.3f}",
                    "range_offset [m]": f"{fit.range_offset:.3f}",
                }
            )
    return rows


def crazyflie(path: Path) -> SensorLog:
    """Return the first scans of a drone's log, with its odometry as poses."""
    log = read_log(path).only_sensor()
    log = log.with_poses(log.odometry)
    return log.select(np.arange(min(len(log), SCANS_BEFORE_DRIFT)))


def held_out_score(log: SensorLog, opening_angle: float) -> dict[str, Any]:
    """Fit a log in maps of its halves and score every reading of its held-out blocks.

    Parameters
    ----------
    log
        Scans with poses.
    opening_angle
        Taken for the sensor's, radians, in the maps and in the model; 0 for beams.

    Returns
    -------
    `parameters`; `n` held-out readings; mean log-likelihoods of the `fit` and its `gain` over a uniform with the right
    share without return; share of readings whose cone meets `nothing`.
    """
    log = replace(log, finder=replace(log.finder, opening_angle=opening_angle))
    maps = build_cross_fit_maps(log, resolution=RESOLUTION)
    posed = np.isfinite(log.poses).all(axis=1)
    table, _ = cross_fit_table(log, maps, posed, unknown="free")
    held_out = held_out_mask(table.stamps, None)
    learned = ~held_out & ~table.hits_nothing
    parameters = learn_intrinsic_parameters(
        table.ranges[learned],
        table.expected_ranges[learned],
        table.max_range,
        min_range=table.min_range,
        fit_offset=True,
        fit_sigma_slope=True,
    ).parameters
    test = table.select(held_out)
    uniform = uniform_parameters(float((table.ranges[~held_out] >= table.max_range).mean()))
    fit, nothing_known = (
        beam_log_density(test.ranges, test.expected_ranges, table.max_range, model, min_range=table.min_range)
        for model in (parameters, uniform)
    )
    return {
        "parameters": parameters,
        "n": len(test),
        "fit": float(fit.mean()),
        "gain": float((fit - nothing_known).mean()),
        "nothing": float(table.hits_nothing.mean()),
    }


def room() -> OccupancyGrid:
    """Return a room of 8 m x 6 m with a half wall, a board and posts."""
    rng = np.random.default_rng(5)
    occupied = np.zeros((120, 160), bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    occupied[60, :70] = occupied[30:50, 110] = True
    for row, col in rng.integers(8, [112, 152], (10, 2)):
        occupied[row : row + 3, col : col + 3] = True
    return OccupancyGrid(occupied.astype(np.float32), RESOLUTION)


def ring(n_sensors: int) -> RangeFinder:
    """Return sonars of 30 degrees, evenly on a circle of 0.2 m."""
    bearings = np.linspace(-np.pi, np.pi, n_sensors, endpoint=False)
    mounts = np.column_stack([0.2 * np.cos(bearings), 0.2 * np.sin(bearings), bearings])
    return RangeFinder(mounts, 5.0, opening_angle=np.radians(30.0), name="ring")


def drawn_log(grid: OccupancyGrid, finder: RangeFinder, n_scans: int, seed: int) -> SensorLog:
    """Return scans from SonarModel at random places of the room, 5 s apart, so that no turn between them is fast."""
    rng = np.random.default_rng(seed)
    poses = np.column_stack([rng.uniform([0.4, 0.4], [7.6, 5.6], (4 * n_scans, 2)), rng.uniform(-3, 3, 4 * n_scans)])
    clear = ConeCaster(grid).expected_ranges(poses, ring(16)).min(axis=1) > 0.1
    poses = poses[clear][:n_scans]
    ranges = np.array([scan.ranges for scan in SonarModel(grid, TRUTH, finder=finder).sample(poses, rng=rng)])
    return SensorLog(finder, 5.0 * np.arange(n_scans), ranges, poses, np.full((n_scans, 3), np.nan))


if __name__ == "__main__":
    set_threads(1)
    main(sys.argv[1:])
