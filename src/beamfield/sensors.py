"""Range finders, scans and logs of scans, in one set of conventions for every sensor and file format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Integral
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import LARGEST, as_floats, check_fields, checked, keep, require
from beamfield.data_frame import data_frame
from beamfield.errors import InvalidInputError, NoSuchIndexError
from beamfield.geometry import FloatArray, as_poses, compose
from beamfield.indices import as_indices, subset_of
from beamfield.short_repr import short_repr

# Metres between a sensor's limits. In less, the densities of wide hits and steep shorts cannot be told from 0 / 0.
SHORTEST_SPAN = 1e-6
NO_POSE = np.full(3, np.nan)
TURN_TOLERANCE = 1e-3  # radians


@dataclass(frozen=True, eq=False)
class RangeFinder:
    """A sensor that measures ranges along beams (or cones) with fixed mounts on the robot.

    Parameters
    ----------
    mounts
        (k, 3) pose of each beam's origin and direction in the robot frame, (x, y, theta)_k,sens of (6.32), in metres
        and radians. Any order and spacing; one sensor may combine several origins (a merged scan, a sonar ring).
    max_range
        Ranges from here on mean "no return": the chapter's z_max (as a distance), in metres.
    min_range
        Ranges below mean "too close to measure", in metres.
    opening_angle
        Full width of the cone in radians; 0 for a beam.
    name
        Topic, frame or message name in the log.

    Raises
    ------
    InvalidInputError
        If the mounts are not finite (k, 3), the limits are not 0 <= min_range < max_range <= 1e9, or the opening angle
        is not in [0, pi).

    Examples
    --------
    A laser 0.25 m before the robot's centre, with 181 beams over a half circle:

    >>> bearings = np.linspace(-np.pi / 2, np.pi / 2, 181)
    >>> laser = RangeFinder.from_bearings(bearings, max_range=12.0, mount=(0.25, 0.0, 0.0))
    >>> laser.n_beams, laser.mounts[90].tolist()
    (181, [0.25, 0.0, 0.0])
    """

    mounts: FloatArray
    max_range: float
    min_range: float = 0.0
    opening_angle: float = 0.0
    name: str = ""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        mounts = np.array(as_poses(self.mounts, "mounts"))
        require(mounts.ndim == 2, "mounts", "shape (k, 3)", mounts.shape)
        keep(self, mounts=mounts)
        if not (0.0 <= self.min_range <= self.max_range - SHORTEST_SPAN and self.max_range <= LARGEST):
            raise InvalidInputError(
                f"range limits: expected 0 <= min_range < max_range <= {LARGEST:g}, {SHORTEST_SPAN:g} m or more apart, "
                f"got min_range {self.min_range} and max_range {self.max_range}"
            )
        require(0.0 <= self.opening_angle < np.pi, "opening_angle", "[0, pi) radians", self.opening_angle)

    @classmethod
    @checked
    def from_bearings(cls, bearings: ArrayLike, max_range: float, *, mount: ArrayLike = (0.0, 0.0, 0.0),
                      **limits: Any) -> RangeFinder:  # fmt: skip
        """Build a finder whose beams start at one point.

        Parameters
        ----------
        bearings
            (k,) directions in the sensor frame, radians, counter-clockwise; any order and spacing.
        max_range
            As for the class.
        mount
            (3,) the sensor's pose in the robot frame.
        **limits
            `min_range`, `opening_angle`, `name`.

        Returns
        -------
        A finder with k beams; `bearings` are then in the robot frame, in (-pi, pi].

        Raises
        ------
        InvalidInputError
            If the bearings are not finite (k,), the mount is not a finite pose, an angle is beyond a full turn (degrees
            are, nearly always), or as for the class.
        """
        angles = as_floats(bearings, "bearings")
        require(angles.ndim == 1, "bearings", "shape (k,)", angles.shape)
        _require_radians("bearings", angles)
        _require_radians("heading of mount", as_poses(mount, "mount")[..., 2])
        in_sensor = np.column_stack([np.zeros_like(angles), np.zeros_like(angles), angles])
        return cls(compose(as_poses(mount, "mount"), in_sensor), max_range, **limits)

    @property
    def n_beams(self) -> int:
        """Number of beams, k."""
        return len(self.mounts)

    @property
    def bearings(self) -> FloatArray:
        """(k,) direction of each beam in the robot frame, radians."""
        return self.mounts[:, 2]

    @checked
    def subset(self, beams: ArrayLike) -> RangeFinder:
        """Return the finder with only the given beams, in the given order.

        Parameters
        ----------
        beams
            Indices, or a mask (k,).

        Returns
        -------
        The finder with the same limits and name.

        Raises
        ------
        InvalidInputError
            If the choice is neither indices that are there nor a mask of the right length.
        """
        return self._with_mounts(self.mounts[as_indices(beams, self.n_beams, "beams")])

    def _with_mounts(self, mounts: FloatArray) -> RangeFinder:
        """Return the finder with some of its own mounts, which need no check; models ask for it with each scan."""
        other = object.__new__(RangeFinder)
        other.__dict__.update(self.__dict__)
        keep(other, mounts=mounts)
        return other


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

    __repr__ = short_repr

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


def _require_radians(name: str, angles: FloatArray) -> None:
    """Refuse angles of more than a full turn, which degrees are, nearly always."""
    farthest = np.max(np.abs(angles), initial=0.0)
    if 2.0 * np.pi + TURN_TOLERANCE < farthest < np.inf:
        raise InvalidInputError(
            f"{name}: expected radians, at most a full turn, got {farthest:g}; np.radians(...) converts degrees"
        )


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
    with np.errstate(invalid="ignore"):
        z[z < finder.min_range] = np.nan
        z[z >= finder.max_range] = finder.max_range
    return z


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

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        t, k = np.size(self.stamps), self.finder.n_beams
        for name, shape in (("stamps", (t,)), ("ranges", (t, k)), ("poses", (t, 3)), ("odometry", (t, 3))):
            array = np.array(as_floats(getattr(self, name), name))
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
        if isinstance(index, Integral) and not -len(self) <= index < len(self):
            raise NoSuchIndexError(f"index: expected a scan from {-len(self)} to {len(self) - 1}, got {index}")
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
        return replace(self, poses=np.asarray(poses, dtype=np.float64))

    @property
    def has_poses(self) -> bool:
        """Whether any scan has a reference pose."""
        return bool(np.isfinite(self.poses).all(axis=-1).any())

    @property
    def has_odometry(self) -> bool:
        """Whether any scan has an odometry pose."""
        return bool(np.isfinite(self.odometry).all(axis=-1).any())


@dataclass(frozen=True, eq=False)
class Track:
    """A trajectory: poses with stamps.

    Parameters
    ----------
    stamps
        (t,) seconds, not decreasing.
    poses
        (t, 3) metres and radians.
    """

    stamps: FloatArray
    poses: FloatArray

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.stamps)

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with the columns stamp, x, y and theta; needs pandas."""
        return data_frame({"stamp": self.stamps, **dict(zip(("x", "y", "theta"), self.poses.T, strict=True))})


@dataclass(frozen=True, eq=False)
class ScanLog:
    """What a log file says: one entry per sensor, the odometry at its own rate, and notes on how it was read.

    Parameters
    ----------
    sensors
        The logs of the sensors by name (message or topic name), in the order of the file.
    odometry
        The robot's odometry at its own rate; None if the log has none.
    source
        Name of the file.
    notes
        What a user should know about how the file was read; one sentence each.
    parameters
        Parameters that the file itself carries (CARMEN's PARAM lines, for example).
    """

    sensors: Mapping[str, SensorLog]
    odometry: Track | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    parameters: Mapping[str, str] = field(default_factory=dict)

    __repr__ = short_repr

    def __getitem__(self, name: str) -> SensorLog:
        """Return the log of a sensor by its name."""
        if not isinstance(name, str):
            raise InvalidInputError(f"expected the name of a sensor, got {name!r}; .only_sensor()[...] chooses scans")
        return self.only_sensor(name)

    def only_sensor(self, name: str | None = None) -> SensorLog:
        """Return the sensor of that name, or the only one there is.

        Parameters
        ----------
        name
            Topic or message name; None if the log has one sensor.

        Returns
        -------
        The scans of that sensor.

        Raises
        ------
        InvalidInputError
            If there is no such sensor, or no name was given and there are several.
        """
        known = ", ".join(repr(n) for n in self.sensors) or "none"
        if name is None:
            if len(self.sensors) != 1:
                raise InvalidInputError(f"{self.source}: which sensor? name one, the log has {known}")
            return next(iter(self.sensors.values()))
        if name not in self.sensors:
            raise InvalidInputError(f"{self.source}: no sensor {name!r}; the log has {known}")
        return self.sensors[name]
