"""The frames of a bag: the robot's frame, the mounts of its sensors, its odometry and its reference poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray, as_mount, compose, interpolate_poses
from beamfield.io.bags.frames import TransformBuffer, Transforms, rotate, strip_slash
from beamfield.io.bags.laser_scan import LaserScans
from beamfield.io.bags.namespaces import holds
from beamfield.io.bags.pose_topic import PoseTopicCollector, poses_at
from beamfield.sensors import MAX_GAP, Track

MAX_TILT = np.deg2rad(5.0)  # from here on a scan is not a cut through the map's plane: cos(5 deg) shortens it by 0.4%
MAX_MOTION = (0.02, np.deg2rad(2.0))  # how far a mount may wander over the log, metres and radians
BASE_FRAMES = ("base_link", "base_footprint")
TRUTH_NAMES = ("ground_truth", "groundtruth", "amcl_pose")


@dataclass(eq=False)
class BagContent:
    """What was taken from a bag: scans per topic, transforms, and the poses by topic that may be odometry or reference.

    `cones` are topics whose sensors have no frame of their own, the rangers of a drone; `ranger_odometry` is that
    drone's; `lags` are the seconds from the stamps to the recording of transforms and odometry.
    """

    path: Path
    scans: list[LaserScans]
    frames: TransformBuffer
    pose_topics: dict[str, PoseTopicCollector]
    cones: set[str]
    ranger_odometry: Track | None
    notes: list[str]
    lags: list[float]


@dataclass(frozen=True)
class Odometry:
    """The odometry.

    Parameters
    ----------
    at
        Returns the poses (n, 3) at given times (n,), NaN where they are not known.
    track
        The odometry at its own rate; None if there is none.
    frame
        Its frame in /tf; "" if it is not from there.
    """

    at: Callable[[FloatArray], FloatArray]
    track: Track | None
    frame: str = ""


def choose_base(content: BagContent, asked: str | None, mount_given: bool) -> str:
    """Return the robot's frame; "" if the bag has no frames and none was asked for.

    If the user gives the sensor's mount, no chain to its frame is needed. InvalidInputError if the frame that was asked
    for is not there, FormatError if no frame that may be the robot's is connected to the sensors.
    """
    frames = content.frames
    if len(frames) == 0:
        return strip_slash(asked or "")
    if asked is not None:
        return _frame_called(content, asked)
    sensor_frames = [s.frame for s in content.scans if s.topic not in content.cones and not mount_given]
    children = [topic.child for topic in content.pose_topics.values() if topic.child]
    named = [f for f in frames.frames if _last_name(f) in BASE_FRAMES]
    candidates = [f for f in dict.fromkeys([*BASE_FRAMES, *children, *named]) if f in frames]
    connected = [c for c in candidates if all(frames.connected(c, s) for s in sensor_frames)]
    if len(connected) > 1:
        # A map connects robots with each other: a sensor is fixed to the frames of its own only.
        return next((c for c in connected if _are_fixed(content, c)), connected[0])
    if connected:
        return connected[0]
    if not sensor_frames:
        return ""
    raise _unconnected(content, candidates, sensor_frames)


def _frame_called(content: BagContent, name: str) -> str:
    """Return a frame that the user names; InvalidInputError if it is not there."""
    frame = strip_slash(name)
    if frame not in content.frames:
        raise InvalidInputError(f"{content.path}: no frame {frame!r}; the log has {content.frames.describe()}")
    return frame


def _unconnected(content: BagContent, candidates: list[str], sensor_frames: list[str]) -> FormatError:
    """Return the error for sensors that no frame of the robot reaches, with those that the best one lacks."""
    frames = content.frames
    if all(any(frames.connected(c, f) for c in candidates) for f in sensor_frames):
        listed = ", ".join(repr(scans.topic) for scans in content.scans)
        several = "the scans are of several robots that no frame connects; choose one by sensor_topic: the bag has"
        return FormatError(content.path, f"{several} {listed}")
    reached = [[f for f in sensor_frames if frames.connected(c, f)] for c in candidates]
    best = max(range(len(candidates)), key=lambda i: len(reached[i]), default=None)
    robot = "the robot (no frame base_link or base_footprint)" if best is None else f"the robot {candidates[best]!r}"
    known = [] if best is None else reached[best]
    lost = [s for s in content.scans if s.frame in sensor_frames and s.frame not in known]
    sensors = ", ".join(f"{s.frame!r} of {s.topic}" for s in lost)
    why = "" if frames.has_static else "no /tf_static was recorded; "
    return FormatError(
        content.path,
        f"no chain of transforms connects {robot} and the sensor's frame {sensors}; the log has {frames.describe()}; "
        f"{why}give mount (with 0 0 0, beamfield trajectory says where the laser sits), say base_frame, or choose "
        "other scans by sensor_topic",
    )


def beam_mounts(content: BagContent, scans: LaserScans, base: str, mount: ArrayLike | None,
            notes: list[str]) -> FloatArray:  # fmt: skip
    """Return the pose (k, 3) of every beam on the robot, from the chain of transforms in space.

    A sensor that hangs upside down so gets clockwise bearings. What is left of a tilt is projected to the plane.
    FormatError if the frames do not connect, or the sensor is tilted by more than `MAX_TILT` or moves on the robot.
    """
    k = len(scans.bearings)
    in_sensor = np.column_stack([np.zeros((k, 2)), scans.bearings])
    if mount is not None:
        return compose(as_mount(mount), in_sensor)
    sensor = scans.frame
    if scans.topic in content.cones or len(content.frames) == 0 or sensor == base:
        if scans.topic not in content.cones:
            why = "the bag has no transforms" if len(content.frames) == 0 else "the scans are in the robot's own frame"
            notes.append(
                f"{scans.topic}: {why}; the sensor is assumed at the robot's origin, facing forward: if it is "
                "not, give mount"
            )
        return compose(np.zeros(3), in_sensor)
    notes += [
        f"{scans.topic}: /tf_static from {link} was published with several values; the last counts here, as in tf2: do "
        "two nodes publish it?"
        for link in content.frames.contradictions(base, sensor)
    ]
    found = content.frames.look_up(base, sensor, scans.stamps, hold=True)
    position, rotation = np.median(found.translation, axis=0), found.rotation[0]
    _check_fixed(content, scans.topic, sensor, base, found)
    up = rotate(rotation, np.array([0.0, 0.0, 1.0]))[2]
    tilt = float(np.arccos(np.clip(abs(up), 0.0, 1.0)))
    if tilt > MAX_TILT:
        raise FormatError(
            content.path,
            f"the sensor's frame {sensor!r} is tilted by {np.rad2deg(tilt):.1f} degrees against {base!r}; at most "
            f"{np.rad2deg(MAX_TILT):.0f} are taken for a scan in the map's plane; choose other topics by sensor_topic, "
            "or give mount if the frame is wrong",
            field=scans.topic,
        )
    in_plane = np.column_stack([np.cos(scans.bearings), np.sin(scans.bearings), np.zeros(k)])
    direction = rotate(np.broadcast_to(rotation, (k, 4)), in_plane)
    heading = np.arctan2(direction[:, 1], direction[:, 0])
    forward = rotate(rotation, np.array([1.0, 0.0, 0.0]))
    notes.append(
        f"{scans.topic}: frame {sensor!r} sits at ({position[0]:.3f}, {position[1]:.3f}) m, turned by "
        f"{np.rad2deg(np.arctan2(forward[1], forward[0])):.1f} degrees, on {base!r}"
        + (", upside down" if up < 0 else "")
        + (f", tilted by {np.rad2deg(tilt):.1f} degrees (ignored)" if tilt > np.deg2rad(0.5) else "")
    )
    return np.column_stack([np.tile(position[:2], (k, 1)), heading])


def _are_fixed(content: BagContent, base: str) -> bool:
    """Return whether no sensor is seen to move on this frame: with a mount given, its frame may be missing."""
    scans = [s for s in content.scans if s.topic not in content.cones]
    seen = [s for s in scans if content.frames.connected(base, s.frame)]
    mounts = (content.frames.look_up(base, s.frame, s.stamps, hold=True) for s in seen)
    return not any(_moves(*_motion(mount)) for mount in mounts)


def _motion(mount: Transforms) -> tuple[float, float]:
    """Return how far a mount wanders over the log, metres and radians."""
    moved = float(np.max(np.linalg.norm(mount.translation - np.median(mount.translation, axis=0), axis=1)))
    cosine = np.clip(np.abs(mount.rotation @ mount.rotation[0]), 0.0, 1.0)
    return moved, float(2.0 * np.arccos(cosine.min()))


def _moves(moved: float, turned: float) -> bool:
    return moved > MAX_MOTION[0] or turned > MAX_MOTION[1]


def _check_fixed(content: BagContent, topic: str, sensor: str, base: str, mount: Transforms) -> None:
    moved, turned = _motion(mount)
    if _moves(moved, turned):
        several = "; of another robot? choose scans by sensor_topic" if len(content.scans) > 1 else ""
        raise FormatError(
            content.path,
            f"the sensor's frame {sensor!r} moves on {base!r} by {moved:.3g} m and {np.rad2deg(turned):.3g} degrees; "
            f"only sensors that are fixed to the robot are read{several}",
            field=topic,
        )


def find_odometry(content: BagContent, base: str, notes: list[str]) -> Odometry:
    """Find the odometry: in /tf, else in a topic; `notes` says where."""
    topic = _odometry_topic(content, base)
    frames = content.frames
    named = frames.nearest_first(base, [f for f in frames.frames if _last_name(f) == "odom"])
    exact = dict.fromkeys([topic.frame if topic else "", "odom", *named])
    # Frames such as odom_combined; those of parts, such as a wheel's encoder, do not move on the robot.
    near = frames.nearest_first(base, [f for f in frames.frames if "odom" in f.lower() and f not in exact])
    for frame in [*exact, *near]:
        stamps = frames.stamps_between(frame, base) if frame and frame != base else np.empty(0)
        if len(stamps) == 1 and topic is not None and len(topic) > 1:
            only = f"every stamp is {stamps[0]:.10g}; {topic.topic} is used instead"
            notes.append(f"/tf from {frame!r} to {base!r}: {only}")
        elif len(stamps) and (frame in exact or _moves_on(content, frame, base)):
            track = Track(stamps, frames.look_up(frame, base, stamps, max_gap=MAX_GAP).planar())
            known = np.isfinite(track.poses).all(axis=1)
            notes.append(f"odometry: /tf from {frame!r} to {base!r}")

            def in_tf(when: FloatArray, frame: str = frame) -> FloatArray:
                return frames.look_up(frame, base, when, max_gap=MAX_GAP).planar()

            return Odometry(in_tf, Track(track.stamps[known], track.poses[known]), frame)
    if topic is not None and len(topic):
        track = topic.track(notes, _child_from_base(content, topic, base, notes), Transforms.identity(1))
        notes.append(f"odometry: topic {topic.topic}")
        return _from_track(track)
    if content.ranger_odometry is not None:
        notes.append("odometry: optical flow and attitude of the drone")
        return _from_track(content.ranger_odometry)
    return Odometry(lambda when: np.full((len(when), 3), np.nan), None)


def _from_track(track: Track) -> Odometry:
    return Odometry(lambda when: interpolate_poses(track.stamps, track.poses, when, max_gap=MAX_GAP), track)


def _odometry_topic(content: BagContent, base: str) -> PoseTopicCollector | None:
    """Return the robot's topic of odometry: the one called so, else the first that is not called truth."""
    topics = [t for t in _own_pose_topics(content, base) if t.is_odometry and not says_truth(t.topic)]
    exact = [t for t in topics if _last_name(t.topic) == "odom"]
    near = [t for t in topics if "odom" in t.topic.lower()]
    return next(iter(exact + near + topics), None)


def _own_pose_topics(content: BagContent, base: str) -> list[PoseTopicCollector]:
    """Return the topics that have poses, without those of other robots.

    Of several with one name, that of the scans' namespace is the robot's own; so are those whose frame does not move on
    it.
    """
    filled = [topic for topic in content.pose_topics.values() if len(topic)]
    near = [t for t in filled if all(holds(_publisher(t.topic), scans.topic) for scans in content.scans)]
    names = {_last_name(_publisher(topic.topic)) for topic in near}
    ours = [t for t in filled if t in near or _last_name(_publisher(t.topic)) not in names]
    if len(ours) < 2:
        return ours
    return [t for t in ours if not _moves_on(content, t.child, base)] or ours


def _publisher(topic: str) -> str:
    """Return a topic's name up to the part that says truth: /ground_truth/odom is no odometry of another robot."""
    parts = topic.split("/")
    return next(("/".join(parts[: i + 1]) for i, part in enumerate(parts) if says_truth(part)), topic)


def _last_name(name: str) -> str:
    return name.rpartition("/")[2]


def _moves_on(content: BagContent, frame: str, base: str) -> bool:
    """Return whether transforms say that a frame moves on the robot's."""
    if frame == base or not content.frames.connected(base, frame):
        return False
    return _moves(*_motion(content.frames.look_up(base, frame, content.scans[0].stamps, hold=True)))


def _child_from_base(content: BagContent, topic: PoseTopicCollector, base: str, notes: list[str]) -> Transforms:
    """Return where the robot's frame sits in the frame whose poses the topic has."""
    child = topic.child
    if not child or child == base or not base:
        return Transforms.identity(1)
    if not content.frames.connected(child, base):
        notes.append(
            f"{topic.topic}: its frame {child!r} is not connected to {base!r}; they are assumed to be the same"
        )
        return Transforms.identity(1)
    stamps = content.scans[0].stamps[:1]
    return content.frames.look_up(child, base, stamps, hold=True)


def find_reference(content: BagContent, base: str, poses_topic: str | None, map_frame: str | None, odometry: Odometry,
               notes: list[str]) -> Callable[[FloatArray], FloatArray]:  # fmt: skip
    """Return what gives the reference poses (n, 3) at given times (n,); NaN where they are not known.

    The user names a topic or the map's frame; None to choose: /tf with a map in which the odometry's frame moves, then
    a topic that `says_truth`. Odometry bridges the time between sparse poses. InvalidInputError if the map's frame is
    not there, FormatError if the frames do not connect, or the poses are not poses.
    """
    frames = content.frames
    if poses_topic is not None:
        return _reference_topic(content, content.pose_topics[poses_topic], base, odometry, notes)
    frame = _map_frame(content, base, map_frame, notes)
    fixed = "" if frame is None or map_frame is not None else _why_odometry_alone(frames, frame, odometry.frame)
    if fixed:
        notes.append(
            f"/tf from {frame!r} to {odometry.frame!r} {fixed}: odometry alone, no reference (if it is exact, give "
            "map_frame)"
        )
    elif frame is not None:
        notes.append(f"reference poses: /tf from {frame!r} to {base!r}")
        return lambda when: frames.look_up(frame, base, when, max_gap=MAX_GAP).planar()
    topics = _own_pose_topics(content, base)
    by_name = [t for name in TRUTH_NAMES for t in topics if name in t.topic.lower()]
    if by_name:
        return _reference_topic(content, by_name[0], base, odometry, notes)
    notes.append("reference poses: none in this bag")
    return lambda when: np.full((len(when), 3), np.nan)


def published_poses(content: BagContent, base: str, map_frame: str | None) -> FloatArray:
    """Return the poses (n, 3) in the map by /tf when its transforms were published; none if it has none.

    Two localizers need not show at the scans' stamps: one of them may make its transforms for these.
    """
    frame = _map_frame(content, base, map_frame, [])
    if frame is None:
        return np.empty((0, 3))
    return content.frames.look_up(frame, base, content.frames.first_stamps(frame, base), max_gap=MAX_GAP).planar()


def _map_frame(content: BagContent, base: str, asked: str | None, notes: list[str]) -> str | None:
    frames = content.frames
    if asked is not None:
        frame = _frame_called(content, asked)
        if not frames.connected(frame, base):
            raise FormatError(
                content.path,
                f"no chain of transforms connects the map {frame!r} and the robot {base!r}; the log has "
                f"{frames.describe()}",
            )
        return frame
    named = [f for f in frames.frames if f.endswith("/map")]
    for frame in [f for f in frames.frames if f == "map"] + frames.nearest_first(base, named):
        if frames.connected(frame, base):
            return frame
        notes.append(f"the frame {frame!r} is not connected to {base!r}; the log has {frames.describe()}")
    return None


def _why_odometry_alone(frames: TransformBuffer, map_frame: str, odometry_frame: str) -> str:
    """Return why what /tf says of the robot in the map is its odometry; "" if it is not."""
    if not odometry_frame or not frames.connected(map_frame, odometry_frame):
        return ""
    if frames.contradictions(map_frame, odometry_frame):
        return "is static, but was published with several values (do two nodes publish it?)"
    stamps = frames.stamps_between(map_frame, odometry_frame)
    return "is static" if len(stamps) == 0 else f"has one stamp, {stamps[0]:.10g}" if len(stamps) == 1 else ""


def _reference_topic(content: BagContent, topic: PoseTopicCollector, base: str, odometry: Odometry,
                     notes: list[str]) -> Callable[[FloatArray], FloatArray]:  # fmt: skip
    if len(topic) == 0:
        raise FormatError(content.path, "the topic holds no poses", field=topic.topic)
    map_frame, map_from_frame = _map_from_frame(content, topic.frame)
    track = topic.track(notes, _child_from_base(content, topic, base, notes), map_from_frame)
    odometry_at = None if odometry.track is None else odometry.at
    bridged = poses_at(track, track.stamps[:1], odometry_at)[1]
    notes.append(
        f"reference poses: topic {topic.topic} in frame {topic.frame!r}"
        + (f", moved to {map_frame!r} by /tf" if map_frame else "")
        + (", with odometry between its poses" if bridged else "")
    )
    return lambda when: poses_at(track, when, odometry_at)[0]


def _map_from_frame(content: BagContent, frame: str) -> tuple[str, Transforms]:
    """Return the map's frame, and where another frame that is fixed to it lies in it; else "", and no motion."""
    frames = content.frames
    for name in (f for f in frames.frames if _last_name(f) == "map"):
        if name != frame and frames.connected(name, frame) and not _moves_on(content, frame, name):
            return name, frames.look_up(name, frame, content.scans[0].stamps[:1], hold=True)
    return "", Transforms.identity(1)


def says_truth(topic: str) -> bool:
    """Whether a topic's name says that its poses are references."""
    return any(name in topic.lower() for name in TRUTH_NAMES)
