"""What the shell offers at the tab key, as argcomplete asks for it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("argcomplete")


def offered(line: str, folder: Path) -> list[str]:
    """Return the words that are offered at the end of a line."""
    out = folder / "offered"
    asked = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(out),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
        "COMP_TYPE": "9",
    }
    subprocess.run([sys.executable, "-m", "beamfield"], env={**os.environ, **asked}, check=True, timeout=60)
    return [word.strip() for word in out.read_text().splitlines()]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("beamfield cal", ["calibrate", "calibrate-landmarks"]),
        ("beamfield fi", ["figures"]),
        ("beamfield map run.log --lon", ["--lone-poses", "--longest-hit"]),
        ("beamfield precompute map.yaml --max", ["--max-range", "--max-size"]),
        ("beamfield map run.log --mode ", ["trinary", "raw"]),
    ],
)
def test_commands_options_and_values_are_offered(line, words, tmp_path):
    assert offered(line, tmp_path) == words
