"""The format of a log is recognised by its content, and errors say what is supported."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.read_log import read_log

FLASER = "FLASER 3 1 2 3 0 0 0 0 0 0 {0} host {0}"
G2O = "VERTEX_SE2 0 1 2 3\nROBOTLASER1 0 -1 2 1 50 0.1 0 3 1 2 3 0 0 0 0 0 0 0 0 0 0 0 0 10 nohost 1\n"
WEAN = "O 1 2 3 0.5\nL 0 0 0 25 0 0 " + "70 " * 180 + "0.6\n"
CORESLAM = "1000000 " + "0 " * 23 + "700 " * 682 + "\n"
GFS = "PARAM a 1\nODOM 0 0 0 1\nLASER_READING 180 " + "3 " * 180 + "0 0 0 5\n"

CASES = {
    "FLASER": FLASER.format(1) + "\n",
    "ROBOTLASER1": G2O,
    "L": WEAN,
    "laser": CORESLAM,
    "LASER_READING": GFS,
}


@pytest.mark.parametrize("sensor", CASES)
@pytest.mark.parametrize("name", ["log", "log.gz", "odd.csv"])
def test_the_content_decides_not_the_name(tmp_path, sensor, name):
    text = CASES[sensor].encode()
    path = tmp_path / name
    path.write_bytes(gzip.compress(text) if name == "odd.csv" else text)
    log = read_log(path)
    assert list(log.sensors) == [sensor]
    assert log.source == str(path)
    assert len(log.only_sensor()) == 1


def test_odometry_may_come_long_before_the_first_scan(tmp_path):
    path = tmp_path / "log"
    lines = [f"ODOM {i} 0 0 0 0 0 {i} host {i}" for i in range(500)] + [FLASER.format(500 + i) for i in range(3)]
    path.write_text("\n".join(lines))
    assert len(read_log(path).only_sensor()) == 3


def test_options_reach_the_reader(tmp_path):
    path = tmp_path / "log"
    path.write_text("\n".join(FLASER.format(i) for i in (3, 2, 1)))
    sensor = read_log(
        path, no_return=(3.0,), max_range=9.0, min_range=0.5, stamps="order", lone_poses="odometry"
    ).only_sensor()
    assert sensor.finder.max_range == 9.0
    assert sensor.finder.min_range == 0.5
    assert np.isposinf(sensor.ranges[:, 2]).all()
    assert sensor.no_return.origin == "given"
    assert sensor.has_odometry
    assert not sensor.has_poses


def test_sensors_are_chosen_by_name(tmp_path):
    path = tmp_path / "log"
    path.write_text(FLASER.format(1) + "\n" + FLASER.format(2).replace("FLASER", "RLASER") + "\n")
    assert list(read_log(path).sensors) == ["FLASER", "RLASER"]
    assert list(read_log(path, sensor_topic="RLASER").sensors) == ["RLASER"]
    assert list(read_log(path, sensor_topic=["RLASER", "FLASER"]).sensors) == ["RLASER", "FLASER"]
    with pytest.raises(InvalidInputError, match="no sensor '/scan'"):
        read_log(path, sensor_topic="/scan")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no scans: the file is empty"),
        (b"# only\n\n# comments\n", "no scans: the file is empty"),
        (b"t,x,y,theta\n0,1,2,3\n", r":1: unknown format, the text starts with 't,x,y,theta'; supported: CARMEN"),
        (b"hello world\n" * 500, "unknown format, the text starts with 'hello world'"),
        (b"\x7fELF\x02\x01\x01\x00\x00\x00", "expected text, got binary data"),
        (gzip.compress(b"FLASER 3 1 2 3\n", mtime=0)[:-6], "gzip stream is damaged or ends early"),
        (b"ODOM 1 2 3 0 0 0 1 host 1\n", "no scans"),
    ],
)
def test_what_is_no_log_is_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message) as caught:
        read_log(path)
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_missing_files_and_other_folders(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_log(tmp_path / "nothing.log")
    with pytest.raises(FormatError, match=r"a folder without metadata\.yaml"):
        read_log(tmp_path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"poses_topic": "/pose"}, "poses_topic: is for bags; .* is text"),
        ({"map_frame": "map"}, "map_frame: is for bags"),
        ({"base_frame": "base"}, "base_frame: is for bags"),
        ({"min_range": -1.0}, "min_range: expected a finite number"),
        ({"max_range": float("nan")}, "max_range: expected a finite number"),
        ({"no_return": "maybe"}, "expected 'detect', 'none'"),
        ({"stamps": "sorted"}, "expected 'file' or 'order'"),
        ({"lone_poses": "both"}, "expected 'reference' or 'odometry'"),
        ({"mask": (-1.0, 1.0)}, r"mask\[0\]: expected \(a number, a number\), got -1.0"),
        ({"no_return": 0.0}, "no_return: expected 'detect' or 'none' or a sequence, got 0.0"),
    ],
)
def test_options_that_do_not_fit_are_refused(tmp_path, options, message):
    path = tmp_path / "log"
    path.write_text(FLASER.format(1))
    with pytest.raises(InvalidInputError, match=message):
        read_log(path, **options)


@pytest.mark.parametrize("name", ["run.bag", "renamed"])
def test_bags_go_to_the_bag_reader(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"#ROSBAG V2.0\nbroken")
    with pytest.raises(FormatError) as caught:
        read_log(path)
    assert "unknown format" not in str(caught.value)
    with pytest.raises(InvalidInputError, match="stamps='order' is for text logs, this is a bag"):
        read_log(path, stamps="order")
    with pytest.raises(InvalidInputError, match="lone_poses='odometry' is for text logs, this is a bag"):
        read_log(path, lone_poses="odometry")
