"""Runs of a replay, kept on disk while it lasts: one that was interrupted goes on where it was."""

from __future__ import annotations

import hashlib
import json
import pickle
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import beamfield
from beamfield.io.files.atomic import write_file
from beamfield.localization.replay import ReplayErrors
from beamfield.localization.replay_comparison import ReplayTrials

# Seconds between two writes: a kill loses the runs since the last one, Ctrl-C none.
EVERY_S = 2.0
# Nobody comes back to an interrupted replay after so long.
OLD_S = 30 * 86400.0


class KeptRuns:
    """Runs by what tells them apart, in a file, or in memory alone where there is none or it cannot be written."""

    def __init__(self, path: Path | None = None) -> None:
        self._path, self._written = path, time.monotonic()
        self._runs: dict[str, Any] = {}
        if path is not None:
            with suppress(OSError, ValueError):
                self._runs = json.loads(path.read_bytes())

    def find(self, key: tuple[object, ...]) -> ReplayTrials | None:
        """Return the runs of a key, if they are there."""
        kept = self._runs.get(repr(key))
        if kept is None:
            return None
        return ReplayTrials(kept["log"], tuple(kept["seeds"]), tuple(ReplayErrors(**one) for one in kept["errors"]))

    def keep(self, key: tuple[object, ...], trials: ReplayTrials) -> None:
        """Take in the runs of a key."""
        self._runs[repr(key)] = asdict(trials)
        if time.monotonic() - self._written > EVERY_S:
            self.write()

    def write(self) -> None:
        """Write all runs, if there is a file and it can be written: no result depends on it."""
        if self._path is not None and self._runs:
            with suppress(OSError):
                write_file(self._path, json.dumps(self._runs))
        self._written = time.monotonic()


@contextmanager
def kept_runs(folder: Path, inputs: object) -> Iterator[KeptRuns]:
    """Find in a folder what an interrupted replay kept, and remove it when this one is done.

    What the runs depend on, the content of `inputs` and beamfield's own files, is the file's name.
    """
    path = folder / f"replay_{_digest(inputs)}.json"
    runs = KeptRuns(path)
    try:
        yield runs
    except BaseException:
        runs.write()
        raise
    with suppress(OSError):
        path.unlink(missing_ok=True)
        for left in folder.glob("replay_*.json"):
            if time.time() - left.stat().st_mtime > OLD_S:
                left.unlink()


def _digest(inputs: object) -> str:
    files = sorted(Path(beamfield.__file__).parent.rglob("*.py"))
    program = [(str(file), file.stat().st_mtime_ns, file.stat().st_size) for file in files]
    return hashlib.sha256(pickle.dumps((program, inputs))).hexdigest()
