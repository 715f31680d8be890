"""Progress on stderr while a command works."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import TYPE_CHECKING, NoReturn

from beamfield.cli.terminal import complain

if TYPE_CHECKING:
    from tqdm import tqdm

# Seconds between two looks at the clock: a stage that has nothing to count shows that the program is alive.
TICK_S = 0.5
# A stage that has not counted anything for so many seconds says what it may be waiting for.
PATIENCE_S = 4.0
PATIENCE = "the first run after an installation compiles here"
COUNTED = "{desc}: {percentage:3.0f}%|{bar}| {n_fmt}/{total_fmt} [{elapsed}<{remaining}]"
TIMED = "{desc} ... {elapsed}"


class StageProgress:
    """Show named stages one after the other: bars on a terminal, one line per stage elsewhere.

    Call it with (stage, done, total); use it as a context manager so that the last bar is closed.

    Parameters
    ----------
    quiet
        Show nothing.
    verbose
        One numbered line per stage, and how long it took.
    """

    def __init__(self, *, quiet: bool = False, verbose: bool = False) -> None:
        self._quiet = quiet
        self._verbose = verbose
        self._number = 0
        self._stage = ""
        self._since = 0.0
        self._bar: tqdm[NoReturn] | None = None
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._clock: threading.Thread | None = None

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show that `done` of `total` units of a stage are done."""
        if self._quiet:
            return
        with self._lock:
            if stage != self._stage:
                self._begin(stage, total)
            if self._bar is not None:
                if done > 0:
                    self._bar.set_description_str(stage, refresh=False)
                self._bar.total = total
                self._bar.update(done - self._bar.n)

    def __enter__(self) -> StageProgress:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the current stage."""
        self._ended.set()
        if self._clock is not None:
            self._clock.join()
            self._clock = None
        with self._lock:
            self._end()

    def _begin(self, stage: str, total: int) -> None:
        self._end()
        self._stage, self._since = stage, time.monotonic()
        self._number += 1
        if self._verbose or not sys.stderr.isatty():
            complain(f"{self._number}. {stage} ..." if self._verbose else f"{stage} ...")
            return
        # Imported where a bar is drawn: it takes a fifth of the time of --help.
        from tqdm import tqdm

        self._bar = tqdm(
            total=total, desc=stage, leave=False, file=sys.stderr, bar_format=TIMED if total <= 1 else COUNTED
        )
        if self._clock is None:
            self._ended.clear()
            self._clock = threading.Thread(target=self._tick, name="progress", daemon=True)
            self._clock.start()

    def _end(self) -> None:
        if self._verbose and self._stage:
            complain(f"{self._number}. took {time.monotonic() - self._since:.1f} s")
        if self._bar is not None:
            self._bar.close()
            self._bar = None
        self._stage = ""

    def _tick(self) -> None:
        """Keep the elapsed time of the bar going."""
        while not self._ended.wait(TICK_S):
            with self._lock:
                if self._bar is None:
                    continue
                if self._bar.n == 0 and time.monotonic() - self._since > PATIENCE_S:
                    self._bar.set_description_str(f"{self._stage} ({PATIENCE})", refresh=False)
                self._bar.refresh()
