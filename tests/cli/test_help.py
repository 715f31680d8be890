"""What --help says: the same formats in every command, and all that are read."""

from __future__ import annotations

import re

import pytest

from beamfield.cli.formats import LOG_FORMATS, MAP_FORMATS
from beamfield.cli.main import main
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
