"""ROS 2 messages made and written, for what beamfield writes as a bag."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import require
from beamfield.errors import InvalidInputError, needs
from beamfield.geometry import FloatArray
from beamfield.sensors import RangeFinder

ANGLE_TOLERANCE = 1e-6  # radians: what float32 angles keep

if TYPE_CHECKING:
    from rosbags.interfaces import Qos
    from rosbags.typesys.store import Typestore


@dataclass(frozen=True)
class Message:
    """One message: when, where, and what."""

    nanoseconds: int
    topic: str
    content: Any


@dataclass(frozen=True)
class MessageMaker:
    """Makes messages of the types that a typestore knows.

    Parameters
    ----------
    typestore
        Of rosbags; see `load_typestore`.
    """

    typestore: Typestore

    def at(self, stamp: float, topic: str, content: Any) -> Message:
        """Return a message for a topic."""
        time = self.time(stamp)
        return Message(time.sec * 10**9 + time.nanosec, topic, content)

    def new(self, msgtype: str, *fields: Any) -> Any:
        """Return a message with its fields in the order of its definition."""
        return self.typestore.types[msgtype](*fields)

    def time(self, stamp: float) -> Any:
        """Return a builtin_interfaces/Time."""
        require(0.0 <= stamp < 2**31, "stamps", "seconds within [0, 2^31), as ROS 2 times are", stamp)
        second = math.floor(stamp)
        nanosecond = round((stamp - second) * 1e9)
        return self.new("builtin_interfaces/msg/Time", second + nanosecond // 10**9, nanosecond % 10**9)

    def header(self, stamp: float, frame: str) -> Any:
        """Return a std_msgs/Header."""
        return self.new("std_msgs/msg/Header", self.time(float(stamp)), frame)

    def vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        """Return a geometry_msgs/Vector3 or Point."""
        return self.new(f"geometry_msgs/msg/{kind}", float(x), float(y), float(z))

    def turn(self, heading: float) -> Any:
        """Return the geometry_msgs/Quaternion of a heading in radians."""
        return self.new("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))

    def pose(self, pose: ArrayLike) -> Any:
        """Return the geometry_msgs/Pose of x, y, heading."""
        x, y, heading = np.asarray(pose, dtype=np.float64)
        return self.new("geometry_msgs/msg/Pose", self.vector(x, y, 0.0, "Point"), self.turn(heading))

    def pose_with_covariance(self, stamp: float, frame: str, pose: ArrayLike, covariance: FloatArray | None) -> Any:
        """Return a geometry_msgs/PoseWithCovarianceStamped; a covariance (3, 3) of x, y, heading, or None for zeros."""
        six = np.zeros((6, 6))
        if covariance is not None:
            six[np.ix_([0, 1, 5], [0, 1, 5])] = covariance
        content = self.new("geometry_msgs/msg/PoseWithCovariance", self.pose(pose), six.ravel())
        return self.new("geometry_msgs/msg/PoseWithCovarianceStamped", self.header(stamp, frame), content)

    def transform(self, parent: str, child: str, stamp: float, pose: ArrayLike) -> Any:
        """Return a geometry_msgs/TransformStamped."""
        x, y, heading = np.asarray(pose, dtype=np.float64)
        moved = self.new("geometry_msgs/msg/Transform", self.vector(x, y, 0.0), self.turn(heading))
        return self.new("geometry_msgs/msg/TransformStamped", self.header(stamp, parent), child, moved)

    def tf(self, parent: str, child: str, stamp: float, pose: ArrayLike) -> Message:
        """Return a message for /tf."""
        moved = [self.transform(parent, child, stamp, pose)]
        return self.at(stamp, "/tf", self.new("tf2_msgs/msg/TFMessage", moved))

    def laser_scan(
        self, stamp: float, frame: str, ranges: FloatArray, finder: RangeFinder, bearings: tuple[float, float]
    ) -> Any:
        """Return a sensor_msgs/LaserScan; the bearings are those of `even_bearings`."""
        first, step = bearings
        last = first + step * (finder.n_beams - 1)
        return self.new(
            "sensor_msgs/msg/LaserScan", self.header(stamp, frame), first, last, step, 0.0, 0.0,
            finder.min_range, finder.max_range, ranges.astype(np.float32), np.empty(0, dtype=np.float32),
        )  # fmt: skip


def even_bearings(finder: RangeFinder, topic: str) -> tuple[float, float]:
    """Return angle_min and angle_increment of a sensor, in the robot's frame; refuse one that cannot be a LaserScan."""
    if finder.n_beams == 0:
        raise InvalidInputError(f"{topic}: expected a sensor with beams, got none")
    origins = finder.mounts[:, :2]
    if np.abs(origins - origins[0]).max() > ANGLE_TOLERANCE:
        raise InvalidInputError(
            f"{topic}: a LaserScan's beams start at one point, but the mounts of this sensor differ"
        )
    bearings = np.unwrap(finder.bearings)
    step = float((bearings[-1] - bearings[0]) / max(1, finder.n_beams - 1))
    even = bearings[0] + step * np.arange(finder.n_beams)
    worst = float(np.abs(even - bearings).max())
    if worst > ANGLE_TOLERANCE:
        raise InvalidInputError(
            f"{topic}: a LaserScan's bearings are evenly spaced, but this sensor's are up to {worst:.3g} rad off"
        )
    return float(bearings[0]), step


def load_typestore() -> Typestore:
    """Return the message definitions of the newest ROS 2; MissingDependencyError if rosbags is not installed."""
    with needs("rosbags", "ros", "writing a bag"):
        import rosbags.rosbag2  # noqa: F401 - for `write_messages`
        from rosbags.typesys import Stores, get_typestore
    return get_typestore(Stores.LATEST)


def write_messages(
    folder: Path,
    messages: Sequence[Message],
    typestore: Typestore,
    *,
    latched: Collection[str] = ("/tf_static",),
) -> None:
    """Make a folder with a bag of messages, in the order of time, whose types the typestore knows.

    The file in it, of the kind mcap, has its name. Late listeners get the last message of latched topics.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    connections: dict[str, Any] = {}
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for message in messages:
            msgtype = message.content.__msgtype__
            if message.topic not in connections:
                qos = [_latched()] if message.topic in latched else []
                connections[message.topic] = writer.add_connection(
                    message.topic, msgtype, typestore=typestore, offered_qos_profiles=qos
                )
            raw = typestore.serialize_cdr(message.content, msgtype)
            writer.write(connections[message.topic], message.nanoseconds, raw)


def _latched() -> Qos:
    """Return the quality of service without which a replay does not reach late listeners."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    unlimited = QosTime(2147483647, 4294967295)
    return Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        unlimited,
        unlimited,
        QosLiveliness.AUTOMATIC,
        unlimited,
        avoid_ros_namespace_conventions=False,
    )
