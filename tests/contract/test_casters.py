"""What holds for everything that casts the beams or cones of a sensor in a map."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from beamfield.maps.cone import ConeCaster
from beamfield.maps.landmark_cone import LandmarkCones
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from tests.threads import forced_threads

RNG = np.random.default_rng(8)
GRID = OccupancyGrid(RNG.choice([0.0, 1.0, np.nan], (60, 80), p=[0.96, 0.02, 0.02]).astype(np.float32), 0.1)
POSTS = LandmarkMap(RNG.uniform(0.0, [8.0, 6.0], (30, 2)))
POSES = np.column_stack([RNG.uniform(-1.0, [9.0, 7.0], (601, 2)), RNG.uniform(-4.0, 4.0, 601)])
BEARINGS = np.linspace(-3.0, 3.0, 16)
# What makes a caster, and the opening angle of what it casts.
CASTERS: dict[str, tuple[Callable[[], Any], float]] = {
    "rays": (lambda: RayCaster(GRID), 0.0),
    "rays that stop at unknown cells": (lambda: RayCaster(GRID, unknown="occupied"), 0.0),
    "a table of ranges": (lambda: RangeTable.build(GRID, resolution=0.5, headings=36), 0.0),
    "cones": (lambda: ConeCaster(GRID), 0.4),
    "cones among posts": (lambda: LandmarkCones(POSTS, 0.05), 0.4),
}


@pytest.fixture(params=CASTERS)
def caster(request: pytest.FixtureRequest) -> Any:
    return CASTERS[request.param][0]()


@pytest.fixture
def finder(request: pytest.FixtureRequest) -> RangeFinder:
    opening_angle = CASTERS[request.node.callspec.params["caster"]][1]
    return RangeFinder.from_bearings(BEARINGS, 6.0, mount=(0.2, -0.1, 0.5), opening_angle=opening_angle)


def test_poses_may_have_any_shape_and_be_none_and_so_may_beams(caster, finder):
    ranges = caster.expected_ranges(POSES[:600], finder)
    assert 0.3 < (ranges < 6.0).mean() < 1.0
    assert (caster.expected_ranges(POSES[:600].reshape(20, 30, 3), finder) == ranges.reshape(20, 30, 16)).all()
    assert (caster.expected_ranges(POSES[5], finder) == ranges[5]).all()
    assert caster.expected_ranges(np.empty((4, 0, 3)), finder).shape == (4, 0, 16)
    assert caster.expected_ranges(POSES, finder.subset([])).shape == (601, 0)


def test_one_by_one_by_any_number_of_threads_and_at_once_ranges_have_the_same_bits(caster, finder):
    with forced_threads(1):
        one = caster.expected_ranges(POSES, finder)
        assert (np.stack([caster.expected_ranges(pose, finder) for pose in POSES]) == one).all()
    for threads in (2, 3, 7):
        with forced_threads(threads):
            assert (caster.expected_ranges(POSES, finder) == one).all()
    with ThreadPoolExecutor(4) as pool:
        for ranges in pool.map(lambda _: caster.expected_ranges(POSES, finder), range(16)):
            assert (ranges == one).all()


def test_casters_pickle_and_do_not_change(caster, finder):
    again = pickle.loads(pickle.dumps(caster))
    assert (again.expected_ranges(POSES, finder) == caster.expected_ranges(POSES, finder)).all()
    with pytest.raises(AttributeError):
        caster.grid = None
