"""ROS 1 and ROS 2 bags without ROS: scans with their mounts, odometry and reference poses; and maps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.bags.bag_file import BagFile, BagMessage, seconds
from beamfield.io.bags.frames import TransformBuffer, strip_slash
from beamfield.io.bags.laser_scan import LaserScanCollector, LaserScans
from beamfield.io.bags.map_topic import read_bag_map
from beamfield.io.bags.multiranger import OPENING_ANGLE, RawDataCollector, ranger_topics, read_rangers
from beamfield.io.bags.namespaces import transform_topics
from beamfield.io.bags.pose_topic import ODOMETRY, POSE_TYPES, PoseTopicCollector
from beamfield.io.bags.published_twice import published_twice
from beamfield.io.bags.robot_frames import (
    BagContent,
    beam_mounts,
    choose_base,
    find_odometry,
    find_reference,
    published_poses,
    says_truth,
)
from beamfield.io.bags.scan_ranges import limit_doubts, resolve_limits, resolve_scan_ranges
from beamfield.io.no_return import NoReturnRule
from beamfield.sensors import RangeFinder, ScanLog, SensorLog

__all__ = ["read_bag", "read_bag_map"]

LASER_SCAN = "sensor_msgs/msg/LaserScan"
# Nodes that make scans of what other lasers publish.
MAKES_SCANS = {
    "sensor_msgs/msg/PointCloud2": "pointcloud_to_laserscan",
    "sensor_msgs/msg/MultiEchoLaserScan": "laser_proc",
}
# Share of the scans beside the odometry that is worth a note.
UNMATCHED = 0.2
# Seconds between poses of the odometry: a simulated robot that turns at up to 0.7 rad/s is then off by up to 9 degrees
# in between at 1 s, 5 at 0.5 s, 2 at 0.25 s, and 1 at 0.05 s.
SELDOM = 0.4
# Messages that are so much longer under way than others, seconds, are stamped by another clock: networks delay scans by
# less.
CLOCKS_APART = 1.0
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage", "tf/msg/TFMessage")


def read_bag(
    path: str | Path,
    *,
    sensor_topic: str | Sequence[str] | None = None,
    poses_topic: str | None = None,
    map_frame: str | None = None,
    base_frame: str | None = None,
    mount: ArrayLike | None = None,
    no_return: NoReturnRule = "detect",
    max_range: float | None = None,
    min_range: float | None = None,
) -> ScanLog:
    """Read the scans of a bag, with the sensors' mounts, the odometry and the reference poses.

    Parameters
    ----------
    path
        A ROS 1 ``.bag``, a ROS 2 folder, or a single ``.db3`` or ``.mcap`` file.
    sensor_topic
        The topic, or topics, of scans; all sensor_msgs/LaserScan topics if None. Of several robots in one bag, those
        of one: transforms, odometry and poses are then those of its namespace and of its frames.
    poses_topic
        The topic of the reference poses: Odometry, PoseStamped or PoseWithCovarianceStamped, in the map's frame or one
        that /tf fixes to it. If None: /tf, if it has the map's frame; else a topic whose name says ground truth or
        amcl_pose.
    map_frame
        The map's frame in /tf; ``map`` if None. Not together with `poses_topic`.
    base_frame
        The robot's frame; if None the first of ``base_link``, ``base_footprint``, and the odometry's child frames on
        which the sensors are fixed.
    mount
        (3,) pose of the sensor in the robot's frame, metres and radians, instead of the one that /tf says.
    no_return
        What means "no return" besides +inf and ranges that reach the limit: see `resolve_scan_ranges`.
    max_range, min_range
        The sensor's limits in metres, instead of the declared ones.

    Returns
    -------
    One `SensorLog` per topic, named by it, in the order of the bag; odometry at its own rate; notes on what was found
    where. The stamp of a scan is that of its first beam, and its poses are those of that time: interpolated between the
    neighbouring transforms, NaN outside of them or where neighbours are more than `MAX_GAP` apart.

    Raises
    ------
    FormatError
        If the bag is damaged, has no scans, frames do not connect, a sensor is tilted by more than 5 degrees or moves
        on the robot, stamps run backwards, or a scan of a topic has no beam where the others have theirs: file, topic
        and message number are named.
    InvalidInputError
        If a topic or frame that was asked for is not there, or the scans are of several robots.
    MissingDependencyError
        If rosbags is not installed.
    FileNotFoundError
        If there is no such path.

    References
    ----------
    REP 103 and 105 (axes and frames), REP 117 (ranges).

    Examples
    --------
    >>> read_bag("office.bag").only_sensor("/scan").finder.n_beams  # doctest: +SKIP
    720
    """
    if poses_topic is not None and map_frame is not None:
        raise InvalidInputError("expected poses_topic or map_frame for the reference poses, got both")
    with BagFile(path) as bag:
        poses_topic = None if poses_topic is None else bag.find_topic(poses_topic, *POSE_TYPES)
        content = _collect(bag, _scan_topics(bag, sensor_topic), poses_topic, (min_range, max_range))
    if mount is not None and len(content.scans) > 1:
        raise InvalidInputError(f"{path}: one mount was given, but the bag has {len(content.scans)} sensors")
    notes = list(content.notes)
    base = choose_base(content, base_frame, mount is not None)
    odometry = find_odometry(content, base, notes)
    reference_at = find_reference(content, base, poses_topic, map_frame, odometry, notes)
    twice = [] if odometry.track is None else published_twice("odometry", odometry.track.poses)
    sensors = {}
    for scans in content.scans:
        notes += scans.notes
        _note_clocks(scans, content.lags, notes)
        beams = beam_mounts(content, scans, base, mount, notes)
        low, high = resolve_limits(scans, content.path, min_range, max_range)
        found = resolve_scan_ranges(scans.ranges, low, high, no_return, limit_given=max_range is not None)
        if max_range is None:
            notes += [f"{scans.topic}: {doubt}" for doubt in limit_doubts(scans.ranges, high)]
        cone = OPENING_ANGLE if scans.topic in content.cones else 0.0
        poses = reference_at(scans.stamps)
        driven = odometry.at(scans.stamps)
        _note_missing(scans.topic, poses, notes)
        twice += [] if twice else published_twice(f"{scans.topic}: reference poses", poses)
        if odometry.track is not None:
            _note_unmatched(scans.topic, scans.stamps, driven, odometry.track.stamps, notes)
            _note_seldom(scans.topic, scans.stamps, odometry.track.stamps, notes)
        sensors[scans.topic] = SensorLog(
            finder=RangeFinder(beams, found.max_range, min_range=low, opening_angle=cone, name=scans.topic),
            stamps=scans.stamps,
            ranges=found.ranges,
            poses=poses,
            odometry=driven,
            no_return=found.policy,
        )
    if not twice and poses_topic is None:
        twice = published_twice("reference poses", published_poses(content, base, map_frame))
    return ScanLog(sensors, odometry.track, str(path), (*notes, *twice), frames=content.frames.all_if_whole())


def _scan_topics(bag: BagFile, asked: str | Sequence[str] | None) -> list[str]:
    rangers = ranger_topics(bag.topics)
    if asked is None:
        found = bag.of_type(LASER_SCAN) or list(rangers)
        filled = [topic for topic in found if bag.counts[topic]]
        if not filled:
            has = f"no scans (sensor_msgs/LaserScan) in this bag; it has {bag.describe()}"
            raise FormatError(bag.path, "; ".join([has, *_how_to_make_scans(bag)]))
        return filled
    names = [asked] if isinstance(asked, str) else list(asked)
    if not names:
        raise InvalidInputError("sensor_topic: expected at least one topic, or None for all, got none")
    return list(
        dict.fromkeys(t if (t := bag.find_topic(n)) in rangers else bag.find_topic(n, LASER_SCAN) for n in names)
    )


def _how_to_make_scans(bag: BagFile) -> list[str]:
    """Return what to do for each topic that could become scans."""
    return [
        f"run {MAKES_SCANS[msgtype]} on {topic!r} and record its scans"
        for topic, msgtype in bag.topics.items()
        if msgtype in MAKES_SCANS
    ]


def _collect(bag: BagFile, scan_topics: list[str], poses_topic: str | None,
             limits: tuple[float | None, float | None]) -> BagContent:  # fmt: skip
    """Walk through the bag once and keep what scans need."""
    rangers = {t: p for t, p in ranger_topics(bag.topics).items() if t in scan_topics}
    lasers = {t: LaserScanCollector(bag.path, t, limits) for t in scan_topics if t not in rangers}
    raw = {t: RawDataCollector(bag.path, t, 9) for t in rangers}
    raw |= {p: RawDataCollector(bag.path, p, 2) for p in rangers.values() if p}
    pose_topics = {t: PoseTopicCollector(bag.path, t) for t in _pose_topics(bag, poses_topic)}
    frames = TransformBuffer(bag.path)
    tf_topics = transform_topics(bag.path, bag.of_type(*TF_TYPES), scan_topics)
    collectors: dict[str, LaserScanCollector | RawDataCollector | PoseTopicCollector]
    collectors = {**lasers, **raw, **pose_topics}
    of_tf: list[float] = []
    of_odometry: list[float] = []
    for message in bag.messages([*collectors, *tf_topics]):
        with bag.quoting(message):
            if message.topic in collectors:
                collectors[message.topic].add(message)
                if message.msgtype == ODOMETRY and message.stamp > 0.0:
                    of_odometry.append(message.recorded - message.stamp)
            else:
                of_tf += _add_transforms(frames, message)
    scans, ranger_odometry = [], None
    for topic in scan_topics:
        if topic in rangers:
            found, ranger_odometry = read_rangers(raw[topic], raw.get(rangers[topic]))
            scans.append(found)
        else:
            scans.append(lasers[topic].finish())
    counts = bag.counts
    notes = [
        f"{topic}: the bag declares {counts[topic]} messages, but has {len(collectors[topic])}"
        for topic in scan_topics
        if counts[topic] != len(collectors[topic])
    ]
    if bag.n_files > 1 and bag.path.is_file():
        notes.append(f"{bag.path.name} is one of {bag.n_files} files of a bag: all of them were read")
    return BagContent(
        bag.path, scans, frames, pose_topics, set(rangers), ranger_odometry, notes, of_tf or of_odometry
    )  # fmt: skip


def _pose_topics(bag: BagFile, asked: str | None) -> list[str]:
    """Return the topics of poses that may be needed: odometry, reference poses by name, and the one asked for."""
    topics = bag.of_type(ODOMETRY) + [t for t in bag.of_type(*POSE_TYPES[1:]) if says_truth(t)]
    return list(dict.fromkeys(topics if asked is None else [*topics, asked]))


def _add_transforms(frames: TransformBuffer, message: BagMessage) -> list[float]:
    """Add what a message says; return how long what moves was under way, but for the map's, which filters postdate."""
    static = message.topic.endswith("tf_static")
    lags = []
    for item in message.content.transforms:
        t, q = item.transform.translation, item.transform.rotation
        frames.add(
            item.header.frame_id,
            item.child_frame_id,
            seconds(item.header.stamp),
            (t.x, t.y, t.z),
            (q.x, q.y, q.z, q.w),
            static=static,
            place=message.place,
            depth=message.topic.count("/"),
        )
        stamp = seconds(item.header.stamp)
        if stamp > 0.0 and not static and not strip_slash(item.header.frame_id).endswith("map"):
            lags.append(message.recorded - stamp)
    return lags


def _note_clocks(scans: LaserScans, lags: list[float], notes: list[str]) -> None:
    apart = scans.lag - float(np.median(lags)) if lags else 0.0
    if abs(apart) > CLOCKS_APART:
        notes.append(
            f"{scans.topic}: its scans are stamped {abs(apart):.1f} s {'earlier' if apart > 0.0 else 'later'} than the "
            "transforms or odometry recorded at the same time, so that ROS drops them, or puts them where the robot "
            "was not: compare the clocks of scanner and base (NTP, chrony), what the driver stamps, and use_sim_time"
        )


def _note_missing(topic: str, poses: FloatArray, notes: list[str]) -> None:
    missing = int(np.count_nonzero(~np.isfinite(poses).all(axis=1)))
    if 0 < missing < len(poses):
        notes.append(f"{topic}: {missing} of {len(poses)} scans have no reference pose at their time")


def _note_unmatched(topic: str, stamps: FloatArray, driven: FloatArray, times: FloatArray, notes: list[str]) -> None:
    missing = int(np.count_nonzero(~np.isfinite(driven).all(axis=1)))
    if missing > UNMATCHED * len(stamps) and len(times):
        notes.append(
            f"{topic}: {missing} of {len(stamps)} scans have no odometry at their time: they are from {stamps[0]:.3f} "
            f"to {stamps[-1]:.3f} s, the odometry from {times[0]:.3f} to {times[-1]:.3f} s; do two clocks differ?"
        )


def _note_seldom(topic: str, stamps: FloatArray, times: FloatArray, notes: list[str]) -> None:
    scans, step = (float(np.median(np.diff(each))) if len(each) > 1 else 0.0 for each in (stamps, times))
    if step > SELDOM and scans < 0.5 * step:
        notes.append(
            f"{topic}: the odometry has a pose every {step:.1f} s, the scans come every {scans:.1f} s: between, the "
            "robot is taken to move evenly, and in turns poses are degrees off; record /tf or /odom at 20 Hz or more"
        )
