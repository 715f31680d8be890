"""Stamps of the scans of a text log: which column is usable, and what to do where none is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import require
from beamfield.errors import FormatError
from beamfield.geometry import FloatArray

StampRule = Literal["file", "order"]

# Of the Intel log's 909 steps 4 go back, by 0.05 to 0.86 s; its heading shows that the order of the file is right.
MAX_BACKWARD_STEP = 1.0
MAX_BACKWARD_SHARE = 0.01
# No time is longer, in nanoseconds since 1970 either.
LONGEST = 1e19
# Scans that are further apart come from no drive, but may have stamps in another unit.
SLOW = 60.0


@dataclass(frozen=True, eq=False)
class ScanStamps:
    """Stamps (t,) in seconds, not decreasing, and what was done about them.

    `column` is the column of the file that they come from; None if they count the scans.
    """

    seconds: FloatArray
    column: int | None
    notes: tuple[str, ...] = ()


def resolve_stamps(
    path: str | Path,
    name: str,
    lines: list[int],
    columns: ArrayLike,
    rule: StampRule = "file",
    repeated: NDArray[np.bool_] | None = None,
) -> ScanStamps:
    """Return stamps that do not decrease, from the first usable column of a file.

    A column is usable if its stamps are finite, at least half of them differ from the one before (public logs exist
    whose stamps were rounded until they are all equal), and they run forwards. Single steps back, at most 1% of all and
    none longer than 1 s, pass: clocks of two computers differ. There the scans stay in the order of the file and the
    stamp that is too early is raised to the one before it. In the Intel log, where this occurs, the heading turns
    steadily in the order of the file and jumps back and forth in the order of the stamps.

    If no column is usable because the stamps are lost, scans are numbered, one second apart; so they are by the rule
    "order". If they run backwards otherwise, that is an error, because two runs may have been joined or a clock was
    set; so is a single one that is no number.

    Columns (t, c) are in seconds and in order of preference. Repeated scans (t,) are the one before once more, stamps
    and readings: that their stamps are equal says nothing. Path, name and the line of each scan are for errors and
    notes.
    """
    require(rule in ("file", "order"), "stamps", "'file' or 'order'", rule)
    table = np.asarray(columns, dtype=np.float64)
    numbered = np.arange(len(table), dtype=np.float64)
    if rule == "order":
        return ScanStamps(numbered, None, (f"{name}: scans are numbered, one second apart, as requested",))
    distinct = table if repeated is None else table[~repeated]
    kept = [c for c in range(table.shape[1]) if not _is_lost(distinct[:, c])]
    if not kept:
        different = len(np.unique(table[:, 0]))
        note = (
            f"{name}: the stamps are lost ({different} different values in {len(table)} scans); scans are numbered "
            "instead, one second apart, so times and rates are meaningless"
        )
        return ScanStamps(numbered, None, (note,))
    for column in kept:
        if _are_usable(table[:, column]):
            notes = _notes(table[:, column], column, repeated)
            return ScanStamps(
                np.maximum.accumulate(table[:, column]), column, tuple(f"{name}: {note}" for note in notes)
            )
    raise _refused(path, name, lines, table[:, kept[0]])


def _are_usable(stamps: FloatArray) -> bool:
    """Return whether all are times, and hardly any of them go back."""
    if not _are_times(stamps).all():
        return False
    behind = np.maximum.accumulate(stamps) - stamps
    n_back = np.count_nonzero(np.diff(stamps) < 0.0)
    return bool(behind.max() <= MAX_BACKWARD_STEP and n_back <= MAX_BACKWARD_SHARE * len(stamps))


def _notes(stamps: FloatArray, column: int, repeated: NDArray[np.bool_] | None) -> Iterator[str]:
    """Say what is unusual about stamps that are used."""
    if column:
        yield f"stamps are those of column {column + 1}, the first is not usable"
    if repeated is not None and repeated.any():
        yield f"{repeated.sum()} of {len(stamps)} scans repeat the one before, stamp and readings"
    steps = np.diff(stamps)
    if n_back := int(np.count_nonzero(steps < 0.0)):
        behind = (np.maximum.accumulate(stamps) - stamps).max()
        yield (
            f"{n_back} of {len(stamps)} stamps go backwards, by up to {behind:.3g} s; scans stay in the order of the "
            "file, and those stamps are raised to the one before"
        )
    if len(steps) and (rate := float(np.median(steps))) > SLOW:
        yield (
            f"scans are {rate:.3g} s apart: are the stamps in milliseconds or nanoseconds? Divide them, or read with "
            "stamps='order'"
        )


def _refused(path: str | Path, name: str, lines: list[int], stamps: FloatArray) -> FormatError:
    if not (known := _are_times(stamps)).all():
        bad = int(np.argmin(known))
        text = f"expected a stamp in seconds, got {stamps[bad]:g}; mend or remove the line, or read with stamps='order'"
        return FormatError(path, text, line=lines[bad], field=name)
    steps = np.diff(stamps)
    worst = int(np.argmin(steps))
    return FormatError(
        path,
        f"the stamps run backwards: {stamps[worst + 1]:.6f} s after {stamps[worst]:.6f} s "
        f"({np.count_nonzero(steps < 0.0)} steps back in {len(stamps)} scans); read with stamps='order' if the order "
        "of the file is right",
        line=lines[worst + 1],
        field=name,
    )


def _is_lost(stamps: FloatArray) -> bool:
    """Whether most scans have the stamp of the scan before, or one that is not a number."""
    if np.count_nonzero(_are_times(stamps)) <= len(stamps) / 2:
        return True
    return len(stamps) > 1 and bool(np.count_nonzero(np.diff(stamps) == 0.0) >= len(stamps) / 2)


def _are_times(stamps: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(np.abs(stamps) < LONGEST)
