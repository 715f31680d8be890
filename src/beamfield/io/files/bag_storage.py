"""How bags are stored, told by the name or the first bytes of a file, and what mends each kind."""

from __future__ import annotations

from pathlib import Path

_MAGIC = {".bag": b"#ROSBAG V", ".mcap": b"\x89MCAP0\r\n", ".db3": b"SQLite format 3\0"}
BAG_SUFFIXES = tuple(_MAGIC)
# The programs of each format that save what can still be read.
_REPAIRS = {
    ".bag": "rosbag reindex {file}",
    ".mcap": "mcap recover {file} -o repaired.mcap",
    # Not .recover: Debian's sqlite3 is built without what it needs, and nothing would be in the file.
    ".db3": "sqlite3 {file} .dump | sed '/^ROLLBACK/s/.*/COMMIT;/' | sqlite3 repaired.db3",
}


def storage_of(path: Path) -> str | None:
    """Return the suffix that fits a file's first bytes; None if it is no bag."""
    with path.open("rb") as file:
        start = file.read(16)
    return next((suffix for suffix, magic in _MAGIC.items() if start.startswith(magic)), None)


def mcap_profile(path: Path) -> str | None:
    """Return whose messages an MCAP file says that it holds; None of other files, and damaged ones."""
    magic = _MAGIC[".mcap"] + b"\x01"  # the header is the first record
    with path.open("rb") as file:
        start = file.read(100)
    at = len(magic) + 8 + 4
    length = int.from_bytes(start[at - 4 : at], "little")
    name = start[at : at + length]
    return name.decode() if start.startswith(magic) and len(name) == length and name.isascii() else None


def is_packed_storage(path: Path) -> bool:
    """Return whether a file is, by its name, the compressed storage file of a ROS 2 bag."""
    return path.suffix == ".zstd" and Path(path.stem).suffix in BAG_SUFFIXES


def repair_of(path: Path) -> str:
    """Return the command that may mend a damaged bag, a file or a folder; "" if none is known."""
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    stored = [file for file in files if file.suffix in _REPAIRS]
    if not stored:
        return ""
    suffix = stored[0].suffix
    return _REPAIRS[suffix].format(file=stored[0].name if len(stored) == 1 else f"FILE{suffix}")
