"""sensor_msgs/LaserScan messages: bearings, limits and ranges of one sensor, checked to belong together."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_floats, checked
from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.io.bags.bag_file import BagMessage, seconds
from beamfield.io.bags.bearing_grid import ScanGeometry, on_one_grid
from beamfield.io.bags.frames import strip_slash
from beamfield.sensors import RangeFinder, Scan

STAMP_TOLERANCE = 0.5  # seconds: neighbours may swap on a lossy network; a clock that was set jumps further
# Up to this share of the messages may be later, one at a time and by so many seconds: after a clock was set, several
# messages in a row are behind.
LATE_SHARE, LATEST = 0.01, 10.0


class LaserScanMessage(Protocol):
    """What has the fields of sensor_msgs/LaserScan: a message of rclpy, rospy or rosbags."""

    @property
    def header(self) -> Any:
        """Stamp and frame_id."""

    @property
    def angle_min(self) -> float:
        """Direction of the first beam in the sensor's frame, radians."""

    @property
    def angle_increment(self) -> float:
        """From one beam to the next, radians."""

    @property
    def range_min(self) -> float:
        """Metres."""

    @property
    def range_max(self) -> float:
        """Metres."""

    @property
    def ranges(self) -> Any:
        """(k,) metres, as in REP 117."""


@checked
def scan_from_message(
    message: LaserScanMessage,
    *,
    mount: ArrayLike = (0.0, 0.0, 0.0),
    no_return: tuple[float, ...] = (),
    max_range: float | None = None,
) -> Scan:
    """Turn a message of sensor_msgs/LaserScan into a scan, as a callback of rclpy gets it; ROS is not needed.

    Parameters
    ----------
    message
        Any object with the fields of the message.
    mount
        (3,) the sensor's pose on the robot, metres and radians: what tf has from base_link to `header.frame_id`.
    no_return
        Values in metres by which the sensor says "no return", if it does not follow REP 117 (+inf, or range_max and
        more): 0.0 for many, NaN for some.
    max_range
        The sensor's limit in metres, for drivers that leave range_max at 0 or inf; None takes it from the message.

    Returns
    -------
    The scan with its finder, whose name is `header.frame_id`, and the stamp of its first beam, seconds.

    Raises
    ------
    InvalidInputError
        If something is not a message, it has no beams, or its angles or limits make no sense.

    Notes
    -----
    One message is not enough to find out by what value a sensor says "no return", as `read_log` does.

    Examples
    --------
    >>> from types import SimpleNamespace as Message
    >>> header = Message(frame_id="laser", stamp=Message(sec=12, nanosec=500_000_000))
    >>> message = Message(header=header, angle_min=-0.5, angle_increment=0.5, range_min=0.1, range_max=12.0,
    ...                   ranges=[2.0, 0.0, 12.0])
    >>> scan = scan_from_message(message, mount=(0.2, 0.0, 0.0), no_return=(0.0,))
    >>> scan.ranges.tolist(), scan.finder.bearings.tolist(), scan.stamp
    ([2.0, inf, 12.0], [-0.5, 0.0, 0.5], 12.5)
    """
    ranges = np.array(as_floats(message.ranges, "ranges"))
    if ranges.ndim != 1 or len(ranges) == 0:
        raise InvalidInputError(f"ranges: expected shape (k,) with beams, got {ranges.shape}")
    geometry = ScanGeometry(float(message.angle_min), float(message.angle_increment), len(ranges))
    _check_geometry(*geometry)
    ranges[is_one_of(ranges, no_return)] = np.inf
    # Of float32 precision as the ranges are: a sensor that answers 5.6 for "no return" writes 5.599999904632568.
    limit = float(np.float32(message.range_max if max_range is None else max_range))
    if max_range is None and not 0.0 < limit < np.inf:
        raise InvalidInputError(f"range_max: expected a finite number of metres > 0, got {limit!r}; give max_range")
    finder = RangeFinder.from_bearings(
        _bearings(geometry),
        limit,
        mount=mount,
        min_range=float(message.range_min),
        name=str(message.header.frame_id),
    )
    return Scan(ranges, finder, seconds(message.header.stamp))


@dataclass(frozen=True, eq=False)
class LaserScans:
    """All scans of one topic.

    Parameters
    ----------
    topic, frame
        Where they were published, and the frame of the sensor, without a leading slash.
    bearings
        (k,) direction of each beam in the sensor's frame, radians.
    range_min, range_max
        The limits that the messages declare, metres.
    stamps
        (t,) seconds, of the first beam of each scan, not decreasing.
    ranges
        (t, k) metres, as published.
    notes
        What a user should know about them.
    lag
        Median time from stamp to recording, seconds; NaN where the stamps say nothing.
    """

    topic: str
    frame: str
    bearings: FloatArray
    range_min: float
    range_max: float
    stamps: FloatArray
    ranges: FloatArray
    notes: tuple[str, ...] = ()
    lag: float = np.nan


@dataclass(eq=False)
class LaserScanCollector:
    """Collects the messages of one topic and checks that they belong together; path and topic are for errors.

    Declared limits may change if others are `given`, least and greatest range.

    The direction of beam i is ``angle_min + i angle_increment``, computed in float64 from the float32 fields, whose
    rounding leaves it less than 1e-6 radians off. The increment may be negative. The number of beams and their
    directions may change from scan to scan, as those of lidars do whose motor runs freely; see `on_one_grid`.
    """

    path: Path
    topic: str
    given: tuple[float | None, float | None] = (None, None)
    _geometries: list[ScanGeometry] = field(default_factory=list)
    _limits: tuple[float, float] = (0.0, 0.0)
    _frame: str = ""
    _stamps: list[float] = field(default_factory=list)
    _recorded: list[float] = field(default_factory=list)
    _ranges: list[NDArray[np.float32]] = field(default_factory=list)
    _notes: list[str] = field(default_factory=list)

    def add(self, message: BagMessage) -> None:
        """Add one message.

        Raises
        ------
        FormatError
            If the scan is empty, its angles make no sense, or the limits or the frame differ from those of the first
            message; the topic and the message's number are named.
        """
        scan = message.content
        ranges = np.asarray(scan.ranges, dtype=np.float32)
        if len(ranges) == 0:
            raise self._error(message.place, "the scan has no beams")
        geometry = ScanGeometry(float(scan.angle_min), float(scan.angle_increment), len(ranges))
        try:
            _check_geometry(*geometry)
        except InvalidInputError as error:
            raise self._error(message.place, str(error)) from error
        if self._geometries:
            self._compare(message)
        else:
            self._begin(message, geometry)
        self._geometries.append(geometry)
        self._stamps.append(message.stamp)
        self._recorded.append(message.recorded)
        self._ranges.append(ranges)

    def __len__(self) -> int:
        return len(self._stamps)

    def finish(self) -> LaserScans:
        """Return the scans, sorted by their stamps.

        Raises
        ------
        FormatError
            If there are none, the stamps go backwards as `ordered_stamps` does not allow, no range is a number, or a
            scan has no beam in the direction of any other's.
        """
        if not self._geometries:
            raise FormatError(self.path, "the topic holds no scans", field=self.topic)
        # Damaged messages may hold signalling NaNs, of which NumPy would warn.
        with np.errstate(invalid="ignore"):
            gridded = on_one_grid(self._ranges, self._geometries)
            if gridded.elsewhere is not None:
                raise self._looks_elsewhere(gridded.elsewhere)
            ranges = gridded.ranges.astype(np.float64)
        if np.isnan(ranges).all():
            raise FormatError(
                self.path, f"every range of all {len(ranges)} scans is NaN (no measurement)", field=self.topic
            )
        recorded = np.array(self._recorded)
        stamps, order = ordered_stamps(np.array(self._stamps), self.path, self.topic, self._notes, recorded)
        ranges = ranges if np.array_equal(order, np.arange(len(ranges))) else ranges[order]
        self._notes += [f"{self.topic}: {note}" for note in gridded.notes]
        at_once = np.flatnonzero(np.diff(stamps) == 0.0)
        if repeated := sum(np.array_equal(ranges[i], ranges[i + 1], equal_nan=True) for i in at_once):
            self._notes.append(
                f"{self.topic}: {repeated} of {len(stamps)} scans repeat the one before, stamp and readings"
            )
        return LaserScans(
            topic=self.topic,
            frame=self._frame,
            bearings=_bearings(gridded.grid),
            range_min=self._limits[0],
            range_max=self._limits[1],
            stamps=stamps,
            ranges=ranges,
            notes=tuple(self._notes),
            lag=float(np.median(np.subtract(self._recorded, self._stamps))) if self._are_stamped() else np.nan,
        )

    def _begin(self, message: BagMessage, geometry: ScanGeometry) -> None:
        angle_min, increment, n_beams = geometry
        declared = (float(message.content.angle_max) - angle_min) / increment + 1.0 if increment else 1.0
        if abs(declared - n_beams) > 1.5:
            self._notes.append(
                f"{self.topic}: angle_min, angle_max and angle_increment make {declared:.1f} beams, but the scans have "
                f"{n_beams}; beam i is taken at angle_min + i angle_increment"
            )
        self._limits = (float(message.content.range_min), float(message.content.range_max))
        frame = message.content.header.frame_id
        if not isinstance(frame, str):
            raise self._error(message.place, f"expected a frame_id, got {frame!r}")
        self._frame = strip_slash(frame)

    def _compare(self, message: BagMessage) -> None:
        scan = message.content
        limits = (float(scan.range_min), float(scan.range_max))
        for option, now, first, given in zip(("min_range", "max_range"), limits, self._limits, self.given, strict=True):
            if given is None and not np.array_equal(now, first, equal_nan=True):
                raise self._error(
                    message.place,
                    f"range_{option[:3]} {now:.6g} m differs from that of the first scan, {first:.6g} m; give {option}",
                )
        frame = strip_slash(scan.header.frame_id)
        if frame != self._frame:
            raise self._error(
                message.place,
                f"frame_id {frame!r} differs from that of the first scan, {self._frame!r}: cut the bag there, "
                "or have two sensors publish on two topics",
            )

    def _looks_elsewhere(self, scan: int) -> FormatError:
        angle_min, increment, n_beams = self._geometries[scan]
        return self._error(
            f"{self.topic}, message {scan + 1}",
            f"angle_min {angle_min!r}, angle_increment {increment!r} and {n_beams} beams: it has no beam where most "
            "scans of the topic have theirs; do two sensors publish there?",
        )

    def _are_stamped(self) -> bool:
        return len(self._stamps) < 2 or len(set(self._stamps)) > 1

    def _error(self, place: str, text: str) -> FormatError:
        return FormatError(self.path, text, field=place)


def _check_geometry(angle_min: float, increment: float, n_beams: int) -> None:
    if not np.isfinite([angle_min, increment]).all() or (n_beams > 1 and increment == 0.0):
        raise InvalidInputError(
            "expected a finite angle_min and an angle_increment that is not 0, "
            f"got angle_min {angle_min!r} and angle_increment {increment!r}"
        )
    span = abs(increment) * (n_beams - 1)
    if span > 2.1 * np.pi:
        raise InvalidInputError(
            f"the beams span {span:.6g} rad, more than a full turn (angle_increment {increment!r}: degrees?)"
        )


def _bearings(geometry: ScanGeometry) -> FloatArray:
    angles = geometry.angles
    # Some drivers go on counting after a full turn.
    return angles if np.abs(angles).max() <= 2.0 * np.pi else wrap_angle(angles)


def is_one_of(ranges: FloatArray, values: Iterable[float]) -> NDArray[np.bool_]:
    """Return which ranges, of any shape, are one of some values, as float32 holds them; NaN is equal to NaN here."""
    found = np.zeros(ranges.shape, dtype=bool)
    for value in values:
        found |= np.isnan(ranges) if np.isnan(value) else ranges == float(np.float32(value))
    return found


def ordered_stamps(
    stamps: FloatArray, path: Path, topic: str, notes: list[str], recorded: FloatArray | None = None
) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return the stamps of t messages sorted, and the indices of these messages.

    Times of recording (t,) replace stamps that are all equal, with a note. Messages may overtake each other on the way
    to the recorder: that is sorted, and a note added that says so. Few with a stamp that is wrong alone are left out,
    with a note. A clock that runs backwards, by more than `STAMP_TOLERANCE` at more than few single messages, is a
    FormatError.
    """
    if recorded is not None and len(stamps) > 1 and (stamps == stamps[0]).all():
        notes.append(
            f"{topic}: every header stamp is {stamps[0]:.10g}; receive times are used instead, but ROS drops such "
            "messages: the driver, or the node that makes them, has to stamp them"
        )
        stamps = recorded
    stray = _stray(stamps)
    if stray.any():
        wrong = int(np.argmax(stray))
        neighbour = stamps[wrong + 1 if wrong + 1 < len(stamps) else wrong - 1]
        notes.append(
            f"{topic}: {stray.sum()} of {len(stamps)} messages left out, whose stamps alone are wrong (message "
            f"{wrong + 1}: {stamps[wrong]:.6f} s, beside one of {neighbour:.6f} s)"
        )
    kept = np.flatnonzero(~stray)
    stamps = stamps[kept]
    latest = np.maximum.accumulate(stamps)
    behind = latest - stamps
    late = behind > STAMP_TOLERANCE
    delayed = late & (behind <= LATEST) & np.append(behind[1:] == 0.0, False)
    if (late > delayed).any() or delayed.sum() > max(1.0, LATE_SHARE * len(stamps)):
        where = int(np.argmax(late))
        raise FormatError(
            path,
            f"the stamps run backwards, from {latest[where - 1]:.6f} to {stamps[where]:.6f} s; cut the bag there",
            field=f"{topic}, message {kept[where] + 1}",
        )
    swapped = int(np.count_nonzero(behind))
    if swapped:
        notes.append(
            f"{topic}: {swapped} of {len(stamps)} messages came after later ones, by up to {behind.max():.3g} s, "
            "and are sorted by their stamps"
        )
    order = np.argsort(stamps, kind="stable")
    return stamps[order], kept[order]


def _stray(stamps: FloatArray) -> NDArray[np.bool_]:
    """Return which messages (t,) are stamped out of order while their neighbours are in order; none if that is common.

    After a clock was set the neighbours are not, and a message that another has overtaken is behind one alone.
    """
    before, after = np.append(-np.inf, stamps[:-1]), np.append(stamps[1:], np.inf)
    after_next = np.full(len(stamps), -np.inf)
    after_next[:-2] = stamps[2:]
    between = before <= after
    ahead = between & (stamps - after > STAMP_TOLERANCE) & (stamps > after_next)
    behind = between & (before - stamps > LATEST) & ~np.append(False, ahead[:-1])
    stray = ahead | behind
    return stray if stray.sum() <= max(1.0, LATE_SHARE * len(stamps)) else np.zeros(len(stamps), dtype=bool)
