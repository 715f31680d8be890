"""What must hold for every map and every ray, on rays chosen to meet corners and borders."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster

grids = arrays.arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 7)))
# Quarters of cells and slopes of small whole numbers: many rays run along borders and through corners.
starts = st.tuples(st.integers(-12, 40), st.integers(-12, 40))
slopes = st.tuples(st.integers(-5, 5), st.integers(-5, 5))
rays = st.lists(st.tuples(starts, slopes), min_size=1, max_size=30)
relaxed = settings(max_examples=200, derandomize=True)


def as_origins(chosen):
    return np.array([[x / 4, y / 4, np.arctan2(dy, dx)] for (x, y), (dx, dy) in chosen])


def caster_of(occupied, resolution=1.0, origin=(0.0, 0.0, 0.0)):
    return RayCaster(OccupancyGrid(occupied.astype(np.float32), resolution, origin))


@relaxed
@given(grids, rays, st.data())
def test_adding_an_obstacle_never_lengthens_a_ray(occupied, chosen, data):
    more = occupied.copy()
    more[data.draw(st.integers(0, occupied.shape[0] - 1)), data.draw(st.integers(0, occupied.shape[1] - 1))] = True
    origins = as_origins(chosen)
    assert (caster_of(more).cast(origins, 20.0) <= caster_of(occupied).cast(origins, 20.0)).all()


@relaxed
@given(grids, rays, st.floats(0.1, 20.0))
def test_a_longer_max_range_only_uncovers_what_was_cut(occupied, chosen, max_range):
    caster, origins = caster_of(occupied), as_origins(chosen)
    np.testing.assert_array_equal(caster.cast(origins, max_range), np.minimum(caster.cast(origins, 25.0), max_range))


@relaxed
@given(
    grids,
    rays,
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-4, 4)),
    st.sampled_from([0.05, 0.1, 0.025, 1.0]),
)
def test_moving_the_map_and_the_rays_together_changes_nothing(occupied, chosen, origin, resolution):
    origins = as_origins(chosen)
    moved = compose(origin, origins * [resolution, resolution, 1.0])
    here = caster_of(occupied).cast(origins, 20.0)
    there = caster_of(occupied, resolution, origin).cast(moved, 20.0 * resolution) / resolution
    np.testing.assert_allclose(there, here, atol=1e-8)


@relaxed
@given(grids, rays)
def test_a_mirrored_map_mirrors_the_ranges_of_rays_that_start_inside_cells(occupied, chosen):
    origins = as_origins(chosen) + np.array([0.125, 0.125, 0.0])  # never on a border, where the floor rule has a side
    mirrored = origins * [-1.0, 1.0, -1.0] + [occupied.shape[1], 0.0, np.pi]
    here, there = caster_of(occupied).cast(origins, 20.0), caster_of(occupied[:, ::-1]).cast(mirrored, 20.0)
    np.testing.assert_allclose(there, here, atol=1e-9)


@relaxed
@given(grids, rays)
def test_a_range_ends_at_an_occupied_cell_and_passes_through_none(occupied, chosen):
    caster, origins = caster_of(occupied), as_origins(chosen)
    ranges, hits = caster.cast(origins, 20.0), caster.cast_hits(origins, 20.0)
    assert ((hits[:, 0] >= 0) == (ranges < 20.0)).all()
    for (x, y, theta), length, (row, col) in zip(origins, ranges, hits, strict=True):
        if row >= 0:
            assert occupied[row, col]
            end_x, end_y = x + length * np.cos(theta), y + length * np.sin(theta)
            assert max(col - end_x, end_x - col - 1, row - end_y, end_y - row - 1) < 1e-9
