"""What came of one input, and whether that is allowed."""

from __future__ import annotations

import gc
import json
import shutil
import time
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beamfield.errors import (
    FormatError,
    InvalidInputError,
    MissingDependencyError,
    TooLittleDataError,
)
from tests.fuzz.case import Case
from tests.fuzz.memory import PeakMemory
from tests.fuzz.target import Target

DOCUMENTED = (FormatError, InvalidInputError, MissingDependencyError, TooLittleDataError)
MAX_SECONDS = 1.0
MAX_BYTES = 512 * 2**20


@dataclass(frozen=True)
class Outcome:
    """What came of one input.

    Parameters
    ----------
    kind
        "ok", "refused" (a documented error), "system" (the file system speaking); else the fault: "exception",
        "result", "message", "warning", "slow", "memory", "leftover".
    text
        What happened, for people; the traceback if there is one.
    place
        Where in the code it ended; the same for inputs that take the same way.
    seconds
        CPU time.
    n_bytes
        How far memory grew while it was read, as far as it is known.
    """

    kind: str
    text: str
    place: str
    seconds: float
    n_bytes: int

    @property
    def is_fault(self) -> bool:
        return self.kind not in ("ok", "refused", "system")


def observe(target: Target, case: Case, folder: Path, memory: PeakMemory | None = None) -> Outcome:
    """Read one input and judge what comes of it.

    Parameters
    ----------
    target
        The reader.
    case
        The input.
    folder
        Where its files are written; whatever is in it is removed.
    memory
        Measures how far memory grows; None leaves that out.
    """
    entry = case.write(folder)
    first = _read(target, entry, memory)
    if first.kind == "slow":
        # A busy machine or a first compilation is no fault of the reader: only what is slow twice is slow.
        gc.collect()
        again = _read(target, case.write(folder), memory)
        first = again if again.seconds < first.seconds else first
    if first.is_fault:
        return first
    left = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    expected = sorted(case.files)
    if left != expected and not target.writes:
        return Outcome("leftover", f"files after reading: {left}, before: {expected}", "", first.seconds, first.n_bytes)
    return first


def keep(fault: Outcome, target: str, case: Case, faults: Path, origin: str) -> Path:
    """Write a faulty input into a folder of its own, and return it."""
    number = 0
    while (folder := faults / f"{target}-{fault.kind}-{number}").exists():
        number += 1
    case.write(folder / "case")
    document = {
        "target": target, "entry": case.entry, "kind": fault.kind, "text": fault.text, "place": fault.place,
        "seconds": fault.seconds, "n_bytes": fault.n_bytes, "origin": origin,
    }  # fmt: skip
    (folder / "fault.json").write_text(json.dumps(document, indent=2) + "\n")
    return folder


def keep_folder(kind: str, text: str, target: str, entry: str, cases: Path, faults: Path, origin: str) -> Path | None:
    """Keep the input that a worker was reading when it ended; None if it has left none."""
    if not cases.is_dir() or not any(cases.iterdir()):
        return None
    case = Case.read(cases, entry)
    kept = keep(Outcome(kind, text, "", float("nan"), 0), target, case, faults, origin)
    shutil.rmtree(cases)
    return kept


def _read(target: Target, entry: Path, memory: PeakMemory | None) -> Outcome:
    before = memory.start() if memory is not None else 0
    start = time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        kind, text, place, result = _attempt(target, entry)
    seconds = time.process_time() - start
    grown = memory.peak() - before if memory is not None else 0
    if kind == "ok":
        kind, text, place = _checked(target, result)
    if kind in ("ok", "refused", "system"):
        if caught:
            found = caught[0]
            kind, place = "warning", f"{Path(found.filename).name}:{found.lineno}"
            text = f"{found.category.__name__}: {found.message} ({found.filename}:{found.lineno})"
        elif seconds > MAX_SECONDS:
            kind, text = "slow", f"{seconds:.2f} s of CPU time; {text}"
        elif grown > MAX_BYTES:
            kind, text = "memory", f"{grown / 2**20:.0f} MB; {text}"
    return Outcome(kind, text, place, seconds, grown)


def _attempt(target: Target, entry: Path) -> tuple[str, str, str, Any]:
    try:
        return "ok", "", "", target.read(entry)
    except DOCUMENTED as error:
        place = _place(error)
        text = str(error)
        if not text.replace(str(entry.parent), "").isprintable():
            return "message", f"{type(error).__name__} whose text is more than one line of print: {text!r}", place, None
        return "refused", f"{type(error).__name__}: {text}", place, None
    except OSError as error:
        if error.errno is not None and error.filename is not None:
            return "system", str(error), _place(error), None
        return "exception", traceback.format_exc(), _place(error), None
    except MemoryError as error:
        return "memory", traceback.format_exc(), _place(error), None
    except Exception as error:
        return "exception", traceback.format_exc(), _place(error), None


def _checked(target: Target, result: Any) -> tuple[str, str, str]:
    try:
        target.check(result)
    except AssertionError as error:
        return "result", traceback.format_exc(), _place(error)
    return "ok", "", ""


def _place(error: BaseException) -> str:
    """Return file and line where an error, and what it came from, was raised."""
    steps = []
    cause: BaseException | None = error
    while cause is not None:
        step = cause.__traceback__
        while step is not None and step.tb_next is not None:
            step = step.tb_next
        if step is not None:
            steps.append(f"{step.tb_frame.f_code.co_filename.rsplit('/', 1)[-1]}:{step.tb_lineno}")
        cause = cause.__cause__ or (None if cause.__suppress_context__ else cause.__context__)
    return " < ".join(steps[:3])
