"""What must hold for every map, and every ray and cone in it, chosen to meet corners and run along borders."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from beamfield.geometry import compose
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster

# Cones are looked for in words of 32 cells.
grids = arrays.arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7) | st.integers(1, 40)))
# Quarters of cells and slopes of small whole numbers: many rays run along borders and through corners.
starts = st.tuples(st.integers(-12, 40), st.integers(-12, 40))
slopes = st.tuples(st.integers(-5, 5), st.integers(-5, 5))
all_origins = st.lists(st.tuples(starts, slopes), min_size=1, max_size=30).map(
    lambda chosen: np.array([[x / 4, y / 4, np.arctan2(dy, dx)] for (x, y), (dx, dy) in chosen])
)
# Halves of these, added to directions of small whole numbers, run through corners and along borders again.
openings = st.sampled_from([0.0, 1e-9, 0.1, np.pi / 4, np.pi / 2, 2 * np.arctan2(1, 2), 2 * np.arctan2(1, 3), 3.0])
RAY = None
rays_and_cones = st.just(RAY) | openings
relaxed = settings(max_examples=200, derandomize=True)


def cast(occupied, origins, opening, max_range=20.0, resolution=1.0, origin=(0.0, 0.0, 0.0)):
    grid = OccupancyGrid(occupied.astype(np.float32), resolution, origin)
    if opening is RAY:
        return RayCaster(grid).cast(origins, max_range)
    return ConeCaster(grid).cast(origins, opening, max_range)


@relaxed
@given(grids, all_origins, rays_and_cones, st.data())
def test_adding_an_obstacle_never_lengthens_a_range(occupied, origins, opening, data):
    more = occupied.copy()
    more[data.draw(st.integers(0, occupied.shape[0] - 1)), data.draw(st.integers(0, occupied.shape[1] - 1))] = True
    assert (cast(more, origins, opening) <= cast(occupied, origins, opening)).all()


@relaxed
@given(grids, all_origins, rays_and_cones, st.floats(0.1, 20.0))
def test_a_longer_max_range_only_uncovers_what_was_cut(occupied, origins, opening, max_range):
    cut, whole = cast(occupied, origins, opening, max_range), cast(occupied, origins, opening, 45.0)
    np.testing.assert_allclose(cut, np.minimum(whole, max_range), rtol=0.0 if opening is RAY else 1e-14)


@relaxed
@given(
    grids,
    all_origins,
    rays_and_cones,
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-4, 4)),
    st.sampled_from([0.05, 0.1, 0.025, 1.0]),
)
def test_moving_the_map_and_the_origins_together_changes_nothing(occupied, origins, opening, origin, resolution):
    moved = compose(origin, origins * [resolution, resolution, 1.0])
    there = cast(occupied, moved, opening, 20.0 * resolution, resolution, origin) / resolution
    np.testing.assert_allclose(there, cast(occupied, origins, opening), atol=1e-8)


@relaxed
@given(grids, all_origins, rays_and_cones)
def test_a_mirrored_map_mirrors_the_ranges_from_inside_cells(occupied, origins, opening):
    origins = origins + np.array([0.125, 0.125, 0.0])  # never on a border, where the floor rule has a side
    mirrored = origins * [-1.0, 1.0, -1.0] + [occupied.shape[1], 0.0, np.pi]
    there = cast(occupied[:, ::-1], mirrored, opening)
    np.testing.assert_allclose(there, cast(occupied, origins, opening), atol=1e-9)


@relaxed
@given(grids, all_origins, rays_and_cones)
def test_a_transposed_map_has_the_same_ranges(occupied, origins, opening):
    """The search runs along rows; along columns it must find the same."""
    origins = origins + np.array([0.125, 0.125, 0.0])
    swapped = np.column_stack([origins[:, 1], origins[:, 0], np.pi / 2 - origins[:, 2]])
    np.testing.assert_allclose(cast(occupied.T, swapped, opening), cast(occupied, origins, opening), atol=1e-9)


@relaxed
@given(grids, all_origins, openings, openings)
def test_a_wider_cone_is_never_longer(occupied, origins, one, other):
    narrow, wide = sorted([one, other])
    assert (cast(occupied, origins, wide) <= cast(occupied, origins, narrow) + 1e-8).all()


@relaxed
@given(grids, all_origins, openings, st.floats(-1.0, 1.0))
def test_a_cone_is_never_longer_than_a_ray_in_it(occupied, origins, opening, where):
    inside = origins + np.array([0.0, 0.0, where * opening / 2])
    assert (cast(occupied, origins, opening) <= cast(occupied, inside, RAY) + 1e-8).all()


@relaxed
@given(grids, all_origins)
def test_a_cone_without_width_is_a_ray(occupied, origins):
    np.testing.assert_array_equal(cast(occupied, origins, 0.0), cast(occupied, origins, RAY))


@relaxed
@given(grids, all_origins)
def test_a_range_ends_at_an_occupied_cell_and_passes_through_none(occupied, origins):
    caster = RayCaster(OccupancyGrid(occupied.astype(np.float32), 1.0))
    ranges, hits = caster.cast(origins, 20.0), caster.cast_hits(origins, 20.0)
    assert ((hits[:, 0] >= 0) == (ranges < 20.0)).all()
    for (x, y, theta), length, (row, col) in zip(origins, ranges, hits, strict=True):
        if row >= 0:
            assert occupied[row, col]
            end_x, end_y = x + length * np.cos(theta), y + length * np.sin(theta)
            assert max(col - end_x, end_x - col - 1, row - end_y, end_y - row - 1) < 1e-9
