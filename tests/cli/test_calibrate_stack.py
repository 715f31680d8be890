"""``beamfield calibrate --stack`` as a user runs it."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.calibration.pose_windows import WindowOptions
from beamfield.cli.calibrate_replay import _cache_folder
from beamfield.cli.calibrate_stack import _fits, _motion_for_new_file, _said, fit_for_stack, next_step, write_patch
from beamfield.cli.main import main
from beamfield.cli.report_part import StackPart
from beamfield.errors import TooLittleDataError
from beamfield.finding import Finding
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.read_map import read_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import hollowed
from beamfield.report.page_section import PageSection
from beamfield.report.verdict import DOUBTS
from beamfield.stacks.files.calibration_record import goes_with_moved_map
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.fit.kept_runs import kept_runs
from beamfield.stacks.nav2.motion import Nav2Motion
from tests.cli.simulated import on_map, simulated

MINE = """\
amcl:
  ros__parameters:
    # tuned on a Friday
    z_hit: 0.5
    z_rand: 0.5
    sigma_hit: 0.6   # wide
    laser_model_type: "likelihood_field"
    max_beams: 60
    min_particles: 100
    max_particles: 200
    alpha1: 0.2   # as shipped
    alpha5: 0.1
"""
KEPT = StackPart("stack", "", {}, PageSection("stack", "", ""), {}, values={}, record="as calibrated")

pytestmark = pytest.mark.usefixtures("short_stack_fit", "without_figures")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("world"), "--duration 90 --scan-rate 3 --beams 31")


def calibrate(world: Path, out: Path, *more: str, quiet: bool = True) -> int:
    return on_map("calibrate", world, "log.carmen", out, *(["--quiet"] if quiet else []), "--no-refine", *more)


def test_the_users_file_gets_calibrated_values_and_the_report_says_what_they_do(world, tmp_path, capsys):
    mine = tmp_path / "mine.yaml"
    mine.write_text(MINE)
    assert calibrate(world, tmp_path / "out", "--stack", "nav2", "--patch", str(mine), quiet=False) == 0
    printed = capsys.readouterr().out
    assert "likelihood_field_prob, before" in printed
    assert "the old file is mine.yaml.bak" in printed
    verdict, _, wrote, changed, then = printed.splitlines()[-5:]
    assert verdict.startswith("Use the new values: replayed in nav2's own filter")
    assert (wrote[:6], changed[:8]) == ("wrote ", "changed ")
    assert then == (
        f"next, on another drive: beamfield evaluate OTHER_LOG --map {world / 'map.yaml'} --params "
        f"{tmp_path / 'mine.yaml.bak'} {mine} --filter-maps {world / 'map.yaml'} {tmp_path / 'out' / 'amcl_map.yaml'}"
    )
    assert (tmp_path / "mine.yaml.bak").read_text() == MINE
    after = mine.read_text()
    assert "    # tuned on a Friday\n" in after
    assert re.search(r"    alpha1: 0\.0\d+   # as shipped\n", after)
    new, own = checked_values(read_stack_file(mine)), checked_values(read_stack_file(tmp_path / "out" / "nav2.yaml"))
    assert new == own
    assert new.sigma_hit != 0.6
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())["stack"]
    # The product does better than the sum of cubes that the file asks for.
    assert (document["stack"], document["model"]) == ("nav2", "likelihood_field_prob")
    assert new.laser_model_type == "likelihood_field_prob"
    assert {"stack-other-model", "stack-map"} <= {finding["name"] for finding in document["findings"]}
    own, taken = document["models"]
    assert (own["chosen"], taken["chosen"]) == (False, True)
    assert own["start"]["laser_model_type"] == "likelihood_field"
    assert taken["calibrated"]["score"] > own["calibrated"]["score"]
    assert taken["parameters"]["sigma_hit"] == pytest.approx(new.sigma_hit, rel=1e-5)
    both = [
        read_filter_settings(read_stack_file(path, stack="nav2")) for path in (mine, tmp_path / "out" / "nav2.yaml")
    ]
    # The new file alone runs the same filter, with what the user's has of the motion model.
    assert both[0].motion == both[1].motion == Nav2Motion(**document["motion"], alpha5=0.1)
    shift = document["replay"]["chosen"]["origin_shift"]
    assert shift == 0.025  # nav2 reads maps half a cell off
    corrected, as_it_was = read_map(tmp_path / "out" / "amcl_map.yaml"), read_map(world / "map.yaml")
    np.testing.assert_allclose(corrected.origin, as_it_was.origin + np.array([shift, shift, 0.0]), atol=1e-9)
    np.testing.assert_array_equal(corrected.probability, as_it_was.probability)
    assert re.search(r"\n# .*; checksum \w+ of the values; chosen for the map amcl_map.yaml\n$", after)
    copied = tmp_path / "elsewhere" / "amcl_map.yaml"
    copied.parent.mkdir()
    copied.write_text((tmp_path / "out" / "amcl_map.yaml").read_text())
    np.testing.assert_array_equal(read_map(copied).probability, as_it_was.probability)
    (image,) = (one.name for one in world.iterdir() if one.stem == "map" and one.suffix != ".yaml")
    assert f"# On another computer put this file beside the picture, and write image: {image}\n" in copied.read_text()
    assert "for the map amcl_map.yaml beside this file" in (tmp_path / "out" / "nav2.yaml").read_text()
    for path in (mine, tmp_path / "out" / "nav2.yaml"):
        assert main(["doctor", str(path), "--map", str(world / "map.yaml")]) == 0
        assert "info: calibrated" in capsys.readouterr().out
    out = ("--out", str(tmp_path / "again"))
    for command in (["calibrate", "LOG"], ["trajectory", "LOG"], ["evaluate", "LOG", "--params", str(mine)]):
        assert main([*command, "--map", str(copied), *(() if command[0] == "trajectory" else out)]) == 1
        assert "amcl_map.yaml: this is the map that beamfield calibrate wrote for amcl alone" in capsys.readouterr().err
    mine.write_text(after.replace("z_rand: ", "z_rand: 1"))
    main(["doctor", str(mine)])
    assert "info: calibrated" not in capsys.readouterr().out
    page = (tmp_path / "out" / "report.html").read_text()
    assert "<title>nav2: likelihood_field_prob for FLASER</title>" in page
    assert page.index("Use the new values: replayed in nav2&#x27;s own filter") < page.index("beats nav2")
    assert document["verdict"].startswith("Use the new values: replayed in nav2's own filter, emulated")
    assert document["replay"]["error"]["after"] < document["replay"]["error"]["before"]
    assert 'id="stack-choice"' in page


def test_for_a_map_painted_black_where_nothing_is_known_amcl_gets_one_that_is_not(world, tmp_path, capsys):
    known = read_map(world / "map.yaml")
    cells = np.pad(np.where(known.free, 0.0, 1.0), 80, constant_values=1.0)
    corner = known.origin - np.array([*[80 * known.resolution] * 2, 0.0])
    black = OccupancyGrid(cells, known.resolution, corner)
    write_map(black, tmp_path / "map.yaml")
    # As of a map that was only ever black and white: no grey lies between the thresholds.
    text = (tmp_path / "map.yaml").read_text()
    text = text.replace("_thresh: 0.65", "_thresh: 0.5").replace("_thresh: 0.25", "_thresh: 0.499")
    (tmp_path / "map.yaml").write_text(text)
    shutil.copy(world / "log.carmen", tmp_path)
    mine, out = tmp_path / "mine.yaml", tmp_path / "out"
    mine.write_text(MINE)
    main(["doctor", str(mine), "--map", str(tmp_path / "map.yaml")])
    assert "warning: map-painted-black" in capsys.readouterr().out
    localized = ["localize", str(tmp_path / "log.carmen"), "--map", str(tmp_path / "map.yaml"), "--params", str(mine)]
    main([*localized, "--out", str(tmp_path / "localized")])
    assert "% of the map's cells are black, but no wall" in capsys.readouterr().err
    asked = ("--stack", "nav2", "--model", "likelihood_field", "--patch", str(mine))
    assert calibrate(tmp_path, out, *asked, quiet=False) == 0
    printed = capsys.readouterr().out
    assert f"--filter-maps {tmp_path / 'map.yaml'} {out / 'amcl_map.yaml'}" in printed
    assert "amcl_map.yaml, your map unknown where it is painted black far from what is free, and with its" in printed
    chosen = json.loads((out / "calibration.json").read_text())["stack"]["replay"]["chosen"]
    assert (chosen["origin_shift"], chosen["black_areas_unknown"]) == (0.025, True)
    corrected, expected = read_map(out / "amcl_map.yaml"), hollowed(black)
    np.testing.assert_array_equal(corrected.probability, expected.probability)
    np.testing.assert_allclose(corrected.origin, black.origin + np.array([0.025, 0.025, 0.0]), atol=1e-9)
    assert "# map.yaml for amcl alone: it is unknown where" in (out / "amcl_map.yaml").read_text()
    assert (out / "amcl_map.pgm").exists()
    main(["doctor", str(mine), "--map", str(out / "amcl_map.yaml")])
    assert "map-painted-black" not in capsys.readouterr().out
    # Asked to keep the map, it does.
    assert calibrate(tmp_path, tmp_path / "kept", *asked, "--keep-map") in (0, 3)
    assert not (tmp_path / "kept" / "amcl_map.yaml").exists()


def test_without_a_file_or_a_replay_windows_choose_the_model(world, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("beamfield.cli.calibrate_stack.replay_fit", lambda *_: (None, "not tested here"))
    assert calibrate(world, tmp_path / "out", "--stack", "beluga") == 3
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())["stack"]
    assert [fit["model"] for fit in document["models"]] == ["likelihood_field", "likelihood_field_prob"]
    best = max(document["models"], key=lambda fit: max(trial["net_score"] for trial in fit["trials"]))
    assert best["chosen"]
    file = read_stack_file(tmp_path / "out" / "beluga.yaml", stack="beluga")
    assert file.model == best["model"]
    assert document["replay"] == {"missing": "not tested here"}
    assert document["verdict"].startswith("no value for beluga is proven, for its filter could not be replayed")
    assert capsys.readouterr().out == f"{document['verdict']}\n"


def test_without_a_replay_the_users_file_stays(world, tmp_path, capsys):
    mine = tmp_path / "mine.yaml"
    mine.write_text(MINE.rstrip("\n") + "\n    update_min_d: 20.0\n    update_min_a: 6.0\n")
    before = mine.read_text()
    asked = ("--stack", "nav2", "--model", "likelihood_field", "--patch", str(mine))
    assert calibrate(world, tmp_path / "out", *asked, quiet=False) == 3
    said = capsys.readouterr()
    assert mine.read_text() == before
    assert "its filter could not be replayed: a replay needs" in said.err
    assert f"left {mine} as it was; what would have changed is in nav2.yaml" in said.out


def test_values_can_be_chosen_for_the_map_as_it_is(world, tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text(f"{MINE}# chosen for the map amcl_map.yaml\n")
    asked = ("--stack", "nav2", "--model", "likelihood_field", "--keep-map", "--patch", str(mine))
    assert calibrate(world, tmp_path / "out", *asked) == 0
    assert not goes_with_moved_map(mine.read_text())
    replay = json.loads((tmp_path / "out" / "calibration.json").read_text())["stack"]["replay"]
    assert replay["error"]["after"] > 0.0
    assert not (tmp_path / "out" / "amcl_map.yaml").exists()


@pytest.mark.parametrize(
    ("options", "message", "code"),
    [
        (("--keep-map",), "--keep-map: is for another program's model, name it with --stack", 2),
        (("--stack", "ros9"), "--stack: expected one of nav2, ros1, beluga, mrpt, f1tenth, got 'ros9'", 2),
        (("--stack", "nav2", "--model", "table"), "--model: nav2 has likelihood_field, likelihood_field_prob, beam", 2),
        (("--model", "beam"), "--model: is for another program's model, name it with --stack", 2),
        (("--stack", "nav2", "--patch", "missing.yaml"), "missing.yaml: No such file or directory", 1),
        (("--stack", "nav2", "--reference-error", "0"), "--reference-error: expected 0 to 0.25 m, without 0", 2),
    ],
    ids=["keep map", "stack", "model", "no stack", "no file", "reference error"],
)
def test_wrong_requests_fail_before_any_work(world, tmp_path, capsys, options, message, code):
    assert calibrate(world, tmp_path / "out", *options) == code
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_file_that_was_patched_before_gets_no_second_backup_of_the_same(tmp_path):
    mine = tmp_path / "mine.yaml"
    mine.write_text(MINE)
    part = StackPart(
        "stack", "", {}, PageSection("stack", "", ""), {}, values={"sigma_hit": 0.1}, record="as calibrated"
    )
    assert write_patch(read_stack_file(mine, stack="nav2"), part) == (
        f"changed sigma_hit in {mine}; the old file is mine.yaml.bak",
        tmp_path / "mine.yaml.bak",
    )
    after = mine.read_text()
    again = write_patch(read_stack_file(mine, stack="nav2"), replace(part, values={}))
    assert again == (f"left {mine} as it was", None)
    assert mine.read_text() == after
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine.yaml", "mine.yaml.bak"]


def test_what_was_noted_in_a_file_whose_values_stay_is_said(tmp_path):
    mine = tmp_path / "mine.yaml"
    of_map = "chosen for the map amcl_map.yaml"
    of_values = f"calibrated by beamfield 1; checksum {'0' * 16} of the values"
    for record, said in ((of_map, "for which map its values are"), (of_values, "that its values were checked")):
        mine.write_text(MINE)
        part = StackPart("stack", "", {}, PageSection("stack", "", ""), {}, values={}, record=record)
        line, _ = write_patch(read_stack_file(mine, stack="nav2"), part)
        assert line.startswith(f"noted {said} in {mine}; ")


def asked_to_patch(path: Path, text: str, stack: str = "nav2", topic: str | None = None):
    path.write_text(text)
    given = SimpleNamespace(map="map.yaml", map_topic=topic, patch="mine.yaml", out=Path("out"), section=None)
    return given, read_stack_file(path, stack=stack)


def test_files_are_compared_on_another_drive_only_if_they_differ(tmp_path):
    given, mine = asked_to_patch(tmp_path / "mine.yaml", MINE)
    _, was_moved = asked_to_patch(tmp_path / "moved.yaml", MINE + "# chosen for the map amcl_map.yaml\n")
    moved, values = replace(KEPT, files={"amcl_map.yaml": ""}), {"z_hit": 0.6}
    backup = Path("mine.yaml.bak")
    assert next_step(given, backup, KEPT, mine) == ""
    assert next_step(given, backup, moved, mine).endswith("--filter-maps map.yaml out/amcl_map.yaml")
    assert "--filter-maps" not in next_step(given, backup, replace(KEPT, values=values), mine)
    assert next_step(given, backup, moved, was_moved) == ""
    again = next_step(given, backup, replace(moved, values=values), was_moved)
    assert again.endswith("--filter-maps out/amcl_map.yaml out/amcl_map.yaml")


@pytest.mark.parametrize(
    ("text", "stack", "said"),
    [
        (MINE, "nav2", ""),
        (MINE, "beluga", " --stack beluga"),
        ("laser_z_hit: 0.9\nlaser_model_type: likelihood_field\n", "ros1", ""),
        ("laser_z_hit: 0.9\nlaser_model_type: likelihood_field\n", "beluga", " --stack beluga"),
    ],
)
def test_the_next_command_says_whose_file_it_is_where_the_file_does_not(tmp_path, text, stack, said):
    given, mine = asked_to_patch(tmp_path / "mine.yaml", text, stack, "/map")
    step = next_step(given, Path("mine.yaml.bak"), replace(KEPT, values={"z_hit": 0.6}), mine)
    assert step.endswith(f"--params mine.yaml.bak mine.yaml --map-topic /map{said}")


def test_a_new_file_names_the_motion_model_that_its_values_are_for(tmp_path):
    _, mine = asked_to_patch(tmp_path / "mine.yaml", "laser_z_hit: 0.9\nodom_model_type: omni\n", "ros1")
    assert _motion_for_new_file(mine, None) == {"odom_model_type": "omni"}
    assert _motion_for_new_file(None, None) == {}


def test_a_stack_needs_a_map(world, tmp_path, capsys):
    log = str(next(world.glob("log.*")))
    assert main(["calibrate", log, "--stack", "nav2", "--out", str(tmp_path / "out"), "--quiet"]) == 2
    assert "--stack: needs --map" in capsys.readouterr().err


def test_a_read_only_file_is_refused_and_left_alone(world, tmp_path, capsys):
    mine = tmp_path / "mine.yaml"
    mine.write_text(MINE)
    mine.chmod(0o444)
    assert calibrate(world, tmp_path / "out", "--stack", "nav2", "--patch", str(mine)) == 1
    assert "mine.yaml: the file is read-only" in capsys.readouterr().err
    assert mine.read_text() == MINE
    assert not (tmp_path / "out").exists()


def test_a_file_of_another_stack_is_refused_and_left_alone(world, tmp_path, capsys):
    theirs = tmp_path / "theirs.yaml"
    theirs.write_text("amcl:\n  laser_z_hit: 0.9\n")
    assert calibrate(world, tmp_path / "out", "--stack", "nav2", "--patch", str(theirs)) == 1
    assert "theirs.yaml: expected a file of nav2, this is one of ros1" in capsys.readouterr().err
    assert theirs.read_text() == "amcl:\n  laser_z_hit: 0.9\n"


def test_a_log_too_short_for_the_stack_is_named_early_and_the_rest_is_written(tmp_path, capsys):
    short = simulated(tmp_path / "short", "--duration 30 --speed 0.25 --scan-rate 5 --beams 31")
    mine = tmp_path / "mine.yaml"
    mine.write_text(MINE)
    assert calibrate(short, tmp_path / "out", "--stack", "nav2", "--patch", str(mine), quiet=False) == 3
    printed = capsys.readouterr()
    said = printed.err.splitlines()
    early = next(i for i, line in enumerate(said) if "too short for --stack nav2, the rest goes on" in line)
    assert re.search(r"need 5 of each: a drive about \d+\.\d times as long should do", said[early])
    assert early < said.index("learning ...")
    assert said[-1].startswith("beamfield: warning: no values for nav2: ")
    assert printed.out.count("no values for nav2") == 1
    names = ["beam_model.yaml", "calibration.json", "likelihood_field.yaml", "report.html"]
    assert [name for name in names if (tmp_path / "out" / name).exists()] == names
    assert not (tmp_path / "out" / "nav2.yaml").exists()
    assert mine.read_text() == MINE
    assert "need 5 of each" in json.loads((tmp_path / "out" / "calibration.json").read_text())["stack"]["missing"]
    assert "no values for nav2" in (tmp_path / "out" / "report.html").read_text()


def test_where_map_or_poses_are_wrong_the_users_file_stays(world, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("beamfield.cli.calibrate_stack.replay_fit", lambda *_: (None, "not tested here"))
    monkeypatch.setitem(DOUBTS, "few-blocks", "the map is wrong")  # stands for a finding of a wrong map
    mine, out = tmp_path / "mine.yaml", tmp_path / "out"
    mine.write_text(MINE)
    out.mkdir()
    (out / "amcl_map.yaml").write_text("of another day")
    asked = ("--stack", "nav2", "--model", "likelihood_field", "--patch", str(mine))
    assert calibrate(world, out, *asked, quiet=False) == 3
    said = capsys.readouterr()
    assert f"left {mine} as it was; what would have changed is in nav2.yaml\n" in said.out
    assert f"{out / 'amcl_map.yaml'}: of an earlier run; these values do not go with it" in said.err
    assert mine.read_text() == MINE
    assert not (tmp_path / "mine.yaml.bak").exists()
    said = "Do not use these values yet: the map is wrong."
    assert f"# {said}\n" in (out / "nav2.yaml").read_text()
    assert f'<p class="verdict bad"><b class="label">Do not trust</b> {said}</p>' in (out / "report.html").read_text()
    main(["doctor", str(out / "nav2.yaml")])
    assert "info: calibrated" not in capsys.readouterr().out


def test_values_are_fitted_in_a_map_that_is_out_of_date_but_not_in_that_of_another_place(monkeypatch):
    monkeypatch.setattr("beamfield.stacks.fit.fit.fit_stack", lambda _, name, *__, **___: name)
    arguments = SimpleNamespace(stack="nav2", model="beam", reference_error=0.04, seed=0, block=None, keep_map=True)
    job = SimpleNamespace(arguments=arguments, patched=None, progress=None)

    def fits_with(name: str) -> list[str]:
        findings, options = (Finding(name, "warning", ""),), SimpleNamespace(selection=None)
        result = SimpleNamespace(findings=findings, candidates=(), options=options)
        return _fits(job, None, SimpleNamespace(origin=np.zeros(3)), result)

    assert fits_with("map-out-of-date") == ["beam"]
    with pytest.raises(TooLittleDataError, match="most readings disagree with the map"):
        fits_with("map-disagrees")


@pytest.mark.parametrize(
    ("model", "said", "tried"),
    [
        (None, None, ["likelihood_field", "likelihood_field_prob"]),
        (None, "beam", ["beam"]),
        ("likelihood_field", None, ["likelihood_field", "likelihood_field_prob"]),
        ("beam", None, ["beam", "likelihood_field_prob"]),
        ("likelihood_field_prob", None, ["likelihood_field_prob"]),
        ("likelihood_field", "likelihood_field", ["likelihood_field"]),
    ],
)
def test_the_model_that_runs_is_tried_and_a_product_instead_of_a_sum(tmp_path, monkeypatch, model, said, tried):
    mine = tmp_path / "mine.yaml"
    mine.write_text(MINE.replace('"likelihood_field"', str(model)))
    monkeypatch.setattr("beamfield.stacks.fit.fit.fit_stack", lambda _, name, *__, start, **___: (name, start))
    job = SimpleNamespace(
        arguments=SimpleNamespace(stack="nav2", model=said, reference_error=0.04, seed=0, block=None, keep_map=True),
        patched=None if model is None else read_stack_file(mine, stack="nav2", model=said), progress=None,
    )  # fmt: skip
    result = SimpleNamespace(findings=(), candidates=(), options=SimpleNamespace(selection=None))
    fits = _fits(job, None, SimpleNamespace(origin=np.zeros(3)), result)
    assert [name for name, _ in fits] == tried
    assert [start.laser_model_type for _, start in fits] == tried
    assert {start.sigma_hit for _, start in fits} == {0.2 if model is None else 0.6}


def test_where_scans_tell_nothing_nothing_is_replayed_or_written(monkeypatch):
    blind = SimpleNamespace(mean=0.2, coverage=1.0)  # as with the map of another building
    fit = SimpleNamespace(chosen=SimpleNamespace(crossed=blind, held_out=blind), options=WindowOptions())
    monkeypatch.setattr("beamfield.cli.calibrate_stack._fits", lambda *_: [fit])
    monkeypatch.setattr("beamfield.cli.calibrate_stack.replay_fit", lambda *_: pytest.fail("replayed"))
    job = SimpleNamespace(arguments=SimpleNamespace(stack="nav2"))
    part = fit_for_stack(job, None, None, None, {})
    assert part.problem.startswith(
        "no values for nav2: with the best ones 4 scans tell 0.20 nats of where the robot is"
    )
    assert part.problem.endswith("(0.69); do log, poses and map belong together?")
    assert part.files == {}


def test_a_map_whose_yaw_the_program_ignores_gets_no_values():
    turned = SimpleNamespace(origin=np.array([0.0, 0.0, 0.1]))
    job = SimpleNamespace(arguments=SimpleNamespace(stack="nav2"), patched=None)
    part = fit_for_stack(job, None, turned, SimpleNamespace(findings=()), {})
    assert part.problem == (
        "no values for nav2: the map's origin has a yaw of 5.73 degrees, and nav2 takes only the origin's x and y: "
        "every pose is matched against a rotated map. Save the map with a yaw of 0 (rotate the picture)."
    )
    assert part.files == {}


@pytest.mark.parametrize(("name", "what"), [("laser-mount", "laser's mount"), ("scan-delay", "scans' stamps")])
def test_where_the_lasers_mount_or_stamps_are_wrong_no_values_are_found_that_make_up_for_it(name: str, what: str):
    upright = SimpleNamespace(origin=np.zeros(3))
    job = SimpleNamespace(arguments=SimpleNamespace(stack="nav2"), patched=None)
    found = Finding(name, "warning", "It is wrong.", do="Correct it.")
    part = fit_for_stack(job, None, upright, SimpleNamespace(findings=(found,)), {})
    assert part.problem == f"no values for nav2: correct the {what} first: It is wrong. Correct it."
    assert part.files == {}


def test_motion_noise_that_a_file_has_no_place_for_is_said():
    said = "motion noise to go with it, not written: it belongs under motion_model_2d of mrpt_pf_localization, beside "
    assert _said("mrpt", {"a1": 0.02, "a4": 0.1}) == [f"{said}modelSelection: a1 = 0.02, a4 = 0.1"]
    assert _said("mrpt", {}) == _said("beluga", {"alpha1": 0.02}) == []


def test_nothing_is_kept_for_a_user_without_a_home(monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr("os.getuid", lambda: 2**31 - 7)
    with kept_runs(_cache_folder(), "inputs") as kept:
        kept.write()
    assert not _cache_folder().exists()


def test_another_motion_model_is_written_not_said():
    assert _said("nav2", {"robot_model_type": "nav2_amcl::OmniMotionModel", "alpha5": 0.02}) == []
