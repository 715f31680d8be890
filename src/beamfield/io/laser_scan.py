"""sensor_msgs/LaserScan messages: bearings, limits, ranges, and what each sensor means by "no return"."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.bag_file import BagMessage
from beamfield.sensors import NoReturnPolicy

NoReturnRule = Literal["detect", "none"] | tuple[float, ...]

STAMP_TOLERANCE = 0.5  # seconds: neighbours may swap on a lossy network; a clock that was set jumps further
BEARING_TOLERANCE = 1e-3  # radians: what the geometry may change between the messages of one topic
FREQUENT = 0.01  # share of all readings from which a special value counts as the sensor's way to say "no return"
RARE = 0.001


@dataclass(frozen=True, eq=False)
class LaserScans:
    """All scans of one topic.

    Parameters
    ----------
    topic, frame
        Where they were published, and the frame of the sensor.
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
    """

    topic: str
    frame: str
    bearings: FloatArray
    range_min: float
    range_max: float
    stamps: FloatArray
    ranges: FloatArray
    notes: tuple[str, ...] = ()


@dataclass(eq=False)
class LaserScanCollector:
    """Collects the messages of one topic and checks that they belong together.

    The direction of beam i is ``angle_min + i angle_increment``, computed in float64 from the float32 fields, whose
    rounding leaves it less than 1e-6 radians off. The increment may be negative.

    Parameters
    ----------
    path
        The bag, for errors.
    topic
        The topic, for errors.
    """

    path: Path
    topic: str
    _geometry: tuple[float, float] | None = None
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
            If the scan is empty, its angles make no sense, or the number of beams, the angles, the limits or the frame
            differ from those of the first message; the topic and the message's number are named.
        """
        scan = message.content
        ranges = np.asarray(scan.ranges, dtype=np.float32)
        if len(ranges) == 0:
            raise self._error(message, "the scan has no beams")
        geometry = (float(scan.angle_min), float(scan.angle_increment))
        if self._geometry is None:
            self._begin(message, geometry, len(ranges))
        else:
            self._compare(message, geometry, len(ranges))
        self._stamps.append(message.stamp)
        self._recorded.append(message.recorded)
        self._ranges.append(ranges)

    def finish(self) -> LaserScans:
        """Return the scans, sorted by their stamps.

        Raises
        ------
        FormatError
            If there are none, the stamps run backwards by more than `STAMP_TOLERANCE`, or no range is a number.
        """
        if self._geometry is None:
            raise FormatError(self.path, "the topic holds no scans", field=self.topic)
        ranges = np.stack(self._ranges).astype(np.float64)
        if np.isnan(ranges).all():
            raise FormatError(
                self.path, f"every range of all {len(ranges)} scans is NaN (no measurement)", field=self.topic
            )
        stamps, order = self._ordered_stamps()
        angle_min, increment = self._geometry
        return LaserScans(
            topic=self.topic,
            frame=self._frame,
            bearings=np.asarray(angle_min + increment * np.arange(ranges.shape[1]), dtype=np.float64),
            range_min=self._limits[0],
            range_max=self._limits[1],
            stamps=stamps,
            ranges=ranges[order],
            notes=tuple(self._notes),
        )

    def _begin(self, message: BagMessage, geometry: tuple[float, float], n_beams: int) -> None:
        angle_min, increment = geometry
        if not np.isfinite(geometry).all() or (n_beams > 1 and increment == 0.0):
            raise self._error(
                message,
                "expected a finite angle_min and an angle_increment that is not 0, "
                f"got angle_min {angle_min!r} and angle_increment {increment!r}",
            )
        span = abs(increment) * (n_beams - 1)
        if span > 2.1 * np.pi:
            raise self._error(
                message,
                f"the beams span {span:.6g} rad, more than a full turn (angle_increment {increment!r}: degrees?)",
            )
        declared = (float(message.content.angle_max) - angle_min) / increment + 1.0 if increment else 1.0
        if abs(declared - n_beams) > 1.5:
            self._notes.append(
                f"{self.topic}: angle_min, angle_max and angle_increment make {declared:.1f} beams, but the scans have "
                f"{n_beams}; beam i is taken at angle_min + i angle_increment"
            )
        self._geometry = geometry
        self._limits = (float(message.content.range_min), float(message.content.range_max))
        self._frame = message.content.header.frame_id

    def _compare(self, message: BagMessage, geometry: tuple[float, float], n_beams: int) -> None:
        scan = message.content
        known = len(self._ranges[0])
        if n_beams != known:
            raise self._error(message, f"the scan has {n_beams} beams, the first scan of the topic has {known}")
        first = self._geometry or geometry
        shift = np.subtract(geometry, first)
        worst = max(abs(shift[0]), abs(shift[0] + shift[1] * (n_beams - 1)))
        if not worst <= BEARING_TOLERANCE:
            raise self._error(
                message,
                f"angle_min {geometry[0]!r} and angle_increment {geometry[1]!r} differ from those of the first scan, "
                f"{first[0]!r} and {first[1]!r}",
            )
        limits = (float(scan.range_min), float(scan.range_max))
        if not np.array_equal(limits, self._limits, equal_nan=True):
            raise self._error(
                message, f"range_min, range_max {limits} differ from those of the first scan, {self._limits}"
            )
        if scan.header.frame_id != self._frame:
            raise self._error(
                message, f"frame_id {scan.header.frame_id!r} differs from that of the first scan, {self._frame!r}"
            )

    def _ordered_stamps(self) -> tuple[FloatArray, NDArray[np.intp]]:
        stamps = np.array(self._stamps)
        if len(stamps) > 1 and not stamps.any():
            self._notes.append(f"{self.topic}: every header stamp is 0; the times of recording are used instead")
            stamps = np.array(self._recorded)
        return ordered_stamps(stamps, self.path, self.topic, self._notes)

    def _error(self, message: BagMessage, text: str) -> FormatError:
        return FormatError(self.path, text, field=message.place)


def ordered_stamps(stamps: FloatArray, path: Path, topic: str, notes: list[str]) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return stamps sorted, and the order that sorts them.

    Messages may overtake each other on the way to the recorder: that is sorted, and a note says so. A clock that runs
    backwards is an error.

    Parameters
    ----------
    stamps
        (t,) seconds in the order of recording.
    path, topic
        For errors.
    notes
        Where to add a note.

    Raises
    ------
    FormatError
        If a stamp lies more than `STAMP_TOLERANCE` before one that was recorded earlier.
    """
    latest = np.maximum.accumulate(stamps)
    behind = latest - stamps
    if len(stamps) and behind.max() > STAMP_TOLERANCE:
        where = int(np.argmax(behind > STAMP_TOLERANCE))
        raise FormatError(
            path,
            f"the stamps run backwards, from {latest[where - 1]:.6f} to {stamps[where]:.6f} s",
            field=f"{topic}, message {where + 1}",
        )
    swapped = int(np.count_nonzero(behind))
    if swapped:
        notes.append(
            f"{topic}: {swapped} of {len(stamps)} messages came after later ones, by up to {behind.max():.3g} s, "
            "and are sorted by their stamps"
        )
    order = np.argsort(stamps, kind="stable")
    return stamps[order], order


def resolve_limits(
    scans: LaserScans, path: Path, min_range: float | None, max_range: float | None
) -> tuple[float, float]:
    """Return the range limits: the given ones, else those that the messages declare.

    Given limits are rounded to float32, as the ranges are: a sensor that answers 5.6 for "no return" writes
    5.599999904632568, which a max_range of 5.6 must include.

    Raises
    ------
    FormatError
        If the declared limits are not 0 <= range_min < range_max < inf and no others are given.
    InvalidInputError
        If a given limit is not a number, or not within the other.
    """
    low = scans.range_min if min_range is None else float(np.float32(min_range))
    high = scans.range_max if max_range is None else float(np.float32(max_range))
    if 0.0 <= low < high < np.inf:
        return low, high
    if min_range is not None and max_range is not None:
        raise InvalidInputError(f"expected 0 <= min_range < max_range < inf, got {min_range!r} and {max_range!r}")
    raise FormatError(
        path,
        f"expected limits 0 <= range_min < range_max < inf, got {low!r} and {high!r}; "
        "give min_range and max_range yourself",
        field=scans.topic,
    )


def mark_no_return(
    ranges: FloatArray, min_range: float, max_range: float, rule: NoReturnRule = "detect"
) -> tuple[FloatArray, NoReturnPolicy]:
    """Return ranges in which the sensor's own values for "no return" are +inf, and what was done.

    REP 117 needs no conversion: +inf, and what reaches max_range, is no return; NaN is no measurement; -inf, and what
    falls short of min_range, is too close. Where a driver says it otherwise, "detect" looks for it, only in data in
    which (almost) nothing else says "no return":

    1. zeros, if they are at least `FREQUENT`;
    2. one value below max_range that is the greatest of all and far more frequent than the values next to it.

    A zero that is not explained so is no range: it becomes NaN if min_range is 0 (else it is too close anyway).

    Parameters
    ----------
    ranges
        (t, k) metres, as published, of float32 precision.
    min_range, max_range
        The sensor's limits, metres.
    rule
        "detect"; "none" to convert nothing; or the values (metres, NaN is allowed) that mean "no return".

    References
    ----------
    REP 117, "Informational Distance Measurements".
    """
    if rule == "none":
        return ranges, NoReturnPolicy(explanation="not looked for, as asked")
    if not isinstance(rule, str):
        return _convert_given(ranges, rule)
    if rule != "detect":
        raise InvalidInputError(f"no_return: expected 'detect', 'none' or a tuple of metres, got {rule!r}")
    with np.errstate(invalid="ignore"):
        declared = float(np.mean(ranges >= max_range))
    zero = ranges == 0.0
    zeros = float(zero.mean())
    if declared < RARE and zeros >= FREQUENT:
        return _converted(ranges, zero, (0.0,), "detected", "are 0 and nothing else says that nothing came back")
    special = _find_repeated_maximum(ranges) if declared < RARE else None
    if special is not None:
        return _converted(
            ranges, ranges == special, (special,), "detected", f"are exactly {special:.6g} m, the greatest of all"
        )
    text = (
        f"{declared:.2%} of the readings are +inf or reach {max_range:.6g} m"
        if declared
        else f"no reading is +inf or reaches {max_range:.6g} m"
    )
    if zeros and min_range <= 0.0:
        text += f"; {zeros:.2%} are 0, taken as no measurement"
        ranges = np.where(zero, np.nan, ranges)
    missing = float(np.isnan(ranges).mean())
    if declared < RARE and missing >= FREQUENT:
        text += f"; {missing:.2%} are NaN: no measurement, unless no_return names NaN as this sensor's word for it"
    return ranges, NoReturnPolicy(share=declared, origin="declared" if declared else "none", explanation=text)


def _convert_given(ranges: FloatArray, values: tuple[float, ...]) -> tuple[FloatArray, NoReturnPolicy]:
    mask = np.zeros(ranges.shape, dtype=bool)
    for value in values:
        mask |= np.isnan(ranges) if np.isnan(value) else ranges == float(np.float32(value))
    listed = ", ".join(f"{v:.6g}" for v in values)
    return _converted(ranges, mask, tuple(float(v) for v in values), "given", f"are one of the given values ({listed})")


def _converted(ranges: FloatArray, mask: NDArray[np.bool_], values: tuple[float, ...], origin: str,
               why: str) -> tuple[FloatArray, NoReturnPolicy]:  # fmt: skip
    share = float(mask.mean())
    return np.where(mask, np.inf, ranges), NoReturnPolicy(values, share, origin, f"{share:.2%} of the readings {why}")


def _find_repeated_maximum(ranges: FloatArray) -> float | None:
    """Return the greatest value if it is repeated as no measurement is: more than ten times as often as others near."""
    finite: Any = ranges[np.isfinite(ranges) & (ranges > 0.0)]
    if len(finite) == 0:
        return None
    top = float(finite.max())
    near, counts = np.unique(finite[finite >= 0.9 * top], return_counts=True)
    repeated = int(counts[-1])
    others = int(counts[:-1].max()) if len(near) > 1 else 0
    # In data that are one value only, that value may be a wall: nothing to compare it with.
    alone = repeated == len(finite)
    if alone or repeated < max(20, 2 * RARE * ranges.size) or repeated <= 10 * others:
        return None
    return top
