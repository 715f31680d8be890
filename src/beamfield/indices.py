"""Choosing some of many (beams, scans, features, rows) by their indices or by a mask."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import checked, require
from beamfield.errors import InvalidInputError

Table = TypeVar("Table")


@checked
def as_indices(choice: ArrayLike, n: int, name: str) -> NDArray[np.int64]:
    """Return a selection of n items as indices from 0 to n - 1.

    Parameters
    ----------
    choice
        Indices (m,), of which negative ones count from the end; a mask (n,); or an empty list, for none.
    n
        How many there are.
    name
        How to call the choice in an error.

    Returns
    -------
    (m,) indices in the given order, repeated where the choice repeats them.

    Raises
    ------
    InvalidInputError
        If the choice is neither whole numbers nor a mask, an index is not there, or the mask has another length.

    Examples
    --------
    >>> as_indices([2, -1], 5, "beams").tolist()
    [2, 4]
    >>> as_indices([True, False, True], 3, "beams").tolist()
    [0, 2]
    >>> as_indices([7], 5, "beams")
    Traceback (most recent call last):
    beamfield.errors.InvalidInputError: beams: expected indices from -5 to 4, got 7
    """
    array = np.asarray(choice)
    if array.size == 0 and array.dtype != np.bool_:
        return np.empty(0, np.int64)
    if array.ndim != 1 or array.dtype.kind not in "iub":
        raise InvalidInputError(f"{name}: expected indices (m,) or a mask ({n},), got {array.dtype} {array.shape}")
    if array.dtype == np.bool_:
        require(len(array) == n, name, f"a mask of length {n}", len(array))
        return np.flatnonzero(array)
    there = (-n <= array) & (array < n)
    if not there.all():
        expected = f"expected indices from {-n} to {n - 1}" if n else "expected none, as there is none to choose"
        raise InvalidInputError(f"{name}: {expected}, got {array[~there][0]}")
    return np.arange(n, dtype=np.int64)[array.astype(np.int64)]


def subset_of(table: Table, choice: ArrayLike, n: int, name: str, columns: Sequence[str]) -> Table:
    """Return a dataclass with only the rows of its columns that `as_indices` allows; a column of None stays None."""
    chosen = as_indices(choice, n, name)
    values = {column: getattr(table, column) for column in columns}
    kept = {column: None if value is None else value[chosen] for column, value in values.items()}
    return replace(table, **kept)  # type: ignore[type-var]
