"""``beamfield calibrate-landmarks``: what it prints, writes and refuses."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.detection_log import DetectionLog
from beamfield.detections import Detections
from beamfield.io.landmarks.landmark_files import write_landmarks
from beamfield.io.parameters.landmark_model_file import read_landmark_model
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from tests.sightings_file import write_sightings

MAP = LandmarkMap([[0.0, 0.0], [9.0, 1.0], [4.0, 7.0]], ids=[4, 9, 2])
TRUTH = LandmarkParameters(0.1, 0.02, range_bias=0.5)
QUICK = ("--replicates", "20")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("landmarks")
    rng = np.random.default_rng(4)
    poses = rng.uniform([1.0, 1.0, -3.0], [8.0, 6.0, 3.0], (200, 3))
    seen = LandmarkModel(MAP, TRUTH, correspondence="known", mount=(0.2, 0.0, 1.0)).sample(poses, rng)
    log = DetectionLog(poses, [Detections(z.ranges, z.bearings, ids=z.ids, stamp=float(i)) for i, z in enumerate(seen)])
    write_landmarks(place / "tags.csv", MAP)
    write_sightings(place / "seen.csv", log)
    return place


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """The file has a default name."""
    monkeypatch.chdir(tmp_path)


def run(folder: Path, *words: str) -> int:
    mount = ("--mount", "0.2", "0", str(math.degrees(1.0)))
    files = (str(folder / "seen.csv"), "--landmarks", str(folder / "tags.csv"))
    return main(["calibrate-landmarks", *files, *mount, *QUICK, *words])


def test_headings_in_degrees_are_not_taken_for_a_wide_sensor(folder, tmp_path, capsys):
    """Each row alone could be right; that no bearing fits its landmark shows only in sigma."""
    header, *rows = (folder / "seen.csv").read_text().splitlines()
    cells = [row.split(",") for row in rows]
    turned = [",".join([*row[:3], repr(math.degrees(float(row[3]))), *row[4:]]) for row in cells]
    (tmp_path / "seen.csv").write_text("\n".join([header, *turned]))
    (tmp_path / "tags.csv").write_bytes((folder / "tags.csv").read_bytes())
    assert run(tmp_path) == 3
    shown = capsys.readouterr()
    assert "error (bearing-unrelated): Measured bearings have hardly to do with" in shown.out
    assert shown.err.endswith("beamfield: warning: the parameters are not to be used: bearing-unrelated\n")


def test_it_prints_parameters_with_intervals_and_the_bias(folder, capsys):
    assert run(folder) == 0
    printed = capsys.readouterr().out
    assert "600 sightings in 24 blocks" in printed
    row = re.search(r"range_bias +(\S+)  \[(\S+), (\S+)\] +m ", printed)
    assert float(row[2]) < float(row[1]) < float(row[3])
    assert float(row[1]) == pytest.approx(0.5, abs=0.03)
    assert "range_scale" not in printed
    assert "warning (range-bias): Range bias +0." in printed
    assert "Remove it at the sensor (mount, clock) or keep range_bias." in printed


def test_what_it_writes_is_read_back(folder, tmp_path, capsys):
    assert run(folder, "--out", str(tmp_path / "noise.yaml")) == 0
    assert capsys.readouterr().out.endswith(f"wrote {tmp_path / 'noise.yaml'}\n")
    parameters = read_landmark_model(tmp_path / "noise.yaml")
    assert parameters.sigma_range == pytest.approx(0.1, rel=0.1)
    text = (tmp_path / "noise.yaml").read_text()
    assert "intervals_95:" in text
    assert "sha256" in text
    assert str(folder) not in text


def test_options_reach_the_learner(folder, capsys):
    assert run(folder, "--scale", "on", "--block", "50", "--max-range", "30") == 0
    printed = capsys.readouterr().out
    assert "in 4 blocks" in printed
    assert "range_scale" in printed


def test_a_csv_without_map_and_too_few_sightings_are_refused(folder, tmp_path, capsys):
    assert main(["calibrate-landmarks", str(folder / "seen.csv"), "--quiet"]) == 2
    assert "--landmarks" in capsys.readouterr().err
    lines = (folder / "seen.csv").read_text().splitlines()[:6]
    (tmp_path / "few.csv").write_text("\n".join(lines))
    assert (
        main(["calibrate-landmarks", str(tmp_path / "few.csv"), "--landmarks", str(folder / "tags.csv"), "--quiet"])
        == 3
    )
    assert "5 sightings of known landmarks at known poses, need 20" in capsys.readouterr().err


def test_a_landmark_that_is_not_in_the_map_is_refused_by_its_line(folder, tmp_path, capsys):
    lines = (folder / "seen.csv").read_text().splitlines()
    fields = lines[7].split(",")
    (tmp_path / "seen.csv").write_text("\n".join([*lines[:7], ",".join([*fields[:4], "77", *fields[5:]]), *lines[8:]]))
    tags = str(folder / "tags.csv")
    assert main(["calibrate-landmarks", str(tmp_path / "seen.csv"), "--landmarks", tags, "--quiet"]) == 1
    error = capsys.readouterr().err
    assert f"seen.csv:8: id: landmark 77 is not in {tags}: add it there, or leave the id empty" in error


def test_what_the_learner_refuses_is_said_in_options(folder, capsys):
    assert run(folder, "--max-range", "1") == 1
    assert "give --max-range at least as large" in capsys.readouterr().err


def test_a_bag_is_not_taken_for_a_mat_file(tmp_path, capsys):
    (tmp_path / "tags.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert main(["calibrate-landmarks", str(tmp_path / "tags.bag"), "--landmarks", "tags.csv"]) == 1
    assert "sightings are not read from bags: write them into a CSV file" in capsys.readouterr().err
