"""Maps of the Wean Hall data set: text with one probability per cell, as BeeSoft wrote it."""

from __future__ import annotations

import gzip
import os
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files.yaml_file import shorten
from beamfield.io.maps.map_image import MAX_PIXELS
from beamfield.maps.occupancy import OccupancyGrid

_SPECIFICATION = re.compile(rb"robot_specifications->(\w+)\s+(\S+)\s*$")
_SIZE = re.compile(rb"global_map\[0\]:\s*([0-9]{1,9})\s+([0-9]{1,9})\s*$")
_HEADER_LINES = 100
_LINE_LIMIT = 65_536
_BYTES_PER_CELL = 32


def read_wean_map(
    path: str | os.PathLike[str],
    *,
    occupied_thresh: float = 0.65,
    free_thresh: float = 0.25,
    max_cells: int = MAX_PIXELS,
) -> OccupancyGrid:
    """Read a map such as Wean Hall's ``wean.dat``.

    Parameters
    ----------
    path
        The file, plain or compressed by gzip: lines ``robot_specifications->resolution 10`` (centimetres), a line
        ``global_map[0]: 800 800``, then one line of numbers per x, each with one number per y.
    occupied_thresh, free_thresh
        Thresholds of the grid; the file has none.
    max_cells
        Maps with more cells are refused before they are read.

    Returns
    -------
    The grid, its origin at (0, 0, 0).

    Raises
    ------
    FormatError
        If the header is incomplete, the number of cells is wrong or a value is neither -1 nor in [0, 1].
    InvalidInputError
        If a parameter is outside its range.
    OSError
        As the file system says.

    Notes
    -----
    The value is the probability that a cell is *free*, and -1 is unknown. The text that came with the data says
    occupied, but corridors are near 1 in it, and the scans fit only this way.

    A map that was shifted (autoshifted_x, autoshifted_y) is refused, because no text says which way.
    """
    if max_cells < 1:
        raise InvalidInputError(f"max_cells: expected at least 1, got {max_cells}")
    source = Path(path)
    with _opened(source) as file:
        resolution_cm, n_x, n_y, line = _read_header(file, source, max_cells)
        free = _read_values(file, source, n_x, n_y, line)
    # Unknown is NaN from here on; rows of the grid are y, lines of the file are x.
    probability = (1.0 - np.where(free < 0, np.nan, free)).T.astype(np.float32)
    return OccupancyGrid(
        probability, resolution_cm / 100.0, np.zeros(3), occupied_thresh=occupied_thresh, free_thresh=free_thresh
    )


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    with path.open("rb") as raw:
        is_compressed = raw.read(2) == b"\x1f\x8b"
        raw.seek(0)
        if not is_compressed:
            yield raw
            return
        try:
            with gzip.GzipFile(fileobj=raw) as file:
                yield file  # type: ignore[misc]
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise FormatError(path, f"damaged gzip file: {error}") from error


def _read_header(file: BinaryIO, path: Path, max_cells: int) -> tuple[float, int, int, int]:
    """Return the resolution in centimetres, the number of cells in x and y, and the number of lines read."""
    numbers: dict[str, float] = {}
    for line in range(1, _HEADER_LINES + 1):
        text = file.readline(_LINE_LIMIT)
        size = _SIZE.match(text)
        if size is not None:
            n_x, n_y = int(size[1]), int(size[2])
            _check_header(numbers, n_x, n_y, path, line, max_cells)
            return numbers["resolution"], n_x, n_y, line
        specification = _SPECIFICATION.match(text)
        if specification is not None:
            name = specification[1].decode("ascii", "replace")
            numbers[name] = _number(specification[2], path, line, name)
        elif not text or text.strip():
            found = shorten(text[:60]) if text else "the end of the file"
            raise FormatError(
                path, f"expected 'robot_specifications->...' or 'global_map[0]: rows cols', got {found}", line=line
            )
    raise FormatError(path, f"expected 'global_map[0]: rows cols' within {_HEADER_LINES} lines")


def _number(text: bytes, path: Path, line: int, name: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise FormatError(path, f"expected a number, got {shorten(text)}", line=line, field=name)
    return value


def _check_header(numbers: dict[str, float], n_x: int, n_y: int, path: Path, line: int, max_cells: int) -> None:
    if "resolution" not in numbers:
        raise FormatError(path, "expected 'robot_specifications->resolution' before the map", line=line)
    if numbers["resolution"] <= 0:
        raise FormatError(
            path, f"expected a positive number of centimetres, got {numbers['resolution']}", field="resolution"
        )
    for name in ("autoshifted_x", "autoshifted_y"):
        if numbers.get(name, 0.0) != 0.0:
            raise FormatError(path, f"expected a map that is not shifted, got {numbers[name]}", field=name)
    if n_x < 1 or n_y < 1:
        raise FormatError(path, f"expected a map with cells, got {n_x} x {n_y}", line=line)
    if n_x * n_y > max_cells:
        raise FormatError(path, f"{n_x} x {n_y} cells are more than the limit of {max_cells}: not read", line=line)


def _read_values(file: BinaryIO, path: Path, n_x: int, n_y: int, line: int) -> NDArray[np.float64]:
    columns = []  # grows with what the file really holds, not with what its header says
    for i in range(n_x):
        text = file.readline(_BYTES_PER_CELL * n_y + 2)
        line += 1
        if not text:
            raise FormatError(path, f"truncated: expected {n_x} lines of numbers, got {i}", line=line)
        columns.append(_read_column(text, path, n_y, line))
    while rest := file.readline(_LINE_LIMIT):
        line += 1
        if rest.strip():
            raise FormatError(path, f"expected {n_x} lines of numbers, got more: {shorten(rest[:40])}", line=line)
    return np.array(columns)


def _read_column(text: bytes, path: Path, n_y: int, line: int) -> NDArray[np.float64]:
    words = text.split()
    if len(words) != n_y:
        raise FormatError(path, f"expected {n_y} numbers, got {len(words)}", line=line)
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        values = np.array([_number(word, path, line, "cell") for word in words])
    valid = (values == -1.0) | ((values >= 0.0) & (values <= 1.0))
    if not valid.all():
        bad = words[int(np.argmin(valid))]
        raise FormatError(path, f"expected -1 or a probability in [0, 1], got {shorten(bad)}", line=line)
    return values
