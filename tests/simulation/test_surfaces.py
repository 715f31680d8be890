"""Walls of a grid: all of its faces, straightened no more than allowed, with their corners and edges."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import transform_points
from beamfield.kernels.acoustics import INNER_CORNER, PLAIN_END, ROUND, SHARP_EDGE
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.simulation.surfaces import Surfaces, surfaces_of_grid


def grid_of(picture: str, resolution: float = 1.0, origin: tuple[float, float, float] = (0.0, 0.0, 0.0)):
    """Draw a grid; # is occupied, the last line has the lowest y."""
    rows = picture.split()[::-1]
    cells = np.array([[1.0 if c == "#" else 0.0 for c in row] for row in rows])
    return OccupancyGrid(cells, resolution, origin)


def walls_as_set(surfaces: Surfaces) -> set[tuple[float, ...]]:
    return {tuple(np.round([*a, *b], 9)) for a, b in zip(surfaces.starts, surfaces.ends, strict=True)}


def test_a_block_has_four_walls_with_the_free_space_on_their_left():
    surfaces = surfaces_of_grid(grid_of(".... .##. .##. ...."))
    assert walls_as_set(surfaces) == {(1, 1, 1, 3), (1, 3, 3, 3), (3, 3, 3, 1), (3, 1, 1, 1)}
    np.testing.assert_allclose(surfaces.bends, -np.pi / 2)
    assert (surfaces.walls().end == SHARP_EDGE).all()


def test_the_walls_of_a_room_turn_the_other_way_round_and_meet_in_corners():
    surfaces = surfaces_of_grid(grid_of("#### #..# #### "))
    inner = {(1, 1, 3, 1), (3, 1, 3, 2), (3, 2, 1, 2), (1, 2, 1, 1)}
    assert inner < walls_as_set(surfaces)
    kinds = surfaces.walls().end
    in_room = [tuple(np.round([*a, *b])) in inner for a, b in zip(surfaces.starts, surfaces.ends, strict=True)]
    assert (kinds[in_room] == INNER_CORNER).all()
    assert (kinds[~np.array(in_room)] == SHARP_EDGE).all()


def test_cells_that_touch_at_a_corner_are_one_thing():
    surfaces = surfaces_of_grid(grid_of("#. .#"), smoothing=0.0)
    assert len(surfaces) == 8
    start, seen = 0, []
    while start not in seen:
        seen.append(start)
        start = int(surfaces.following[start])
    assert len(seen) == 8


def test_walls_lie_in_the_map_frame():
    origin = (2.0, -1.0, 0.5)
    plain = surfaces_of_grid(grid_of("... .#. ..."))
    turned = surfaces_of_grid(grid_of("... .#. ...", 0.5, origin))
    np.testing.assert_allclose(turned.starts, transform_points(origin, 0.5 * plain.starts))


def test_without_smoothing_the_length_of_the_walls_is_that_of_the_faces(rng):
    cells = (rng.random((30, 40)) < 0.4).astype(float)
    surfaces = surfaces_of_grid(OccupancyGrid(cells, 0.1), smoothing=0.0)
    padded = np.pad(cells, 1)
    n_faces = np.abs(np.diff(padded, axis=0)).sum() + np.abs(np.diff(padded, axis=1)).sum()
    assert np.hypot(*(surfaces.ends - surfaces.starts).T).sum() == pytest.approx(0.1 * n_faces)
    # Every wall has an occupied cell on its right and a free one on its left.
    along = (surfaces.ends - surfaces.starts) / np.hypot(*(surfaces.ends - surfaces.starts).T)[:, None]
    beside = np.column_stack([-along[:, 1], along[:, 0]]) * 0.05
    middle = surfaces.starts + along * 0.05
    grid = OccupancyGrid(cells, 0.1)
    assert not grid.look_up(grid.occupied, middle + beside).any()
    assert grid.look_up(grid.occupied, middle - beside).all()


def test_a_slanted_wall_becomes_straight_and_stays_within_the_tolerance():
    y, x = np.indices((120, 160)) + 0.5
    slanted = np.abs((y - 60.0) * np.cos(0.3) - (x - 80.0) * np.sin(0.3)) < 6.0
    slanted &= np.abs((x - 80.0) * np.cos(0.3) + (y - 60.0) * np.sin(0.3)) < 60.0
    grid = OccupancyGrid(slanted.astype(float), 0.05)
    stairs, straight = surfaces_of_grid(grid, smoothing=0.0), surfaces_of_grid(grid, smoothing=1.25)
    assert len(stairs) > 60
    assert len(straight) <= 12
    # Every corner of a cell is near the straight walls.
    along = straight.ends - straight.starts
    offset = stairs.starts[:, None] - straight.starts[None]
    share = np.clip((offset * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
    distance = np.hypot(*np.moveaxis(offset - share[..., None] * along, -1, 0)).min(axis=1)
    assert distance.max() <= 1.25 * 0.05 + 1e-9
    longest = np.argsort(-np.hypot(*along.T))[:2]
    np.testing.assert_allclose(np.mod(np.arctan2(along[longest, 1], along[longest, 0]), np.pi), 0.3, atol=0.02)


def test_a_pillar_is_round():
    y, x = np.indices((40, 40)) + 0.5
    surfaces = surfaces_of_grid(OccupancyGrid((np.hypot(x - 20, y - 20) < 8).astype(float), 0.05))
    assert (surfaces.walls().end == ROUND).all()


def test_ends_of_open_outlines_are_edges_and_blunt_inner_bends_are_nothing():
    surfaces = Surfaces.from_outlines([[[0, 0], [1, 0], [2, 0.5]]], closed=False)
    assert surfaces.following.tolist() == [1, -1]
    assert np.isnan(surfaces.bends[1])
    assert surfaces.walls().end.tolist() == [PLAIN_END, SHARP_EDGE]


def test_walls_that_are_none_are_refused():
    with pytest.raises(InvalidInputError, match="no occupied cell"):
        surfaces_of_grid(grid_of("..."))
    with pytest.raises(InvalidInputError, match=r"smoothing: expected .* got -1"):
        surfaces_of_grid(grid_of(".#."), smoothing=-1.0)
    with pytest.raises(InvalidInputError, match="at least one, got none"):
        Surfaces.from_outlines([])
    with pytest.raises(InvalidInputError, match=r"outline: expected shape \(n, 2\) with n > 1, got \(1, 2\)"):
        Surfaces.from_outlines([[[0, 0]]])
    with pytest.raises(InvalidInputError, match="wall 1 has no length"):
        Surfaces.from_outlines([[[0, 0], [1, 0], [1, 0]]])
    with pytest.raises(InvalidInputError, match="finite"):
        Surfaces.from_outlines([[[0, 0], [1, np.nan], [1, 0]]])
    with pytest.raises(InvalidInputError, match=r"m > 0, got \(0, 2\)"):
        Surfaces(np.empty((0, 2)), np.empty((0, 2)), np.empty(0, int))
    with pytest.raises(InvalidInputError, match="indices of walls"):
        Surfaces(np.zeros((1, 2)), np.ones((1, 2)), np.array([3]))
