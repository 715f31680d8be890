"""The main job as a user runs it: by the content of what it prints and writes."""

from __future__ import annotations

import contextlib
import gzip
import io
import json
import os
import re
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.cli.calibrate import _folders
from beamfield.cli.calibrate_field import learn_field
from beamfield.cli.calibrate_sensor import _table
from beamfield.cli.main import main
from beamfield.finding import Finding
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.parameters.beam_model_file import read_beam_model
from beamfield.io.parameters.likelihood_field_file import read_likelihood_field
from beamfield.io.read_log import read_log
from beamfield.report.scan_fit_figures import fit_of_own_log
from tests.cli.simulated import on_map, simulated
from tests.io.mini_bag import MiniBag

FILES = ("beam_model.yaml", "calibration.json", "likelihood_field.yaml", "report.html")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short simulated log with its map, as files."""
    return simulated(tmp_path_factory.mktemp("world"), "--duration 60 --scan-rate 4 --beams 61 --format both")


@pytest.fixture
def copy(world: Path, tmp_path: Path) -> Path:
    """A copy of the world that a test may damage."""
    target = tmp_path / "damaged"
    shutil.copytree(world, target)
    return target


def calibrate(folder: Path, out: Path, *more: str, quiet: bool = True) -> int:
    return on_map("calibrate", folder, "log.carmen", out, *(["--quiet"] if quiet else []), *more)


def fails(capsys: pytest.CaptureFixture[str], code: int, expected: int = 1) -> str:
    """Check that a command failed on one line without a traceback, and return the line."""
    assert code == expected
    captured = capsys.readouterr()
    lines = captured.err.strip().splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("beamfield: error: ")
    return lines[0]


@pytest.fixture(scope="module")
def run(world: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The result for the world, and what was printed."""
    folder, printed = tmp_path_factory.mktemp("result") / "out", io.StringIO()
    with contextlib.redirect_stdout(printed):
        assert calibrate(world, folder, quiet=False) == 0
    return folder, printed.getvalue()


@pytest.fixture(scope="module")
def out(run: tuple[Path, str]) -> Path:
    """The result for the world."""
    return run[0]


class TestResult:
    def test_four_files_are_written(self, out: Path):
        assert sorted(p.name for p in out.iterdir()) == sorted(FILES)

    def test_the_verdict_is_printed_once_and_last_before_what_was_written(self, run: tuple[Path, str]):
        verdict = json.loads((run[0] / "calibration.json").read_text())["verdict"]
        assert run[1].count(verdict) == 1
        assert run[1].splitlines()[-3:-1] == [verdict, ""]
        assert run[1].splitlines()[-1].startswith("wrote ")

    def test_the_yaml_holds_the_same_parameters_as_the_json(self, out: Path):
        parameters = read_beam_model(out / "beam_model.yaml")
        document = json.loads((out / "calibration.json").read_text())
        for name, entry in document["parameters"].items():
            assert getattr(parameters, name) == pytest.approx(entry["value"], rel=5e-6, abs=1e-9)
        assert parameters.max_range == 12.0

    def test_the_likelihood_field_is_learned_too(self, out: Path):
        saved = read_likelihood_field(out / "likelihood_field.yaml")
        document = json.loads((out / "calibration.json").read_text())["likelihood_field"]
        assert document["parameters"] == pytest.approx(vars(saved.parameters), rel=5e-6)
        assert (document["exponent"], document["n_beams"]) == (pytest.approx(saved.exponent, rel=5e-6), saved.n_beams)
        assert (saved.n_beams, saved.max_range) == (60, 12.0)
        assert saved.parameters.z_hit > 0.6
        assert 0.0 < saved.exponent < 1.0
        assert [score["name"] for score in document["scores"]][-1] == "uniform"
        page = (out / "report.html").read_text()
        assert '<h2 id="field">Likelihood field</h2>' in page
        assert f"sigma_hit: {saved.parameters.sigma_hit}" in page

    def test_it_says_how_many_independent_beams_a_scan_is_worth(self, out: Path):
        document = json.loads((out / "calibration.json").read_text())["independent_beams"]
        saved = read_beam_model(out / "beam_model.yaml")
        assert (saved.n_beams, document["n_beams"], document["beams_of_scan"]) == (30, 30, 61)
        taken = "single" if document["single_in_filter"] else "drive"
        assert saved.exponent == pytest.approx(document[taken]["value"], rel=5e-6)
        assert saved.single_scan_exponent == pytest.approx(document["single"]["value"], rel=5e-6)
        assert 0.0 < document["drive"]["value"] < saved.single_scan_exponent < 1.0
        assert document["independent_beams"] == pytest.approx(30 * saved.single_scan_exponent, rel=5e-6)
        said = f"A scan of 61 beams is worth about {document['independent_beams']:.2g} independent ones"
        page = (out / "report.html").read_text()
        assert '<h3>Independent beams</h3></summary>\n<div id="independent-beams">' in page
        assert said in page

    def test_it_says_which_file_localizes_better(self, run: tuple[Path, str]):
        out, text = run
        document = json.loads((out / "calibration.json").read_text())["own_filter"]
        runs = document["runs"]
        assert list(runs) == ["likelihood_field.yaml", "beam_model.yaml"]
        # The map is right: the beam model knows which side of a wall it sees.
        assert runs["beam_model.yaml"]["mean"] < runs["likelihood_field.yaml"]["mean"] < 0.1
        assert [one["lost"] for one in runs.values()] == [0, 0]
        # Each file has the exponent with which its model errs less; the surer one only if that is by 5%.
        tried = document["tried"]
        for file, read in (("beam_model.yaml", read_beam_model), ("likelihood_field.yaml", read_likelihood_field)):
            of_drives, of_scans = (name for name in tried if name.startswith(file))
            better = of_scans if tried[of_scans]["mean"] < 0.95 * tried[of_drives]["mean"] else of_drives
            assert better == f"{file}, exponent {read(out / file).exponent:.3g}"
            assert runs[file] == tried[better]
        assert document["best"] == "beam_model.yaml"
        said = "Localize with beam_model.yaml: in beamfield&#x27;s own filter it errs least on this log."
        page = (out / "report.html").read_text()
        assert said in page
        assert said.replace("&#x27;", "'") in text
        assert f"{runs['beam_model.yaml']['mean']:.3f}" in page

    def test_the_provenance_names_inputs_by_hash_and_no_folder(self, out: Path, world: Path):
        origin = json.loads((out / "calibration.json").read_text())["provenance"]
        assert not {"mask", "poses_topic"} & origin["options"].keys()  # not given
        assert set(origin["inputs"]) == {"log", "map", "map image"}
        assert origin["inputs"]["log"]["name"] == "log.carmen"
        assert len(origin["inputs"]["map image"]["sha256"]) == 64
        assert origin["seed"] == 0
        for name in FILES:
            assert str(world) not in (out / name).read_text()

    def test_the_page_is_one_file_that_names_the_parameters(self, out: Path):
        page = (out / "report.html").read_text()
        assert page.count("<html") == 1
        for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short"):
            assert name in page


@pytest.mark.usefixtures("without_figures")
def test_in_the_map_of_another_building_no_file_is_said_to_localize_better(world: Path, tmp_path: Path, office):
    shutil.copy(world / "log.carmen", tmp_path)
    write_map(office, tmp_path / "map.yaml")
    out = tmp_path / "out"
    assert calibrate(tmp_path, out, "--no-refine", "--poses", str(world / "truth.tum")) == 3
    document = json.loads((out / "calibration.json").read_text())
    assert document["verdict"].startswith("Do not use these values yet")
    assert "own_filter" not in document


def test_the_table_is_printed(run: tuple[Path, str]):
    out, text = run
    assert json.loads((out / "calibration.json").read_text())["verdict"] in text
    for words in (
        "scans used", "sigma_hit", "95% interval", "nav2 defaults", "ROS 1 defaults", "uniform", "likelihood field",
        "beam model's, exponent 1", "The exponents are for 60 beams", "A scan of 61 beams is worth about",
    ):  # fmt: skip
        assert words in text


@pytest.mark.usefixtures("without_figures")
def test_what_is_found_of_the_field_is_among_the_main_findings_and_in_the_verdict(
    world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def doubtful(*given):
        return replace(learn_field(*given), findings=(Finding("field-says-nothing", "warning", "No better."),))

    monkeypatch.setattr("beamfield.cli.calibrate_sensor.learn_field", doubtful)
    assert calibrate(world, tmp_path / "out", "--no-refine", quiet=False) == 3
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())
    assert "field-says-nothing" in [finding["name"] for finding in document["findings"]]
    assert document["verdict"].startswith("Do not use these values yet: the readings hardly tell where the robot is")
    text, problem = capsys.readouterr()
    assert "beamfield: warning: Do not use these values yet: the readings hardly tell" in problem
    assert document["verdict"] in text
    assert text.count("warning (field-says-nothing): No better.") == 1
    head = (tmp_path / "out" / "report.html").read_text().split('id="parameters"')[0]
    assert "<code>field-says-nothing</code>" in head
    assert 'class="verdict bad"><b class="label">Do not trust</b> Do not use these values yet' in head


@pytest.mark.usefixtures("without_figures")
def test_masked_beams_poses_from_a_file_a_held_parameter_and_a_fixed_form_are_respected(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    recorded = tmp_path / "beams.mcap"
    code = calibrate(
        world, tmp_path / "out", "--no-refine", "--mask=-30.5:-10", "--mask=170:-170", "--mcap", str(recorded),
        "--poses", str(world / "truth.tum"), "--hold", "z_max=0.1", "--range-offset", "on", "--sigma-slope", "off",
        quiet=False,
    )  # fmt: skip
    assert code == 0
    assert b"/causes" in recorded.read_bytes()
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())
    log = read_log(world / "log.carmen").only_sensor()
    degrees = np.degrees(log.finder.bearings)
    n_masked = int(((degrees > -30.5) & (degrees < -10)).sum() + (np.abs(degrees) > 170).sum())
    assert n_masked > 3
    assert document["beams"]["n_nan"] == n_masked * document["selection"]["n_used"]
    assert document["provenance"]["options"]["mask"] == ["-30.5:-10", "170:-170"]
    assert f"{n_masked} of {len(degrees)} beams masked" in " ".join(document["notes"])
    assert "nan-readings" not in [finding["name"] for finding in document["findings"]]
    assert "reference pose from the given trajectory" in capsys.readouterr().err
    assert document["provenance"]["inputs"]["poses"]["name"] == "truth.tum"
    parameters = read_beam_model(tmp_path / "out" / "beam_model.yaml")
    assert parameters.z_max == pytest.approx(0.1, abs=1e-12)
    assert parameters.range_offset != 0.0
    assert parameters.sigma_slope == 0.0


@pytest.mark.usefixtures("without_figures")
def test_text_and_bag_of_one_drive_give_the_same_parameters(world: Path, out: Path, tmp_path: Path):
    assert on_map("calibrate", world, "bag", tmp_path / "bag", "--quiet", "--no-refine") == 0
    text, bag = (read_beam_model(folder / "beam_model.yaml") for folder in (out, tmp_path / "bag"))
    for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short"):
        # The bag's ranges are float32, the text's have a few digits.
        assert getattr(text, name) == pytest.approx(getattr(bag, name), rel=5e-3, abs=1e-4), name


def test_without_a_map_one_is_drawn_and_the_report_says_so(world: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(
        "beamfield.report.html.report_figures", lambda *given: [fit_of_own_log(given[3], map_from_log=True)]
    )
    log, out = str(world / "log.carmen"), tmp_path / "out"
    assert main(["calibrate", log, "--out", str(out), "--quiet", "--resolution", "0.1"]) == 0
    report = (out / "report.html").read_text()
    assert not (out / "likelihood_field.yaml").exists()
    assert "No map was given" in report
    assert "map <b>drawn from the log</b>" in report
    # Each scan is judged by the other half's map, and the caption says what that cannot show.
    assert 'id="scan-fit"' in report
    assert "The map is the log&#x27;s own" in report
    assert "FLASER: the laser is at" in report.split("How the log was read")[1]
    document = json.loads((out / "calibration.json").read_text())
    assert set(document["provenance"]["inputs"]) == {"log"}
    assert "cross-fitted-map" in [finding["name"] for finding in document["findings"]]


class TestBadInput:
    """Each: one line that names file, place and value; exit code 1, or 3 for too little data; nothing written."""

    @pytest.fixture
    def refused(self, copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Iterator[Callable[..., str]]:
        yield lambda *more, code=1: fails(capsys, calibrate(copy, tmp_path / "out", *more), code)
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize("name", ["log.carmen", "map.yaml", "map.pgm"])
    def test_a_missing_file(self, copy, refused, name):
        (copy / name).unlink()
        assert name in refused()

    def test_a_truncated_log(self, copy, refused):
        text = (copy / "log.carmen").read_text()
        (copy / "log.carmen").write_text(text[: len(text) * 2 // 3])
        line = refused()
        assert f"log.carmen:{text[: len(text) * 2 // 3].count(chr(10)) + 1}" in line

    def test_a_truncated_gzip(self, copy, refused):
        packed = gzip.compress((copy / "log.carmen").read_bytes())
        (copy / "log.carmen").write_bytes(packed[: len(packed) // 2])
        assert "log.carmen" in refused()

    def test_a_log_of_another_kind(self, copy, refused):
        (copy / "log.carmen").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(200))
        assert "log.carmen" in refused()

    def test_a_number_that_is_none(self, copy, refused):
        lines = (copy / "log.carmen").read_text().splitlines()
        row = next(i for i, line in enumerate(lines) if line.startswith("FLASER") and i > 20)
        words = lines[row].split()
        words[7] = "4,5"
        lines[row] = " ".join(words)
        (copy / "log.carmen").write_text("\n".join(lines) + "\n")
        line = refused()
        assert f"log.carmen:{row + 1}" in line
        assert "'4,5'" in line

    @pytest.mark.parametrize(
        ("key", "value", "words"),
        [
            ("resolution", "0.0", ("map.yaml", "resolution")),
            ("origin", "[500.0, 500.0, 0.0]", ("log.carmen", "lie off the map")),
        ],
    )
    def test_a_map_of_no_size_or_elsewhere(self, copy, refused, key, value, words):
        text = (copy / "map.yaml").read_text()
        changed = re.sub(rf"^{key}:.*$", f"{key}: {value}", text, flags=re.MULTILINE)
        assert changed != text
        (copy / "map.yaml").write_text(changed)
        line = refused("--poses", str(copy / "truth.tum"))
        assert all(word in line for word in words)

    def test_a_bomb_of_an_image(self, copy, refused):
        (copy / "map.pgm").write_bytes(b"P5\n900000 900000\n255\n" + bytes(100))
        line = refused()
        assert "map.pgm" in line
        assert "900000" in line

    def test_a_map_without_obstacles(self, copy, refused):
        header, pixels = (copy / "map.pgm").read_bytes().split(b"255\n", 1)
        (copy / "map.pgm").write_bytes(header + b"255\n" + pixels.replace(b"\0", b"\xfe"))
        assert "no occupied cell" in refused()

    def test_poses_that_are_nan(self, copy, refused):
        lines = (copy / "truth.tum").read_text().splitlines()
        lines[5] = "102.0 nan 1 0 0 0 0 1"
        (copy / "truth.tum").write_text("\n".join(lines) + "\n")
        line = refused("--poses", str(copy / "truth.tum"))
        assert "truth.tum:6" in line

    def test_poses_of_another_day_leave_too_little_data(self, copy, refused):
        lines = (copy / "truth.tum").read_text().splitlines()
        moved = [lines[0]] + [f"{float(x.split()[0]) + 1e6} {x.split(maxsplit=1)[1]}" for x in lines[1:]]
        (copy / "truth.tum").write_text("\n".join(moved) + "\n")
        line = refused("--poses", str(copy / "truth.tum"))
        assert "pose" in line

    def test_too_little_data_has_its_own_exit_code(self, copy, refused):
        lines = (copy / "log.carmen").read_text().splitlines()
        scans = [line for line in lines if line.startswith("FLASER")]
        rest = [line for line in lines if not line.startswith(("FLASER", "ODOM"))]
        (copy / "log.carmen").write_text("\n".join(rest + scans[:6]) + "\n")
        line = refused(code=3)
        assert "of 6 scans used" in line

    @pytest.mark.parametrize(
        ("words", "message"),
        [
            (("--no-return", "many"), "'many'"),
            (("--sensor", "REAR"), "no sensor 'REAR'; the log has 'FLASER'"),
            (("--resolution", "0.1"), "--resolution"),
            (("--max-range", "5600"), "--max-range: expected metres, at most 1000, got '5600'"),
            (("--hold", "z_foo=0.1"), "z_foo"),
            *(((f"--mask={bad}",), "--mask: expected DEG:DEG, got") for bad in ("", "10", "a:b", "1:2:3", "nan:3")),
        ],
    )
    def test_an_option_that_does_not_fit(self, refused, words, message):
        assert message in refused(*words, code=2)

    def test_a_topic_of_a_map_that_is_not_given(self, world, tmp_path, capsys):
        words = ("calibrate", str(world / "log.carmen"), "--map-topic", "/map", "--out", str(tmp_path / "out"))
        assert "--map-topic: is in the bag that --map names" in fails(capsys, main(words), 2)
        assert not (tmp_path / "out").exists()


def test_wrong_usage_has_exit_code_two(capsys):
    assert "missing: LOG. See beamfield calibrate --help" in fails(capsys, main(["calibrate"]), 2)


@pytest.mark.usefixtures("without_figures")
def test_a_file_name_that_is_no_text_comes_through(copy, tmp_path):
    log = copy / os.fsdecode(b"l\xe4uf$x_{.log")
    (copy / "log.carmen").rename(log)
    out = tmp_path / "out"
    assert on_map("calibrate", copy, log.name, out, "--quiet", "--no-refine") == 0
    for name in FILES:
        assert r"l\xe4uf$x_{.log" in (out / name).read_text().replace("\\\\", "\\")
    # Nor is a name with dollar signs a formula in a picture's title.
    assert main(["inspect", str(log), "--out", str(tmp_path / "a.png")]) == 0
    assert main(["inspect", str(log), "--json"]) == 0


def test_a_stream_without_a_character_shows_its_number_instead(monkeypatch, world):
    words = ["inspect", str(world / "log.carmen")]
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr("sys.stdout", stream)
    monkeypatch.setattr("beamfield.cli.inspect._text", lambda *_: "\xb1")
    assert main(words) == 0
    stream.flush()
    assert stream.buffer.getvalue().startswith(b"log.carmen: \\xb1\n")


def test_an_output_that_cannot_be_written_is_one_line(world, tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    # Before any work: not even the map is read.
    line = fails(capsys, calibrate(world / "none", tmp_path / "file"))
    assert line.endswith("file: Not a directory")
    assert (tmp_path / "file").read_text() == "in the way"


def test_what_was_noticed_of_a_log_is_said_with_an_error(world, tmp_path, capsys):
    bag = MiniBag().tf("base_link", "laser", 100.0, static=True)
    for i in range(3):
        bag.scan(100.0 + i).tf("odom", "base_link", 5.0 + i, recorded=100.0 + i)
    code = main(["calibrate", str(bag.write(tmp_path)), "--map", str(world / "map.yaml"), "--out", str(tmp_path / "x")])
    assert code == 1
    said = capsys.readouterr().err
    assert "note: log: /scan: its scans are stamped 95.0 s later than the transforms" in said
    assert "without odometry at the times of the scans none is fitted" in said


def test_each_of_several_sensors_has_a_folder_of_its_own():
    assert _folders(["FLASER"]) == {"FLASER": "."}
    names = ("/front/scan", "/front_scan", "..", "LASER 1")
    assert list(_folders(names).values()) == ["front_scan", "front_scan_", "sensor", "LASER_1"]


def test_sentences_are_broken_for_a_terminal_and_tables_are_not(monkeypatch):
    monkeypatch.setattr("beamfield.cli.calibrate_sensor.calibration_details", lambda *_, **__: "summary")
    monkeypatch.setenv("COLUMNS", "80")
    table = f"a  b\n-  {'-' * 99}\n1  {'x' * 99}"
    parts = [SimpleNamespace(table=f"{'word ' * 30}end.\n\n{table}")]
    monkeypatch.setattr("sys.stdout.isatty", lambda: False)
    assert _table(None, parts) == f"summary\n\n{parts[0].table}"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    _, sentence, shown = _table(None, parts).split("\n\n")
    assert max(map(len, sentence.splitlines())) <= 80
    assert sentence.split() == ["word"] * 30 + ["end."]
    assert shown == table
