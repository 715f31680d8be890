"""Rays that take many steps at once beside those that look at each; passes with the JIT off as well."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.kernels.marching import march
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.mrpt.rays import BITS, STEP, steps_at_once


@pytest.mark.parametrize("n_steps", [3, 80])
def test_many_steps_at_once_find_what_single_steps_find(rng, n_steps):
    cells = np.kron(rng.choice([0.0, 0.5, 1.0], (8, 10), p=[0.85, 0.05, 0.1]), np.ones((4, 4)))
    grid = OccupancyGrid(cells, 0.05, np.array([-0.3, 0.2, 0.0]))
    known = steps_at_once(grid)
    assert known.max() > 5
    poses = np.column_stack([rng.uniform(-0.6, 2.0, 60), rng.uniform(0.0, 2.0, 60), rng.uniform(-4.0, 4.0, 60)])
    bearings = np.concatenate([np.arange(4) * np.pi / 2, rng.uniform(-4.0, 4.0, 16)])
    poses[:10, 2] = 0.0  # rays along the axes
    found = []
    for steps in (known, np.minimum(known, 1)):
        ranges = np.empty((60, 20))
        starts = np.zeros((2, 20))
        march(poses, (-0.3, 0.2), 0.05, starts, bearings, STEP, BITS, n_steps, steps, ranges)
        found.append(ranges)
    assert len(np.unique(found[1])) > 3
    assert found[0].tolist() == found[1].tolist()
