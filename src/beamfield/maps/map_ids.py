"""The ids of a map's features."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import restore
from beamfield.detections import as_ids
from beamfield.errors import InvalidInputError


class MapWithIds:
    """Looks up features by their id; base of the maps that have ids."""

    ids: NDArray[np.int64]

    __setstate__ = restore

    def indices_of(self, ids: ArrayLike) -> NDArray[np.int64]:
        """Return the index in [0, n) of the feature with each id; InvalidInputError names one that there is not."""
        wanted = np.asarray(ids, dtype=np.int64)
        found = self.by_id.take(self.ids.searchsorted(wanted, sorter=self.by_id), mode="clip")
        unknown = self.ids.take(found) != wanted
        if unknown.any():
            raise InvalidInputError(f"ids: expected ids of the map, got {wanted[unknown][0]}")
        return np.asarray(found)

    @cached_property
    def by_id(self) -> NDArray[np.int64]:
        """(n,) the indices that sort the ids."""
        order = np.argsort(self.ids)
        order.flags.writeable = False  # as `restore` makes it
        return order


def as_map_ids(ids: ArrayLike | None, n: int) -> NDArray[np.int64]:
    """Return the ids of a map's n features as read-only integers; None numbers them from 1.

    InvalidInputError if they are not whole numbers >= 0, not n of them, or one appears twice.
    """
    result = as_ids(np.arange(1, n + 1) if ids is None else ids, n, 0)
    values, counts = np.unique(result, return_counts=True)
    if (counts > 1).any():
        raise InvalidInputError(f"ids: expected each id once, got {values[counts.argmax()]} {counts.max()} times")
    return result
