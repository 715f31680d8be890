"""What every command does with --json, --quiet and --verbose, and with an error of its own."""

from __future__ import annotations

import json
from argparse import Namespace
from pathlib import Path

import pytest

from beamfield.cli.main import main
from beamfield.cli.outcome import Outcome, show
from beamfield.cli.wording import in_options
from beamfield.io.bags.writer import write_bag
from beamfield.io.read_log import read_log
from tests.cli.simulated import simulated
from tests.io.mini_bag import MiniBag

NAV2 = (
    "amcl:\n  ros__parameters:\n    laser_model_type: likelihood_field_prob\n    z_hit: 0.5\n    laser_max_range: 9.0\n"
)
LOG = "{world}/log.carmen --map {world}/map.yaml"
# What is typed, the keys that are promised, and the exit code.
COMMANDS = {
    "simulate": ("--out {out}/w --duration 5 --beams 9", {"parameters", "files", "scans", "seed"}, 0),
    "inspect": ("{world}/log.carmen", {"source", "kind", "sensors", "odometry"}, 0),
    "map": ("{world}/log.carmen --out {out}/m.yaml --resolution 0.2", {"kind", "rows", "cols", "cells", "scans"}, 0),
    "likelihood": (
        f"{LOG} --scan 3 --resolution 1 --headings 8 --out {{out}}/l.png",
        {"scan", "model", "n_poses", "n_places", "n_headings", "resolution_m", "maximum", "rival", "reference"},
        0,
    ),
    "check": (
        f"{LOG} --worst 0 --out {{out}}/c",
        {"n_judged", "share_that_fits", "longest_lost", "worst", "provenance"},
        0,
    ),
    "calibrate": (f"{LOG} --out {{out}}/b --no-refine", {"sensors"}, 0),
    "doctor": ("{world}/nav2.yaml", {"file", "stack", "stack_is_certain", "model", "section", "findings"}, 0),
    "translate": ("{world}/nav2.yaml --to beluga --max-range 9", {"stack", "model", "from", "values", "file"}, 0),
    "figures": ("--list", {"figures"}, 0),
}


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = simulated(tmp_path_factory.mktemp("world"), "--duration 40 --scan-rate 4 --beams 31")
    (folder / "nav2.yaml").write_text(NAV2)
    write_bag(folder / "bag", read_log(folder / "log.carmen"))
    return folder


def typed(command: str, world: Path, out: Path) -> list[str]:
    return [command, *(word.format(world=world, out=out) for word in COMMANDS[command][0].split())]


@pytest.mark.usefixtures("without_figures")
@pytest.mark.parametrize("command", COMMANDS)
def test_json_is_all_of_stdout_and_has_the_documented_keys(command, world, tmp_path, capsys):
    _, keys, code = COMMANDS[command]
    assert main([*typed(command, world, tmp_path), "--json"]) == code
    said = capsys.readouterr()
    document = json.loads(said.out)
    assert (document["command"], document["exit_code"]) == (command, code)
    assert {"notes", "wrote"} <= set(document)
    noted = [line.removeprefix("note: ") for line in said.err.splitlines() if line.startswith("note: ")]
    assert set(noted) <= {in_options(note) for note in document["notes"]}
    assert keys <= set(document)
    assert all(Path(path).exists() for path in document["wrote"])


@pytest.mark.parametrize("command", sorted(set(COMMANDS) - {"calibrate", "check", "figures", "translate"}))
def test_quiet_leaves_the_result_on_one_line(command, world, tmp_path, capsys):
    assert main([*typed(command, world, tmp_path), "--quiet"]) == COMMANDS[command][2]
    out, err = capsys.readouterr()
    assert out.count("\n") == 1
    assert err == ""


def test_verbose_numbers_the_steps(world, capsys):
    assert main(["inspect", str(world / "log.carmen"), "-v"]) == 0
    first, last = capsys.readouterr().err.splitlines()
    assert first == "1. reading ..."
    assert last.startswith("1. took ")


def test_on_an_error_json_leaves_stdout_empty(tmp_path, capsys):
    assert main(["inspect", str(tmp_path / "none.log"), "--json", "--quiet"]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err == f"beamfield: error: {tmp_path / 'none.log'}: No such file or directory\n"


def test_an_error_of_our_own_is_one_line_and_shows_its_place_if_asked(world, capsys, monkeypatch):
    def broken(*_: object) -> None:
        raise KeyError("a mistake")

    monkeypatch.setattr("beamfield.cli.inspect._read", broken)
    assert main(["inspect", str(world / "log.carmen"), "--quiet"]) == 70
    said = "beamfield: error: internal error, please report it: KeyError: 'a mistake'"
    assert capsys.readouterr().err == f"{said}; -v shows where\n"
    assert main(["inspect", str(world / "log.carmen"), "--quiet", "--verbose"]) == 70
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert err.splitlines()[-1] == said


@pytest.mark.parametrize(
    ("log", "grid"), [("map.yaml", "log.carmen"), ("map.yaml", "bag"), ("log.carmen", "bag"), ("map.yaml", "map.yaml")]
)
@pytest.mark.parametrize("command", ["calibrate", "check", "figures"])
def test_a_log_and_a_map_that_are_swapped_are_said_to_be(command, log, grid, world, tmp_path, capsys):
    words = [command, str(world / log), "--map", str(world / grid), "--out", str(tmp_path / "out"), "--quiet"]
    assert main(words) == 1
    error = capsys.readouterr().err
    assert error.endswith("did you swap LOG and --map?\n")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_what_was_assumed_about_log_and_map_is_said_before_an_error(world, tmp_path, capsys):
    bag = MiniBag().scan(1.0).write(tmp_path)  # nothing says where the laser sits
    (tmp_path / "dark.yaml").write_text((world / "map.yaml").read_text().replace("negate: 0", "negate: 1"))
    (tmp_path / "map.pgm").write_bytes((world / "map.pgm").read_bytes())
    words = ["likelihood", str(bag), "--map", str(tmp_path / "dark.yaml"), "--scan", "7"]
    assert main(words) == 2
    *_, of_map, _, of_mount, error = capsys.readouterr().err.splitlines()
    assert of_map.startswith("note: dark.yaml: occupied cells outnumber free ones")
    assert of_mount == (
        "note: log: /scan: the bag has no transforms; the sensor is assumed at the robot's origin, facing forward: "
        "if it is not, give --mount"
    )
    assert error.startswith("beamfield: error: --scan:")
    assert main([*words, "--quiet"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_json_names_options_as_the_terminal_does(capsys):
    finding = {"text": "read it with lone_poses='odometry'", "name": "lone_poses"}
    outcome = Outcome("", document={"findings": [finding]}, notes=["no_return"])
    show(outcome, Namespace(quiet=True, json=True, command="calibrate"))
    said = json.loads(capsys.readouterr().out)
    assert said["findings"] == [{"text": "read it with --lone-poses odometry", "name": "lone_poses"}]
    assert said["notes"] == ["--no-return"]
