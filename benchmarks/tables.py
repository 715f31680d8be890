"""Tables of benchmarks in Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def print_table(
    rows: Sequence[Mapping[str, Any]], *, columns: Sequence[str] | None = None, digits: int | None = None
) -> None:
    """Print rows as a Markdown table.

    `columns` are those of the first row unless given; what a row has not stays empty. Floating-point numbers are cut to
    so many `digits`, or printed as they are.
    """
    columns = list(rows[0]) if columns is None else columns
    print(f"| {' | '.join(columns)} |")
    print(f"|{'---|' * len(columns)}")
    for row in rows:
        values = (row.get(column, "") for column in columns)
        shown = (f"{v:.{digits}g}" if digits is not None and isinstance(v, float) else str(v) for v in values)
        print(f"| {' | '.join(shown)} |", flush=True)
