"""One measurement of a range finder, and what its ranges mean."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import as_floats, check_fields, checked, keep, require, restore
from beamfield.geometry import FloatArray
from beamfield.indices import as_indices
from beamfield.sensors.range_finder import RangeFinder
from beamfield.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class Scan:
    """One measurement z = {z^1, ..., z^K} of a range finder (6.1).

    Parameters
    ----------
    ranges
        (k,) metres, as in REP 117: +inf or >= max_range: no return (a measurement); NaN: no measurement;
        -inf or < min_range: too close, dropped.
    finder
        The sensor; one range per beam.
    stamp
        Seconds.

    Raises
    ------
    InvalidInputError
        If there is not one range per beam.

    Examples
    --------
    >>> laser = RangeFinder.from_bearings([-0.1, 0.0, 0.1], max_range=12.0)
    >>> scan = Scan([2.5, np.inf, np.nan], laser)  # an obstacle, no return, no measurement
    >>> usable_ranges(scan.ranges, laser).tolist()
    [2.5, 12.0, nan]
    """

    ranges: FloatArray
    finder: RangeFinder
    stamp: float = 0.0

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(self, ranges: ArrayLike, finder: RangeFinder, stamp: float = 0.0) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        ranges = np.array(as_floats(self.ranges, "ranges"))
        require(ranges.shape == (self.finder.n_beams,), "ranges", f"shape ({self.finder.n_beams},)", ranges.shape)
        keep(self, ranges=ranges)

    @checked
    def subset(self, beams: ArrayLike) -> Scan:
        """Return the scan with only the given beams, in the given order.

        Parameters
        ----------
        beams
            Indices, or a mask (k,).

        Returns
        -------
        The scan with the same stamp, and the finder of these beams.

        Raises
        ------
        InvalidInputError
            If the choice is neither indices that are there nor a mask of the right length.
        """
        chosen = as_indices(beams, self.finder.n_beams, "beams")
        other = object.__new__(Scan)
        other.__dict__.update(self.__dict__)
        keep(other, ranges=self.ranges[chosen], finder=self.finder._with_mounts(self.finder.mounts[chosen]))
        return other

    def __getitem__(self, beams: slice | ArrayLike) -> Scan:
        """Return the scan with only these beams: a slice, indices or a mask."""
        if isinstance(beams, slice):
            beams = np.arange(self.finder.n_beams)[beams]
        return self.subset(beams if np.ndim(beams) else np.reshape(beams, 1))

    # Its readings are `ranges`: one scan is one measurement, not a row of them.
    __iter__ = None

    @checked
    def every(self, n_beams: int) -> Scan:
        """Return about equally spaced beams (6.3.4), whether they carry a measurement or not.

        `n_beams` of a model thins beams that carry one.

        Parameters
        ----------
        n_beams
            How many to keep, at least 1.

        Returns
        -------
        A scan with `n_beams` beams, or the scan itself if it has no more.

        Raises
        ------
        InvalidInputError
            If n_beams < 1.

        References
        ----------
        Probabilistic Robotics, section 6.3.4.
        """
        require(n_beams >= 1, "n_beams", "at least 1", n_beams)
        k = self.finder.n_beams
        if n_beams >= k:
            return self
        return self.subset(np.round(np.linspace(0, k - 1, n_beams)).astype(np.int64))


@checked
def usable_ranges(ranges: ArrayLike, finder: RangeFinder) -> FloatArray:
    """Return ranges with "no return" as max_range and all that is not a measurement as NaN.

    Parameters
    ----------
    ranges
        (..., k) metres, in the conventions of `Scan`.
    finder
        The sensor.

    Returns
    -------
    (..., k) metres: max_range where there was no return (+inf, or z >= max_range); NaN where there is no measurement
    (NaN, -inf, or z < min_range).

    Examples
    --------
    >>> laser = RangeFinder.from_bearings([0.0] * 5, max_range=8.0, min_range=0.1)
    >>> usable_ranges([2.0, np.inf, np.nan, 0.05, 8.19], laser).tolist()
    [2.0, 8.0, nan, nan, 8.0]
    """
    z = np.array(as_floats(ranges, "ranges"))
    z[z < finder.min_range] = np.nan
    z[z >= finder.max_range] = finder.max_range
    return z
