"""The scans of one sensor of a text log, from lines to a `SensorLog`; all text formats end here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray, as_poses, between, compose, wrapped
from beamfield.io.files.text_lines import Line
from beamfield.io.logs.scan_stamps import ScanStamps, StampRule, resolve_stamps
from beamfield.io.no_return import NoReturnRule, resolve_no_return
from beamfield.sensors import NO_POSE, RangeFinder, SensorLog, Track

LonePoses = Literal["reference", "odometry"]

# A robot that stands still may read the same range on a beam forever; one that moves this far does not.
MOVED = 1.0
SCANS_FOR_STUCK = 50
# Metres or radians; no place on Earth is so far away, and arithmetic with such numbers overflows sooner or later.
ABSURD = 1e9


@dataclass(frozen=True)
class TextOptions:
    """What a user may say about a text log; see `beamfield.io.read_log.read_log`."""

    sensors: tuple[str, ...] | None = None
    no_return: NoReturnRule = "detect"
    max_range: float | None = None
    min_range: float | None = None
    stamps: StampRule = "file"
    lone_poses: LonePoses = "reference"

    def __post_init__(self) -> None:
        if self.lone_poses not in ("reference", "odometry"):
            raise InvalidInputError(f"lone_poses: expected 'reference' or 'odometry', got {self.lone_poses!r}")

    def wants(self, name: str) -> bool:
        """Whether the sensor of that name is asked for."""
        return self.sensors is None or name in self.sensors


DEFAULTS = TextOptions()


@dataclass(eq=False)
class TextScans:
    """Collects the scans of one sensor, line by line.

    Parameters
    ----------
    path
        The file, for errors.
    name
        The sensor's message name, for errors and notes.
    """

    path: Path
    name: str
    lines: list[int] = field(default_factory=list)
    ranges: list[FloatArray] = field(default_factory=list)
    poses: list[FloatArray] = field(default_factory=list)
    odometry: list[FloatArray] = field(default_factory=list)
    stamps: list[Sequence[float]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.lines)

    def add(
        self,
        line: int,
        ranges: FloatArray,
        stamps: Sequence[float],
        pose: FloatArray = NO_POSE,
        odometry: FloatArray = NO_POSE,
    ) -> None:
        """Add one scan of a line: ranges (k,) in metres as in the file, stamps in seconds, the preferred clock's first.

        The poses (3,) are NaN where the format has none. FormatError, with line and counts, if the scan is empty or the
        number of beams changes.
        """
        if len(ranges) == 0:
            raise self.error(line, "the scan has no readings")
        if self.ranges and len(ranges) != len(self.ranges[0]):
            raise self.error(
                line,
                f"the scan has {len(ranges)} beams, the first one (line {self.lines[0]}) has {len(self.ranges[0])}",
            )
        absurd = np.isfinite(ranges) & (np.abs(ranges) > ABSURD)
        if absurd.any():
            raise self.error(line, f"expected a range in metres, got {float(ranges[np.argmax(absurd)])!r}")
        self.lines.append(line)
        self.ranges.append(ranges)
        self.stamps.append(stamps)
        self.poses.append(pose)
        self.odometry.append(odometry)

    def error(self, line: int | None, text: str) -> FormatError:
        """Return the error for a line of this sensor."""
        return FormatError(self.path, text, line=line, field=self.name)

    def constant_mount(self, mounts: FloatArray, tolerance: float) -> FloatArray:
        """Return the sensor's pose on the robot, (3,): the median of what the scans (t, 3) say.

        FormatError names line and poses of a scan that is further from it than the tolerance, metres and radians.
        """
        mount = middle_mount(mounts)
        off = np.abs(between(mount, mounts)).max(axis=1)
        if off.max() > tolerance:
            worst = int(np.argmax(off))
            raise self.error(
                self.lines[worst],
                f"the laser moves on the robot: its mount is {mounts[worst].round(4).tolist()}, elsewhere "
                f"{mount.round(4).tolist()}",
            )
        return mount

    def resolve_stamps(self, rule: StampRule) -> ScanStamps:
        """Return stamps that do not decrease; see `beamfield.io.logs.scan_stamps.resolve_stamps`."""
        stamps, ranges = np.array(self.stamps), np.stack(self.ranges)
        repeated = np.zeros(len(self), bool)
        repeated[1:] = (stamps[1:] == stamps[:-1]).all(axis=1)
        repeated[1:] &= ((ranges[1:] == ranges[:-1]) | np.isnan(ranges[1:]) & np.isnan(ranges[:-1])).all(axis=1)
        return resolve_stamps(self.path, self.name, self.lines, stamps, rule, repeated)

    def finish(
        self,
        mounts: ArrayLike,
        options: TextOptions,
        *,
        stamps: ScanStamps | None = None,
        poses: FloatArray | None = None,
        odometry: FloatArray | None = None,
        declared_max: float | None = None,
        declared_min: float = 0.0,
        opening_angle: float = 0.0,
    ) -> tuple[SensorLog, list[str]]:
        """Return the log of the sensor and notes on it.

        Stamps, poses and odometry (t, 3) stand for those that were collected; limits are those that the file or the
        format declares. Mounts are (k, 3), the opening angle is the full width of the cones. FormatError if no reading
        of the sensor is a number, or the stamps go backwards.
        """
        raw = np.stack(self.ranges)
        if np.isnan(raw).all():
            raise self.error(self.lines[0], f"every reading of all {len(self)} scans is NaN (no measurement)")
        time = stamps or self.resolve_stamps(options.stamps)
        reference = np.stack(self.poses) if poses is None else poses
        driven = np.stack(self.odometry) if odometry is None else odometry
        stuck = _stuck_beams(raw, reference, driven)
        masked = raw.copy()
        masked[:, stuck] = np.nan
        resolved = resolve_no_return(
            masked, rule=options.no_return, declared_max=declared_max, max_range=options.max_range
        )
        z = resolved.ranges
        z[:, stuck] = np.nan
        notes = [*time.notes, *(f"{self.name}: {note}" for note in resolved.notes)]
        for beam in np.flatnonzero(stuck):
            value = float(raw[0, beam])
            if value >= resolved.max_range or value in resolved.policy.values:
                z[:, beam] = np.inf
            else:
                notes.append(
                    f"{self.name}: beam {beam} reads {value:.6g} m in all {len(self)} scans while the robot moves: "
                    "taken as no measurement"
                )
        silent = int(np.count_nonzero(np.isnan(z).all(axis=1)))
        if silent:
            notes.append(f"{self.name}: {silent} of {len(self)} scans have no measurement at all")
        low = declared_min if options.min_range is None else options.min_range
        finder = RangeFinder(
            as_poses(mounts), resolved.max_range, min_range=low, opening_angle=opening_angle, name=self.name
        )
        return SensorLog(finder, time.seconds, z, reference, driven, resolved.policy), notes


def middle_mount(mounts: FloatArray) -> FloatArray:
    """Return the median (3,) of mounts (t, 3)."""
    # Seen from the first: headings of a sensor at the rear are rounded to pi or to nearly -pi.
    return compose(mounts[0], np.median(between(mounts[0], mounts), axis=0))


def finite_pose(line: Line, pose: FloatArray, field: str | None = None) -> FloatArray:
    """Return a pose with its heading in (-pi, pi]; if it is not finite, raise a FormatError with line and value."""
    x, y, theta = numbers = pose.tolist()
    if not all(abs(number) < ABSURD for number in numbers):
        raise line.error(f"expected a finite pose, got {' '.join(map(str, numbers))}", field or line.words[0])
    return np.array([x, y, wrapped(theta)])


def sorted_track(stamps: ArrayLike, poses: ArrayLike, name: str, notes: list[str], *, numbered: bool) -> Track | None:
    """Return a track sorted by its stamps; None if they are lost, the scans have none, or there are no poses.

    Messages of several programs reach a log in any order, and every pose has its own stamp, so sorting changes no data.
    The name is for notes. If the scans are numbered, no time can be matched to them.
    """
    times = np.asarray(stamps, dtype=np.float64)
    if not len(times):
        return None
    if numbered:
        notes.append(f"{name}: left out: scans are numbered, and these times cannot be matched to them")
        return None
    track = np.asarray(poses, dtype=np.float64)
    if not np.isfinite(times).all() or len(np.unique(times)) <= len(times) / 2:
        notes.append(f"{name}: the stamps are lost, so there is no odometry at its own rate")
        return None
    n_back = int(np.count_nonzero(np.diff(times) < 0.0))
    if n_back:
        notes.append(f"{name}: {n_back} of {len(times)} messages come before an earlier one; sorted by their stamps")
    order = np.argsort(times, kind="stable")
    return Track(times[order], track[order])


def _stuck_beams(raw: FloatArray, *tracks: FloatArray) -> NDArray[np.bool_]:
    """Return which beams read one value > 0 always although the robot moves."""
    moved = any(_extent(track) > MOVED for track in tracks)
    if len(raw) < SCANS_FOR_STUCK or not moved:
        return np.zeros(raw.shape[1], dtype=bool)
    return np.asarray((raw == raw[0]).all(axis=0) & (raw[0] > 0.0) & np.isfinite(raw[0]))


def _extent(track: FloatArray) -> float:
    positions = track[np.isfinite(track).all(axis=1), :2]
    return float(np.ptp(positions, axis=0).max()) if len(positions) else 0.0
