"""``beamfield inspect`` on real logs says what their documentation says."""

from __future__ import annotations

import json

import pytest
from PIL import Image

from beamfield.cli.main import main

pytestmark = pytest.mark.real


def inspected(capsys, *words) -> dict:
    assert main(["inspect", *map(str, words), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_wean_hall_with_its_reference_poses_over_its_map(data, tmp_path, capsys):
    folder = data / "wean_hall"
    facts = inspected(
        capsys, folder / "robotdata1.log.gz", "--poses", folder / "reference_robotdata1.csv.gz",
        "--map", folder / "wean.dat.gz", "--out", tmp_path / "a.png",
    )  # fmt: skip
    sensor = facts["sensors"]["L"]
    assert (sensor["scans"], sensor["beams"]["count"]) == (713, 180)
    assert sensor["beams"]["origins_m"] == [[0.25, 0.0]]
    assert sensor["reference_poses"]["path_length_m"] == pytest.approx(sensor["odometry"]["path_length_m"], rel=0.02)
    with Image.open(tmp_path / "a.png") as picture:
        assert min(picture.size) > 800


def test_the_turtlebots_bag_and_the_map_whose_unknown_cells_read_as_free(data, capsys):
    pytest.importorskip("rosbags")
    folder = data / "olin_mac_tb4"
    facts = inspected(capsys, folder / "macfirst_floor_take_2")
    sensor = facts["sensors"]["/scan"]
    assert (sensor["scans"], sensor["beams"]["count"], sensor["max_range_m"]) == (357, 720, 12.0)
    (note,) = inspected(capsys, folder / "map/mac_1st_floor_final.yaml")["notes"]
    assert "79.2% of the pixels have grey 205" in note


def test_a_bag_with_two_lidars(data, tmp_path, capsys):
    pytest.importorskip("rosbags")
    facts = inspected(capsys, data / "hokuyo_pair/scans_demo.bag", "--out", tmp_path / "a.png")
    assert set(facts["sensors"]) == {"/front_scan", "/rear_scan"}
