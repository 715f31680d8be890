"""``beamfield calibrate-landmarks``: what it prints, writes and refuses."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from beamfield.cli.main import main
from beamfield.detection_log import DetectionLog
from beamfield.detections import Detections
from beamfield.io.landmarks.landmark_files import write_landmarks
from beamfield.io.landmarks.sightings import write_sightings
from beamfield.io.parameters.landmark_model_file import read_landmark_model
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters

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
    return main(
        [
            "calibrate-landmarks",
            str(folder / "seen.csv"),
            "--landmarks",
            str(folder / "tags.csv"),
            *mount,
            *QUICK,
            *words,
        ]
    )


def test_it_prints_parameters_with_intervals_and_the_bias(folder, capsys):
    assert run(folder) == 0
    printed = capsys.readouterr().out
    assert "600 sightings in 24 blocks" in printed
    row = re.search(r"range_bias +(\S+)  \[(\S+), (\S+)\] +m ", printed)
    assert float(row[2]) < float(row[1]) < float(row[3])
    assert float(row[1]) == pytest.approx(0.5, abs=0.03)
    assert "range_scale" not in printed.split("held-out")[0]
    assert re.search(r"bias \(chosen\) +\S+ +\+\d+\.\d{4} ± ", printed)
    assert "warning (range-bias): Range bias +0." in printed
    assert "remove it at the sensor or keep range_bias" in printed


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
    assert "range_scale" in printed.split("held-out")[0]
    assert run(folder, "--truncated-at", "2", "57.3") == 0
    assert run(folder, "--truncated-at", "0.1", "inf", "--quiet") == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith(
        f"beamfield: error: {folder / 'seen.csv'}: --truncated-at: expected all range residuals within 0.1"
    )


def test_a_csv_without_map_and_too_few_sightings_are_refused(folder, tmp_path, capsys):
    assert main(["calibrate-landmarks", str(folder / "seen.csv"), "--quiet"]) == 2
    assert "a CSV file of sightings needs a map of landmarks" in capsys.readouterr().err
    lines = (folder / "seen.csv").read_text().splitlines()[:6]
    (tmp_path / "few.csv").write_text("\n".join(lines))
    assert (
        main(["calibrate-landmarks", str(tmp_path / "few.csv"), "--landmarks", str(folder / "tags.csv"), "--quiet"])
        == 3
    )
    assert "5 sightings of known landmarks at known poses, need 20" in capsys.readouterr().err


def test_files_that_carry_their_map_need_none(tmp_path, capsys):
    rng = np.random.default_rng(1)
    truth = np.column_stack([np.arange(40), rng.uniform(1.0, 8.0, (40, 2)), np.zeros(40)])
    distance = np.hypot(truth[:, 1], truth[:, 2]) + 0.3 + rng.normal(0.0, 0.1, 40)
    heard = np.column_stack([truth[:, 0], np.full(40, 2), np.full(40, 1), distance])
    savemat(tmp_path / "radio.mat", {"TL": [[1.0, 0.0, 0.0]], "TD": heard, "GT": truth})
    assert main(["calibrate-landmarks", str(tmp_path / "radio.mat"), *QUICK, "--scale", "off"]) == 0
    printed = capsys.readouterr().out
    assert "sigma_bearing" not in printed
    assert re.search(r"range_bias +0\.[23]", printed)


def test_a_log_that_was_cleaned_gets_the_option_to_say_so(folder, tmp_path, capsys):
    lines = (folder / "seen.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines[1:]]
    rng = np.random.default_rng(5)
    where = dict(zip(MAP.ids.tolist(), MAP.positions, strict=True))
    for row in rows:
        x, y = (float(word) for word in row[1:3])
        theta, mark = float(row[3]), where[int(float(row[4]))]
        sensor = np.array([x + 0.2 * math.cos(theta), y + 0.2 * math.sin(theta)])
        row[5] = f"{math.hypot(*(mark - sensor)) + 0.3 * math.sin(rng.uniform(-1.57, 1.57)):.6f}"
    (tmp_path / "cut.csv").write_text("\n".join([lines[0], *map(",".join, rows)]) + "\n")
    mount = ("--mount", "0.2", "0", str(math.degrees(1.0)))
    words = ["calibrate-landmarks", str(tmp_path / "cut.csv"), "--landmarks", str(folder / "tags.csv"), *mount, *QUICK]
    assert main(words) == 0
    option = re.search(r"run it again with (--truncated-at \S+ \S+)$", capsys.readouterr().out, re.M)[1]
    # As it stands, it is accepted.
    assert main([*words, *option.split()]) == 0
    assert "looks-cut" not in capsys.readouterr().out


def test_a_bag_is_not_taken_for_a_mat_file(tmp_path, capsys):
    (tmp_path / "tags.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert main(["calibrate-landmarks", str(tmp_path / "tags.bag")]) == 1
    assert "sightings are not read from bags: write them into a CSV file" in capsys.readouterr().err
