"""Logs of O and L lines."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.io.logs.wean_log import read_wean_log
from tests.io.test_carmen import write


def l_line(t, x=100.0, theta=0.0, ahead=25.0):
    laser = f"{x + ahead * np.cos(theta):.6f} {50.0 + ahead * np.sin(theta):.6f} {theta}"
    values = " ".join(str(v) for v in 100 + np.arange(180))
    return f"L {x} 50.0 {theta} {laser} {values} {t}"


def test_centimetres_become_metres_and_the_lasers_pose_the_mount(tmp_path):
    path = write(tmp_path, l_line(0.5, theta=1.0), "O 110 50 1.0 0.6", l_line(0.7, x=120.0, theta=1.2))
    log = read_wean_log(path)
    sensor = log.only_sensor("L")
    np.testing.assert_allclose(sensor.odometry, [[1.0, 0.5, 1.0], [1.2, 0.5, 1.2]])
    np.testing.assert_allclose(sensor.finder.mounts[:, :2], np.tile([0.25, 0.0], (180, 1)), atol=1e-12)
    np.testing.assert_allclose(np.degrees(sensor.finder.bearings), np.arange(-90, 90))
    np.testing.assert_array_equal(sensor.ranges[0], (100 + np.arange(180)) / 100)
    np.testing.assert_array_equal(sensor.stamps, [0.5, 0.7])
    assert not sensor.has_poses
    assert log.odometry is not None
    np.testing.assert_allclose(log.odometry.poses, [[1.1, 0.5, 1.0]])
    np.testing.assert_array_equal(log.odometry.stamps, [0.6])


BAD = {
    "cut off": (l_line(2.0).rsplit(" ", 3)[0], "L: expected 188 words, got 185"),
    "no number": (l_line(2.0).replace(" 150 ", " 15o "), "expected a number, got '15o'"),
    "nan pose": (l_line(2.0).replace("L 100.0", "L nan"), "expected a finite pose"),
    "short odometry": ("O 1 2 3", "O: expected 5 words, got 4"),
    "other line": ("FLASER 1 2 3", "expected a line O or L, got 'FLASER'"),
    "moving laser": (l_line(2.0, ahead=40.0), r"the laser moves on the robot.*0\.4"),
    "stamps": (l_line(-5.0), r"the stamps run backwards: -5\.0+ s after 1\.0+ s"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_line_is_named(tmp_path, case):
    line, message = BAD[case]
    with pytest.raises(FormatError, match=message) as caught:
        read_wean_log(write(tmp_path, l_line(0.0), l_line(1.0), line))
    assert caught.value.line == 3


def test_a_log_without_scans_is_refused(tmp_path):
    with pytest.raises(FormatError, match="no line L among 1 lines O"):
        read_wean_log(write(tmp_path, "O 1 2 3 4"))
