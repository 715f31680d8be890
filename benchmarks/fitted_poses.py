"""What fitting the poses of a log to the map hides from a calibration of the sensor.

Simulated logs of 60 s and 181 beams in COUNT offices, with drifting odometry. Each is calibrated at its exact poses; at
poses fitted to the beams that are judged; and at poses fitted to every other beam, the beams between being judged, as
``beamfield calibrate`` does for a log without poses. In "walls moved" the map that is used has each wall 0 to 6 cm off:
the world differs from its map, as it always does. Printed: median over the offices of the position's error, of the
noise that was learned over that at exact poses and in the true map, and the differences of z_hit.

Run: python benchmarks/fitted_poses.py [COUNT]     (5 offices)
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace

import numpy as np

import beamfield as bf
from beamfield.localization.fitted_poses import cross_fit_poses
from tables import print_table

LASER = bf.RangeFinder.from_bearings(np.radians(np.linspace(-135, 135, 181)), max_range=12.0)
NOISE = (0.01, 0.03, 0.06)
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
    """Return a map whose parts, of 4 m, lie up to a cell (5 cm) off in x and y each."""
    cells = np.asarray(grid.to_ros()).copy()
    side = round(4.0 / grid.resolution)
    for row in range(0, cells.shape[0], side):
        for col in range(0, cells.shape[1], side):
            part = cells[row : row + side, col : col + side]
            part[:] = np.roll(part, rng.integers(-1, 2, 2), axis=(0, 1))
    return bf.OccupancyGrid.from_ros(cells, resolution=grid.resolution, origin=grid.origin)


def main(count: int) -> None:
    """Print one row a kind of world and noise."""
    rows = []
    for moved in (False, True):
        for sigma in NOISE:
            found = [measure(seed, sigma, moved=moved) for seed in range(1, count + 1)]
            rows.append((
                "walls moved" if moved else "true map", f"{sigma:.2f}",
                f"{np.median([one.error for one in found]):.4f}", f"{np.median([one.stated for one in found]):.4f}",
                f"{min(one.trusted for one in found):.0%}",
                *(f"{np.median([one.exact[0] for one in found]):.4f}",),
                *(f"{np.median([getattr(one, kind)[0] / one.exact[0] - 1 for one in found]):+.1%}"
                  for kind in ("same", "crossed")),
                *(f"{np.median([getattr(one, kind)[1] - one.exact[1] for one in found]):+.4f}"
                  for kind in ("same", "crossed")),
            ))  # fmt: skip
    print_table(
        ("map", "noise [m]", "error of poses [m]", "stated per axis [m]", "least trusted", "sigma at exact poses [m]",
         "same beams", "other beams", "z_hit, same beams", "z_hit, other beams"), rows,
    )  # fmt: skip


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
