"""Changed places on real logs: independent drives name the same missing walls, and windows return nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beamfield.io.read_map import read_map
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.changed_places import ChangedPlaces, find_changed_places
from tests.real.posed_logs import turtlebot_log, wean_log

pytestmark = pytest.mark.real
# About what `calibrate` learns, which would take the time of all the rest.
WEAN = BeamParameters(0.88, 0.067, 0.004, 0.049, 0.08, 0.39, range_offset=0.25, sigma_slope=0.13)
TURTLEBOT = BeamParameters(0.6, 0.01, 0.185, 0.205, 0.014, 0.0, range_offset=0.04, sigma_slope=0.013)


def wean_places(data: Path, number: int) -> ChangedPlaces:
    log = wean_log(data, number, max_range=81.83)
    return find_changed_places(log, read_map(data / "wean_hall/derived_wean.yaml"), WEAN)


def test_two_drives_through_wean_hall_name_the_same_missing_walls(data: Path):
    first, third = (wean_places(data, number) for number in (1, 3))
    for x, y in ((34.8, 41.3), (33.4, 41.55), (30.0, 39.9), (46.6, 40.6), (56.5, 38.4)):
        for found in (first, third):
            assert min(np.hypot(p.x - x, p.y - y) for p in found.of_kind("missing wall")) < 0.5, (x, y)
    # People go along the corridor in the first drive only.
    assert len(first.of_kind("passing (people)")) > 10 > len(third.of_kind("passing (people)"))
    assert not first.of_kind("new obstacle")


def test_windows_return_nothing(data: Path):
    found = find_changed_places(
        turtlebot_log(data), read_map(data / "olin_mac_tb4/map/mac_1st_floor_final.yaml"), TURTLEBOT
    )
    front = max(found.of_kind("no return (glass?)"), key=lambda place: place.readings)
    assert (front.x, front.y) == pytest.approx((9.7, -5.0), abs=0.3)
    assert front.height == pytest.approx(2.1, abs=0.4)
    assert front.visits_changed == front.visits == 9
    assert front.rate > 0.7
