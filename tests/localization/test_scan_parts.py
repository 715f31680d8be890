"""Parts of a scan that fit the map by different headings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.localization.scan_parts import parts_that_disagree
from beamfield.localization.trajectory import fit_trajectory
from beamfield.localization.wall_distance import walls_of
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog


def with_bearings(log: SensorLog, bearings: np.ndarray) -> SensorLog:
    mounts = log.finder.mounts.copy()
    mounts[:, 2] = bearings
    return replace(log, finder=replace(log.finder, mounts=mounts))


def test_a_laser_that_was_merged_by_a_wrong_transform_is_named(drive: SensorLog, office: OccupancyGrid):
    bearings = drive.finder.mounts[:, 2]
    merged = with_bearings(drive, np.where(bearings > 0.0, bearings + np.radians(6.0), bearings))
    fit = fit_trajectory(merged, office, start=drive.poses[0])
    [found] = [one for one in fit.findings if one.name == "scan-parts-disagree"]
    # Only the difference shows: the left half belongs further to the right, or the right half to the left.
    assert found.text.startswith("The beams from -90 to 0 degrees fit the map best turned by ")
    assert np.radians(3.5) < found.values["turn_rad"] < np.radians(7.0)


@pytest.mark.parametrize(("stretched", "n"), [(1.0, 0), (1.01, 0), (1.06, 1)])
def test_bearings_that_are_too_wide_are_named(drive: SensorLog, office: OccupancyGrid, stretched, n):
    log = with_bearings(drive, stretched * drive.finder.mounts[:, 2])
    assert len(parts_that_disagree(log, walls_of(office), drive.poses, np.ones(len(drive), bool))) == n


def test_few_scans_say_nothing(drive: SensorLog, office: OccupancyGrid):
    log = with_bearings(drive, 1.06 * drive.finder.mounts[:, 2])
    assert parts_that_disagree(log, walls_of(office), drive.poses, np.arange(len(drive)) < 19) == []
