"""The caster beside two independent ways to cast rays, on more than two million rays."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from tests.reference.raycast_oracles import intersect_boxes, traverse

SHAPES = [(1, 1), (1, 9), (7, 1), (2, 2), (20, 30)]
N_RAYS = 6000
DENSITIES = [0.0, 0.03, 0.2, 0.5, 0.9]


def assert_same(ranges, wanted, directions):
    """Equal to float64 rounding of the start (1e-16 cells, seen along the ray) and of the range."""
    slowest = np.where(np.abs(directions) < 1e-12, 1.0, np.abs(directions)).min(axis=-1)
    error = np.abs(ranges - wanted)
    worst = np.argmax(error - 1e-12 * (1 + wanted) - 4e-16 / slowest)
    assert error[worst] <= 1e-12 * (1 + wanted[worst]) + 4e-16 / slowest[worst], (ranges[worst], wanted[worst], worst)


def compare(occupied, origins, max_cells, *, boxes=False):
    """Cast rays given in cells in a grid whose frame is the map's, and compare ranges and cells with the oracles."""
    caster = RayCaster(OccupancyGrid(occupied.astype(np.float32), 1.0))
    ranges, hits = caster.cast(origins, max_cells), caster.cast_hits(origins, max_cells)
    directions = np.column_stack([np.cos(origins[:, 2]), np.sin(origins[:, 2])])
    rays = origins[:, 0].copy(), origins[:, 1].copy(), directions[:, 0].copy(), directions[:, 1].copy()
    wanted, cells, pinched = traverse(*rays, occupied, max_cells)
    assert_same(ranges, wanted, directions)
    np.testing.assert_array_equal(hits[~pinched], cells[~pinched])
    assert occupied[tuple(hits[pinched].T)].all()
    if boxes:
        for part in np.array_split(np.arange(len(origins)), max(1, len(origins) // 2000)):
            by_boxes = intersect_boxes(*(v[part] for v in rays), occupied, max_cells)
            np.testing.assert_allclose(ranges[part], by_boxes, rtol=1e-9, atol=1e-9)
    return wanted


def starts_around(rng, shape):
    return rng.uniform(-3, 3, (N_RAYS, 2)) + rng.random((N_RAYS, 2)) * np.array(shape[::-1])


@pytest.mark.parametrize("shape", SHAPES)
def test_random_rays_agree_with_both_oracles(rng, shape):
    for density in DENSITIES:
        origins = np.column_stack([starts_around(rng, shape), rng.uniform(-4, 4, N_RAYS)])
        compare(rng.random(shape) < density, origins, 12.3, boxes=True)


@pytest.mark.parametrize("shape", SHAPES)
def test_rays_through_corners_and_along_borders_agree_with_both_oracles(rng, shape):
    for density in DENSITIES:
        occupied = rng.random(shape) < density
        on_quarters = np.round(starts_around(rng, shape) * 4) / 4
        slopes = np.arctan2(rng.integers(-4, 5, N_RAYS), rng.integers(-4, 5, N_RAYS))
        eighths = np.pi / 4 * rng.integers(-16, 17, N_RAYS)
        for heading in (slopes, eighths):
            compare(occupied, np.column_stack([on_quarters, heading]), 40.0, boxes=True)


@pytest.mark.parametrize("shape", SHAPES)
def test_rays_that_just_miss_corners_and_borders_agree_with_both_oracles(rng, shape):
    for density in DENSITIES:
        occupied = rng.random(shape) < density
        starts = np.round(starts_around(rng, shape) * 4) / 4
        starts += rng.choice([0, 1e-13, -1e-13, 1e-7, -1e-7, 1e-5], (N_RAYS, 2))
        heading = np.pi / 4 * rng.integers(-16, 17, N_RAYS)
        heading += rng.choice([0, 0, 1e-14, -1e-14, 1e-7, -1e-7, 1e-5, -1e-4], N_RAYS)
        compare(occupied, np.column_stack([starts, heading]), 40.0, boxes=True)


def floor_plan(rng, rows, cols):
    """Rooms with doors, and clutter."""
    occupied = rng.random((rows, cols)) < 0.002
    occupied[:: rows // 6], occupied[:, :: cols // 6] = True, True
    occupied[:, cols // 12 :: cols // 6] = False
    occupied[rows // 12 :: rows // 6] = False
    return occupied


def test_a_million_rays_in_a_floor_plan_agree_with_the_traversal(rng):
    occupied = floor_plan(rng, 700, 900)
    starts = rng.uniform(-40, [940, 740], (1_000_000, 2))
    wanted = compare(occupied, np.column_stack([starts, rng.uniform(-np.pi, np.pi, len(starts))]), 200.0)
    assert 0.2 < np.mean(wanted < 200.0) < 0.999


def test_long_rays_in_a_large_room_agree_with_the_traversal(rng):
    # Free rectangles are at most 255 cells wide; these rays cross up to 3000 cells.
    occupied = np.zeros((2000, 2200), bool)
    occupied[0], occupied[-1], occupied[:, 0], occupied[:, -1] = True, True, True, True
    occupied[rng.integers(0, 2000, 200), rng.integers(0, 2200, 200)] = True
    starts = rng.uniform(1, [2199, 1999], (60_000, 2))
    heading = rng.uniform(-np.pi, np.pi, len(starts))
    heading[:20_000] = np.pi / 4 * rng.integers(-8, 9, 20_000) + rng.choice([0, 1e-6, -1e-4], 20_000)
    starts[:30_000] = np.round(starts[:30_000] * 2) / 2
    wanted = compare(occupied, np.column_stack([starts, heading]), 5000.0)
    assert wanted.max() > 1500


def test_long_rays_without_any_obstacle_see_nothing(rng):
    caster = RayCaster(OccupancyGrid(np.zeros((600, 700)), 1.0))
    origins = np.column_stack([rng.uniform(-100, 800, (2000, 2)), rng.uniform(-np.pi, np.pi, 2000)])
    assert (caster.cast(origins, 1e6) == 1e6).all()
    assert (caster.cast_hits(origins, 1e6) == -1).all()


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (-12.35, 7.7, 0.0), (3e3, -2e3, 0.7), (-5.0, 2.0, np.pi / 2)])
@pytest.mark.parametrize("resolution", [0.05, 0.1, 1.0])
def test_a_turned_and_shifted_grid_agrees_with_the_traversal_in_its_frame(rng, origin, resolution):
    occupied = floor_plan(rng, 120, 150)
    grid = OccupancyGrid(occupied.astype(np.float32), resolution, origin)
    in_grid = np.column_stack([rng.uniform(-20, [170, 140], (20_000, 2)), rng.uniform(-4, 4, 20_000)])
    # Among them rays whose path is decided at corners.
    in_grid[:10_000, :2] = np.round(in_grid[:10_000, :2] * 2) / 2
    in_grid[:10_000, 2] = np.arctan2(rng.integers(-3, 4, 10_000), rng.integers(-3, 4, 10_000))
    poses = compose(origin, in_grid * [resolution, resolution, 1.0])
    x, y, theta = in_grid.T.copy()
    wanted, _, _ = traverse(x, y, np.cos(theta), np.sin(theta), occupied, 60.0)
    ranges = RayCaster(grid).cast(poses, 60.0 * resolution)
    # The transform rounds starts by up to 1e-11 cells, and shallow rays stretch that.
    slowest = np.abs(np.column_stack([np.cos(theta), np.sin(theta)])).min(axis=1)
    slowest[slowest < 1e-9] = 1.0
    assert np.all(np.abs(ranges / resolution - wanted) < 1e-10 + 1e-10 / slowest)


def test_every_beam_starts_at_its_own_mount(rng):
    occupied = floor_plan(rng, 120, 150)
    origin = (-3.0, 4.0, 0.4)
    grid = OccupancyGrid(occupied.astype(np.float32), 0.05, origin)
    mounts = np.column_stack([rng.uniform(-0.5, 0.5, (37, 2)), rng.uniform(-4, 4, 37)])
    finder = RangeFinder(mounts, 3.0)
    poses = compose(origin, np.column_stack([rng.uniform(-1, [8.5, 7.0], (5000, 2)), rng.uniform(-4, 4, 5000)]))
    ranges = RayCaster(grid).expected_ranges(poses, finder)
    sensors = compose(poses[:, None], mounts)
    col, row = np.moveaxis(grid.to_cells(sensors[..., :2]).reshape(-1, 2), 1, 0)
    theta = (sensors[..., 2] - origin[2]).ravel()
    wanted, _, _ = traverse(col.copy(), row.copy(), np.cos(theta), np.sin(theta), occupied, 60.0)
    slowest = np.abs(np.column_stack([np.cos(theta), np.sin(theta)])).min(axis=1)
    assert np.all(np.abs(ranges.ravel() / 0.05 - wanted) < 1e-10 + 1e-10 / slowest)


@pytest.mark.parametrize("unknown", ["free", "occupied"])
def test_unknown_cells_stop_rays_or_not(rng, unknown):
    probability = rng.choice([0.0, np.nan, 1.0], (80, 90), p=[0.9, 0.08, 0.02])
    grid = OccupancyGrid(probability, 1.0)
    stops = grid.occupied | (grid.unknown if unknown == "occupied" else False)
    x, y = rng.uniform(-5, [95, 85], (50_000, 2)).T.copy()
    theta = rng.uniform(-4, 4, 50_000)
    wanted, _, _ = traverse(x, y, np.cos(theta), np.sin(theta), stops, 50.0)
    ranges = RayCaster(grid, unknown=unknown).cast(np.column_stack([x, y, theta]), 50.0)
    assert_same(ranges, wanted, np.column_stack([np.cos(theta), np.sin(theta)]))


@pytest.mark.real
def test_rays_in_a_real_map_agree_with_the_traversal(rng, data):
    from beamfield.io.maps.ros_map import read_ros_map

    path = next(iter(sorted(data.glob("ros_maps/**/*.yaml"))))
    grid = read_ros_map(path)
    rows, cols = grid.shape
    in_grid = np.column_stack([rng.uniform(0, [cols, rows], (200_000, 2)), rng.uniform(-4, 4, 200_000)])
    x, y, theta = in_grid.T.copy()
    wanted, _, _ = traverse(x, y, np.cos(theta), np.sin(theta), grid.occupied, 400.0)
    s = grid.resolution
    ranges = RayCaster(grid).cast(compose(grid.origin, in_grid * [s, s, 1.0]), 400.0 * s)
    assert np.quantile(np.abs(ranges / s - wanted), 0.9999) < 1e-6
