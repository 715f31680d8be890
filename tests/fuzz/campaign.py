"""Long runs: worker processes, watched, and a table of what came of their inputs."""

from __future__ import annotations

import multiprocessing
import os
import shutil
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.process import BaseProcess
from pathlib import Path

from tests.fuzz.outcome import keep_folder
from tests.fuzz.worker import Batch, Task, work

_TICKS = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


@dataclass
class Row:
    """What came of all inputs of one target."""

    inputs: int = 0
    ok: int = 0
    documented: int = 0
    slowest: float = 0.0
    largest: int = 0
    cpu: float = 0.0
    faults: int = 0

    def add(self, batch: Batch) -> None:
        counts = batch.counts
        self.inputs += sum(counts.values())
        self.ok += counts["ok"]
        self.documented += counts["refused"] + counts["system"]
        self.slowest = max(self.slowest, batch.slowest)
        self.largest = max(self.largest, batch.largest)
        self.cpu += batch.cpu
        self.faults += len(batch.faults)


@dataclass
class Report:
    """The rows of all targets, and the faults by what and where: a text and a folder each, and how often."""

    rows: dict[str, Row] = field(default_factory=dict)
    faults: dict[str, tuple[str, str, int]] = field(default_factory=dict)

    def add(self, batch: Batch) -> None:
        self.rows.setdefault(batch.target, Row()).add(batch)
        for place, text, kept in batch.faults:
            self.add_fault(f"{batch.target}: {place}", text, kept)

    def add_fault(self, place: str, text: str, kept: str) -> None:
        first, folder, n = self.faults.get(place, (text, kept, 0))
        self.faults[place] = (first, folder or kept, n + 1)

    def text(self) -> str:
        names = f"{'inputs':>10}{'ok':>9}{'refused':>10}{'slowest s':>11}{'largest MB':>12}{'CPU s':>8}{'faults':>8}"
        lines = [f"{'target':<18}{names}"]
        total = Row()
        for name, row in self.rows.items():
            lines.append(_line(name, row))
            for item in ("inputs", "ok", "documented", "cpu", "faults"):
                setattr(total, item, getattr(total, item) + getattr(row, item))
            total.slowest, total.largest = max(total.slowest, row.slowest), max(total.largest, row.largest)
        lines.append(_line("all", total))
        for place, (text, kept, n) in self.faults.items():
            lines.append(f"{n} x {place}: {text}" + (f"\n    {kept}" if kept else ""))
        return "\n".join(lines)


Look = Callable[[Report], bool]


@dataclass(frozen=True)
class Limits:
    """Seconds of CPU and of the clock after which an input counts as one that never ends."""

    cpu: float = 10.0
    clock: float = 180.0


class Worker:
    """A worker process and what is known of it from outside; one that hangs or dies is replaced."""

    def __init__(self, task: Task, limits: Limits) -> None:
        self._task, self._limits = task, limits
        self._starts = 0
        self._spawn()

    def _spawn(self) -> None:
        context = multiprocessing.get_context("spawn")
        memory_disk = Path("/dev/shm")
        self._folder = Path(
            tempfile.mkdtemp(prefix="beamfield-fuzz-", dir=memory_disk if memory_disk.is_dir() else None)
        )
        self._connection, theirs = context.Pipe()
        self._started = context.Value("d", 0.0, lock=False)
        task = self._task if self._starts == 0 else replace(self._task, seed=f"{self._task.seed}.{self._starts}")
        self._starts += 1
        self._process: BaseProcess = context.Process(
            target=work, args=(theirs, self._started, task, self._folder), daemon=True
        )
        self._process.start()
        theirs.close()
        self._target = task.names[0]
        self._last: tuple[float, float] = (-1.0, time.monotonic())

    def receive(self) -> Batch | None:
        """Return a batch if one is there."""
        with suppress(EOFError, ConnectionResetError):
            while self._connection.poll(0.0):
                message = self._connection.recv()
                if isinstance(message, Batch):
                    return message
                self._target = message
        return None

    def check(self, report: Report) -> None:
        """Report and replace a worker that hangs or has died."""
        begun = float(self._started.value)
        if begun != self._last[0]:
            self._last = begun, time.monotonic()
        if not self._process.is_alive():
            self._replace(report, "crash", f"the process ended with code {self._process.exitcode}")
        elif begun and _cpu_seconds(self._process.pid) - begun > self._limits.cpu:
            self._replace(report, "hang", f"more than {self._limits.cpu:g} s of CPU time")
        elif time.monotonic() - self._last[1] > self._limits.clock:
            self._replace(report, "hang", f"more than {self._limits.clock:g} s by the clock")

    def stop(self) -> None:
        self._process.kill()
        self._process.join()
        self._connection.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    def _replace(self, report: Report, kind: str, text: str) -> None:
        self._process.kill()
        self._process.join()
        folder = self._folder / "case"
        by_name = {target.name: target for target in self._task.targets()}
        entries = [case.entry for case in by_name[self._target].seeds()]
        entry = next((entry for entry in entries if (folder / entry).is_file()), ".")
        origin = f"seed {self._task.seed}, start {self._starts}"
        kept = keep_folder(kind, text, self._target, entry, folder, self._task.faults, origin)
        report.add_fault(f"{self._target}: {kind}", text, str(kept or ""))
        report.rows.setdefault(self._target, Row()).faults += 1
        # The others come first now, lest a reader that fails at once keeps them from their turn.
        place = self._task.names.index(self._target) + 1
        self._task = replace(self._task, names=self._task.names[place:] + self._task.names[:place])
        self.stop()
        self._spawn()


def run(task: Task, *, minutes: float, processes: int, limits: Limits = Limits(), look: Look | None = None) -> Report:
    """Fuzz for a time by the clock, with some processes side by side, and return what came of it.

    Each process has a seed of its own, which follows from the task's. `look` sees the report now and then, and may end
    the run before its time by returning True.
    """
    task.faults.mkdir(parents=True, exist_ok=True)
    report = Report({name: Row() for name in task.names})
    end = time.monotonic() + 60.0 * minutes
    workers = [Worker(replace(task, seed=f"{task.seed}-{i}"), limits) for i in range(processes)]
    try:
        while time.monotonic() < end:
            for worker in workers:
                while (batch := worker.receive()) is not None:
                    report.add(batch)
                worker.check(report)
            if look is not None and look(report):
                break
            time.sleep(0.05)
    except KeyboardInterrupt:
        pass  # what was found until then is worth a table
    finally:
        for worker in workers:
            worker.stop()
    return report


def _line(name: str, row: Row) -> str:
    return (
        f"{name:<18}{row.inputs:>10,}{row.ok:>9,}{row.documented:>10,}{row.slowest:>11.3f}{row.largest / 2**20:>12.1f}"
        f"{row.cpu:>8.0f}{row.faults:>8,}"
    )


def _cpu_seconds(pid: int | None) -> float:
    """Return the CPU time that a process has used, 0 where the system does not say."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except (OSError, IndexError):
        return 0.0
    return (int(fields[11]) + int(fields[12])) / _TICKS
