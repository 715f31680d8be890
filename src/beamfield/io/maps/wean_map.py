"""Maps of the Wean Hall data set: text with one probability per cell, as BeeSoft wrote it."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files.text_lines import Line, most_bytes, read_lines
from beamfield.io.files.yaml_file import shorten
from beamfield.io.maps.map_image import MAX_PIXELS
from beamfield.maps.occupancy import OccupancyGrid

_SPECIFICATION = re.compile(r"robot_specifications->(\w+)\s+(\S+)\s*$")
_SIZE = re.compile(r"global_map\[0\]:\s*([0-9]{1,9})\s+([0-9]{1,9})\s*$")
_HEADER_LINES = 100
_EXPECTED = "expected 'robot_specifications->...' or 'global_map[0]: rows cols'"


def read_wean_map(path: str | os.PathLike[str], *, max_cells: int = MAX_PIXELS) -> OccupancyGrid:
    """Read a map such as Wean Hall's ``wean.dat``.

    Parameters
    ----------
    path
        The file, plain or compressed by gzip: lines ``robot_specifications->resolution 10`` (centimetres), a line
        ``global_map[0]: 800 800``, then one line of numbers per x, each with one number per y.
    max_cells
        Maps with more cells are refused before they are read.

    Returns
    -------
    The grid, its origin at (0, 0, 0).

    Raises
    ------
    FormatError
        If the header is incomplete, the number of cells is wrong or more than the file can hold, a value is neither -1
        nor in [0, 1], or the file is a bomb (`read_lines`).
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
    lines = read_lines(source)
    resolution_cm, n_x, n_y = _read_header(lines, source, max_cells)
    # Rows of the grid are y, lines of the file are x.
    return OccupancyGrid(_read_values(lines, source, n_x, n_y).T, resolution_cm / 100.0, np.zeros(3))


def _read_header(lines: Iterator[tuple[int, str]], path: Path, max_cells: int) -> tuple[float, int, int]:
    """Return the resolution in centimetres, and the number of cells in x and y."""
    numbers: dict[str, float] = {}
    number = 0
    for number, text in islice(lines, _HEADER_LINES):
        line = Line(path, number, text.split())
        size = _SIZE.match(text)
        if size is not None:
            n_x, n_y = int(size[1]), int(size[2])
            _check_header(numbers, n_x, n_y, line, max_cells)
            return numbers["resolution"], n_x, n_y
        specification = _SPECIFICATION.match(text)
        if specification is not None:
            numbers[specification[1]] = _number(line, specification[2], specification[1])
        elif text.strip():
            raise line.error(f"{_EXPECTED}, got {shorten(text[:60])}")
    if number < _HEADER_LINES:
        raise FormatError(path, f"{_EXPECTED}, got the end of the file", line=number + 1)
    raise FormatError(path, f"expected 'global_map[0]: rows cols' within {_HEADER_LINES} lines")


def _number(line: Line, text: str, name: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise line.error(f"expected a number, got {shorten(text)}", name)
    return value


def _check_header(numbers: dict[str, float], n_x: int, n_y: int, line: Line, max_cells: int) -> None:
    if "resolution" not in numbers:
        raise line.error("expected 'robot_specifications->resolution' before the map")
    if numbers["resolution"] <= 0:
        text = f"expected a positive number of centimetres, got {numbers['resolution']}"
        raise FormatError(line.path, text, field="resolution")
    for name in ("autoshifted_x", "autoshifted_y"):
        if numbers.get(name, 0.0) != 0.0:
            raise FormatError(line.path, f"expected a map without a shift, got {numbers[name]}", field=name)
    if n_x < 1 or n_y < 1:
        raise line.error(f"expected a map with cells, got {n_x} x {n_y}")
    if n_x * n_y > max_cells:
        raise line.error(f"{n_x} x {n_y} cells exceed the limit of {max_cells}")
    # A digit and a space for each.
    if 2 * n_x * n_y - 1 > most_bytes(line.path):
        raise line.error(f"truncated: {n_x} x {n_y} cells are more than the file can hold")


def _read_values(lines: Iterator[tuple[int, str]], path: Path, n_x: int, n_y: int) -> NDArray[np.float32]:
    """Return the probabilities of being occupied, (n_x, n_y); NaN where it is unknown."""
    probability = np.empty((n_x, n_y), np.float32)
    done = 0
    for number, text in lines:
        line = Line(path, number, text.split())
        if done < n_x:
            free = _read_column(line, n_y)
            probability[done] = 1.0 - np.where(free < 0, np.nan, free)
            done += 1
        elif line.words:
            raise line.error(f"expected {n_x} lines of numbers, got more: {shorten(text[:40])}")
    if done < n_x:
        raise FormatError(path, f"truncated: expected {n_x} lines of numbers, got {done}")
    return probability


def _read_column(line: Line, n_y: int) -> NDArray[np.float64]:
    if len(line.words) != n_y:
        raise line.error(f"expected {n_y} numbers, got {len(line.words)}")
    values = line.numbers(0, field="cell")
    valid = (values == -1.0) | ((values >= 0.0) & (values <= 1.0))
    if not valid.all():
        bad = line.words[int(np.argmin(valid))]
        raise line.error(f"expected -1 or a probability in [0, 1], got {shorten(bad)}")
    return values
