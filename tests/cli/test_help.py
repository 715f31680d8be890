"""What --help says: the same formats in every command, and all that are read."""

from __future__ import annotations

import argparse
import inspect
import math
import re
import shlex
import subprocess
import sys

import pytest

from beamfield.calibration.cross_fit import build_cross_fit_maps
from beamfield.calibration.selection import SelectionOptions
from beamfield.calibration.time_split import LONGEST_BLOCK_S
from beamfield.cli.main import build_parser, main
from beamfield.cli.options import LOG_FORMATS, MAP_FORMATS
from beamfield.io.read_log import SUPPORTED


def help_of(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the help of a command on one line."""
    assert main([*command.split(), "--help"]) == 0
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("command", ["calibrate", "check", "doctor", "inspect", "map", "likelihood", "figures"])
def test_every_command_that_reads_a_log_names_all_formats(command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "2000")
    text = help_of(command, capsys)
    assert LOG_FORMATS in text
    assert command == "map" or MAP_FORMATS in text


def test_help_names_every_format_that_the_reader_names():
    formats = re.findall(
        r"CARMEN|Wean Hall|GMapping|g2o|CoreSLAM|gzip|measurement\.txt|\.bag|ROS 2 folder|\.db3|\.mcap", SUPPORTED
    )
    assert len(set(formats)) == 11
    for name in formats:
        assert name.replace("gzip", ".gz") in LOG_FORMATS, name


def commands() -> dict[str, argparse.ArgumentParser]:
    """Return the parser of every command, those of a group by both words."""
    found: dict[str, argparse.ArgumentParser] = {}
    for name, command in inner_commands(build_parser()).items():
        inner = {f"{name} {word}": parser for word, parser in inner_commands(command).items()}
        found |= inner or {name: command}
    return found


def inner_commands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    groups = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return {name: command for group in groups for name, command in group.choices.items()}


ALL = tuple(commands())


def options_of_commands() -> list[tuple[str, argparse.Action]]:
    """Return (command, option) for every option of every command."""
    return [(name, option) for name, command in commands().items() for option in command._actions]


def test_every_default_is_stated():
    silent = [
        f"{command} {option.option_strings[0]}"
        for command, option in options_of_commands()
        if option.default not in (None, False, [], argparse.SUPPRESS) and "(default: " not in (option.help or "")
    ]
    assert silent == []


def test_the_stated_defaults_of_the_library_are_its_own():
    stated = {
        option.option_strings[0]: float(re.search(r"\(default: ([\d.]+)", option.help or "")[1])
        for command, option in options_of_commands()
        if command == "calibrate" and set(option.option_strings) & {"--min-travel", "--min-turn", "--block",
                                                                    "--max-turn-rate", "--resolution"}
    }  # fmt: skip
    library = SelectionOptions()
    assert stated["--min-travel"] == library.min_travel
    assert stated["--min-turn"] == pytest.approx(math.degrees(library.min_turn), abs=0.005)
    assert stated["--max-turn-rate"] == pytest.approx(math.degrees(library.max_turn_rate), abs=0.5)
    assert stated["--block"] == LONGEST_BLOCK_S
    assert stated["--resolution"] == inspect.signature(build_cross_fit_maps).parameters["resolution"].default


def test_units_are_explained(capsys):
    assert "DEG for degrees" in help_of("calibrate", capsys)


def test_one_sensor_is_not_called_repeatable(capsys):
    assert "repeatable" in help_of("inspect", capsys)
    assert "scan topic or sensor (default" in help_of("check", capsys)


def test_every_command_has_the_same_short_options():
    shared = {("-q", "--quiet"), ("-v", "--verbose"), ("--json",)}
    for name, command in commands().items():
        spelt = {tuple(option.option_strings) for option in command._actions}
        assert shared <= spelt, name
        assert ("-o", "--out") in spelt or name in ("doctor", "explore")


def test_an_option_means_the_same_in_every_command():
    """One spelling, one unit: angles are degrees, and no option has its unit in its name."""
    units: dict[str, set[object]] = {}
    for _, option in options_of_commands():
        for name in option.option_strings:
            units.setdefault(name, set()).add(option.metavar)
            assert not name.endswith(("-deg", "-s", "-m")), name
    several = {name: found for name, found in units.items() if len(found) > 1}
    # Switches of calibrate are values in simulate; the models of a stack are not a fixed list.
    assert set(several) == {"-o", "--out", "--range-offset", "--sigma-slope", "--model"}


def test_switches_are_spelt_alike():
    for command, option in options_of_commands():
        if option.choices is not None and "auto" in option.choices:
            assert tuple(option.choices) == ("auto", "on", "off"), command


@pytest.mark.parametrize("command", [*ALL, "fleet"])
def test_the_examples_of_a_command_are_ones(command, capsys):
    assert main([*command.split(), "--help"]) == 0
    lines = re.findall(r"^  (beamfield .*)$", capsys.readouterr().out, re.M)
    assert 2 <= len(lines) <= 3
    for line in lines:
        build_parser().parse_args(shlex.split(line)[1:])


def test_help_and_the_list_of_figures_load_no_numerical_library():
    """They answer at once."""
    for words in (["--help"], ["check", "--help"], ["figures", "--list"]):
        code = f"import sys; from beamfield.cli.main import main; main({words}); print('numpy' in sys.modules)"
        run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert run.stdout.splitlines()[-1] == "False", words


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["calibrat", "run.log"], "no command 'calibrat'; did you mean calibrate? See beamfield --help"),
        (["check", "run.log", "--mpa", "m.yaml"], "no option --mpa; did you mean --map? See beamfield check --help"),
        (["check", "run.log"], "missing: --map. See beamfield check --help"),
        (["check", "run.log", "--map", "m", "--max-range", "abc"], "--max-range: expected a number > 0, got 'abc'."),
        (["map", "run.log", "--hit", "abc"], "--hit: expected a number, got 'abc'."),
        (["map", "run.log", "--mode", "rwa"], "--mode: expected one of trinary, raw, got 'rwa'; did you mean raw?"),
        (
            ["trajectory", "run.log", "--map", "m", "--start", "nan", "0", "0"],
            "--start: expected a finite number, got 'nan'.",
        ),
        (
            ["localize", "run.log", "--map", "m", "--start", "0", "0", "inf"],
            "--start: expected a finite number, got 'inf'.",
        ),
        (["map", "run.log", "--mount", "a", "0", "0"], "--mount: expected a finite number, got 'a'."),
        (["map", "run.log", "--mount", "1", "2"], "--mount: expected 3 arguments."),
        (
            ["map", "run.log", "--mount", "1", "2", "361"],
            "--mount: expected an angle of at most 360 degrees, got 361.",
        ),
        (
            ["check", "run.log", "--map", "m", "--start", "1", "2", "-400"],
            "--start: expected an angle of at most 360 degrees, got -400.",
        ),
        (
            ["check", "run.log", "--map", "m", "--find-rate", "1/0"],
            "--find-rate: expected a number > 0 or a fraction such as 1/600, got '1/0'.",
        ),
        (["simulate", "--out", ""], "-o/--out: expected a name, got ''."),
        (["inspect", ""], "LOG|MAP|POSES: expected a name, got ''."),
        (["map", "run.log", "map.yaml"], "not understood: map.yaml."),
        (["--json", "map", "run.log"], "--json: options go after the command. See beamfield --help"),
        (["-q", "map", "run.log"], "-q: options go after the command. See beamfield --help"),
        (["fleet", "--out", "x", "scan", "."], "--out: options go after the command. See beamfield fleet --help"),
        (
            ["map", "s3://key:secret@store/run.log"],
            "LOG: expected a path on this machine, got the address 's3://store/run.log'",
        ),
        (
            ["map", "run.log", "--out", "s3://store/map.yaml"],
            "-o/--out: expected a path on this machine, got the address",
        ),
        (["figures", "--out", "s3://store/pictures"], "-o/--out: expected a path on this machine, got the address"),
        (
            ["localize", "run.log", "--map", "m", "-o", "x.tum"],
            "-o/--out: expected a folder to write files into, got 'x.tum'",
        ),
        (["map", "run.log", "--no-return", "foo"], "--no-return: expected detect, none or numbers, got 'foo'."),
        (["map", "run.log", "--opening-angle", "180"], "--opening-angle: expected an angle below 180 degrees, got"),
    ],
)
def test_wrong_usage_is_one_line_with_the_reason_first(words, message, capsys):
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"beamfield: error: {message}")
    assert error.count("\n") == 1


def test_a_rate_may_be_typed_as_its_default_is_stated():
    given = build_parser().parse_args(["check", "run.log", "--map", "m", "--find-rate", "1/60", "--lose-rate", "0.01"])
    assert (given.find_rate, given.lose_rate) == (1.0 / 60.0, 0.01)


def test_a_value_may_begin_with_a_minus():
    apart = "map run.log --mask -5:5 --hit -1e-3 --mount -1e-3 -2 -.5"
    assert build_parser().parse_args(apart.split()).mount == [-1e-3, -2.0, -0.5]
