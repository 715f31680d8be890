"""Logs of sonars on the command line: calibrated, mapped and scored as cones."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.io.files.yaml_file import read_yaml
from beamfield.io.read_log import read_log
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.sonar import SonarModel

TRUTH = BeamParameters(z_hit=0.75, z_short=0.05, z_max=0.1, z_rand=0.1, sigma_hit=0.05, lambda_short=0.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An eight-sonar log in the format of measurement.txt and poses.txt, in a room with a half wall, and its map."""
    folder = tmp_path_factory.mktemp("sonar")
    occupied = np.zeros((60, 80), bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    occupied[30, :35] = True
    rng = np.random.default_rng(9)
    angle = np.linspace(0.0, 8.0 * np.pi, 500)
    poses = np.column_stack([2.7 + 0.8 * np.cos(angle), 1.5 + 0.8 * np.sin(angle), angle + np.pi / 2])
    poses = np.round(poses * [1000, 1000, 1800 / np.pi]) / [1000, 1000, 1800 / np.pi]
    (folder / "poses.txt").write_text(
        "".join(
            f"{200 * i} {p[0] * 1000:.0f} {p[1] * 1000:.0f} {p[2] * 1800 / np.pi:.0f}\n" for i, p in enumerate(poses)
        )
    )
    # Read once for the sensor's geometry.
    (folder / "measurement.txt").write_text("".join(f"{200 * i}" + " 5110" * 4 + " 900" * 4 + "\n" for i in range(500)))
    finder = read_log(folder, max_range=5.11).only_sensor().finder
    model = SonarModel(OccupancyGrid(occupied.astype(np.float32), 0.05), TRUTH, finder=finder)
    rows = [np.round(1000 * scan.ranges).astype(int) for scan in model.sample(poses, rng=rng)]
    (folder / "measurement.txt").write_text(
        "".join(f"{200 * i} " + " ".join(map(str, row)) + "\n" for i, row in enumerate(rows))
    )
    picture = np.where(occupied[::-1], 0, 254).astype(np.uint8)
    (folder / "map.pgm").write_bytes(b"P5\n80 60\n255\n" + picture.tobytes())
    (folder / "map.yaml").write_text(
        "image: map.pgm\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    return folder


def calibrate(folder: Path, out: Path, *more: str, code: int = 0) -> dict:
    options = ("--map", str(folder / "map.yaml"), "--out", str(out), "--quiet", "--no-refine")
    assert main(["calibrate", str(folder), *options, *more]) == code
    return json.loads((out / "calibration.json").read_text())


def test_a_log_of_cones_is_calibrated_as_cones_unless_told_otherwise(folder, tmp_path, monkeypatch):
    # Drawing the report's figures takes ten times as long as all the rest.
    monkeypatch.setattr("beamfield.report.html.render_report", lambda *_, **__: "<html></html>")
    cones = calibrate(folder, tmp_path / "cones")
    found = cones["parameters"]
    assert found["z_hit"]["value"] == pytest.approx(TRUTH.z_hit, abs=0.05)
    assert found["sigma_hit"]["value"] == pytest.approx(TRUTH.sigma_hit, rel=0.15)
    assert "cones" in {finding["name"] for finding in cones["findings"]}
    yaml = read_yaml(tmp_path / "cones" / "beam_model.yaml")
    assert yaml.number("sensor", "opening_angle") == pytest.approx(math.radians(20.0))

    # As beams they say that the map is too large: a cone ends at whatever is nearest in it.
    beams = calibrate(folder, tmp_path / "beams", "--opening-angle", "0", code=3)
    assert "cones" not in {finding["name"] for finding in beams["findings"]}
    sensor = read_yaml(tmp_path / "beams" / "beam_model.yaml").value("sensor")
    assert "opening_angle" not in sensor
    assert cones["scores"][0]["name"] == beams["scores"][0]["name"] == "fit"
    assert cones["scores"][0]["log_likelihood"] > beams["scores"][0]["log_likelihood"] + 0.2


def test_a_map_of_the_log_is_drawn_from_cones(folder, tmp_path, capsys):
    assert main(["map", str(folder), "--out", str(tmp_path / "map.yaml")]) == 0
    assert main(["map", str(folder), "--out", str(tmp_path / "thin.yaml"), "--opening-angle", "0"]) == 0
    free = [
        int(line.split()[1].replace(",", ""))
        for line in capsys.readouterr().out.splitlines()
        if line.startswith("  free")
    ]
    assert free[0] > 1.2 * free[1]


@pytest.mark.usefixtures("undrawn")
def test_the_likelihood_of_a_scan_is_that_of_cones(folder, tmp_path, capsys):
    scores = {}
    for angle in ("20", "0"):
        options = ("--map", str(folder / "map.yaml"), "--model", "beam", "--scan", "40")
        coarse = ("--resolution", "0.2", "--headings", "36", "--opening-angle", angle, "--out", str(tmp_path / "a.png"))
        assert main(["likelihood", str(folder), *options, *coarse]) == 0
        scores[angle] = capsys.readouterr().out
    assert scores["20"] != scores["0"]


def test_an_opening_angle_that_makes_no_sense_is_an_error(folder, tmp_path, capsys):
    for angle in ("-5", "180"):
        code = main(["calibrate", str(folder), "--out", str(tmp_path / "x"), "--quiet", "--opening-angle", angle])
        assert code == 2
        assert "--opening-angle: expected " in capsys.readouterr().err


def test_read_log_takes_an_opening_angle_for_every_format(folder, tmp_path):
    assert read_log(folder, opening_angle=0.5).only_sensor().finder.opening_angle == 0.5
    text = tmp_path / "log.txt"
    text.write_text("FLASER 3 1 2 3 0 0 0 0 0 0 1 host 1\n")
    assert read_log(text).only_sensor().finder.opening_angle == 0.0
    assert read_log(text, opening_angle=0.5).only_sensor().finder.opening_angle == 0.5
