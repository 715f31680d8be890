"""The direction of a wall is that of the wall that was drawn, whatever the grid's."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.wall_normals import wall_normals

RESOLUTION, YAW = 0.05, 0.3


def plank(degrees: float, thickness_cells: float) -> tuple[OccupancyGrid, FloatArray]:
    """Return a grid with a straight wall, and which cells of it are far from its ends."""
    rows, cols = np.mgrid[0:120, 0:120] - 59.5
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    along, across = cols * c + rows * s, rows * c - cols * s
    wall = (np.abs(across) <= max(0.5 * thickness_cells, 0.71)) & (np.abs(along) < 50.0)
    return OccupancyGrid(wall.astype(float), RESOLUTION, (1.0, 2.0, YAW)), wall & (np.abs(along) < 44.0)


@pytest.mark.parametrize("thickness", [1.0, 2.0, 3.0, 6.0])
def test_normals_of_drawn_walls(thickness: float):
    errors = []
    for degrees in range(0, 180, 7):
        grid, middle = plank(degrees, thickness)
        normals = wall_normals(grid)[middle]
        truth = np.radians(degrees + 90.0) + YAW
        errors.append((normals[np.isfinite(normals)] - truth + 0.5 * np.pi) % np.pi - 0.5 * np.pi)
        if thickness < 3.0:
            assert np.isfinite(normals).all()
    off = np.degrees(np.abs(np.concatenate(errors)))
    assert np.median(off) < 2.5
    assert np.quantile(off, 0.95) < 5.0


def test_corners_ends_and_clutter_have_no_direction():
    cells = np.zeros((40, 60))
    cells[10, 10:50] = cells[10:30, 10] = 1.0
    cells[25, 40] = cells[25, 42] = 1.0
    normals = wall_normals(OccupancyGrid(cells, RESOLUTION))
    assert np.isnan(normals[[10, 25, 25], [10, 40, 42]]).all()
    assert np.isnan(normals[cells == 0.0]).all()
    np.testing.assert_allclose(normals[10, 20:50] % np.pi, 0.5 * np.pi, atol=1e-6)
    np.testing.assert_allclose(np.cos(2.0 * normals[20:30, 10]), 1.0, atol=1e-6)
