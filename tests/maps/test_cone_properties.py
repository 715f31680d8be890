"""What must hold for every map and every cone, on cones whose edges meet corners and borders."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from beamfield.geometry import compose
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from tests.maps.test_raycast_properties import as_origins, rays

grids = arrays.arrays(bool, st.tuples(st.integers(1, 7), st.integers(1, 40)))
# Halves of these, added to directions of small whole numbers, run through corners and along borders again.
openings = st.sampled_from([0.0, 1e-9, 0.1, np.pi / 4, np.pi / 2, 2 * np.arctan2(1, 2), 2 * np.arctan2(1, 3), 3.0])
relaxed = settings(max_examples=80, derandomize=True)


def caster_of(occupied, resolution=1.0, origin=(0.0, 0.0, 0.0)):
    return ConeCaster(OccupancyGrid(occupied.astype(np.float32), resolution, origin))


@relaxed
@given(grids, rays, openings, st.data())
def test_adding_an_obstacle_never_lengthens_a_cone(occupied, chosen, opening, data):
    more = occupied.copy()
    more[data.draw(st.integers(0, occupied.shape[0] - 1)), data.draw(st.integers(0, occupied.shape[1] - 1))] = True
    origins = as_origins(chosen)
    assert (caster_of(more).cast(origins, opening, 20.0) <= caster_of(occupied).cast(origins, opening, 20.0)).all()


@relaxed
@given(grids, rays, openings, openings)
def test_a_wider_cone_is_never_longer(occupied, chosen, one, other):
    caster, origins = caster_of(occupied), as_origins(chosen)
    narrow, wide = sorted([one, other])
    assert (caster.cast(origins, wide, 20.0) <= caster.cast(origins, narrow, 20.0) + 1e-8).all()


@relaxed
@given(grids, rays, openings, st.floats(-1.0, 1.0))
def test_a_cone_is_never_longer_than_a_ray_in_it(occupied, chosen, opening, where):
    caster, origins = caster_of(occupied), as_origins(chosen)
    inside = origins + np.array([0.0, 0.0, where * opening / 2])
    beam = RayCaster(caster.grid).cast(inside, 20.0)
    assert (caster.cast(origins, opening, 20.0) <= beam + 1e-8).all()


@relaxed
@given(grids, rays)
def test_a_cone_without_width_is_a_ray(occupied, chosen):
    caster, origins = caster_of(occupied), as_origins(chosen)
    np.testing.assert_array_equal(caster.cast(origins, 0.0, 20.0), RayCaster(caster.grid).cast(origins, 20.0))


@relaxed
@given(grids, rays, openings, st.floats(0.1, 20.0))
def test_a_longer_max_range_only_uncovers_what_was_cut(occupied, chosen, opening, max_range):
    caster, origins = caster_of(occupied), as_origins(chosen)
    cut, whole = caster.cast(origins, opening, max_range), caster.cast(origins, opening, 45.0)
    np.testing.assert_allclose(cut, np.minimum(whole, max_range), rtol=1e-14)


@relaxed
@given(
    grids,
    rays,
    openings,
    st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3), st.floats(-4, 4)),
    st.sampled_from([0.05, 0.1, 0.025, 1.0]),
)
def test_moving_the_map_and_the_cones_together_changes_nothing(occupied, chosen, opening, origin, resolution):
    origins = as_origins(chosen)
    moved = compose(origin, origins * [resolution, resolution, 1.0])
    here = caster_of(occupied).cast(origins, opening, 20.0)
    there = caster_of(occupied, resolution, origin).cast(moved, opening, 20.0 * resolution) / resolution
    np.testing.assert_allclose(there, here, atol=1e-8)


@relaxed
@given(grids, rays, openings)
def test_a_mirrored_map_mirrors_the_ranges_of_cones_that_start_inside_cells(occupied, chosen, opening):
    origins = as_origins(chosen) + np.array([0.125, 0.125, 0.0])  # never on a border, where the floor rule has a side
    mirrored = origins * [-1.0, 1.0, -1.0] + [occupied.shape[1], 0.0, np.pi]
    here, there = (
        caster_of(occupied).cast(origins, opening, 20.0),
        caster_of(occupied[:, ::-1]).cast(mirrored, opening, 20.0),
    )
    np.testing.assert_allclose(there, here, atol=1e-9)


@relaxed
@given(grids, rays, openings)
def test_a_transposed_map_has_the_same_ranges(occupied, chosen, opening):
    """The search runs along rows; along columns it must find the same."""
    origins = as_origins(chosen) + np.array([0.125, 0.125, 0.0])
    swapped = np.column_stack([origins[:, 1], origins[:, 0], np.pi / 2 - origins[:, 2]])
    here, there = caster_of(occupied).cast(origins, opening, 20.0), caster_of(occupied.T).cast(swapped, opening, 20.0)
    np.testing.assert_allclose(there, here, atol=1e-9)
