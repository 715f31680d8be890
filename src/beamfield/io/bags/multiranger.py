"""Four time-of-flight rangers on a Crazyflie, as arrays of bare numbers in infrastructure/RawData messages."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, interpolate_poses, wrap_angle, yaw_from_quaternion
from beamfield.io.bags.bag_file import BagMessage
from beamfield.io.bags.laser_scan import LaserScans, ordered_stamps
from beamfield.sensors import Track

RAW_DATA = "infrastructure/msg/RawData"
RANGES_TOPIC = "state_ranger_qxyzw"
POSITION_TOPIC = "state_xyzv"

# The rangers look right, forward, left and back. A VL53L1X measures from 0.04 m to 4 m, in a cone of 27 degrees.
BEARINGS = np.array([-np.pi / 2, 0.0, np.pi / 2, np.pi])
MIN_RANGE = 0.04
MAX_RANGE = 4.0
OPENING_ANGLE = float(np.deg2rad(27.0))


def ranger_topics(topics: dict[str, str]) -> dict[str, str]:
    """Return the topic of the position (or "") for each topic of ranges."""
    found = {}
    for topic, msgtype in topics.items():
        if msgtype == RAW_DATA and topic.endswith(RANGES_TOPIC):
            position = topic.removesuffix(RANGES_TOPIC) + POSITION_TOPIC
            found[topic] = position if topics.get(position) == RAW_DATA else ""
    return found


@dataclass(eq=False)
class RawDataCollector:
    """Collects the arrays of one topic, `width` numbers or more in each."""

    path: Path
    topic: str
    width: int
    _stamps: list[float] = field(default_factory=list)
    _rows: list[list[float]] = field(default_factory=list)

    def add(self, message: BagMessage) -> None:
        """Add one message; FormatError if it holds too few numbers, or one that is not finite."""
        # Damaged messages may hold signalling NaNs, of which NumPy would warn.
        with np.errstate(invalid="ignore"):
            raw = np.asarray(message.content.raw, dtype=np.float64)[: self.width]
        if len(raw) < self.width or not np.isfinite(raw).all():
            raise FormatError(
                self.path, f"expected {self.width} finite numbers, got {raw.tolist()}", field=message.place
            )
        self._stamps.append(message.stamp)
        self._rows.append(raw.tolist())

    def __len__(self) -> int:
        return len(self._stamps)

    def table(self, notes: list[str]) -> tuple[FloatArray, FloatArray]:
        """Return stamps (t,) in order and the numbers (t, width)."""
        stamps, order = ordered_stamps(np.array(self._stamps), self.path, self.topic, notes)
        return stamps, np.array(self._rows, dtype=np.float64).reshape(-1, self.width)[order]


def read_rangers(ranges: RawDataCollector, position: RawDataCollector | None) -> tuple[LaserScans, Track | None]:
    """Return the scans of the four rangers, and the flow odometry if its topic is there; FormatError without messages.

    A message of ranges holds four ranges, the height, and the attitude as a quaternion x, y, z, w; one of positions
    begins with x, y. The heading comes from the first, the position is interpolated from the second.
    """
    notes: list[str] = []
    stamps, table = ranges.table(notes)
    if len(stamps) == 0:
        raise FormatError(ranges.path, "the topic holds no scans", field=ranges.topic)
    notes.append(
        f"{ranges.topic}: four rangers at -90, 0, 90 and 180 degrees on a drone, roll and pitch not corrected; limits "
        f"{MIN_RANGE:g} to {MAX_RANGE:g} m are those of the VL53L1X"
    )
    track = None
    if position is not None:
        when, xyz = position.table(notes)
        where = interpolate_poses(when, np.column_stack([xyz[:, :2], np.zeros(len(xyz))]), stamps)
        heading = wrap_angle(yaw_from_quaternion(*table[:, 5:9].T))
        known = np.isfinite(where[:, 0])
        track = Track(stamps[known], np.column_stack([where[:, :2], heading])[known])
    return LaserScans(ranges.topic, "", BEARINGS, MIN_RANGE, MAX_RANGE, stamps, table[:, :4], tuple(notes)), track
