"""Run a command in a process of its own that can be killed, limited, or run as somebody else."""

from __future__ import annotations

import ctypes
import importlib
import os
import pkgutil
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable

import scipy.optimize  # noqa: F401

import beamfield
from beamfield.cli.main import main

# Once, before the processes part: a killed run should die at its work and not while it loads.
for _module in pkgutil.walk_packages(beamfield.__path__, "beamfield."):
    if not _module.name.endswith(("__main__", "cuda")):
        importlib.import_module(_module.name)

NOBODY = 65_534


class Run:
    """A running command.

    Parameters
    ----------
    words
        What is typed.
    before
        What the process does first.
    """

    def __init__(self, words: list[str], before: Callable[[], object] = lambda: None) -> None:
        self._code: int | None = None
        self.pid, self._errors = _start(words, before)

    def ended(self) -> bool:
        if self._code is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self._code = os.waitstatus_to_exitcode(status)
        return self._code is not None

    def said(self) -> str:
        """Return what it has written on stderr, once it has ended."""
        text = b""
        while block := os.read(self._errors, 65_536):
            text += block
        os.close(self._errors)
        return text.decode()

    def wait(self) -> int:
        """Return the exit code; a run that takes longer than ten minutes is killed, and its code is negative."""
        end = time.monotonic() + 600.0
        while not self.ended():
            if time.monotonic() > end:
                return self.kill()
            time.sleep(0.002)
        assert self._code is not None
        return self._code

    def kill(self) -> int:
        """Kill it if it still runs, and return its exit code: negative if that ended it."""
        if not self.ended():
            os.kill(self.pid, signal.SIGKILL)
            _, status = os.waitpid(self.pid, 0)
            self._code = os.waitstatus_to_exitcode(status)
        assert self._code is not None
        return self._code


def _start(words: list[str], before: Callable[[], object]) -> tuple[int, int]:
    """Return the process, and the pipe of its stderr."""
    reading, writing = os.pipe()
    pid = os.fork()
    if pid:
        os.close(writing)
        return pid, reading
    code = 70
    try:
        nowhere = os.open(os.devnull, os.O_RDWR)
        for stream, target in ((0, nowhere), (1, nowhere), (2, writing)):
            os.dup2(target, stream)
        # The parent's objects believe that they stand for other kinds of files.
        sys.stdout, sys.stderr = (os.fdopen(stream, "w", closefd=False) for stream in (1, 2))
        before()
        code = main(words)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)


def limit_files(n_bytes: int) -> Callable[[], object]:
    """Let no file grow beyond this: writing fails as on a full disk. Python ignores the signal that comes with it."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, n_bytes))


def lose_the_rights_of_root() -> None:
    """Give up what lets root write everywhere (capset(2)); files of root stay readable, among them the libraries."""
    libc = ctypes.CDLL(None, use_errno=True)
    head = (ctypes.c_uint32 * 2)(0x20080522, 0)
    sets = (ctypes.c_uint32 * 6)()
    if libc.capget(head, sets):
        raise OSError(ctypes.get_errno(), "capget")
    sets[0] &= ~0b1111  # effective: chown, dac_override, dac_read_search, fowner
    if libc.capset(head, sets):
        raise OSError(ctypes.get_errno(), "capset")
