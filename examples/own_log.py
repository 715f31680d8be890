"""Bring a log of your own: arrays of stamps, ranges and odometry are all that beamfield needs.

Run: python examples/own_log.py
"""

from __future__ import annotations

import numpy as np

import beamfield as bf


def read_mine(grid: bf.OccupancyGrid) -> bf.SensorLog:
    """Stand for your reader: fill in stamps (t,), ranges (t, k) and odometry (t, 3) from your files."""
    laser = bf.RangeFinder.from_bearings(np.radians(np.arange(-90.0, 91.0, 3.0)), max_range=12.0, mount=(0.2, 0.0, 0.0))
    sensor = bf.BeamParameters(z_hit=0.82, z_short=0.09, z_max=0.03, z_rand=0.06, sigma_hit=0.04, lambda_short=0.5)
    log = bf.simulate_log(grid, laser, sensor, duration=80.0, scan_rate=2.0, seed=1).only_sensor()
    nowhere = np.full((len(log), 3), np.nan)  # no reference poses
    return bf.SensorLog(laser, log.stamps, log.ranges, poses=nowhere, odometry=log.poses)


def main() -> None:
    """Fit poses to the map, then calibrate, as `beamfield calibrate` does."""
    grid = bf.draw_floor_plan(seed=1)
    log = read_mine(grid)
    fit = bf.fit_trajectory(log, grid)
    print(f"{fit.trusted.mean():.0%} of the poses can be trusted")
    print(bf.calibrate(log.with_poses(fit.poses), grid).summary())


if __name__ == "__main__":
    main()
