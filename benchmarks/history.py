"""Ratios of `make bench` by commit, in history.json: ``python benchmarks/history.py`` says which have fallen.

Every ratio is larger the better: a baseline's time over ours, or the limit's. An entry is compared with the median of
the last ones of the same machine.
"""

from __future__ import annotations

import json
import statistics
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

HISTORY = Path(__file__).with_name("history.json")
# A ratio that is smaller than before by more than this has fallen.
MOST_FALL = 0.15
# Entries that a new one is compared with.
N_BEFORE = 5

Entry = Mapping[str, Any]


def add_entry(entries: Sequence[Entry], entry: Entry) -> list[Entry]:
    """Return the entries with one more; it replaces that of the same commit and machine."""
    same = [e for e in entries if (e["commit"], e["machine"]) == (entry["commit"], entry["machine"])]
    return [*(e for e in entries if e not in same), entry]


def fallen_ratios(entries: Sequence[Entry]) -> list[str]:
    """Return a line per ratio of the last entry that has fallen; none without an earlier entry of its machine."""
    if not entries:
        return []
    last = entries[-1]
    before = [entry["ratios"] for entry in entries[:-1] if entry["machine"] == last["machine"]][-N_BEFORE:]
    lines = []
    for name, ratio in last["ratios"].items():
        known = [ratios[name] for ratios in before if name in ratios]
        usual = statistics.median(known) if known else 0.0
        if ratio < (1.0 - MOST_FALL) * usual:
            less = f"{1.0 - ratio / usual:.0%} less than {usual:.3g}"
            lines.append(f"{name}: {ratio:.3g}, {less}, the median of {len(known)}")
    return lines


def read_history(path: Path = HISTORY) -> list[Entry]:
    """Return the entries, oldest first."""
    entries: list[Entry] = json.loads(path.read_text()) if path.exists() else []
    return entries


def write_history(entries: Sequence[Entry], path: Path = HISTORY) -> None:
    """Write the entries."""
    path.write_text(json.dumps(entries, indent=1) + "\n")


def main() -> int:
    """Print what has fallen."""
    entries = read_history()
    if not entries:
        print("no entries yet: run `make bench`")
        return 0
    lines = fallen_ratios(entries)
    print("\n".join(lines) or f"{entries[-1]['commit']}: no ratio has fallen by more than {MOST_FALL:.0%}")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
