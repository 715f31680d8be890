"""Mapping, map matching and global search: `python benchmarks/map_matching.py` prints the tables.

The world is our own simulated office storey, 60 m x 40 m at 5 cm, with a log of its range finder (181 beams, 12 m).

- Mapping: the whole log into one map.
- Map matching: one scan at 2000 poses, beside a NumPy version in float32 that transforms all cells of a pose at once.
- Global search: scans in windows of 20 m x 20 m x 360 degrees at 5 cm and 1 degree, the window's centre anywhere up to
  8 m from the robot, beside the time that scoring every candidate takes: measured on a part of the window with the same
  compiled sum, and multiplied. The two give the same answer; the tests compare them on small windows.
- How much the sum over the local map's cells differs from the chapter's, over those of the map, in the correlation:
  scans at free places of storeys of 26 m x 20 m, poses up to a few decimetres off, by the number of cells compared.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import compose, wrap_angle
from beamfield.kernels import global_search as kernels
from beamfield.kernels.threads import set_threads
from beamfield.localization.global_search import GlobalSearch, SearchWindow
from beamfield.maps.end_points import hit_points
from beamfield.maps.mapping import build_map, local_map, scan_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.cell_difference import CellDifferenceModel
from beamfield.models.histogram_matching import HistogramMatchingModel
from beamfield.models.map_matching import MapMatchingModel
from beamfield.sensors import RangeFinder, Scan, SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from measure import median_seconds
from tables import print_table

N_POSES = 2000
N_SEARCHES = 40
# With fewer, a handful of occupied cells decides, and both sums are noise.
FEWEST_CELLS = 300


def main() -> None:
    """Print the tables in Markdown."""
    grid, log = world()
    for rows in (mapping(log), matching(grid, log), searching(grid, log), either_sum()):
        print_table(rows, digits=3)
        print()


def world() -> tuple[OccupancyGrid, SensorLog]:
    """Return the storey and a log of 1500 scans in it."""
    grid = draw_floor_plan(seed=3, width=60.0, height=40.0)
    finder = RangeFinder.from_bearings(np.radians(np.linspace(-135.0, 135.0, 181)), 12.0, mount=(0.1, 0.0, 0.0))
    parameters = BeamParameters(0.85, 0.08, 0.03, 0.04, sigma_hit=0.03, lambda_short=0.5)
    return grid, simulate_log(grid, finder, parameters, duration=300.0, scan_rate=5.0, seed=1).only_sensor()


def mapping(log: SensorLog) -> list[dict[str, Any]]:
    """Measure building the map of the whole log."""
    seconds = median_seconds(lambda: build_map(log))
    beams = int(np.count_nonzero(log.ranges < log.finder.max_range))
    cells = float(log.ranges[log.ranges < log.finder.max_range].sum() / 0.05)
    return [
        {
            "mapping": f"{len(log)} scans of {log.finder.n_beams} beams",
            "seconds": seconds,
            "ns per beam": seconds / beams * 1e9,
            "ns per cell of a beam": seconds / cells * 1e9,
        }
    ]


def matching(grid: OccupancyGrid, log: SensorLog) -> list[dict[str, Any]]:
    """Measure one scan and one local map at many poses around the robot."""
    rng = np.random.default_rng(2)
    rows = []
    for name, z in (("scan", log.scan(700)), ("local map of 10 scans", local_map(log, 700, n=10))):
        poses = log.poses[700] + rng.normal(0.0, [0.5, 0.5, 0.2], (N_POSES, 3))
        local = scan_map(z, resolution=grid.resolution) if isinstance(z, Scan) else z
        n_cells = int(np.count_nonzero(~np.isnan(local.probability)))
        plain = plain_correlation(grid, local)
        model = MapMatchingModel(grid)
        error = np.abs(plain(poses) - model.correlation(z, poses)).max()
        seconds = {
            "NumPy float32": median_seconds(lambda plain=plain, poses=poses: plain(poses), 3),
            "correlation": median_seconds(partial(model.correlation, z, poses)),
            "cell difference": median_seconds(partial(CellDifferenceModel(grid).log_likelihood, z, poses)),
            "histograms": median_seconds(partial(HistogramMatchingModel(grid).log_likelihood, z, poses)),
        }
        rows.append(
            {
                f"{N_POSES} poses": f"{name}, {n_cells} cells",
                **{f"{key} [ms]": value * 1e3 for key, value in seconds.items()},
                "ratio to NumPy": seconds["NumPy float32"] / seconds["correlation"],
                "ns per cell": seconds["correlation"] / N_POSES / n_cells * 1e9,
                "largest difference": float(error),
            }
        )
    return rows


def searching(grid: OccupancyGrid, log: SensorLog) -> list[dict[str, Any]]:
    """Measure the search in large windows."""
    rng = np.random.default_rng(3)
    search = GlobalSearch(grid)
    build = median_seconds(lambda: GlobalSearch(grid), 3)
    search.search(log.scan(0), SearchWindow(log.poses[0], 2.0, 2.0, 0.5))
    seconds, scored, leads = [], [], {True: [], False: []}
    for i in np.linspace(0, len(log) - 1, N_SEARCHES).astype(int):
        window = SearchWindow(log.poses[i] + rng.uniform(-8.0, 8.0, 3))
        start = time.perf_counter()
        result = search.search(log.scan(i), window)
        seconds.append(time.perf_counter() - start)
        error = result.best.pose - log.poses[i]
        found = bool(np.hypot(error[0], error[1]) < 0.15 and abs(wrap_angle(error[2])) < 0.03)
        scored.append(result.n_scored / result.n_candidates)
        leads[found].append(result.best.score - (result.runner_up.score if result.runner_up else 0.0))
    every = result.n_candidates * seconds_per_candidate(search, log.scan(700))
    return [
        {
            "global search": f"{result.n_candidates} candidates",
            "median [s]": statistics.median(seconds),
            "longest [s]": max(seconds),
            "every candidate, one thread [s]": every,
            "ratio": every / statistics.median(seconds),
            "share of sums taken": statistics.median(scored),
            "robot found": f"{len(leads[True])} of {N_SEARCHES}",
            "lead over the runner-up there": statistics.median(leads[True]),
            "and elsewhere": statistics.median(leads[False]) if leads[False] else 0.0,
            "preparing the map [s]": build,
        }
    ]


def seconds_per_candidate(search: GlobalSearch, scan: Scan) -> float:
    """Return the time of one candidate's sum, from 40,000 of them beside each other."""
    points = hit_points(scan.ranges, scan.finder)
    cells = np.ascontiguousarray(np.floor(search.grid.to_cells(points)).astype(np.int32).T[::-1])[None]
    field = np.ascontiguousarray(search._field)[None, None]
    bounds = np.empty((1, 200, 200), np.int64)
    return median_seconds(partial(kernels.fill_coarse_bounds, cells, field, bounds)) / bounds.size


def plain_correlation(
    grid: OccupancyGrid, local: OccupancyGrid
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return the baseline: poses (n, 3) of a grid without yaw to rho, all cells of a pose at once."""
    rows, cols = np.nonzero(~np.isnan(local.probability))
    x, y = (local.to_map(np.column_stack([cols, rows]) + 0.5).T / grid.resolution).astype(np.float32)
    values = local.probability[rows, cols]
    framed = np.full((grid.shape[0] + 2, grid.shape[1] + 2), np.nan, np.float32)
    framed[1:-1, 1:-1] = grid.probability
    flat, width = framed.reshape(-1), framed.shape[1]
    top = np.float32(grid.shape[1] + 1), np.float32(grid.shape[0] + 1)

    def call(poses: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.empty(len(poses))
        starts = grid.to_cells(poses[:, :2]).astype(np.float32) + np.float32(1.0)
        cos, sin = np.cos(poses[:, 2]).astype(np.float32), np.sin(poses[:, 2]).astype(np.float32)
        for i in range(len(poses)):
            col = np.clip(starts[i, 0] + cos[i] * x - sin[i] * y, 0, top[0]).astype(np.int32)
            row = np.clip(starts[i, 1] + sin[i] * x + cos[i] * y, 0, top[1]).astype(np.int32)
            m = flat[row * width + col]
            both = m == m
            m, v = m[both], values[both]
            mean = (m.mean(dtype=np.float64) + v.mean(dtype=np.float64)) / 2.0
            m, v = m - np.float32(mean), v - np.float32(mean)
            out[i] = (m @ v) / np.sqrt((m @ m) * (v @ v))
        return out

    return call


def either_sum() -> list[dict[str, Any]]:
    """Compare the correlation with that of the sum over the map's cells."""
    rng = np.random.default_rng(1)
    finder = RangeFinder.from_bearings(np.linspace(-2.2, 2.2, 121), max_range=8.0, mount=(0.1, 0.0, 0.0))
    found = []
    for resolution in (0.05, 0.1):
        for seed in range(4):
            grid = draw_floor_plan(seed=seed, width=26.0, height=20.0, resolution=resolution)
            model, caster, places = MapMatchingModel(grid), RayCaster(grid), np.argwhere(grid.free)
            for row, col in places[rng.integers(len(places), size=60)]:
                at = [(col + 0.5) * resolution, (row + 0.5) * resolution, rng.uniform(-np.pi, np.pi)]
                pose = compose(grid.origin, at)
                scan = Scan(caster.expected_ranges(pose, finder), finder)
                local = scan_map(scan, resolution=resolution)
                for guess in (pose, *(pose + rng.normal(0.0, 0.2, (4, 3)))):
                    match = model.match(local, guess)
                    n = float(match.overlap) * np.count_nonzero(~np.isnan(local.probability))
                    if match.determined and n >= FEWEST_CELLS:
                        found.append((n, float(match.correlation) - correlation_over_map_cells(grid, local, guess)))
    n_cells, difference = np.array(found).T
    rows = []
    for low, high in ((FEWEST_CELLS, 1000), (1000, 3000), (3000, np.inf)):
        size = np.abs(difference[(n_cells >= low) & (n_cells < high)])
        rows.append({
            "cells compared": f"{low} to {high:g}", "poses": len(size), "median": float(np.median(size)),
            "95%": float(np.quantile(size, 0.95)), "largest": float(size.max()),
        })  # fmt: skip
    return rows


def correlation_over_map_cells(grid: OccupancyGrid, local: OccupancyGrid, pose: NDArray[np.float64]) -> float:
    """Return (6.35) as the chapter writes it: each map cell with the local cell in which its centre falls."""
    rows, cols = np.nonzero(~np.isnan(grid.probability))
    centres = grid.to_map(np.column_stack([cols + 0.5, rows + 0.5])) - pose[:2]
    c, s = np.cos(pose[2]), np.sin(pose[2])
    seen = np.column_stack([c * centres[:, 0] + s * centres[:, 1], c * centres[:, 1] - s * centres[:, 0]])
    cells = np.floor(local.to_cells(seen)).astype(np.int64)
    inside = ((cells >= 0) & (cells < local.shape[::-1])).all(axis=1)
    of_map = grid.probability[rows[inside], cols[inside]]
    of_local = local.probability[cells[inside, 1], cells[inside, 0]]
    both = ~np.isnan(of_local)
    m, z = of_map[both].astype(np.float64), of_local[both].astype(np.float64)
    mean = 0.5 * (m.mean() + z.mean())
    return float(((m - mean) @ (z - mean)) / np.sqrt(np.square(m - mean).sum() * np.square(z - mean).sum()))


if __name__ == "__main__":
    set_threads(1)
    main()
