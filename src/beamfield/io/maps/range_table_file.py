"""Files of pre-cached ranges: a page of text that says what they are, and the codes, which are mapped into memory."""

from __future__ import annotations

import errno
import json
import os
import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from beamfield.arguments import checked
from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files.atomic import atomic_file
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable, RangeTableError
from beamfield.maps.range_table_plan import Codes, Progress, RangeTablePlan, map_key

# The first line is MAGIC, the second JSON, the rest of the page spaces.
MAGIC = b"beamfield range table\n"
PAGE = 4096
VERSION = 1
OPTIONS = ("max_range", "resolution", "headings", "unknown")


@checked
def precompute_ranges(
    path: str | os.PathLike[str],
    grid: OccupancyGrid,
    *,
    max_range: float | None = None,
    resolution: float = 0.15,
    headings: int = 180,
    unknown: Literal["free", "occupied"] = "free",
    max_gigabytes: float = 4.0,
    progress: Progress | None = None,
) -> RangeTable:
    """Return a table of expected ranges that is kept in a file, and build it if it is not there yet.

    A file that is of another map, has other options or is damaged is built anew. It is written whole under another
    name first: two programs may build it at once, and those that use the old one keep it.

    Parameters
    ----------
    path
        The file.
    grid, max_range, resolution, headings, unknown
        As for `RangeTablePlan`, which says how large a table will be.
    max_gigabytes
        A larger one is refused before it is built.
    progress
        Called with how many places are done, and of how many; not at all if the file is as it should be.

    Returns
    -------
    The table; its codes are mapped into memory, so that programs share them and only what is used is read.

    Raises
    ------
    InvalidInputError
        As for `RangeTablePlan`, or if the table is larger than `max_gigabytes`.
    OSError
        As the file system says; before anything is cast if the disk has too little room.

    References
    ----------
    Probabilistic Robotics, section 6.3.4.
    """
    plan = RangeTablePlan(grid, max_range, resolution, headings, unknown)
    plan.check_size(max_gigabytes)
    return table_in_file(path, plan, progress)


def table_in_file(path: str | os.PathLike[str], plan: RangeTablePlan, progress: Progress | None) -> RangeTable:
    """Do what `precompute_ranges` does, for a plan."""
    # Read at the end, too, as another program may have put its own there in the meantime.
    while (table := _current(Path(path), plan)) is None:
        _build(Path(path), plan, progress)
    return table


@checked
def read_range_table(path: str | os.PathLike[str], grid: OccupancyGrid) -> RangeTable:
    """Read a file of pre-cached ranges, whose codes are mapped into memory.

    The codes are not looked at: any values are ranges from 0 to the longest one. FormatError if the file is something
    else, of another map, of another version, or not whole; OSError as the file system says.
    """
    source = Path(path)
    # Opened once: the next moment, another file may have this name.
    with source.open("rb") as file:
        said = _read_page(source, file)
        if said.get("map") != map_key(grid):
            raise FormatError(
                source,
                "the table is of another map, or the map has changed since; build it again (beamfield precompute)",
            )
        try:
            plan = RangeTablePlan(grid, **{name: said[name] for name in OPTIONS})
            error = RangeTableError(**said["error"])
        except (InvalidInputError, KeyError, TypeError) as wrong:
            raise FormatError(source, f"expected the options and the error of a range table: {wrong}") from wrong
        expected, got = PAGE + plan.n_bytes, os.fstat(file.fileno()).st_size
        if got != expected:
            raise FormatError(source, f"the table is not whole: expected {expected} bytes, got {got}")
        return RangeTable(plan, _mapped(file, plan), error)


def _current(path: Path, plan: RangeTablePlan) -> RangeTable | None:
    """Return what is in the file, if it is what the plan would make."""
    try:
        table = read_range_table(path, plan.grid)
    except (FormatError, FileNotFoundError):
        return None
    return table if all(getattr(table.plan, name) == getattr(plan, name) for name in OPTIONS) else None


def _build(path: Path, plan: RangeTablePlan, progress: Progress | None) -> None:
    _require_room(path, plan.n_bytes)
    with atomic_file(path) as part, part.open("w+b") as file:
        file.write(bytes(PAGE))
        for codes in plan.code_blocks(progress):
            file.write(codes.astype("<u2", copy=False).data)
        file.flush()
        error = RangeTable(plan, _mapped(file, plan)).error
        file.seek(0)
        file.write(_page(plan, error))


def _require_room(path: Path, n_bytes: int) -> None:
    nearest = next(folder for folder in Path(os.path.realpath(path)).parents if folder.is_dir())
    free = shutil.disk_usage(nearest).free
    if n_bytes + PAGE > free:
        sizes = f"the table takes {n_bytes / 1e9:.3g} GB, the disk has {free / 1e9:.3g} GB left"
        raise OSError(errno.ENOSPC, f"No space left on device: {sizes}", str(path))


def _page(plan: RangeTablePlan, error: RangeTableError) -> bytes:
    options = {name: getattr(plan, name) for name in OPTIONS}
    said = {"version": VERSION, "map": map_key(plan.grid), **options, "error": asdict(error)}
    return (MAGIC + json.dumps(said, allow_nan=False).encode()).ljust(PAGE - 1) + b"\n"


def _read_page(path: Path, file: BinaryIO) -> dict[str, Any]:
    page = file.read(PAGE)
    if not page.startswith(MAGIC):
        raise FormatError(path, f"expected a range table of beamfield precompute, got {page[:20]!r}")
    try:
        said = json.loads(page[len(MAGIC) :])
    except (ValueError, RecursionError) as error:
        raise FormatError(path, "the first page of the table is damaged") from error
    if not isinstance(said, dict) or said.get("version") != VERSION:
        version = said.get("version") if isinstance(said, dict) else said
        raise FormatError(path, f"expected version {VERSION} of range tables, got {version!r}")
    return said


def _mapped(file: BinaryIO, plan: RangeTablePlan) -> Codes:
    return np.memmap(file, np.dtype("<u2"), "r", PAGE, (plan.n_places, plan.headings))
