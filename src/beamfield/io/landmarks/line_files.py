"""Maps of lines in CSV files."""

from __future__ import annotations

from pathlib import Path

from beamfield.errors import about_file
from beamfield.geometry import FloatArray
from beamfield.io.files.text_lines import Line
from beamfield.io.files.text_rows import id_table, write_csv
from beamfield.maps.lines import LineMap

LINE_HEADER, SEGMENT_HEADER = ("id", "rho", "alpha"), ("id", "x1", "y1", "x2", "y2")


def read_line_map(path: str | Path) -> LineMap:
    """Read a map of lines from CSV, plain or gzip.

    The header is ``id,rho,alpha`` (endless lines; metres and radians) or ``id,x1,y1,x2,y2`` (segments; metres). Blank
    lines, and lines that begin with #, are left out.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If the header is another, a value is no finite number, a row has another length, an id is no whole number >= 0
        or appears twice, both ends of a segment are one point, or there is no line; line and value are named.
    OSError
        As the file system says.
    """
    source = Path(path)

    def two_ends(row: Line, numbers: FloatArray) -> None:
        if len(numbers) == 4 and (numbers[:2] == numbers[2:]).all():
            raise row.error(f"expected two different ends, got {numbers.tolist()}")

    known = (list(LINE_HEADER), list(SEGMENT_HEADER))
    expected = " or ".join(",".join(header) for header in known)
    names, ids, values = id_table(source, "line", lambda names: names in known, expected, two_ends)
    with about_file(source):
        return LineMap.from_segments(values, ids) if len(names) == len(SEGMENT_HEADER) else LineMap(values, ids)


def write_line_map(path: str | Path, lines: LineMap) -> None:
    """Write a map of lines as CSV that `read_line_map` reads back; an existing file is replaced.

    A map with end points is written as segments: numbers return to the last bit, and lines are computed from them.

    Parameters
    ----------
    path
        The file.
    lines
        The map.

    Raises
    ------
    OSError
        As the file system says; the old file is left as it was.
    """
    header, values = (LINE_HEADER, lines.lines) if lines.segments is None else (SEGMENT_HEADER, lines.segments)
    ids = lines.ids.tolist()
    write_csv(path, header, ([ids[i], *map(repr, row)] for i, row in enumerate(values.tolist())))
