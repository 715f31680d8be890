"""Write a log of scans as a ROS 2 bag, for ROS tools and for `read_bag`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from beamfield.errors import InvalidInputError, MissingDependencyError
from beamfield.geometry import FloatArray, compose, interpolate_poses, invert
from beamfield.io.files.atomic import atomic_folder
from beamfield.sensors import RangeFinder, ScanLog, Track

if TYPE_CHECKING:
    from rosbags.interfaces import Qos
    from rosbags.typesys.store import Typestore

ANGLE_TOLERANCE = 1e-6  # radians: what float32 angles keep
POSE_TOLERANCE = 1e-9
NO_COVARIANCE = np.zeros(36)


def write_bag(
    path: str | Path,
    log: ScanLog,
    *,
    topic: str = "/scan",
    odometry_topic: str = "/odom",
    pose_topic: str | None = None,
    map_frame: str = "map",
    odom_frame: str = "odom",
    base_frame: str = "base_link",
    storage: Literal["mcap", "sqlite3"] = "mcap",
) -> None:
    """Write scans, odometry and reference poses as a ROS 2 bag, whole or not at all.

    The scans become sensor_msgs/LaserScan messages; the mount of each sensor a transform on /tf_static; the odometry
    nav_msgs/Odometry messages and transforms from `odom_frame` to `base_frame` on /tf; the reference poses transforms
    from `map_frame` to `odom_frame` at the scans' stamps, so that the chain from map to robot gives each scan's pose
    (without odometry: from `map_frame` to `base_frame`).

    Parameters
    ----------
    path
        The folder to make; files of the same name in it are replaced.
    log
        What to write. Ranges become float32, stamps nanoseconds.
    topic
        Where the scans go. With several sensors each goes to its own name if that is a topic's name (begins with a
        slash), else to `topic` with its number.
    odometry_topic
        Where the odometry goes.
    pose_topic
        Where the reference poses also go, as geometry_msgs/PoseWithCovarianceStamped; None for nowhere.
    map_frame, odom_frame, base_frame
        Names of the frames.
    storage
        "mcap" or "sqlite3".

    Raises
    ------
    InvalidInputError
        If a sensor cannot be a LaserScan (beams from several points, or uneven bearings), a stamp is no ROS 2 time, the
        log has no scans, or a scan has a reference pose but no odometry although others have.
    MissingDependencyError
        If rosbags is not installed.
    OSError
        From the file system.

    Notes
    -----
    The heading of a mount and the sensor's first bearing are one number in a `RangeFinder`: the transform has no
    rotation, and the bearings are those in the robot's frame. Velocities and covariances are not known: zeros.
    """
    if not any(len(sensor) for sensor in log.sensors.values()):
        raise InvalidInputError(f"{log.source or 'log'}: expected scans to write, got none")
    types = _typestore()
    plan = _Plan(log, topic, odometry_topic, pose_topic, map_frame, odom_frame, base_frame, types.types)
    messages = sorted(plan.messages(), key=lambda m: (m.nanoseconds, m.topic != "/tf_static"))
    with atomic_folder(path) as part:
        _write(part, Path(path).name, messages, storage, types)


@dataclass(frozen=True)
class _Message:
    """One message: when, where, and what."""

    nanoseconds: int
    topic: str
    content: Any


@dataclass(frozen=True)
class _Plan:
    """What goes where."""

    log: ScanLog
    topic: str
    odometry_topic: str
    pose_topic: str | None
    map_frame: str
    odom_frame: str
    base_frame: str
    types: Mapping[str, Any]  # the class of each type of message

    def messages(self) -> Iterator[_Message]:
        names = self._topics()
        mounts = []
        for number, (topic, sensor) in enumerate(zip(names, self.log.sensors.values(), strict=True), start=1):
            frame = "laser" if len(names) == 1 else f"laser_{number}"
            first, step = _even_bearings(sensor.finder, topic)
            mounts.append((frame, sensor.finder.mounts[0]))
            for stamp, ranges in zip(sensor.stamps, sensor.ranges, strict=True):
                yield self._at(stamp, topic, self._scan(stamp, ranges, sensor.finder, frame, first, step))
        first_stamps = [
            s.stamps[0] for s in (*self.log.sensors.values(), self.log.odometry) if s is not None and len(s)
        ]
        start = float(min(first_stamps))
        fixed = [self._transform(self.base_frame, frame, start, (m[0], m[1], 0.0)) for frame, m in mounts]
        yield self._at(start, "/tf_static", self._new("tf2_msgs/msg/TFMessage", fixed))
        odometry = _odometry_samples(self.log)
        yield from self._odometry(odometry)
        yield from self._reference(odometry)

    def _topics(self) -> list[str]:
        names = list(self.log.sensors)
        if len(names) == 1:
            return [self.topic]
        return [name if name.startswith("/") else f"{self.topic}_{i}" for i, name in enumerate(names, start=1)]

    def _odometry(self, samples: Track | None) -> Iterator[_Message]:
        if samples is None:
            return
        track = samples if self.log.odometry is None else self.log.odometry
        for stamp, pose in zip(track.stamps, track.poses, strict=True):
            still = self._new("geometry_msgs/msg/Twist", self._vector(0, 0, 0), self._vector(0, 0, 0))
            yield self._at(stamp, self.odometry_topic, self._new(
                "nav_msgs/msg/Odometry",
                self._header(stamp, self.odom_frame),
                self.base_frame,
                self._new("geometry_msgs/msg/PoseWithCovariance", self._pose(pose), NO_COVARIANCE),
                self._new("geometry_msgs/msg/TwistWithCovariance", still, NO_COVARIANCE),
            ))  # fmt: skip
        for stamp, pose in zip(samples.stamps, samples.poses, strict=True):
            yield self._tf(self.odom_frame, self.base_frame, stamp, pose)

    def _reference(self, odometry: Track | None) -> Iterator[_Message]:
        for name, sensor in self.log.sensors.items():
            known = np.isfinite(sensor.poses).all(axis=1)
            stamps, poses = sensor.stamps[known], sensor.poses[known]
            parents = poses if odometry is None else _corrections(name, stamps, poses, odometry)
            child = self.base_frame if odometry is None else self.odom_frame
            for stamp, pose, parent in zip(stamps, poses, parents, strict=True):
                yield self._tf(self.map_frame, child, stamp, parent)
                if self.pose_topic is not None:
                    pose = self._new("geometry_msgs/msg/PoseWithCovariance", self._pose(pose), NO_COVARIANCE)
                    yield self._at(stamp, self.pose_topic, self._new(
                        "geometry_msgs/msg/PoseWithCovarianceStamped", self._header(stamp, self.map_frame), pose
                    ))  # fmt: skip

    def _tf(self, parent: str, child: str, stamp: float, pose: FloatArray) -> _Message:
        moved = [self._transform(parent, child, stamp, pose)]
        return self._at(stamp, "/tf", self._new("tf2_msgs/msg/TFMessage", moved))

    def _at(self, stamp: float, topic: str, content: Any) -> _Message:
        time = self._time(stamp)
        return _Message(time.sec * 10**9 + time.nanosec, topic, content)

    def _new(self, msgtype: str, *fields: Any) -> Any:
        """Return a message with its fields in the order of its definition."""
        return self.types[msgtype](*fields)

    def _scan(
        self, stamp: float, ranges: FloatArray, finder: RangeFinder, frame: str, first: float, step: float
    ) -> Any:
        last = first + step * (finder.n_beams - 1)
        return self._new(
            "sensor_msgs/msg/LaserScan", self._header(stamp, frame), first, last, step, 0.0, 0.0,
            finder.min_range, finder.max_range, ranges.astype(np.float32), np.empty(0, dtype=np.float32),
        )  # fmt: skip

    def _time(self, stamp: float) -> Any:
        if not 0.0 <= stamp < 2**31:
            raise InvalidInputError(f"stamps: expected seconds within [0, 2^31), as ROS 2 times are, got {stamp}")
        second = math.floor(stamp)
        nanosecond = round((stamp - second) * 1e9)
        return self._new("builtin_interfaces/msg/Time", second + nanosecond // 10**9, nanosecond % 10**9)

    def _header(self, stamp: float, frame: str) -> Any:
        return self._new("std_msgs/msg/Header", self._time(float(stamp)), frame)

    def _vector(self, x: float, y: float, z: float, kind: str = "Vector3") -> Any:
        return self._new(f"geometry_msgs/msg/{kind}", float(x), float(y), float(z))

    def _turn(self, heading: float) -> Any:
        return self._new("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))

    def _pose(self, pose: FloatArray) -> Any:
        return self._new("geometry_msgs/msg/Pose", self._vector(pose[0], pose[1], 0.0, "Point"), self._turn(pose[2]))

    def _transform(self, parent: str, child: str, stamp: float, pose: FloatArray | tuple[float, float, float]) -> Any:
        moved = self._new("geometry_msgs/msg/Transform", self._vector(pose[0], pose[1], 0.0), self._turn(pose[2]))
        return self._new("geometry_msgs/msg/TransformStamped", self._header(stamp, parent), child, moved)


def _even_bearings(finder: RangeFinder, topic: str) -> tuple[float, float]:
    """Return angle_min and angle_increment of a sensor, in the robot's frame."""
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


def _odometry_samples(log: ScanLog) -> Track | None:
    """Return what /tf needs so that interpolation gives the track, and each scan's own odometry."""
    known = [np.isfinite(s.odometry).all(axis=1) for s in log.sensors.values()]
    stamps = np.concatenate([s.stamps[k] for s, k in zip(log.sensors.values(), known, strict=True)])
    poses = np.concatenate([s.odometry[k] for s, k in zip(log.sensors.values(), known, strict=True)])
    if log.odometry is not None and len(log.odometry):
        track = log.odometry
        if np.allclose(interpolate_poses(track.stamps, track.poses, stamps), poses, rtol=0.0, atol=POSE_TOLERANCE):
            return Track(track.stamps, track.poses)
        stamps = np.concatenate([track.stamps, stamps])
        poses = np.concatenate([track.poses, poses])
    if len(stamps) == 0:
        return None
    order = np.argsort(stamps, kind="stable")
    last = np.append(np.diff(stamps[order]) > 0, True)
    return Track(stamps[order][last], poses[order][last])


def _corrections(name: str, stamps: FloatArray, poses: FloatArray, odometry: Track) -> FloatArray:
    """Return the poses of the odometry frame in the map."""
    in_odometry = interpolate_poses(odometry.stamps, odometry.poses, stamps)
    unknown = np.flatnonzero(~np.isfinite(in_odometry).all(axis=1))
    if len(unknown):
        raise InvalidInputError(
            f"{name}: the scan at {stamps[unknown[0]]:.6f} s has a reference pose but no odometry, which others have: "
            "a chain from map over odometry to robot cannot express it"
        )
    return compose(poses, invert(in_odometry))


def _typestore() -> Typestore:
    try:
        import rosbags.rosbag2  # noqa: F401 - for `_write`
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise MissingDependencyError("rosbags", "ros", "writing a bag") from error
    return get_typestore(Stores.LATEST)


def _write(folder: Path, name: str, messages: list[_Message], storage: str, types: Typestore) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    plugins = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}
    if storage not in plugins:
        raise InvalidInputError(f"storage: expected 'mcap' or 'sqlite3', got {storage!r}")
    # The writer names its file after the folder that it makes.
    made, connections = folder / name, {}
    with Writer(made, version=9, storage_plugin=plugins[storage]) as writer:
        for message in messages:
            msgtype = message.content.__msgtype__
            if message.topic not in connections:
                qos = [_latched()] if message.topic == "/tf_static" else []
                connections[message.topic] = writer.add_connection(
                    message.topic, msgtype, typestore=types, offered_qos_profiles=qos
                )
            raw = types.serialize_cdr(message.content, msgtype)
            writer.write(connections[message.topic], message.nanoseconds, raw)
    for file in list(made.iterdir()):
        file.rename(folder / file.name)
    made.rmdir()


def _latched() -> Qos:
    """Return the quality of service of /tf_static, without which a replay does not reach late listeners."""
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
