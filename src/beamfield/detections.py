"""Features of one observation: range, bearing and signature of what a feature extractor found (6.38)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import LARGEST, as_floats, check_fields, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.indices import subset_of
from beamfield.short_repr import short_repr

SPURIOUS = -1
"""Correspondence c = N + 1 of 6.6.3: the feature belongs to no landmark of the map."""
UNKNOWN = -2
"""The correspondence is not known."""


@dataclass(frozen=True, eq=False)
class Detections:
    """f(z) = {(r, phi, s), ...} of (6.38): the features of one observation, in the sensor's frame.

    Parameters
    ----------
    ranges
        (k,) metres; NaN where no range was measured (bearing only). A negative range is kept: the Gaussian noise of
        (6.40) can produce one next to a landmark.
    bearings
        (k,) radians, counter-clockwise from the sensor's axis; NaN where no bearing was measured (range only). Any
        finite angle: directions that differ by full turns are the same.
    signatures
        (k,) numbers or types, or (k, d) vectors; NaN where none was measured. None if no feature has one.
    ids
        (k,) id of each feature's landmark, `SPURIOUS` or `UNKNOWN`; None if none is known.
    stamp
        Seconds.

    Raises
    ------
    InvalidInputError
        If shapes differ, a value is infinite, a vector is partly NaN, or an id is below `UNKNOWN`.

    Examples
    --------
    Two features, one seen by its bearing alone:

    >>> seen = Detections([2.1, np.nan], [0.3, -1.2], ids=[7, UNKNOWN])
    >>> len(seen), seen.subset([0]).ids.tolist()
    (2, [7])
    """

    ranges: FloatArray
    bearings: FloatArray
    signatures: FloatArray | None = None
    ids: NDArray[np.int64] | None = None
    stamp: float = 0.0

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            ranges: ArrayLike,
            bearings: ArrayLike,
            signatures: ArrayLike | None = None,
            ids: ArrayLike | None = None,
            stamp: float = 0.0,
        ) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        ranges = _frozen(self.ranges, "ranges")
        require(ranges.ndim == 1, "ranges", "shape (k,)", ranges.shape)
        keep(self, ranges=ranges, bearings=_frozen(self.bearings, "bearings"))
        require(self.bearings.shape == ranges.shape, "bearings", f"shape {ranges.shape}", self.bearings.shape)
        if self.signatures is not None:
            keep(self, signatures=self._checked_signatures(self.signatures))
        if self.ids is not None:
            keep(self, ids=as_ids(self.ids, len(ranges), UNKNOWN))

    def __len__(self) -> int:
        return len(self.ranges)

    def subset(self, features: ArrayLike) -> Detections:
        """Return only the given features, in the given order.

        Parameters
        ----------
        features
            Indices, or a mask (k,).

        Returns
        -------
        The detections with the same stamp.

        Raises
        ------
        InvalidInputError
            If the choice is neither indices that are there nor a mask of the right length.
        """
        return subset_of(self, features, len(self), "features", ("ranges", "bearings", "signatures", "ids"))

    def without_ids(self) -> Detections:
        """Return the same features with all correspondences unknown.

        Returns
        -------
        The detections with `ids` None.
        """
        return replace(self, ids=None)

    def _checked_signatures(self, values: ArrayLike) -> FloatArray:
        signatures = _frozen(values, "signatures")
        if signatures.ndim not in (1, 2) or len(signatures) != len(self.ranges):
            raise InvalidInputError(
                f"signatures: expected shape ({len(self.ranges)},) or ({len(self.ranges)}, d), got {signatures.shape}"
            )
        if signatures.ndim == 2:
            missing = np.isnan(signatures)
            partly = missing.any(axis=1) & ~missing.all(axis=1)
            if partly.any():
                i = int(partly.argmax())
                raise InvalidInputError(
                    f"signatures: expected vectors that are all numbers or all NaN, got {signatures[i].tolist()} "
                    f"at index {i}"
                )
        return signatures


def as_ids(ids: ArrayLike, n: int, lowest: int) -> NDArray[np.int64]:
    """Return n ids as read-only integers; raise if they are not n whole numbers, at least `lowest`."""
    given = np.asarray(ids)
    require(given.shape == (n,), "ids", f"shape ({n},)", given.shape)
    require(not given.size or given.dtype.kind in "iu", "ids", "whole numbers", given.dtype)
    result = np.array(given, dtype=np.int64)
    if (result < lowest).any():
        raise InvalidInputError(f"ids: expected at least {lowest}, got {result.min()}")
    result.flags.writeable = False
    return result


def finite_copy(values: ArrayLike, name: str) -> FloatArray:
    """Return numbers as a read-only copy that nobody else can change.

    InvalidInputError names one, with its index, that is not finite, or so large that sums overflow (beyond 1e9).
    """
    array = np.array(as_floats(values, name), order="C")
    usable = np.abs(array) <= LARGEST
    if not usable.all():
        where = tuple(np.argwhere(~usable)[0].tolist())
        what = f"numbers up to {LARGEST:g}" if np.isfinite(array[where]) else "finite numbers"
        raise InvalidInputError(f"{name}: expected {what}, got {array[where]} at index {where}")
    array.flags.writeable = False
    return array


def _frozen(values: ArrayLike, name: str) -> FloatArray:
    array = np.array(values, dtype=np.float64, order="C")
    if np.isinf(array).any():
        raise InvalidInputError(f"{name}: expected finite numbers or NaN, got {array[np.isinf(array)][0]}")
    array.flags.writeable = False
    return array
