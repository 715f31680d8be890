"""``beamfield check``: what it prints, draws, writes and refuses."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.cli.check import _parameters
from beamfield.cli.main import main
from beamfield.finding import Finding
from tests.cli.simulated import simulated

FILES = ["beam_model.yaml", "scan_fit.csv", "scan_fit.html", "scan_fit.json", "scan_fit_reference.json"]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives through one building, one of them also with poses that jump away in the middle."""
    folder = tmp_path_factory.mktemp("check")
    drive = "--duration 60 --scan-rate 4 --beams 61"
    good = simulated(folder / "good", drive)
    simulated(folder / "fresh", f"{drive} --seed 5 --map {good / 'map.yaml'}")
    lines = (folder / "fresh" / "truth.tum").read_text().splitlines()
    rows = [line.split() for line in lines if not line.startswith("#")]
    for row in rows[120:180]:
        row[1], row[2] = str(float(row[1]) + 1.1), str(float(row[2]) - 1.3)
    (folder / "kidnapped.tum").write_text("\n".join(" ".join(row) for row in rows) + "\n")
    return folder


def check(world: Path, out: Path, *words: str, log: str = "fresh", quiet: bool = True) -> int:
    return main([
        "check", str(world / log / "log.carmen"), "--map", str(world / "good" / "map.yaml"), "--out", str(out),
        *(["--quiet"] if quiet else []), *words,
    ])  # fmt: skip


@pytest.fixture(scope="module")
def result(world: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The kidnapped drive, judged by the good one."""
    out = tmp_path_factory.mktemp("result") / "out"
    good = ("--good", str(world / "good" / "log.carmen"))
    recorded = ("--mcap", str(out / "check.mcap"))
    assert check(world, out, *good, "--poses", str(world / "kidnapped.tum"), *recorded) == 0
    assert b"/probability_of_being_lost" in (out / "check.mcap").read_bytes()
    (out / "check.mcap").unlink()
    return out


class TestResult:
    def test_the_files_are_written(self, result: Path):
        assert sorted(p.name for p in result.iterdir()) == FILES

    def test_the_csv_has_one_line_per_scan_and_finds_the_kidnapping(self, result: Path):
        with (result / "scan_fit.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert len(rows) == 240
        # Stamps are rounded in the text log: the very last scan may lie after the last pose.
        p, lost = (np.array([float(row[name] or "nan") for row in rows]) for name in ("p_value", "lost_probability"))
        away = np.zeros(240, bool)
        away[120:180] = True
        assert (p[away] <= 0.05).mean() > 0.9
        assert np.nanmean(p[~away] <= 0.05) < 0.15
        assert lost[130:180].min() > 0.9
        assert lost[:118].max() < 0.3
        assert lost[200:].max() < 0.3

    def test_the_json_says_the_same(self, result: Path, world: Path):
        document = json.loads((result / "scan_fit.json").read_text())
        assert document["n_judged"] in (239, 240)
        assert 0.6 < document["share_that_fits"] < 0.8
        assert 10.0 < document["longest_lost"]["seconds"] < 20.0
        assert 120 <= document["worst"][0]["scan"] < 180
        assert set(document["provenance"]["inputs"]) == {"log", "map", "map image", "poses", "good"}
        assert document["reference"]["own_log"] is False
        reference = json.loads((result / "scan_fit_reference.json").read_text())
        assert set(reference["inputs"]) == {"good", "map", "map image"}
        for name in FILES:
            assert str(world) not in (result / name).read_text()

    def test_places_are_judged_where_the_robot_was_not_lost(self, result: Path):
        places = json.loads((result / "scan_fit.json").read_text())["changed_places"]
        assert places["reference_error"] == 0.04
        assert 80 < places["n_scans"] <= 190
        assert not [place for place in places["places"] if place["kind"] == "missing wall"]
        assert 'id="changed-places"' in (result / "scan_fit.html").read_text()

    def test_the_page_shows_both_figures(self, result: Path):
        page = (result / "scan_fit.html").read_text()
        assert page.count("<html") == 1
        for words in (
            'id="scan-fit"',
            'id="worst-scans"',
            "go through a mapped wall",
            "Can the lost probability be trusted",
        ):
            assert words in page


def test_a_log_is_judged_by_itself_and_the_table_is_printed(world, tmp_path, capsys):
    assert check(world, tmp_path / "out", "--worst", "3", quiet=False) == 0
    text = capsys.readouterr().out
    share = float(re.search(r"([0-9.]+)% of 2[34][09] scans fit at 5%", text)[1])
    assert 90.0 < share <= 100.0
    assert "of this log" in text
    assert text.startswith("lost probability never above 0.5")
    rows = csv.DictReader((tmp_path / "out" / "scan_fit.csv").read_text().splitlines())
    stamps = [float(row["stamp"]) for row in rows]
    listed = re.findall(r"^ +([0-9]+) +([0-9.]+) ", text, re.M)
    assert [(time, len(listed)) for _, time in listed] == [(f"{stamps[int(i)] - stamps[0]:.1f}", 3) for i, _ in listed]
    page = (tmp_path / "out" / "scan_fit.html").read_text()
    assert all(f"scan {i}, {time} s after the first" in page for i, time in listed)
    assert [words.count(f"{stamps[0]:.3f} s") for words in (text, page)] == [1, 1]
    assert "differs from the map: 0 new obstacles, 0 missing walls" in text


def test_what_was_learned_can_be_used_again(world, result, tmp_path):
    words = ("--params", str(result / "beam_model.yaml"), "--good-scans", str(result / "scan_fit_reference.json"))
    assert check(world, tmp_path / "out", *words, "--worst", "0", "--poses", str(world / "kidnapped.tum")) == 0
    again, first = (
        np.genfromtxt(path / "scan_fit.csv", delimiter=",", skip_header=1) for path in (tmp_path / "out", result)
    )
    # The model's file has six digits; a p-value is a rank among some 200 scans.
    np.testing.assert_allclose(again, first, rtol=1e-3, atol=1e-2)
    assert np.nanmean(np.abs(again - first)) < 1e-4


def test_the_page_says_what_the_terminal_says_of_poses_that_cannot_be_trusted(world, result, tmp_path, capsys):
    rows = [line.split() for line in (world / "fresh" / "truth.tum").read_text().splitlines() if line[0] != "#"]
    turned = tmp_path / "turned.tum"
    turned.write_text("".join(" ".join([*row[:4], "0 0 1 0"]) + "\n" for row in rows))
    learned = ("--params", str(result / "beam_model.yaml"), "--good-scans", str(result / "scan_fit_reference.json"))
    assert check(world, tmp_path / "out", *learned, "--worst", "0", "--poses", str(turned)) == 3
    problem = "ost readings disagree with the map at the reference poses"
    assert problem in capsys.readouterr().err
    first, second, *_ = re.findall(
        r'class="verdict (\w+)"><b class="label">[^<]*</b> (.*)</p>', (tmp_path / "out" / "scan_fit.html").read_text()
    )
    assert first[0] == "bad"
    assert problem in first[1]
    assert "fit the map at 5%" in second[1]


def test_a_sensor_of_another_reach_is_refused(world, result, tmp_path, capsys):
    assert check(world, tmp_path / "out", "--params", str(result / "beam_model.yaml"), "--max-range", "8") == 1
    assert "the sensor's max_range is 8 m" in capsys.readouterr().err


def test_a_file_of_another_program_is_refused_by_name(world, tmp_path, capsys):
    (tmp_path / "amcl.launch").write_text('<launch><node pkg="amcl" type="amcl" name="amcl"/></launch>')
    assert check(world, tmp_path / "out", "--params", str(tmp_path / "amcl.launch")) == 1
    assert "this is a parameter file of ROS 1 amcl, which beamfield explore" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        (("--poses", "missing.tum"), "missing.tum: No such file", 1),
        (("--good", "missing.log"), "missing.log: No such file", 1),
        (("--worst", "-1"), "--worst: expected a whole number >= 0, got '-1'", 2),
        (("--good-poses", "a.tum"), "--good-poses: needs --good", 2),
        (("--good-scans", "a.json"), "--good-scans: needs the parameters", 2),
        (("--good", "a.log", "--good-scans", "a.json", "--params", "b"), "--good-scans: is in place of --good", 2),
        (("--lose-rate", "0"), "--lose-rate: expected a number > 0", 2),
        (("--reference-error", "0"), "--reference-error: expected a number > 0", 2),
        (("--sensor", "RLASER"), "no sensor 'RLASER'", 2),
        (("--min-range", "11.9"), "need", 3),
    ],
    ids=["poses", "good", "worst", "good-poses", "reference", "both", "rate", "error", "sensor", "too-little"],
)
def test_bad_input_is_one_line_and_nothing_is_written(world, tmp_path, capsys, words, message, code):
    assert check(world, tmp_path / "out", *words) == code
    error = capsys.readouterr().err
    assert re.search(message, error), error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_broken_reference_names_the_file(world, result, tmp_path, capsys):
    (tmp_path / "broken.json").write_text("{")
    words = ("--params", str(result / "beam_model.yaml"), "--good-scans", str(tmp_path / "broken.json"))
    assert check(world, tmp_path / "out", *words) == 1
    assert "broken.json: reference: Expecting" in capsys.readouterr().err


def test_where_the_map_is_wrong_what_to_do_is_said(monkeypatch):
    wrong = Finding(
        "map-scale", "warning", "The map is too small.", do="Check the map's resolution: 0.052 m would fit."
    )
    learned = SimpleNamespace(
        findings=(wrong, Finding("few-blocks", "warning", "", do="Record more.")), parameters=None
    )
    monkeypatch.setattr("beamfield.calibration.calibrate.calibrate", lambda *_, **__: learned)
    given = SimpleNamespace(parameters=None, good=None, grid=None, is_own=False)
    _, problem = _parameters(given, SimpleNamespace(seed=0), None)
    assert problem.startswith("Do not use these values yet: the scale of the map is wrong; ")
    assert problem.endswith(f"was learned all the same. {wrong.do}")
