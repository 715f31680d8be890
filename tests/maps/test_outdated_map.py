"""When a map is called out of date."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.maps.outdated_map import find_outdated_map
from tests.pillar_hall import N_BEAMS, POSES, drive, hall


@pytest.mark.parametrize(("n_wrong", "is_outdated"), [(22, False), (23, True), (30, True), (31, False)])
def test_a_map_is_out_of_date_where_a_quarter_to_45_percent_agree_at_the_right_poses_only(n_wrong, is_outdated):
    grid = hall()
    found = find_outdated_map(drive(grid, n_wrong), grid, POSES)
    assert (found is not None) is is_outdated
    if found is not None:
        assert found.values["median_agreement"] == pytest.approx(1.0 - n_wrong / N_BEAMS)
        assert found.values["median_agreement"] >= 2.5 * found.values["agreement_beside"]


def test_where_as_many_agree_beside_the_poses_they_are_not_known_to_be_right():
    # Half a metre along a wall, its readings agree as well.
    grid = hall(0)
    assert find_outdated_map(drive(grid, 25), grid, POSES) is None


def test_poses_that_left_the_robot_halfway_are_not_right():
    grid, log = hall(), drive(hall(), 25)
    lost = log.poses.copy()
    lost[8:] += np.array([1.5, -1.0, 0.5])
    assert find_outdated_map(log, grid, log.poses) is not None
    assert find_outdated_map(log, grid, lost) is None


def test_poses_that_nobody_knows_show_nothing():
    assert find_outdated_map(drive(hall(), 25), hall(), np.full_like(POSES, np.nan)) is None


@pytest.mark.parametrize(("n_wrong", "is_outdated"), [(22, False), (23, True), (30, True), (31, False)])
def test_of_poses_that_are_known_to_be_right_those_beside_them_are_not_asked(n_wrong, is_outdated):
    grid = hall(0)
    found = find_outdated_map(drive(grid, n_wrong), grid, POSES, are_right=True)
    assert (found is not None) is is_outdated
    if found is not None:
        assert found.values == {"median_agreement": pytest.approx(1.0 - n_wrong / N_BEAMS)}
