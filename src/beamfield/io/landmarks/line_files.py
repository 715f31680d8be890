"""Files of mapped lines: CSV, and vector maps of the AMRL."""

from __future__ import annotations

from pathlib import Path

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.files.text_rows import IdRows, csv_rows, expect_columns, finite_numbers, write_csv
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
    rows = csv_rows(source)
    line, header = next(rows, (None, []))
    names = tuple(name.lower() for name in header)
    if names not in (LINE_HEADER, SEGMENT_HEADER):
        raise FormatError(
            source,
            f"expected the header {','.join(LINE_HEADER)} or {','.join(SEGMENT_HEADER)}; got {','.join(header)[:80]!r}",
            line=line,
        )
    table = IdRows(source, "line")
    for line, words in rows:
        if len(words) != len(header):
            raise FormatError(source, f"expected {len(header)} values, got {len(words)}", line=line)
        numbers = table.add(line, words)
        if names == SEGMENT_HEADER:
            _require_two_ends(source, line, numbers)
    ids, values = table.table()
    try:
        return LineMap.from_segments(values, ids) if names == SEGMENT_HEADER else LineMap(values, ids)
    except InvalidInputError as error:
        raise FormatError(source, str(error)) from error


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


def read_amrl_vector_map(path: str | Path) -> LineMap:
    """Read a vector map of the Autonomous Mobile Robotics Laboratory: rows ``x1, y1, x2, y2`` in metres.

    Parameters
    ----------
    path
        The file, plain or gzip. Segments are numbered from 1 in its order.

    Raises
    ------
    FormatError
        If a row has not 4 finite numbers, both ends of a segment are one point, or there is no segment.
    OSError
        As the file system says.
    """
    source = Path(path)
    segments = []
    for line, words in csv_rows(source):
        expect_columns(source, line, words, ("x1", "y1", "x2", "y2"))
        segments.append(finite_numbers(source, line, words, "line"))
        _require_two_ends(source, line, segments[-1])
    if not segments:
        raise FormatError(source, "no lines: the file has no rows")
    return LineMap.from_segments(segments)


def _require_two_ends(path: Path, line: int, segment: FloatArray) -> None:
    if (segment[:2] == segment[2:]).all():
        raise FormatError(path, f"expected two different ends, got {segment.tolist()}", line=line)
