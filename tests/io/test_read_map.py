"""A map is read whatever file it is in."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.bags import reader as rosbag
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.read_map import read_map
from beamfield.maps.occupancy import OccupancyGrid

WEAN = b"robot_specifications->resolution 10\nglobal_map[0]: 1 2\n1.0 0.0\n"


def test_the_ending_decides(tmp_path):
    for name in ("a.yaml", "a.yml"):
        write_map(OccupancyGrid([[0.0, 1.0]], 0.05), tmp_path / name)
        assert read_map(tmp_path / name).resolution == 0.05
    (tmp_path / "a.dat").write_bytes(WEAN)
    (tmp_path / "a.dat.gz").write_bytes(gzip.compress(WEAN))
    for name in ("a.dat", "a.dat.gz"):
        assert read_map(tmp_path / name).shape == (2, 1)


@pytest.mark.parametrize("name", ["a.bag", "a.mcap", "a.db3", "folder"])
def test_bags_are_given_to_their_reader_with_the_topic(tmp_path, monkeypatch, name):
    (tmp_path / "folder").mkdir()
    grid = OccupancyGrid([[0.0]], 0.05)
    calls = []

    def read(path, topic=None):
        calls.append((path, topic))
        return grid

    monkeypatch.setattr(rosbag, "read_bag_map", read)
    assert read_map(tmp_path / name, topic="/map") is grid
    assert calls == [(tmp_path / name, "/map")]


def test_a_topic_for_a_file_that_is_no_bag_is_refused(tmp_path):
    with pytest.raises(InvalidInputError, match=r"a\.yaml: topic applies to bags only"):
        read_map(tmp_path / "a.yaml", topic="/map")


def test_a_picture_alone_is_refused_with_what_to_do(tmp_path):
    (tmp_path / "a.PGM").write_bytes(b"P5 1 1 255\n0")
    with pytest.raises(FormatError, match="give the map_server YAML file"):
        read_map(tmp_path / "a.PGM")


def test_an_unknown_ending_and_a_missing_file_are_named(tmp_path):
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(FormatError, match=r"a\.txt: expected a map ending in \.yaml"):
        read_map(tmp_path / "a.txt")
    for name in ("none.yaml", "none.dat", "none.xyz"):
        with pytest.raises(FileNotFoundError):
            read_map(tmp_path / name)


def test_the_limit_of_pixels_is_passed_on(tmp_path):
    write_map(OccupancyGrid(np.zeros((3, 4)), 0.05), tmp_path / "a.yaml")
    (tmp_path / "a.dat").write_bytes(WEAN)
    with pytest.raises(FormatError, match="limit of 11"):
        read_map(tmp_path / "a.yaml", max_pixels=11)
    with pytest.raises(FormatError, match=r"limit of 1$"):
        read_map(tmp_path / "a.dat", max_pixels=1)
