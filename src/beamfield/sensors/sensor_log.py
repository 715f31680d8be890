"""All scans of one sensor, with the poses they were taken at."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_floats, check_fields, checked, keep, require, restore
from beamfield.errors import InvalidInputError, NoSuchIndexError
from beamfield.geometry import FloatArray
from beamfield.indices import subset_of
from beamfield.sensors.range_finder import RangeFinder
from beamfield.sensors.scan import Scan
from beamfield.short_repr import short_repr

NO_POSE = np.full(3, np.nan)
# Seconds between poses over which none is interpolated. References at the rate of the scans, or of a SLAM program, have
# gaps of seconds; a longer one hides motion.
MAX_GAP = 2.0


@dataclass(frozen=True)
class NoReturnPolicy:
    """How a reader turned a sensor's own "no return" values into +inf, and why.

    Parameters
    ----------
    values
        Raw values (metres, before conversion) that mean "no return"; every value >= max_range does anyway.
    share
        Share of all readings that were converted.
    origin
        "declared" by the file, "detected" in the data, "given" by the user, or "none".
    explanation
        One sentence for people.
    """

    values: tuple[float, ...] = ()
    share: float = 0.0
    origin: str = "none"
    explanation: str = "no special value seen"


@dataclass(frozen=True, eq=False)
class SensorLog:
    """All scans of one sensor, as columns.

    Parameters
    ----------
    finder
        The sensor.
    stamps
        (t,) seconds, not decreasing.
    ranges
        (t, k) metres in the conventions of `Scan`.
    poses
        (t, 3) reference pose of the robot in the map frame per scan; NaN where the log has none.
    odometry
        (t, 3) pose of the robot in the odometry frame per scan; NaN where the log has none.
    no_return
        What was done about the sensor's "no return" values.

    Raises
    ------
    InvalidInputError
        If an array has another shape.

    Examples
    --------
    Two scans of two beams, the second without a reference pose:

    >>> laser = RangeFinder.from_bearings([-0.1, 0.1], max_range=8.0)
    >>> poses = [[0.0, 0.0, 0.0], NO_POSE]
    >>> log = SensorLog(laser, [0.0, 0.1], [[1.0, 2.0], [1.1, np.inf]], poses, np.zeros((2, 3)))
    >>> len(log), log.has_poses, log.select([1]).has_poses
    (2, True, False)
    """

    finder: RangeFinder
    stamps: FloatArray
    ranges: FloatArray
    poses: FloatArray
    odometry: FloatArray
    no_return: NoReturnPolicy = field(default_factory=NoReturnPolicy)

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            finder: RangeFinder,
            stamps: ArrayLike,
            ranges: ArrayLike,
            poses: ArrayLike,
            odometry: ArrayLike,
            no_return: NoReturnPolicy = ...,
        ) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        t, k = np.size(self.stamps), self.finder.n_beams
        for name, shape in (("stamps", (t,)), ("ranges", (t, k)), ("poses", (t, 3)), ("odometry", (t, 3))):
            array = np.array(as_floats(getattr(self, name), name), order="C")
            require(array.shape == shape, name, f"shape {shape}", array.shape)
            keep(self, **{name: array})

    def __len__(self) -> int:
        return len(self.stamps)

    def __iter__(self) -> Iterator[Scan]:
        return (self.scan(i) for i in range(len(self)))

    @overload
    def __getitem__(self, scans: int) -> Scan: ...

    @overload
    def __getitem__(self, scans: slice | Sequence[int] | NDArray[Any]) -> SensorLog: ...

    def __getitem__(self, scans: int | slice | Sequence[int] | NDArray[Any]) -> Scan | SensorLog:
        """Return one scan by its number; or the log with only some: a slice, indices or a mask."""
        if isinstance(scans, slice):
            scans = np.arange(len(self))[scans]
        return self.select(scans) if np.ndim(scans) else self.scan(scans)  # type: ignore[arg-type]

    @checked
    def scan(self, index: int) -> Scan:
        """Return one scan.

        Parameters
        ----------
        index
            Its number; negative ones count from the end.

        Returns
        -------
        A scan with its stamp.

        Raises
        ------
        NoSuchIndexError
            If the log has no scan of that number; it is an IndexError, too.
        """
        if isinstance(index, bool | np.bool_):
            raise InvalidInputError(f"index: expected a whole number, got {index}")
        if isinstance(index, Integral) and not -len(self) <= index < len(self):
            there = f"expected a scan from {-len(self)} to {len(self) - 1}" if len(self) else "the log has no scan"
            raise NoSuchIndexError(f"index: {there}, got {index}")
        return Scan(self.ranges[index], self.finder, float(self.stamps[index]))

    @checked
    def select(self, scans: ArrayLike) -> SensorLog:
        """Return the log with only the given scans, in the given order.

        Parameters
        ----------
        scans
            Indices, or a mask (t,).

        Returns
        -------
        The log with the same finder.

        Raises
        ------
        InvalidInputError
            If the choice is neither indices that are there nor a mask of the right length.
        """
        return subset_of(self, scans, len(self), "scans", ("stamps", "ranges", "poses", "odometry"))

    def with_poses(self, poses: ArrayLike) -> SensorLog:
        """Return the log with other reference poses.

        Parameters
        ----------
        poses
            (t, 3) metres and radians, in the map frame; NaN where there is none.

        Returns
        -------
        The log with everything else as it was.

        Raises
        ------
        InvalidInputError
            If the shape is not (t, 3).
        """
        return replace(self, poses=as_floats(poses, "poses"))

    @property
    def has_poses(self) -> bool:
        """Whether any scan has a reference pose."""
        return bool(np.isfinite(self.poses).all(axis=-1).any())

    @property
    def has_odometry(self) -> bool:
        """Whether any scan has an odometry pose."""
        return bool(np.isfinite(self.odometry).all(axis=-1).any())
