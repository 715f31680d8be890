"""Maps of landmarks in CSV files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.errors import about_file
from beamfield.io.files.text_rows import id_table, write_csv
from beamfield.maps.landmarks import LandmarkMap, SignatureKind


def read_landmarks(path: str | Path) -> LandmarkMap:
    """Read a map of landmarks from CSV, plain or gzip.

    The header is ``id,x,y``, then nothing, or ``signature`` (a number), or ``type`` (0, 1, 2 ...), or ``signature_1,
    signature_2, ...`` (a vector). Blank lines, and lines that begin with #, are left out.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If the header is another, a value is no finite number, a row has another length, an id is no whole number >= 0
        or appears twice, or there is no landmark; the line and the value are named.
    OSError
        As the file system says.
    """
    source = Path(path)
    expected = "id,x,y and then nothing, signature, type, or signature_1,signature_2,..."
    names, ids, values = id_table(
        source, "landmark", lambda names: names[:3] == ["id", "x", "y"] and _kind_of(names[3:]) is not None, expected
    )
    kind = _kind_of(names[3:]) or "none"
    signatures = None if kind == "none" else values[:, 2:] if kind == "vector" else values[:, 2]
    with about_file(source):
        return LandmarkMap(values[:, :2], ids, signatures, kind)


def write_landmarks(path: str | Path, landmarks: LandmarkMap) -> None:
    """Write a map of landmarks as CSV that `read_landmarks` reads back without loss; an existing file is replaced.

    Parameters
    ----------
    path
        The file.
    landmarks
        The map.

    Raises
    ------
    OSError
        As the file system says; the old file is left as it was.
    """
    columns, names = [landmarks.positions], ["id", "x", "y"]
    if landmarks.signatures is not None:
        columns.append(landmarks.signatures.reshape(len(landmarks), -1))
        d = columns[-1].shape[1]
        names += (
            [f"signature_{i + 1}" for i in range(d)]
            if landmarks.kind == "vector"
            else ["type" if landmarks.kind == "type" else "signature"]
        )
    rows = []
    for which, values in zip(landmarks.ids.tolist(), np.column_stack(columns).tolist(), strict=True):
        shown = [repr(value) for value in values]
        if landmarks.kind == "type":
            shown[-1] = str(int(values[-1]))
        rows.append([which, *shown])
    write_csv(path, names, rows)


def _kind_of(columns: list[str]) -> SignatureKind | None:
    """Return what the columns behind the position hold; None if they are none of those known."""
    known: dict[tuple[str, ...], SignatureKind] = {(): "none", ("signature",): "number", ("type",): "type"}
    is_vector = columns == [f"signature_{i + 1}" for i in range(len(columns))]
    return known.get(tuple(columns), "vector" if is_vector else None)
