"""A map of markers that can be told apart, such as those on a ceiling."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses
from beamfield.short_repr import short_repr

MarkerId = int | str


@dataclass(frozen=True, eq=False)
class MarkerMap:
    """Markers with an identity, a position and an orientation.

    Parameters
    ----------
    ids
        (j,) what is printed on each marker: numbers or names.
    poses
        (j, 3) where they are in the map: metres, and radians counter-clockwise seen from above.

    Raises
    ------
    InvalidInputError
        If there are not as many ids as poses, an id comes twice, or a pose is not finite.

    Examples
    --------
    >>> markers = MarkerMap([7, 12], [[0.0, 0.0, 0.0], [2.0, 1.0, 1.57]])
    >>> markers.poses[markers.index_of([12])].tolist()
    [[2.0, 1.0, 1.57]]
    """

    ids: Sequence[MarkerId]
    poses: FloatArray
    _rows: dict[MarkerId, int] = field(init=False, repr=False)

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(self, ids: Sequence[MarkerId], poses: ArrayLike) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        poses = np.array(as_poses(self.poses, "poses"), order="C")
        ids = as_ids(self.ids)
        require(poses.shape == (len(ids), 3), "poses", f"shape ({len(ids)}, 3) for {len(ids)} ids", poses.shape)
        rows: dict[MarkerId, int] = {}
        for row, name in enumerate(ids):
            if name in rows:
                raise InvalidInputError(f"ids: expected each once, got {name!r} at {rows[name]} and at {row}")
            rows[name] = row
        keep(self, ids=ids, poses=poses, _rows=rows)

    def __len__(self) -> int:
        return len(self.ids)

    def index_of(self, ids: Iterable[MarkerId]) -> NDArray[np.int64]:
        """Return the rows of markers in `poses`.

        Parameters
        ----------
        ids
            Numbers or names, any number of times.

        Returns
        -------
        One row each.

        Raises
        ------
        InvalidInputError
            If the map has no marker of that id, or an id is neither an integer nor a string.
        """
        wanted = as_ids(ids)
        for name in wanted:
            if name not in self._rows:
                raise InvalidInputError(f"ids: the map has no marker {name!r}; it has {self._listed()}")
        return np.array([self._rows[name] for name in wanted], dtype=np.int64)

    def _listed(self) -> str:
        shown = ", ".join(repr(name) for name in self.ids[:8])
        return shown + (f" and {len(self) - 8} more" if len(self) > 8 else "") if len(self) else "none"


def as_ids(ids: Iterable[MarkerId]) -> tuple[MarkerId, ...]:
    """Return ids as plain Python numbers and strings; refuse what is neither."""
    result: list[MarkerId] = []
    for name in ids:
        if isinstance(name, str):
            result.append(str(name))
        elif isinstance(name, (int, np.integer)) and not isinstance(name, bool):
            result.append(int(name))
        else:
            raise InvalidInputError(f"ids: expected integers or strings, got {name!r}")
    return tuple(result)
