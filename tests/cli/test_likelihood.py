"""``beamfield likelihood``: what it prints, draws, writes and refuses."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamfield.cli.likelihood import _summary
from beamfield.cli.main import main
from beamfield.geometry import between
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.parameters.beam_model_file import beam_model_text
from beamfield.io.parameters.likelihood_field_file import likelihood_field_text
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, ScanLog, SensorLog, Track

TRUTH = BeamParameters(z_hit=0.9, z_short=0.04, z_max=0.02, z_rand=0.04, sigma_hit=0.04, lambda_short=0.5)
SILENT = 4
QUICK = ("--resolution", "0.2", "--headings", "36")


def make_grid() -> OccupancyGrid:
    cells = np.zeros((60, 80), np.float32)
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    cells[:25, 50:52] = 1.0
    cells[40:44, 10:25] = 1.0
    return OccupancyGrid(cells, 0.1, np.array([-1.0, 2.0, 0.0]))


def make_log(grid: OccupancyGrid) -> SensorLog:
    finder = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 91.0, 2.0)), 10.0, name="FLASER")
    poses = np.column_stack([0.5 + 0.1 * np.arange(6), np.full(6, 4.5), 0.1 * np.arange(6)])
    scans = BeamModel(grid, TRUTH).sample(poses, finder, np.random.default_rng(2))
    ranges = np.array([scan.ranges for scan in scans])
    ranges[ranges >= 10.0] = np.inf
    ranges[SILENT] = np.inf
    return SensorLog(finder, 100.0 + np.arange(6.0), ranges, poses, poses)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("likelihood")
    grid = make_grid()
    log = make_log(grid)
    write_map(grid, place / "room.yaml")
    write_map(OccupancyGrid(np.zeros((10, 10)), 0.1), place / "empty.yaml")
    write_map(OccupancyGrid(np.ones((10, 10)), 0.1), place / "solid.yaml")
    write_carmen(place / "drive.log", ScanLog({"FLASER": log}, Track(log.stamps, log.odometry)))
    return place


def run(folder: Path, *words: str, scan: int = 2, map_name: str = "room.yaml") -> int:
    return main(
        ["likelihood", str(folder / "drive.log"), "--map", str(folder / map_name), "--scan", str(scan), *QUICK, *words]
    )


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """Pictures have a default name."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("model", ["beam", "likelihood_field", "map_matching"])
def test_the_maximum_is_printed_and_lies_at_the_reference(folder, tmp_path, capsys, model):
    assert run(folder, "--model", model, "--npz", str(tmp_path / "all.npz")) == 0
    text = capsys.readouterr().out
    away = re.search(r"the maximum is ([0-9.]+) m and ([0-9.]+) deg away", text)
    assert float(away[1]) <= 0.3
    assert float(away[2]) <= 10.0
    arrays = np.load(tmp_path / "all.npz")
    step = between(arrays["reference_pose"], arrays["best_pose"])
    assert np.hypot(*step[:2]) == pytest.approx(float(away[1]), abs=0.006)
    evaluated = arrays["evaluated"]
    assert evaluated.shape == arrays["log_likelihood"].shape == arrays["heading"].shape == (30, 40)
    assert not np.isnan(arrays["log_likelihood"]).any()
    assert np.isfinite(arrays["heading"][evaluated]).all()
    assert np.isnan(arrays["heading"][~evaluated]).all()
    assert f"compared {36 * int(evaluated.sum()):,} poses" in text
    # The reference is on no lattice: it may be likelier than every pose compared, the maximum included.
    assert re.search(
        r"likelier still, by \d+\.\d\d nats|\d+\.\d\d nats below the maximum; [\d,]+ of [\d,]+ places", text
    )


@pytest.mark.usefixtures("undrawn")
def test_a_field_finds_the_robot_where_the_unknown_is_painted_black(folder, tmp_path, capsys):
    room = make_grid()
    cells = np.pad(room.probability, 30, constant_values=1.0)
    corner = room.origin - np.array([*[30 * room.resolution] * 2, 0.0])
    write_map(replace(room, probability=cells, origin=corner), tmp_path / "black.yaml")
    shutil.copy(folder / "drive.log", tmp_path)
    assert run(tmp_path, "--model", "likelihood_field", map_name="black.yaml") == 0
    away = re.search(r"the maximum is ([0-9.]+) m and ([0-9.]+) deg away", capsys.readouterr().out)
    assert float(away[1]) <= 0.3


def test_a_reference_at_which_the_scan_is_impossible_is_said_to_be_one():
    reference = {"pose": [0.0] * 3, "distance_m": 2.0, "turn_rad": 0.0, "below_maximum": None}
    found = {"n_poses": 8, "n_places": 4, "n_headings": 2, "resolution_m": 0.1, "rival": None, "reference": reference,
             "maximum": {"pose": [2.0, 0.0, 0.0], "log_likelihood": -3.0}}  # fmt: skip
    assert "at the reference the scan is impossible" in _summary(found).splitlines()[-1]


@pytest.mark.usefixtures("undrawn")
def test_the_next_place_is_printed(folder, capsys):
    assert run(folder) == 0
    said = re.search(
        r"next, 1 m away or more: x \S+ m, y \S+ m, heading \S+ deg, ([0-9.]+) nats less", capsys.readouterr().out
    )
    assert float(said[1]) > 0.0


@pytest.mark.usefixtures("undrawn")
def test_what_the_reader_noticed_is_said(folder, capsys):
    assert run(folder) == 0
    assert "note: FLASER: the log has one pose per scan, taken as the corrected (reference)" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["picture.svg", "picture.png"])
def test_the_picture_is_written(folder, tmp_path, capsys, name):
    assert run(folder, "--out", str(tmp_path / name)) == 0
    assert f"wrote {tmp_path / name}" in capsys.readouterr().out
    start = (tmp_path / name).read_bytes()[:60]
    assert start.startswith(b"<?xml") if name.endswith("svg") else start.startswith(b"\x89PNG")
    assert [file.name for file in tmp_path.iterdir()] == [name]


def test_the_picture_has_a_default_name_and_quiet_leaves_the_maximum(folder, tmp_path, capsys):
    assert run(folder, "--quiet") == 0
    assert capsys.readouterr().out.startswith("maximum: x ")
    assert (tmp_path / "beamfield_likelihood.png").read_bytes().startswith(b"\x89PNG")


def test_without_a_reference_pose_only_the_likelihood_is_drawn(folder, tmp_path, capsys):
    words = ("--lone-poses", "odometry", "--out", str(tmp_path / "b.svg"), "--npz", str(tmp_path / "b.npz"))
    log = (folder / "drive.log").read_text()
    lone = tmp_path / "lone.log"
    # Older CARMEN logs end after the first pose; it is then said to be odometry.
    lone.write_text("\n".join(_with_equal_poses(line) for line in log.splitlines()) + "\n")
    code = main(["likelihood", str(lone), "--map", str(folder / "room.yaml"), "--scan", "2", *QUICK, *words])
    assert code == 0
    assert "the scan has no reference pose" in capsys.readouterr().out
    assert np.isnan(np.load(tmp_path / "b.npz")["reference_pose"]).all()
    assert (tmp_path / "b.svg").is_file()


def _with_equal_poses(line: str) -> str:
    words = line.split()
    if not words or words[0] != "FLASER":
        return line
    k = 2 + int(words[1])
    words[k : k + 3] = words[k + 3 : k + 6]
    return " ".join(words)


@pytest.mark.usefixtures("undrawn")
def test_parameters_come_from_a_calibration(folder, tmp_path, capsys):
    parameters = tmp_path / "beam_model.yaml"
    parameters.write_text(
        "beam_model: {z_hit: 0.9, z_short: 0.04, z_max: 0.02, z_rand: 0.04, sigma_hit: 0.04, lambda_short: 0.5}\n"
        "sensor: {name: a, min_range: 0.0, max_range: 10.0}\n"
    )
    values = []
    for words in ((), ("--params", str(parameters)), ("--params", str(parameters), "--no-widening")):
        assert run(folder, *words) == 0
        values.append(re.search(r"= (-?[0-9.]+) nats", capsys.readouterr().out)[1])
    assert len(set(values)) == 3


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        ({"scan": 6}, "has scans 0 to 5, got 6", 2),
        ({"scan": -1}, "--scan: expected a whole number >= 0, got '-1'", 2),
        ({"scan": SILENT}, "drive.log: scan 4 has no measured range", 1),
        ({"map_name": "empty.yaml"}, "the map has no occupied cell", 1),
        ({"map_name": "solid.yaml"}, "the map has no free cell", 1),
        (("--sensor", "RLASER"), "no sensor 'RLASER'; the log has 'FLASER'", 2),
        (("--out", "a.gif"), "expected a name ending in .png, .svg or .pdf, got 'a.gif'", 2),
        (("--npz", "a.csv"), "expected a name ending in .npz, got 'a.csv'", 2),
        (("--out", "/dev/null/a.png"), "/dev/null: Not a directory", 1),
        (("--beams", "-3"), "--beams: expected a whole number >= 0, got '-3'", 2),
        (("--local-scans", "0"), "--local-scans: expected a whole number >= 1, got '0'", 2),
        (("--local-scans", "5"), "--local-scans: is for --model map_matching", 2),
        (("--model", "map_matching", "--beams", "5"), "--beams: map matching takes all beams", 2),
        (("--model", "map_matching", "--no-widening"), "--no-widening: map matching has no noise of beams", 2),
        (("--model", "map_matching", "--params", "a.yaml"), "--params: map matching has no noise of beams", 2),
        (("--resolution", "900"), "--resolution: no place of a lattice of 900 m is free; give a finer one", 2),
        (("--headings", "0"), "--headings: expected a whole number >= 1, got '0'", 2),
        (("--threads", "0"), "--threads: expected a whole number >= 1, got '0'", 2),
        (("--poses", "missing.tum"), "missing.tum: No such file", 1),
    ],
    ids=["beyond", "negative", "silent", "empty", "solid", "sensor", "out", "npz", "folder", "beams", "local",
         "not-local", "all-beams", "no-noise", "no-parameters", "coarse", "headings", "threads", "poses"],
)  # fmt: skip
def test_bad_input_is_one_line(folder, capsys, words, message, code):
    options = words if isinstance(words, dict) else {}
    assert run(folder, "--quiet", *(() if options else words), **options) == code
    error = capsys.readouterr().err
    assert re.search(message, error)
    assert error.count("\n") == 1
    assert error.startswith("beamfield: error: ")


def summary(folder: Path, capsys, *words: str) -> str:
    assert run(folder, "--model", "likelihood_field", "--no-widening", *words) == 0
    captured = capsys.readouterr()
    return captured.out + captured.err


@pytest.mark.usefixtures("undrawn")
def test_a_learned_field_brings_its_exponent_and_number_of_beams(folder, tmp_path, capsys):
    parameters, finder = LikelihoodFieldParameters(0.8, 0.15, 0.1), make_log(make_grid()).finder
    path = tmp_path / "likelihood_field.yaml"
    path.write_text(likelihood_field_text(parameters, finder, exponent=0.25, n_beams=40))
    log, grid = make_log(make_grid()), make_grid()

    def at_the_reference(text: str) -> float:
        top, below = (
            float(re.search(words, text)[1]) for words in (r"= (-?[0-9.]+) nats", r"reference: ([0-9.]+) nats")
        )
        return top - below

    for beams, exponent, n_beams in ((None, 0.25, 40), ("20", 0.5, 20), ("5", 1.0, 5), ("0", 0.25 * 40 / 91, None)):
        more = () if beams is None else ("--beams", beams)
        text = summary(folder, capsys, "--params", str(path), *more)
        model = LikelihoodFieldModel(grid, parameters, exponent=exponent, n_beams=n_beams)
        expected = float(model.log_likelihood(log.scan(2), log.poses[2]))
        if "below the maximum" in text:
            assert at_the_reference(text) == pytest.approx(expected, abs=0.05)
        else:
            assert "likelier still" in text


@pytest.mark.usefixtures("undrawn")
def test_the_model_is_that_of_the_file(folder, tmp_path, capsys):
    path, finder = tmp_path / "learned.yaml", make_log(make_grid()).finder
    field = LikelihoodFieldParameters(0.8, 0.15, 0.1)
    texts = {
        "likelihood_field": likelihood_field_text(field, finder, exponent=1.0, n_beams=40),
        "beam": beam_model_text(TRUTH, finder),
    }
    for model, text in texts.items():
        path.write_text(text)
        assert run(folder, "--params", str(path), "--json", "--quiet") == 0
        assert json.loads(capsys.readouterr().out)["model"] == model
    path.unlink()
    assert run(folder, "--params", str(path)) == 1
    assert "learned.yaml: No such file or directory" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_a_field_from_a_beam_model_says_what_it_leaves_out(folder, tmp_path, capsys):
    beam = BeamParameters(0.8, 0.05, 0.05, 0.1, sigma_hit=0.1, lambda_short=0.5, range_offset=0.03)
    path = tmp_path / "beam_model.yaml"
    path.write_text(beam_model_text(beam, make_log(make_grid()).finder))
    text = summary(folder, capsys, "--params", str(path))
    assert "beam_model.yaml has range_offset 0.03, which a likelihood field cannot have; it is left out" in text
    assert "sigma_slope" not in text
    path.write_text(beam_model_text(TRUTH, make_log(make_grid()).finder))
    assert "left out" not in summary(folder, capsys, "--params", str(path))


@pytest.mark.parametrize(
    ("model", "expected"),
    [("beam", "a beam_model.yaml"), ("likelihood_field", "a likelihood_field.yaml or beam_model.yaml")],
)
def test_a_file_of_another_program_is_refused_with_the_commands_that_take_it(folder, tmp_path, capsys, model, expected):
    path = tmp_path / "nav2.yaml"
    path.write_text("amcl:\n  ros__parameters:\n    z_hit: 0.5\n")
    assert run(folder, "--model", model, "--params", str(path)) == 1
    assert capsys.readouterr().err.endswith(
        "this is a parameter file of nav2 or Beluga, which beamfield explore, localize and evaluate take; "
        f"expected {expected} of beamfield calibrate\n"
    )


@pytest.mark.parametrize(("model", "expected"), [("beam", "beam_model"), ("likelihood_field", "likelihood_field")])
def test_a_file_of_another_kind_is_refused_as_what_the_model_takes(folder, tmp_path, capsys, model, expected):
    path = tmp_path / "landmarks.yaml"
    path.write_text("landmark_model: {sigma_range: 0.1}\n")
    assert run(folder, "--model", model, "--params", str(path)) == 1
    assert capsys.readouterr().err.endswith(f"expected a {expected}.yaml of beamfield, got a landmark_model.yaml\n")
