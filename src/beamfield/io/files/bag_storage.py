"""How bags are stored, told by the name or the first bytes of a file."""

from __future__ import annotations

from pathlib import Path

_MAGIC = {".bag": b"#ROSBAG V", ".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\0"}
BAG_SUFFIXES = tuple(_MAGIC)


def storage_of(path: Path) -> str | None:
    """Return the suffix that fits a file's first bytes; None if it is no bag."""
    with path.open("rb") as file:
        start = file.read(16)
    return next((suffix for suffix, magic in _MAGIC.items() if start.startswith(magic)), None)
