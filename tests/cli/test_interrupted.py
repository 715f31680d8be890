"""Ctrl-C and SIGTERM end a command in order, wherever they come."""

from __future__ import annotations

import subprocess
import sys

import pytest

from beamfield.cli.main import main

# The compiler's objects have destructors, in which Python prints an exception and goes on.
IN_A_DESTRUCTOR = """
class Held:
    def __del__(self):
        raise KeyboardInterrupt
Held()
"""
SIGTERM = "os.kill(os.getpid(), signal.SIGTERM)"
COMMAND = """
import os, signal, sys
from beamfield.cli import main, precompute

def run(arguments):
    exec(how)
    for _ in range(10**8):
        pass

precompute.run = run
how, sys.argv = sys.argv[1], "beamfield precompute map.yaml --max-range 5".split()
sys.exit(main.main())
"""


def test_ctrl_c_before_the_command_begins_is_no_traceback(monkeypatch, capsys):
    def interrupt():
        raise KeyboardInterrupt

    monkeypatch.setattr("beamfield.cli.main.build_parser", interrupt)
    assert main(["inspect", "run.log"]) == 130
    assert capsys.readouterr().err == "beamfield: error: interrupted\n"


@pytest.mark.parametrize("how", [IN_A_DESTRUCTOR, SIGTERM])
def test_a_command_is_interrupted(how):
    done = subprocess.run([sys.executable, "-c", COMMAND, how], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "beamfield: error: interrupted\n")
