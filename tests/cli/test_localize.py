"""``beamfield localize``: what it prints, writes and refuses."""

from __future__ import annotations

import json
import re
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from PIL import Image

from beamfield.cli.film import FRAMES, Film
from beamfield.cli.inputs import OF_MOVED_MAP
from beamfield.cli.localize_summary import run_summary
from beamfield.cli.main import main
from beamfield.errors import TrajectoryNotFoundError
from beamfield.finding import Finding
from beamfield.io.bags.writer import write_bag
from beamfield.io.filter_run import read_run
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.parameters.beam_model_file import beam_model_text
from beamfield.io.parameters.likelihood_field_file import likelihood_field_text
from beamfield.io.trajectory import read_trajectory, write_tum
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.sensors import ScanLog, Track
from beamfield.simulation.floor_plan import draw_floor_plan


@pytest.fixture(scope="module")
def folder(tmp_path_factory, office, black_office, drive, truth) -> Path:
    place = tmp_path_factory.mktemp("localize")
    log = drive[:120]
    write_map(office, place / "map.yaml")
    write_map(black_office, place / "black.yaml")
    write_map(OccupancyGrid(np.ones((10, 10)), 0.1), place / "solid.yaml")
    write_carmen(place / "short.log", ScanLog({"FLASER": log[:2]}, Track(log.stamps[:2], log.odometry[:2])))
    # One pose per scan: either a reference or odometry.
    write_carmen(place / "bare.log", ScanLog({"FLASER": log.with_poses(log.odometry)}))
    write_carmen(place / "drive.log", ScanLog({"FLASER": log}, Track(log.stamps, log.odometry)))
    for name, signs in (("mirrored.log", (1.0, -1.0, -1.0)), ("still.log", (0.0, 0.0, 0.0))):
        # Odometry begins at 0, 0, 0, so that a mirror image has its turns reversed.
        odometry = np.array(signs) * log.odometry
        wrong = replace(log, odometry=odometry)
        write_carmen(place / name, ScanLog({"FLASER": wrong}, Track(log.stamps, odometry)))
    metres = [1000.0, 1000.0, 1.0]
    write_carmen(place / "fast.log", ScanLog({"FLASER": replace(log, odometry=metres * log.odometry)}))
    finder = replace(log.finder, max_range=1000.0 * log.finder.max_range)
    write_carmen(place / "far.log", ScanLog({"FLASER": replace(log, finder=finder, ranges=1000.0 * log.ranges)}))
    write_map(draw_floor_plan(seed=8), place / "elsewhere.yaml")
    write_tum(place / "truth.tum", Track(log.stamps, log.poses))
    provenance = {"program": "test"}
    (place / "beam_model.yaml").write_text(beam_model_text(truth, log.finder, provenance=provenance))
    field = likelihood_field_text(
        LikelihoodFieldParameters(0.8, 0.1, 0.08), log.finder, exponent=0.2, n_beams=20, provenance=provenance
    )
    (place / "likelihood_field.yaml").write_text(field)
    (place / "nav2.yaml").write_text("amcl:\n  ros__parameters:\n    laser_model_type: likelihood_field_prob\n")
    return place


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    """The output folder has a default name."""
    monkeypatch.chdir(tmp_path)


def run(folder: Path, *words: str, poses: bool = True, map_name: str = "map.yaml") -> int:
    log = ("drive.log", "--poses", str(folder / "truth.tum")) if poses else ("bare.log", "--lone-poses", "odometry")
    given = [str(folder / word) if word.endswith(".yaml") else word for word in words]
    return main(["localize", str(folder / log[0]), "--map", str(folder / map_name), *log[1:], *given])


def document(capsys) -> dict:
    return json.loads(capsys.readouterr().out)


def test_the_way_is_written_and_judged_by_the_reference(folder, capsys, tmp_path, drive):
    recordings = ("--rerun", "way.rrd", "--mcap", "way.mcap")
    assert run(folder, "--particles", "500", "--animation", "way.gif", *recordings) == 0
    text = capsys.readouterr().out
    assert "position error 0.0" in text
    assert "within 0.5 m of the reference from 0.0 s on" in text
    out = tmp_path / "beamfield_localization"
    assert {path.name for path in out.iterdir()} == {
        "trajectory.tum", "particles.csv.gz", "localization.png", "localization.json",
    }  # fmt: skip
    written = read_trajectory(out / "trajectory.tum")
    off = np.hypot(*(written.poses - drive.poses[:120])[:, :2].T)
    cloud = read_run(out)
    assert len(cloud.particles) == json.loads((out / "localization.json").read_text())["n_updates"]
    means = [poses[:, :2].mean(axis=0) for poses in cloud.particles]
    expected = np.column_stack([np.interp(cloud.stamps, written.stamps, written.poses[:, k]) for k in (0, 1)])
    assert np.abs(means - expected).max() < 0.05
    assert {len(poses) for poses in cloud.particles} <= set(range(100, 201))
    said = json.loads((out / "localization.json").read_text())
    assert said["errors"]["mean"] == pytest.approx(off.mean(), abs=1e-6)
    assert said["errors"]["mean"] < 0.1
    assert said["found_after_s"] == 0.0
    with Image.open("way.gif") as film:
        assert film.n_frames > 10
    assert all(f"/{topic}".encode() in Path("way.mcap").read_bytes() for topic in ("scan", "estimate", "reference"))
    assert b"/particles" in Path("way.rrd").read_bytes()
    with Image.open(out / "localization.png") as picture:
        assert len(np.unique(np.asarray(picture.convert("L")))) > 20


def test_particles_are_kept_by_their_weights():
    film = Film(3, 0)
    poses = np.arange(2000.0)[:, None] * np.ones(3)
    film.add_cloud(1, poses, np.where(np.arange(2000) < 1000, 0.001, 0.0))
    ((stamp, kept),) = film.clouds(np.array([0.0, 0.5, 1.0]))
    assert stamp == 0.5
    assert 100 <= len(kept) <= 200
    assert kept.max() < 1000.0
    assert kept[:, 0].mean() == pytest.approx(500.0, abs=20.0)


@pytest.mark.parametrize("n", [1, FRAMES, FRAMES + 1, 2 * FRAMES - 1, 1000])
def test_an_animation_has_so_many_pictures_at_most(n):
    film = Film(n, 0)
    for i in range(n):
        film.add_cloud(i, np.zeros((1, 3)), np.ones(1))
    assert min(n, FRAMES // 2) <= len(film.frames) <= FRAMES


@pytest.mark.usefixtures("undrawn")
def test_json_has_what_the_docs_list(folder, capsys):
    assert run(folder, "--json", "--start", "-100", "0", "0", "-q", poses=False) == 2
    assert "free cell" in capsys.readouterr().err
    assert run(folder, "--json", "-q") == 0
    found = document(capsys)
    assert {"filter", "start", "n_scans", "n_updates", "mean_particles", "updates_per_second", "last_pose",
            "last_spread_m", "distance_scale", "sure_after_s", "errors", "found_after_s",
            "findings"} <= set(found)  # fmt: skip
    assert found["n_scans"] == 120
    assert 0 < found["n_updates"] < 120


@pytest.mark.usefixtures("undrawn")
def test_without_reference_or_start_the_robot_can_be_anywhere(folder, capsys):
    assert run(folder, "--particles", "1000", poses=False) == 0
    text = capsys.readouterr().out
    assert "started from: anywhere on the map: no --start, and no reference pose in the log\n" in text
    assert "no reference poses to judge by" in text
    assert "sure of the place from" in text
    assert main(["localize", str(folder / "short.log"), "--map", str(folder / "map.yaml"), "--global"]) == 3
    assert "The robot has not been found" in capsys.readouterr().err


def test_poses_from_before_a_robot_is_found_elsewhere_are_no_guesses():
    found = {
        "filter": "ours", "start": None, "n_scans": 9, "n_updates": 5, "updates_per_second": None,
        "last_pose": [1.0, 2.0, 0.0], "last_spread_m": 0.1, "sure_after_s": 4.0, "findings": [{"name": "relocalized"}],
    }  # fmt: skip
    text = run_summary(found, None, Namespace(anywhere=True, start=None), is_sonar=False)
    assert "sure of the last place from 4.0 s on; before that, poses are of earlier places\n" in text
    assert "guess" not in text


@pytest.mark.usefixtures("undrawn")
def test_nan_as_the_word_for_no_return_is_written_down(folder, drive, tmp_path):
    write_bag(tmp_path / "run", ScanLog({"/scan": drive[:60]}))
    words = ("--map", str(folder / "map.yaml"), "--no-return", "nan", "--particles", "500", "-q")
    assert main(["localize", str(tmp_path / "run"), *words]) == 0
    written = json.loads(Path("beamfield_localization", "localization.json").read_text())
    assert written["provenance"]["options"]["no_return"] == ["nan"]


@pytest.mark.usefixtures("undrawn")
def test_errors_of_the_search_do_not_count(folder, capsys):
    assert run(folder, "--particles", "1000", "--global", "--json") == 0
    found = document(capsys)
    assert found["sure_after_s"] > 0.0
    assert found["errors"]["p95"] < 0.5
    assert not found["errors"]["lost"]


@pytest.mark.usefixtures("undrawn")
def test_the_inside_of_what_is_painted_black_is_no_wall_that_readings_fit(folder, capsys):
    assert run(folder, "--particles", "1000", "--global", "--json", map_name="black.yaml") == 0
    assert document(capsys)["errors"]["p95"] < 0.5


@pytest.mark.usefixtures("undrawn")
def test_what_cannot_be_said_of_a_sonars_path_is_not_advised(folder, capsys):
    assert (
        run(folder, "--particles", "500", "--opening-angle", "5", "--start", "2", "2", "0", "--json", poses=False) == 0
    )
    assert "lost-not-judged" in {finding["name"] for finding in document(capsys)["findings"]}
    assert run(folder, "--particles", "500", "--opening-angle", "5", poses=False) == 0
    assert "beamfield trajectory" not in capsys.readouterr().out


@pytest.mark.usefixtures("undrawn")
def test_a_start_given_is_where_it_starts(folder, capsys, drive):
    x, y, theta = drive.poses[0]
    words = ("--start", f"{x:.2f}", f"{y:.2f}", f"{np.degrees(theta):.0f}", "--json", "-q", "--seed", "4")
    assert run(folder, *words) == 0
    found = document(capsys)
    assert found["start"] == pytest.approx([x, y, theta], abs=0.02)
    assert found["errors"]["mean"] < 0.1


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    "words",
    [
        ("--params", "beam_model.yaml", "--beams", "15"),
        ("--params", "beam_model.yaml", "--model", "likelihood_field", "--leave-out-short", "--beams", "0"),
        ("--params", "beam_model.yaml", "--odometry-error", "2"),
        ("--params", "likelihood_field.yaml", "--exponent", "0.1"),
    ],
)
def test_models_and_options_are_taken(folder, capsys, words):
    assert run(folder, *words, "--particles", "300", "--json", "-q") == 0
    assert document(capsys)["errors"]["mean"] < 0.15


@pytest.mark.usefixtures("undrawn")
def test_a_field_from_a_beam_model_says_what_it_leaves_out(folder, tmp_path, capsys, drive, truth):
    path = tmp_path / "beam_model.yaml"
    path.write_text(beam_model_text(replace(truth, range_offset=0.03), drive.finder))
    assert run(folder, "--particles", "300", "--params", str(path), "--model", "likelihood_field") == 0
    shown = capsys.readouterr()
    assert "beam_model.yaml has range_offset 0.03, which a likelihood field cannot have" in shown.err
    assert "filter: beamfield's own, likelihood field" in shown.out


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("params", "model"),
    [((), "likelihood field"), (("likelihood_field.yaml",), "likelihood field"), (("beam_model.yaml",), "beam model")],
)
def test_the_model_is_that_of_the_file(folder, capsys, params, model):
    assert run(folder, "--particles", "300", *(word for path in params for word in ("--params", path))) == 0
    shown = capsys.readouterr()
    assert f"filter: beamfield's own, {model}" in shown.out
    assert "cannot have" not in shown.err


@pytest.mark.usefixtures("undrawn")
def test_a_file_of_a_stack_runs_that_stacks_filter(folder, capsys):
    words = ("--params", "nav2.yaml", "--rerun", "way.rrd", "--mcap", "way.mcap")
    assert run(folder, *words, "--json", "-q", "--seed", "3") == 0
    found = document(capsys)
    assert all(b"estimate" in Path(name).read_bytes() for name in ("way.rrd", "way.mcap"))
    assert found["filter"].startswith("that of nav2, emulated, with its model likelihood_field_prob")
    assert found["errors"]["mean"] < 0.2


@pytest.mark.usefixtures("undrawn")
def test_a_file_is_read_as_the_stacks_that_is_named_and_says_what_it_was_made_for(folder, tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    path.write_text((folder / "nav2.yaml").read_text() + "\n# chosen for the map amcl_map.yaml\n")
    assert run(folder, "--params", str(path), "--json") == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["filter"].startswith("that of nav2")
    assert "read as nav2's; pass --stack beluga if that is what the robot runs" in said.err
    assert "mine.yaml: its values were chosen for the map amcl_map.yaml" in said.err
    path.write_text(path.read_text() + "other:\n  ros__parameters:\n    z_hit: 0.5\n")
    mine = ("--stack", "beluga", "--section", "amcl.ros__parameters")
    assert run(folder, "--params", str(path), "--json", *mine) == 0
    said = capsys.readouterr()
    assert json.loads(said.out)["filter"].startswith("that of Beluga")
    assert "read as" not in said.err
    (folder / "amcl_map.yaml").write_text(f"# map.yaml {OF_MOVED_MAP} 0.05 m\n" + (folder / "map.yaml").read_text())
    assert run(folder, "--params", str(path), *mine, map_name="amcl_map.yaml") == 0
    said = capsys.readouterr().err
    assert "its values were chosen" not in said
    assert "the map's origin has a yaw" not in said
    (folder / "turned.yaml").write_text(re.sub(r"(origin: .*), 0.0\]", r"\1, 0.3]", (folder / "map.yaml").read_text()))
    run(folder, "--params", str(path), *mine[2:], map_name="turned.yaml")
    assert "mine.yaml: the map's origin has a yaw of 17.2 degrees: nav2 takes only" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("--stack", "nav2"), "--stack: is for a file of another program"),
        (("--section", "amcl"), "--section: is for a file of another program"),
        (("--params", "nav2.yaml", "--animation", "way.gif"), "--animation: for our own filter"),
        (("--params", "nav2.yaml", "--leave-out-short"), "--leave-out-short: for our own filter"),
        (("--start", "1", "1", "0", "--global"), "not allowed with"),
        (("--animation", "film.mp4"), ".gif"),
        (("--model", "ray"), "likelihood_field, beam"),
        (("--particles", "0"), "whole number >= 1"),
        (("--params", "likelihood_field.yaml", "--model", "beam"), "likelihood_field.yaml"),
    ],
)
def test_what_makes_no_sense_is_refused_on_one_line(folder, capsys, words, what):
    assert run(folder, *words) in (1, 2)
    said = capsys.readouterr()
    assert what in said.err.splitlines()[-1]
    assert not Path("beamfield_localization").exists()


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("log", "words"),
    [
        ("mirrored.log", ("--map", "map.yaml")),
        ("still.log", ("--map", "map.yaml", "--params", "nav2.yaml")),
    ],
)
def test_a_robot_that_is_lost_is_said_to_be(folder, capsys, log, words):
    given = [str(folder / word) if word.endswith(".yaml") else word for word in words]
    assert main(["localize", str(folder / log), "--poses", str(folder / "truth.tum"), "--json", *given]) == 3
    said = capsys.readouterr()
    assert "the robot is most likely lost" in said.err
    (finding,) = (one for one in json.loads(said.out)["findings"] if one["name"] == "robot-lost")
    assert finding["values"]["median_agreement"] < 0.45
    assert (finding["values"]["path_length_m"] == 0.0) == (log == "still.log")


@pytest.mark.usefixtures("undrawn")
def test_a_robot_that_is_lost_at_the_end_is_a_problem_too(folder, capsys, monkeypatch):
    finding = Finding("lost-at-end", "warning", "From 40 s after the first scan on, 20% agree.")
    monkeypatch.setattr("beamfield.localization.lost_robot.find_lost_robot", lambda *_: finding)
    assert run(folder) == 3
    assert "at the end the robot is most likely lost" in capsys.readouterr().err


@pytest.mark.usefixtures("undrawn")
def test_a_robot_in_another_building_is_not_found(folder, capsys, monkeypatch):
    # To find that no trajectory fits takes most of the time, and is tested on its own.
    refused = Mock(side_effect=TrajectoryNotFoundError("no trajectory fits"))
    monkeypatch.setattr("beamfield.localization.fitted_poses.fit_trajectory", refused)
    words = ("--map", str(folder / "elsewhere.yaml"), "--global", "--particles", "1000", "--json")
    assert main(["localize", str(folder / "drive.log"), *words]) == 3
    said = capsys.readouterr()
    assert "the robot has not been found" in said.err
    document = json.loads(said.out)
    assert {"not-found", "robot-lost"} & {finding["name"] for finding in document["findings"]}
    assert document["sure_after_s"] is None


@pytest.mark.usefixtures("undrawn")
def test_odometry_in_millimetres_is_no_robots(folder, capsys):
    assert main(["localize", str(folder / "fast.log"), "--map", str(folder / "map.yaml")]) == 3
    assert "steps of the odometry are longer than a robot drives" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["calibrate", "check", "evaluate", "likelihood", "localize", "map", "trajectory"])
def test_readings_in_millimetres_are_refused_on_one_line(folder, capsys, command):
    more = {"evaluate": ["--params", str(folder / "nav2.yaml")], "likelihood": ["--scan", "0"]}.get(command, [])
    assert main([command, str(folder / "far.log"), "--map", str(folder / "map.yaml"), "--quiet", *more]) == 1
    assert "expected readings in metres, not millimetres" in capsys.readouterr().err.splitlines()[-1]


def test_a_map_without_room_and_a_log_without_odometry_are_refused(folder, capsys):
    assert run(folder, "--global", map_name="solid.yaml") == 1
    assert "no free cell" in capsys.readouterr().err
    assert main(["localize", str(folder / "bare.log"), "--map", str(folder / "map.yaml")]) == 1
    assert "no scan has odometry, which moves the particles; if its poses are the odometry" in capsys.readouterr().err
    assert run(folder, "--mask=-180:179.9") == 1
    assert "no reading of any scan hits anything" in capsys.readouterr().err


def test_a_scan_is_worth_what_the_file_says_however_many_beams_are_used():
    from argparse import Namespace

    from beamfield.cli.localize import INDEPENDENT_BEAMS, _counting

    saved = Namespace(n_beams=20, exponent=0.2)
    given = Namespace(beams=None, exponent=None)
    assert _counting(saved, 61, given) == {"n_beams": 20, "exponent": 0.2}
    assert _counting(saved, 61, Namespace(beams=40, exponent=None)) == {"n_beams": 40, "exponent": 0.1}
    assert _counting(saved, 61, Namespace(beams=0, exponent=0.5)) == {"n_beams": 61, "exponent": 0.5}
    assert _counting(None, 30, given) == {"n_beams": 30, "exponent": INDEPENDENT_BEAMS / 30}
    assert _counting(Namespace(n_beams=None, exponent=1.0), 30, given) == _counting(None, 30, given)
    assert _counting(None, 1, given)["exponent"] == 1.0
    # An exponent alone counts for all beams.
    assert _counting(Namespace(n_beams=None, exponent=0.02), 30, given) == {"n_beams": 30, "exponent": 0.02}
