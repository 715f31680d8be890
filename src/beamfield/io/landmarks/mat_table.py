"""Tables of MATLAB files, checked: finite numbers with named columns, ids, what rises, and what is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.maps.landmarks import LandmarkMap


def mat_table(path: Path, arrays: dict[str, FloatArray], name: str, columns: str) -> FloatArray:
    """Return one array of finite numbers with the given columns.

    Parameters
    ----------
    path
        For errors.
    arrays
        As from `read_mat_arrays`.
    name
        The variable.
    columns
        Names of its columns, with blanks between.

    Raises
    ------
    FormatError
        If the variable is missing, has other columns or no row, or a number that is not finite; row and value are
        named.
    """
    if name not in arrays:
        found = ", ".join(sorted(arrays)) or "none"
        raise FormatError(path, f"the variable is missing; arrays in the file: {found[:200]}", field=name)
    table, names = arrays[name], columns.split()
    if table.shape[1] != len(names) or not len(table):
        raise FormatError(path, f"expected rows of {', '.join(names)}, got shape {table.shape}", field=name)
    wrong = ~np.isfinite(table)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise FormatError(
            path, f"row {row + 1}: expected a finite {names[column]}, got {str(table[row, column])!r}", field=name
        )
    return table


def mat_ids(path: Path, table: FloatArray, column: int, name: str, what: str) -> NDArray[np.int64]:
    """Return a column of a table as whole numbers >= 0.

    Parameters
    ----------
    path, name
        File and variable, for errors.
    table, column
        As from `mat_table`, and which of its columns.
    what
        Name of the column.

    Raises
    ------
    FormatError
        If a number is not whole, negative, or beyond 2^53; row and value are named.
    """
    values = table[:, column]
    wrong = (values != np.floor(values)) | (values < 0) | (values > 2**53)
    if wrong.any():
        row = int(wrong.argmax())
        text = f"row {row + 1}: expected a whole number >= 0 as {what}, got {str(values[row])!r}"
        raise FormatError(path, text, field=name)
    return np.asarray(values.astype(np.int64))


def mat_landmarks(path: Path, arrays: dict[str, FloatArray], name: str) -> LandmarkMap:
    """Return one array with the columns id, x and y as a map of landmarks.

    Parameters
    ----------
    path, arrays, name
        As for `mat_table`.

    Raises
    ------
    FormatError
        As for `mat_table` and `mat_ids`, or if an id appears twice.
    """
    table = mat_table(path, arrays, name, "id x y")
    try:
        return LandmarkMap(table[:, 1:], mat_ids(path, table, 0, name, "id"))
    except InvalidInputError as error:
        raise FormatError(path, str(error), field=name) from error


def require_rising(path: Path, values: NDArray[Any], name: str, what: str) -> None:
    """Say if values (n,), a column of a variable, do not rise from row to row.

    Parameters
    ----------
    path, name
        File and variable, for errors.
    values
        The column.
    what
        What its values are, for errors: "times".

    Raises
    ------
    FormatError
        If one is not larger than the one before; row and values are named.
    """
    falls = np.diff(values) <= 0
    if falls.any():
        row = int(falls.argmax()) + 1
        text = f"row {row + 1}: expected {what} that rise, got {values[row]} after {values[row - 1]}"
        raise FormatError(path, text, field=name)


def require_known(path: Path, ids: NDArray[np.int64], known: NDArray[np.int64], name: str, what: str) -> None:
    """Say if an id of a column (n,) of a variable is none of those known, (m,).

    Parameters
    ----------
    path, name
        File and variable, for errors.
    ids, known
        The column, and what it may hold.
    what
        What an id is, for errors: "beacon of TL".

    Raises
    ------
    FormatError
        If one is not known; row and id are named.
    """
    missing = ~np.isin(ids, known)
    if missing.any():
        row = int(missing.argmax())
        raise FormatError(path, f"row {row + 1}: expected a {what}, got {ids[row]}", field=name)
