"""What --help says: the same formats in every command, and all that are read."""

from __future__ import annotations

import argparse
import inspect
import math
import re

import pytest

from beamfield.calibration.cross_fit import build_cross_fit_maps
from beamfield.calibration.selection import SelectionOptions
from beamfield.calibration.time_split import LONGEST_BLOCK_S
from beamfield.cli.formats import LOG_FORMATS, MAP_FORMATS
from beamfield.cli.main import build_parser, main
from beamfield.io.read_log import SUPPORTED


def help_of(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the help of a command on one line."""
    with pytest.raises(SystemExit) as end:
        main([command, "--help"])
    assert end.value.code == 0
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize("command", ["calibrate", "fit", "doctor", "inspect", "map", "likelihood", "figures"])
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


def options_of_commands() -> list[tuple[str, argparse.Action]]:
    """Return (command, option) for every option of every command."""
    commands = next(action for action in build_parser()._actions if isinstance(action, argparse._SubParsersAction))
    return [(name, option) for name, command in commands.choices.items() for option in command._actions]


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
        if command == "calibrate" and set(option.option_strings) & {"--min-travel", "--min-turn-deg", "--block",
                                                                    "--max-turn-rate-deg", "--resolution"}
    }  # fmt: skip
    library = SelectionOptions()
    assert stated["--min-travel"] == library.min_travel
    assert stated["--min-turn-deg"] == pytest.approx(math.degrees(library.min_turn), abs=0.005)
    assert stated["--max-turn-rate-deg"] == pytest.approx(math.degrees(library.max_turn_rate), abs=0.5)
    assert stated["--block"] == LONGEST_BLOCK_S
    assert stated["--resolution"] == inspect.signature(build_cross_fit_maps).parameters["resolution"].default


def test_units_are_explained(capsys):
    assert "DEG for degrees" in help_of("calibrate", capsys)


def test_one_sensor_is_not_called_repeatable(capsys):
    assert "repeatable" in help_of("inspect", capsys)
    assert "scan topic or sensor (default" in help_of("fit", capsys)


@pytest.mark.parametrize("command", ["fit", "likelihood"])
def test_a_beam_model_file_has_the_same_option_everywhere(command, capsys):
    assert "--params FILE, --parameters FILE" in help_of(command, capsys)
