"""Write a log of scans as a ROS 2 bag, for ROS tools and for `read_bag`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, compose, interpolate_poses, invert
from beamfield.io.bags.messages import Message, MessageMaker, even_bearings, load_typestore, write_messages
from beamfield.io.files.atomic import atomic_folder
from beamfield.sensors import ScanLog, Track

TOPIC, ODOMETRY_TOPIC = "/scan", "/odom"
MAP_FRAME, ODOM_FRAME, BASE_FRAME = "map", "odom", "base_link"
POSE_TOLERANCE = 1e-9
NO_COVARIANCE = np.zeros(36)


def write_bag(path: str | Path, log: ScanLog) -> None:
    """Write scans, odometry and reference poses as a ROS 2 bag (mcap), whole or not at all.

    The scans become sensor_msgs/LaserScan messages; the mount of each sensor a transform on /tf_static; the odometry
    nav_msgs/Odometry messages and transforms from odom to base_link on /tf; the reference poses transforms from map to
    odom at the scans' stamps, so that the chain from map to robot gives each scan's pose (without odometry: from map to
    base_link).

    Parameters
    ----------
    path
        The folder to make; files of the same name in it are replaced.
    log
        What to write. Ranges become float32, stamps nanoseconds. The scans go to /scan, the odometry to /odom. With
        several sensors each goes to its own name if that is a topic's name (begins with a slash), else to /scan with
        its number.

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
    types = load_typestore()
    plan = _Plan(log, MessageMaker(types))
    messages = sorted(plan.messages(), key=lambda m: (m.nanoseconds, m.topic != "/tf_static"))
    with atomic_folder(path) as part:
        # The writer names its file after the folder that it makes.
        made = part / Path(path).name
        write_messages(made, messages, types)
        for file in list(made.iterdir()):
            file.rename(part / file.name)
        made.rmdir()


@dataclass(frozen=True)
class _Plan:
    """What goes where."""

    log: ScanLog
    make: MessageMaker

    def messages(self) -> Iterator[Message]:
        names = self._topics()
        mounts = []
        for number, (topic, sensor) in enumerate(zip(names, self.log.sensors.values(), strict=True), start=1):
            frame = "laser" if len(names) == 1 else f"laser_{number}"
            bearings = even_bearings(sensor.finder, topic)
            mounts.append((frame, sensor.finder.mounts[0]))
            for stamp, ranges in zip(sensor.stamps, sensor.ranges, strict=True):
                yield self.make.at(stamp, topic, self.make.laser_scan(stamp, frame, ranges, sensor.finder, bearings))
        first_stamps = [
            s.stamps[0] for s in (*self.log.sensors.values(), self.log.odometry) if s is not None and len(s)
        ]
        start = float(min(first_stamps))
        fixed = [self.make.transform(BASE_FRAME, frame, start, (m[0], m[1], 0.0)) for frame, m in mounts]
        yield self.make.at(start, "/tf_static", self.make.new("tf2_msgs/msg/TFMessage", fixed))
        odometry = _odometry_samples(self.log)
        yield from self._odometry(odometry)
        yield from self._reference(odometry)

    def _topics(self) -> list[str]:
        names = list(self.log.sensors)
        if len(names) == 1:
            return [TOPIC]
        return [name if name.startswith("/") else f"{TOPIC}_{i}" for i, name in enumerate(names, start=1)]

    def _odometry(self, samples: Track | None) -> Iterator[Message]:
        if samples is None:
            return
        track = samples if self.log.odometry is None else self.log.odometry
        for stamp, pose in zip(track.stamps, track.poses, strict=True):
            still = self.make.new("geometry_msgs/msg/Twist", self.make.vector(0, 0, 0), self.make.vector(0, 0, 0))
            yield self.make.at(stamp, ODOMETRY_TOPIC, self.make.new(
                "nav_msgs/msg/Odometry",
                self.make.header(stamp, ODOM_FRAME),
                BASE_FRAME,
                self.make.new("geometry_msgs/msg/PoseWithCovariance", self.make.pose(pose), NO_COVARIANCE),
                self.make.new("geometry_msgs/msg/TwistWithCovariance", still, NO_COVARIANCE),
            ))  # fmt: skip
        for stamp, pose in zip(samples.stamps, samples.poses, strict=True):
            yield self.make.tf(ODOM_FRAME, BASE_FRAME, stamp, pose)

    def _reference(self, odometry: Track | None) -> Iterator[Message]:
        for name, sensor in self.log.sensors.items():
            known = np.isfinite(sensor.poses).all(axis=1)
            stamps, poses = sensor.stamps[known], sensor.poses[known]
            parents = poses if odometry is None else _corrections(name, stamps, poses, odometry)
            child = BASE_FRAME if odometry is None else ODOM_FRAME
            for stamp, parent in zip(stamps, parents, strict=True):
                yield self.make.tf(MAP_FRAME, child, stamp, parent)


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
