"""Ctrl-C ends a command, wherever it comes."""

from __future__ import annotations

import subprocess
import sys

# The compiler's objects have destructors, in which Python prints an exception and goes on.
IN_A_DESTRUCTOR = """
import sys
from beamfield.cli import main, precompute

class Held:
    def __del__(self):
        raise KeyboardInterrupt

def run(arguments):
    Held()
    for _ in range(10**8):
        pass

precompute.run = run
sys.argv = "beamfield precompute map.yaml --max-range 5".split()
sys.exit(main.main())
"""


def test_an_interrupt_in_a_destructor_is_not_lost():
    done = subprocess.run([sys.executable, "-c", IN_A_DESTRUCTOR], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "beamfield: error: interrupted\n")
