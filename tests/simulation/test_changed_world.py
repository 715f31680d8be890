"""A changed world: what is reported as new or gone is what differs, and the robot still gets around."""

from __future__ import annotations

import numpy as np

from beamfield.simulation.changed_world import change_world
from beamfield.simulation.floor_plan import draw_floor_plan


def test_what_changed_is_what_is_said():
    grid, bare = (draw_floor_plan(seed=5, width=26.0, height=20.0, furnished=on) for on in (True, False))
    world, changes = change_world(grid, bare, np.random.default_rng(5))
    again, same = change_world(grid, bare, np.random.default_rng(5))
    assert changes == same
    np.testing.assert_array_equal(world.probability, again.probability)
    assert [change.kind for change in changes] == ["missing wall", "new obstacle"] * 6 + ["new obstacle"]
    covered = {"new obstacle": np.zeros(grid.shape, bool), "missing wall": np.zeros(grid.shape, bool)}
    rows, cols = np.indices(grid.shape)
    points = grid.to_map(np.column_stack([cols.ravel(), rows.ravel()]) + 0.5)
    for change in changes:
        apart = np.abs(points - [change.x, change.y]) / [change.width, change.height]
        covered[change.kind] |= (apart <= 0.5).all(axis=1).reshape(grid.shape)
    for kind, before, after in (("new obstacle", grid, world), ("missing wall", world, grid)):
        differs = after.occupied & before.free
        assert differs.any()
        assert not (differs & ~covered[kind]).any()
