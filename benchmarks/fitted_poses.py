"""What fitting the poses of a log to the map hides from a calibration of the sensor.

Simulated logs of 60 s and 181 beams in COUNT offices, with drifting odometry. Each is calibrated at its exact poses; at
poses fitted to the beams that are judged; and at poses fitted to every other beam, the beams between being judged, as
``beamfield calibrate`` does for a log without poses. The "moved" map has each part of 4 m off by up to 5 cm in x and y:
walls are never quite where a map has them. Printed, as medians over the offices: the positions' error and what the fit
says of it; sigma_hit at the exact poses, how much it differs at the fitted ones, and the differences of z_hit.

A second table counts how many 95% intervals hold the truth, in COVERED other logs of 100 s as `beamfield demo` draws
them, whose neighbouring beams and scans err alike.

Run: python benchmarks/fitted_poses.py [COUNT [COVERED]]     (5 and 24 offices)
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np

import beamfield as bf
from beamfield.localization.fitted_poses import cross_fit_poses
from beamfield.simulation.dependence import Dependence
from tables import print_table

LASER = bf.RangeFinder.from_bearings(np.radians(np.linspace(-135, 135, 181)), max_range=12.0)
NOISE = (0.01, 0.03, 0.06)
NAMES = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
OPTIONS = bf.CalibrationOptions(refine=False, range_offset="off", sigma_slope="off")


@dataclass(frozen=True)
class Row:
    """What one log gave: errors of the poses in metres, and sigma_hit and z_hit at each kind of poses."""

    error: float
    stated: float
    trusted: float
    exact: tuple[float, float]
    same: tuple[float, float]
    crossed: tuple[float, float]


def measure(seed: int, sigma: float, *, moved: bool) -> Row:
    """Simulate a log, fit its poses and learn from it at each kind of poses."""
    world = bf.draw_floor_plan(seed=seed)
    truth = bf.BeamParameters(0.82, 0.09, 0.03, 0.06, sigma, 0.5)
    log = bf.simulate_log(world, LASER, truth, duration=60.0, scan_rate=4.0, seed=seed).only_sensor()
    grid = walls_moved(world, np.random.default_rng(seed)) if moved else world
    lone = log.with_poses(np.full((len(log), 3), np.nan))
    fitted = cross_fit_poses(lone, grid, start=log.poses[0])
    assert fitted.swapped is not None
    assert fitted.same is not None
    beams = np.arange(1, LASER.n_beams, 2)
    exact = replace(log, finder=LASER.subset(beams), ranges=log.ranges[:, beams])
    off = (fitted.log.poses - log.poses)[:, :2]
    return Row(
        float(np.nanmedian(np.hypot(*off.T))), fitted.deviation, fitted.n_trusted / len(log),
        *(learned(one, grid) for one in (exact, fitted.same, fitted.swapped)),
    )  # fmt: skip


def learned(log: bf.SensorLog, grid: bf.OccupancyGrid) -> tuple[float, float]:
    """Return sigma_hit and z_hit."""
    found = bf.calibrate(log, grid, OPTIONS).parameters
    return found.sigma_hit, found.z_hit


def walls_moved(grid: bf.OccupancyGrid, rng: np.random.Generator) -> bf.OccupancyGrid:
    """Return a map whose parts, of 4 m, each lie up to a cell (5 cm) off in x and in y."""
    cells = np.empty_like(grid.probability)
    side = round(4.0 / grid.resolution)
    for row in range(0, cells.shape[0], side):
        for col in range(0, cells.shape[1], side):
            part = np.s_[row : row + side, col : col + side]
            cells[part] = np.roll(grid.probability, rng.integers(-1, 2, 2), axis=(0, 1))[part]
    return replace(grid, probability=cells)


def main(count: int) -> None:
    """Print one row a kind of map and noise."""
    rows = []
    for moved in (False, True):
        for sigma in NOISE:
            found = [measure(seed, sigma, moved=moved) for seed in range(1, count + 1)]
            rows.append({
                "map": "moved" if moved else "true",
                "noise [m]": f"{sigma:.2f}",
                "error of the poses [m]": median([one.error for one in found], ".4f"),
                "stated, per axis [m]": median([one.stated for one in found], ".4f"),
                "least trusted": f"{min(one.trusted for one in found):.0%}",
                "sigma_hit at exact poses [m]": median([one.exact[0] for one in found], ".4f"),
                "same beams": median([one.same[0] / one.exact[0] - 1.0 for one in found], "+.1%"),
                "other beams": median([one.crossed[0] / one.exact[0] - 1.0 for one in found], "+.1%"),
                "z_hit, same beams": median([one.same[1] - one.exact[1] for one in found], "+.4f"),
                "z_hit, other beams": median([one.crossed[1] - one.exact[1] for one in found], "+.4f"),
            })  # fmt: skip
    print_table(rows)


def print_coverage(count: int) -> None:
    """Print how many intervals hold the truth at exact poses, and at fitted ones without and with their error."""
    truth = bf.BeamParameters(0.82, 0.09, 0.03, 0.06, 0.04, 0.5)
    held = {way: dict.fromkeys(NAMES, 0) for way in ("exact", "fitted, as if exact", "fitted")}
    for seed in range(1, count + 1):
        grid = bf.draw_floor_plan(seed=seed)
        log = bf.simulate_log(
            grid, LASER, truth, duration=100.0, scan_rate=5.0, seed=seed, dependence=Dependence(np.radians(4.0), 1.0)
        ).only_sensor()
        fitted = cross_fit_poses(log.with_poses(np.full((len(log), 3), np.nan)), grid)
        judged, errors = fitted.judged, fitted.fit.covariances
        logs = (judged.with_poses(log.poses), None), (judged, None), (judged, errors)
        for counts, (one, covariances) in zip(held.values(), logs, strict=True):
            found = bf.calibrate(one, grid, OPTIONS, covariances=covariances).intervals.intervals
            for name in NAMES:
                counts[name] += found[name][0] <= getattr(truth, name) <= found[name][1]
    print()
    print_table([{f"poses, {count} logs": way, **counts} for way, counts in held.items()])


def median(values: list[float], form: str) -> str:
    """Return the median as text."""
    return format(float(np.median(values)), form)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
    print_coverage(int(sys.argv[2]) if len(sys.argv) > 2 else 24)
