"""Trajectories of a robot that drives a circle in a small room: maps, mounts and logs that were fitted wrongly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import TrajectoryNotFoundError
from beamfield.geometry import between, chained, wrap_angle
from beamfield.localization.scan_odometry import odometry_from_scans
from beamfield.localization.trajectory import TrajectoryFit, fit_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, SensorLog

AROUND = RangeFinder.from_bearings(np.linspace(-3.1, 3.1, 60), max_range=12.0)


def room(*, margin: float = 1.0, resolution: float = 0.05) -> OccupancyGrid:
    """Return a room of 8 m x 6 m with two cupboards; its walls are one cell thick, and the map ends `margin` beyond."""
    rows, cols, k, m = round(6.0 / resolution), round(8.0 / resolution), round(0.6 / resolution), margin / resolution
    cells = np.zeros((rows, cols))
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    cells[k : 2 * k, 3 * k : 4 * k] = cells[-3 * k : -2 * k, -2 * k : -k] = 1.0
    cells = np.pad(cells, round(m), constant_values=np.nan)
    return OccupancyGrid(cells, resolution, (-round(m) * resolution, -round(m) * resolution, 0.0))


def partitions() -> OccupancyGrid:
    """Return a hall of 16 m x 12 m between walls 0.1 m thick."""
    cells = np.zeros((240, 320))
    cells[:2] = cells[-2:] = cells[:, :2] = cells[:, -2:] = 1.0
    for x in range(60, 300, 60):
        for y in range(40, 220, 60):
            cells[y : y + 2, x : x + 14] = cells[y : y + 14, x : x + 2] = 1.0
    return OccupancyGrid(cells, 0.05, (0.0, 0.0, 0.0))


def circle(
    grid: OccupancyGrid, finder: RangeFinder, centre=(4.0, 3.0), radius=1.2, *, n=60, sigma=0.02, bias=0.0
) -> SensorLog:
    """Return a log of one round, exact but for noise of the readings and 2 mm of each step of odometry."""
    rng, angle = np.random.default_rng(0), np.linspace(0.0, 2.0 * np.pi, n)
    around = np.column_stack([np.cos(angle), np.sin(angle)])
    poses = np.column_stack([centre + radius * around, wrap_angle(angle + 0.5 * np.pi)])
    z = RayCaster(grid).expected_ranges(poses, finder)
    z = np.where(z < finder.max_range, z + bias + sigma * rng.standard_normal(z.shape), np.inf)
    odometry = chained(np.zeros(3), between(poses[:-1], poses[1:]) + 0.002 * rng.standard_normal((n - 1, 3)))
    odometry[:, 2] = wrap_angle(odometry[:, 2])
    return SensorLog(finder, 0.5 * np.arange(n), z, poses, odometry)


def fitted(log: SensorLog, grid: OccupancyGrid) -> tuple[TrajectoryFit, np.ndarray]:
    """Return the fit from the true start, and how far it is off, metres."""
    fit = fit_trajectory(log, grid, start=log.poses[0])
    return fit, np.hypot(*(fit.poses - log.poses)[:, :2].T)


@pytest.mark.parametrize(("sigma", "bias"), [(0.06, 0.0), (0.005, 0.1)])
def test_a_map_that_is_cropped_to_its_walls_gives_the_same_poses(sigma, bias):
    wide, cropped = room(), room(margin=0.0)
    log = circle(wide, AROUND, sigma=sigma, bias=bias)
    fit, off = fitted(log, wide)
    close, close_off = fitted(log, cropped)
    assert close.sigma == pytest.approx(fit.sigma, rel=0.05)
    assert np.median(close_off) < 1.2 * np.median(off) + 0.001


@pytest.mark.parametrize("resolution", [0.2, 0.5])
def test_clean_readings_fit_in_coarse_maps(resolution):
    grid = room(resolution=resolution)
    _, off = fitted(circle(grid, AROUND, sigma=0.005), grid)
    assert off.max() < 0.02


def test_the_face_of_a_thin_wall_is_the_one_towards_the_laser_wherever_the_robot_is():
    grid = partitions()
    backwards = RangeFinder.from_bearings(np.linspace(-2.2, 2.2, 90), max_range=12.0, mount=(1.0, 0.0, np.pi))
    _, off = fitted(circle(grid, backwards, (8.0, 6.0), 3.3, n=80), grid)
    assert off.max() < 0.02


def test_odometry_that_is_missing_goes_on_in_time_where_scans_are_missing_too():
    grid = room()
    whole = circle(grid, AROUND, n=80)
    log = whole.select(np.r_[0:22, 36:80])
    odometry = log.odometry.copy()
    odometry[20:26] = np.nan
    fit, off = fitted(replace(log, odometry=odometry), grid)
    assert off[fit.trusted].max() < 0.03


@pytest.mark.parametrize("n_blind", [50, 300])
def test_a_robot_that_stands_blind_between_two_resets_of_its_odometry_is_not_trusted_there(n_blind):
    grid = room()
    log = circle(grid, AROUND)
    log = log.select(np.concatenate([np.arange(40), np.full(n_blind, 40), np.arange(40, 60)]))
    ranges, odometry, blind = log.ranges.copy(), log.odometry.copy(), slice(40, 40 + n_blind)
    ranges[blind] = np.nan
    odometry[40:] += [5.0, 0.0, 0.0]
    odometry[40 + n_blind :] += [-7.0, 3.0, 0.0]
    fit, off = fitted(replace(log, ranges=ranges, odometry=odometry, stamps=0.25 * np.arange(len(log))), grid)
    assert off[fit.trusted].max() < 0.05
    assert not fit.trusted[blind][5:].any()
    assert "odometry-reset" in {finding.name for finding in fit.findings}


def test_a_corridor_says_how_far_a_robot_turned_though_not_how_far_it_drove():
    cells = np.zeros((60, 1200))
    cells[[0, -1]] = 1.0
    grid = OccupancyGrid(cells, 0.05, (-30.0, -1.5, 0.0))
    poses = np.column_stack([np.zeros((30, 2)), np.radians(3.0 * np.arange(30))])
    z = RayCaster(grid).expected_ranges(poses, AROUND)
    log = SensorLog(AROUND, np.arange(30.0), np.where(z < 12.0, z, np.inf), poses, poses)
    found = odometry_from_scans(log, lambda *_: None)
    assert np.degrees(found[-1, 2]) == pytest.approx(87.0, abs=2.0)


def halls() -> OccupancyGrid:
    """Return two halls that meet at a door; by itself, each looks the same in a mirror."""
    cells = np.full((240, 320), np.nan)
    for rows, cols in ((slice(0, 120), slice(0, 160)), (slice(80, 240), slice(158, 320))):
        cells[rows, cols] = 1.0
        cells[rows, cols][2:-2, 2:-2] = 0.0
    cells[94:106, 158:160] = 0.0
    cells[36:44, 8:20] = cells[76:84, 8:20] = cells[110:126, 280:288] = cells[194:210, 280:288] = 1.0
    return OccupancyGrid(cells, 0.05)


def test_a_mirrored_map_is_refused_though_a_robot_that_is_carried_would_fit_it():
    grid, t = halls(), np.linspace(0.0, 1.0, 80)
    # From the lower hall through the door, at (8 m, 5 m), into the upper one.
    x, y = 2.0 + 10.5 * t, 3.0 + 2.0 * np.sin(1.5 * np.pi * t.clip(max=1.0 / 3.0)) + 4.0 * (t - 0.6).clip(min=0.0)
    poses = np.column_stack([x, y, np.arctan2(np.gradient(y), np.gradient(x))])
    rng = np.random.default_rng(0)
    ranges = RayCaster(grid).expected_ranges(poses, AROUND) + 0.02 * rng.standard_normal((80, 60))
    nowhere = np.full((80, 3), np.nan)
    log = SensorLog(AROUND, 0.5 * np.arange(80), ranges, nowhere, poses)
    assert np.hypot(*(fit_trajectory(log, grid).poses - poses)[:, :2].T).max() < 0.05
    mirrored = OccupancyGrid(np.asarray(grid.probability)[::-1], 0.05)
    with pytest.raises(TrajectoryNotFoundError, match="only if the map is mirrored"):
        fit_trajectory(log, mirrored)
