"""Pose messages of a bag as trajectories: nav_msgs/Odometry, PoseStamped and PoseWithCovarianceStamped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, between, compose, interpolate_poses
from beamfield.io.bags.bag_file import BagMessage
from beamfield.io.bags.frames import Transforms, find_fault, rotate, strip_slash
from beamfield.io.bags.laser_scan import ordered_stamps
from beamfield.sensors import MAX_GAP, Track

ODOMETRY = "nav_msgs/msg/Odometry"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_WITH_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
POSE_TYPES = (ODOMETRY, POSE_WITH_COVARIANCE, POSE_STAMPED)

SPARSE = 0.2  # seconds: poses further apart than this are bridged by odometry, if there is any
MOST_TILT_DEG = 20.0  # of the poses of a robot on the floor


@dataclass(eq=False)
class PoseTopicCollector:
    """Collects the poses of one topic; they are checked when they are used, so that unused ones cannot stop a reader.

    Path and topic are for errors. The frames are those of the first message; `child` is empty where the type or the
    publisher does not say it.
    """

    path: Path
    topic: str
    frame: str = ""
    child: str = ""
    is_odometry: bool = False
    _stamps: list[float] = field(default_factory=list)
    _recorded: list[float] = field(default_factory=list)
    _rows: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, message: BagMessage) -> None:
        """Add one message of a type in `POSE_TYPES`."""
        content = message.content
        if not self._stamps:
            self.frame = strip_slash(content.header.frame_id)
            self.is_odometry = message.msgtype == ODOMETRY
            self.child = strip_slash(getattr(content, "child_frame_id", ""))
        pose = content.pose if message.msgtype == POSE_STAMPED else content.pose.pose
        p, q = pose.position, pose.orientation
        self._stamps.append(message.stamp)
        self._recorded.append(message.recorded)
        self._rows.append(tuple(map(float, (p.x, p.y, p.z, q.x, q.y, q.z, q.w))))

    def __len__(self) -> int:
        return len(self._stamps)

    def track(self, notes: list[str], child_from_base: Transforms, target_from_frame: Transforms) -> Track:
        """Return the robot's poses in the plane, one or more, sorted by time; of equal stamps the last one counts.

        Two constant motions lead to the robot from the frame that the topic is of, which may be tilted as a camera is,
        and to the frame that is asked for from the one that the poses are in, whose z may not point upwards.

        FormatError names topic and message if a pose is not finite, its quaternion is not of length 1, or the stamps go
        backwards.
        """
        rows = np.array(self._rows, dtype=np.float64)
        self._check(rows)
        rotation = rows[:, 3:] / np.linalg.norm(rows[:, 3:], axis=1, keepdims=True)
        robots = target_from_frame @ Transforms(rows[:, :3], rotation) @ child_from_base
        poses = robots.planar()
        self._note_tilt(robots, notes)
        # The one pose of a localizer that stands may be published again and again.
        recorded = np.array(self._recorded) if self.is_odometry else None
        stamps, order = ordered_stamps(np.array(self._stamps), self.path, self.topic, notes, recorded)
        last = np.append(np.diff(stamps) > 0, True)
        return Track(stamps[last], poses[order][last])

    def _note_tilt(self, robots: Transforms, notes: list[str]) -> None:
        up = rotate(robots.rotation, np.array([0.0, 0.0, 1.0]))[:, 2]
        tilt = float(np.degrees(np.arccos(np.clip(np.median(up), -1.0, 1.0))))
        if tilt > MOST_TILT_DEG:
            notes.append(
                f"{self.topic}: by its poses the robot is tilted by {tilt:.0f} degrees (median), so they are not those "
                f"of a robot on the floor: does z point upwards in the frame {self.frame!r}?"
            )

    def _check(self, rows: FloatArray) -> None:
        fault = find_fault(rows)
        if fault is not None:
            row, text = fault
            raise FormatError(self.path, f"pose: {text}", field=f"{self.topic}, message {row + 1}")


def poses_at(track: Track, stamps: FloatArray,
             odometry_at: Callable[[FloatArray], FloatArray] | None) -> tuple[FloatArray, bool]:  # fmt: skip
    """Return the poses (n, 3) of a track in the map at other times, and whether odometry bridged its gaps.

    A localiser publishes a pose when it has updated, every few decimetres, and none while the robot stands. Between two
    such poses the robot follows its odometry from either of them, and what is interpolated is where that leads: where
    the odometry's frame lies does not matter. Without bridging, poses are NaN in gaps, and always before the first one
    and after the last one.

    `odometry_at` returns the odometry's poses (n, 3) at given times, NaN where they are not known; None if there is
    none.
    """
    if odometry_at is not None and len(track) > 1 and float(np.median(np.diff(track.stamps))) > SPARSE:
        return _bridged(track, stamps, odometry_at(track.stamps), odometry_at(stamps)), True
    return interpolate_poses(track.stamps, track.poses, stamps, max_gap=MAX_GAP), False


def _bridged(track: Track, stamps: FloatArray, odometry: FloatArray, driven: FloatArray) -> FloatArray:
    """Return the poses (n, 3) at other times, given the odometry at the track's poses and at these times."""
    known = np.isfinite(odometry).all(axis=1)
    times, poses, odometry = track.stamps[known], track.poses[known], odometry[known]
    if not len(times):
        return np.full_like(driven, np.nan)
    after = np.clip(np.searchsorted(times, stamps), min(1, len(times) - 1), len(times) - 1)
    before = np.maximum(after - 1, 0)
    ahead, back = (compose(poses[i], between(odometry[i], driven)) for i in (before, after))
    length = times[after] - times[before]
    share = np.divide(stamps - times[before], length, out=np.zeros(len(stamps)), where=length > 0.0)
    result = compose(ahead, share[:, None] * between(ahead, back))
    result[(stamps < times[0]) | (stamps > times[-1])] = np.nan
    return result
