"""A command does its work where nobody reads what it says."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator

import pytest

COMMAND = """
import sys
from beamfield.cli import main, precompute
from beamfield.cli.outcome import Outcome
from beamfield.cli.terminal import complain

def run(arguments):
    complain("working ...")
    open("result", "w").write("done")
    return Outcome("wrote result", code=3, problem="not converged")

precompute.run = run
sys.argv = "beamfield precompute map.yaml --max-range 5".split()
sys.exit(main.main())
"""


@pytest.fixture
def without_reader() -> Iterator[int]:
    """A pipe whose reader has gone."""
    reader, writer = os.pipe()
    os.close(reader)
    yield writer
    os.close(writer)


@pytest.mark.parametrize("lost", ["stdout", "stderr"])
def test_a_reader_that_has_gone_changes_neither_the_work_nor_the_exit_code(tmp_path, without_reader, lost):
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, lost: without_reader}
    done = subprocess.run([sys.executable, "-c", COMMAND], cwd=tmp_path, text=True, **streams)
    assert done.returncode == 3
    assert (tmp_path / "result").read_text() == "done"
    assert done.stdout in (None, "wrote result\n")
    assert done.stderr in (None, "working ...\n")


@pytest.mark.parametrize("closed", [">&-", "2>&-"])
def test_streams_that_are_closed_are_no_error(tmp_path, closed):
    python = 'exec "$0" -c "$1"'
    done = subprocess.run(
        ["sh", "-c", f"{python} {closed}", sys.executable, COMMAND], cwd=tmp_path, capture_output=True
    )
    assert done.returncode == 3
    assert (tmp_path / "result").read_text() == "done"
    assert b"working" not in done.stdout
