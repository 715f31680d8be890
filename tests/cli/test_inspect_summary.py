"""What inspect says about maps and logs, before it is printed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beamfield.cli.inspect_summary import log_facts, log_text, map_facts, map_text, path_length
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, ScanLog, SensorLog
from tests.cli.wall_drive import make_sensor


def test_a_map_without_obstacles_or_without_free_cells_is_noted():
    assert "no cell is occupied" in map_text(map_facts(OccupancyGrid(np.zeros((2, 2)), 0.1)))
    assert "no cell is free" in map_text(map_facts(OccupancyGrid(np.ones((2, 2)), 0.1)))
    inverted = np.ones((5, 5))
    inverted[0, :2] = 0.0
    text = map_text(map_facts(OccupancyGrid(inverted, 0.1, [0.0, 0.0, 90.0])))
    assert "occupied cells outnumber free ones 12 to 1" in text
    assert "yaw is 90 radians: are these degrees?" in text


def test_every_share_is_counted_apart_and_they_add_up():
    ranges = make_sensor().ranges.copy()
    ranges[0], ranges[1], ranges[2, 0], ranges[3, 0] = np.nan, 0.05, -np.inf, 8.5
    readings = log_facts(ScanLog({"a": make_sensor(ranges=ranges)}))["sensors"]["a"]["readings"]
    assert readings["no_measurement_share"] == pytest.approx(19 / 380)
    assert readings["too_close_share"] == pytest.approx(20 / 380)
    assert readings["no_return_share"] == pytest.approx((18 * 11 - 1) / 380)
    shares = ("measured_share", "no_return_share", "no_measurement_share", "too_close_share")
    assert sum(readings[name] for name in shares) == pytest.approx(1.0)
    assert readings["scans_without_measurement"] == 1
    assert (readings["shortest_m"], readings["longest_m"]) == (1.5, pytest.approx(1.5 / math.sin(math.radians(20))))


def finder_deg(bearings_deg, **limits) -> RangeFinder:
    return RangeFinder.from_bearings(np.radians(bearings_deg), 5.0, **limits)


@pytest.mark.parametrize(
    ("finder", "text"),
    [
        (finder_deg([90.0, 0.0, -90.0]), "90.0 to -90.0 degrees, spanning 180.0, every 90, clockwise"),
        # All the way around, not "-89.0 to -90.0".
        (finder_deg(np.arange(-89.0, 270.5, 1.0)), "from -89.0 to 270.0 degrees, spanning 359.0"),
        (finder_deg([0.0, 10.0, 40.0]), "spanning 40.0, unevenly spaced"),
        (finder_deg(np.arange(0.0, 360.0, 1.0)), "from 0.0 to 359.0 degrees, spanning 359.0, every 1, counter-"),
        (finder_deg(np.arange(-180.0, 180.0, 1.0)), "from -180.0 to 179.0 degrees"),
        (finder_deg(np.arange(-180.0, 180.5, 1.0)), "from -180.0 to 180.0 degrees, spanning 360.0"),
        (finder_deg(np.arange(180.0, -180.0, -1.0)), "from 180.0 to -179.0 degrees, spanning 359.0, every 1, clock"),
        (finder_deg([-45.0, 45.0], opening_angle=math.radians(30)), "cones of 30.0 degrees"),
        (finder_deg([0.0]), "beams             1\n"),
        (RangeFinder(np.array([[0.1, 0.2, 0.0], [0.3, 0.0, 1.0]]), 5.0), "2 places on the robot"),
    ],
)
def test_beams_of_every_kind_are_described(finder, text):
    k = finder.n_beams
    nowhere = np.full((2, 3), np.nan)
    log = ScanLog({"a": SensorLog(finder, np.array([0.0, 1.0]), np.ones((2, k)), nowhere, nowhere)})
    assert text in log_text(log_facts(log)) + "\n"


def test_the_path_length_skips_unknown_poses():
    poses = np.array([[0.0, 0, 0], [np.nan] * 3, [3.0, 4.0, 1.0], [3.0, 5.0, 1.0]])
    assert path_length(poses) == 6.0
    assert path_length(np.full((3, 3), np.nan)) == 0.0
