"""A few seconds of what ``make kills`` does for all commands: kill -9, full disks, no rights, two runs at once."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.skipif(sys.platform == "win32", reason="forks and limits of processes are POSIX's")
def test_kills_and_full_disks_leave_old_files_or_new_ones_and_nothing_else():
    # In a process without threads, as it forks.
    command = [sys.executable, "-m", "tests.faults", "--quick"]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "| killed | 6 |" in done.stdout
    assert "| faults | 0 |" in done.stdout
