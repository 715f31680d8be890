"""Small bags written message by message, with nothing of beamfield in between."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

LASER_SCAN = "sensor_msgs/msg/LaserScan"
ODOMETRY = "nav_msgs/msg/Odometry"
TF = "tf2_msgs/msg/TFMessage"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COV = "geometry_msgs/msg/PoseWithCovarianceStamped"
GRID = "nav_msgs/msg/OccupancyGrid"
RAW = "infrastructure/msg/RawData"
STORAGES = ("ros1", "sqlite3", "mcap")


def quaternion(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> tuple[float, float, float, float]:
    """x, y, z, w of a rotation by roll, then pitch, then yaw about the fixed axes (REP 103)."""
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


@cache
def types_of(storage: str) -> Typestore:
    """Return the messages' definitions, which all bags share: each store compiles its messages anew."""
    if storage != "ros1":
        types = get_typestore(Stores.LATEST)
    else:
        types = get_typestore(Stores.ROS1_NOETIC)
        types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    types.register(get_types_from_msg("std_msgs/Header header\nfloat32[] raw", RAW))
    return types


class MiniBag:
    """Collects messages and writes them in any of the three storages."""

    def __init__(self, storage: str = "mcap") -> None:
        self.storage = storage
        self.ros1 = storage == "ros1"
        self.types = types_of("ros1" if self.ros1 else "ros2")
        self.messages: list[tuple[str, str, float, object]] = []
        self.topics: dict[str, str] = {}

    def make(self, msgtype: str, **fields: object) -> object:
        return self.types.types[msgtype](**fields)

    def header(self, stamp: float, frame: str) -> object:
        second = math.floor(stamp)
        time = self.make("builtin_interfaces/msg/Time", sec=second, nanosec=round((stamp - second) * 1e9))
        sequence = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **sequence)

    def add(self, topic: str, msgtype: str, message: object, recorded: float) -> MiniBag:
        self.topics.setdefault(topic, msgtype)
        self.messages.append((topic, msgtype, recorded, message))
        return self

    def scan(self, stamp: float, ranges: object = (1.0, 2.0, 3.0), *, topic: str = "/scan", frame: str = "laser",
             angle_min: float = -0.25, increment: float = 0.25, angle_max: float | None = None, range_min: float = 0.1,
             range_max: float = 10.0, recorded: float | None = None) -> MiniBag:  # fmt: skip
        values = np.asarray(ranges, dtype=np.float32)
        last = angle_min + increment * (len(values) - 1) if angle_max is None else angle_max
        message = self.make(
            LASER_SCAN,
            header=self.header(stamp, frame),
            angle_min=angle_min,
            angle_max=last,
            angle_increment=increment,
            time_increment=0.0,
            scan_time=0.1,
            range_min=range_min,
            range_max=range_max,
            ranges=values,
            intensities=np.empty(0, dtype=np.float32),
        )
        return self.add(topic, LASER_SCAN, message, stamp if recorded is None else recorded)

    def pose_message(self, xy: tuple[float, float], q: tuple[float, ...]) -> object:
        return self.make(
            "geometry_msgs/msg/Pose",
            position=self.make("geometry_msgs/msg/Point", x=xy[0], y=xy[1], z=0.0),
            orientation=self.make("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3]),
        )

    def tf(self, parent: str, child: str, stamp: float, xyz: tuple[float, float, float] = (0.0, 0.0, 0.0),
           q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0), *, static: bool = False,
           recorded: float | None = None) -> MiniBag:  # fmt: skip
        transform = self.make(
            "geometry_msgs/msg/Transform",
            translation=self.make("geometry_msgs/msg/Vector3", x=xyz[0], y=xyz[1], z=xyz[2]),
            rotation=self.make("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3]),
        )
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp, parent),
            child_frame_id=child,
            transform=transform,
        )
        message = self.make(TF, transforms=[stamped])
        return self.add("/tf_static" if static else "/tf", TF, message, stamp if recorded is None else recorded)

    def odometry(self, stamp: float, xy: tuple[float, float], yaw: float = 0.0, *, topic: str = "/odom",
                 frame: str = "odom", child: str = "base_link",
                 q: tuple[float, ...] | None = None, recorded: float | None = None) -> MiniBag:  # fmt: skip
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        message = self.make(
            ODOMETRY,
            header=self.header(stamp, frame),
            child_frame_id=child,
            pose=self._with_covariance(xy, quaternion(yaw=yaw) if q is None else q),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )
        return self.add(topic, ODOMETRY, message, stamp if recorded is None else recorded)

    def pose(self, stamp: float, xy: tuple[float, float], yaw: float = 0.0, *, topic: str = "/amcl_pose",
             frame: str = "map", covariance: bool = True) -> MiniBag:  # fmt: skip
        q = quaternion(yaw=yaw)
        body = self._with_covariance(xy, q) if covariance else self.pose_message(xy, q)
        msgtype = POSE_COV if covariance else POSE
        return self.add(topic, msgtype, self.make(msgtype, header=self.header(stamp, frame), pose=body), stamp)

    def grid(self, stamp: float, width: int, height: int, data: object, *, topic: str = "/map", resolution: float = 0.5,
             xy: tuple[float, float] = (0.0, 0.0), q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> MiniBag:  # fmt: skip
        header = self.header(stamp, "map")
        info = self.make(
            "nav_msgs/msg/MapMetaData",
            map_load_time=header.stamp,
            resolution=resolution,
            width=width,
            height=height,
            origin=self.pose_message(xy, q),
        )
        message = self.make(GRID, header=header, info=info, data=np.asarray(data, dtype=np.int8))
        return self.add(topic, GRID, message, stamp)

    def raw(self, stamp: float, values: object, topic: str, *, recorded: float | None = None) -> MiniBag:
        message = self.make(RAW, header=self.header(stamp, ""), raw=np.asarray(values, dtype=np.float32))
        return self.add(topic, RAW, message, stamp if recorded is None else recorded)

    def declare(self, topic: str, msgtype: str) -> MiniBag:
        """Add a topic without messages."""
        self.topics[topic] = msgtype
        return self

    def _with_covariance(self, xy: tuple[float, float], q: tuple[float, ...]) -> object:
        return self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose_message(xy, q), covariance=np.zeros(36))

    def write(self, folder: Path, name: str = "log", *, compression: str | None = None) -> Path:
        """Write the bag and return what a user would name.

        `compression` is bz2 or lz4 in ROS 1, and file, message or (MCAP) storage in ROS 2, which has zstd only.
        """
        if self.ros1:
            path = folder / f"{name}.bag"
            writer = rosbag1.Writer(path)
            if compression:
                writer.set_compression(writer.CompressionFormat[compression.upper()])
        else:
            path = folder / name
            plugin = rosbag2.StoragePlugin.MCAP if self.storage == "mcap" else rosbag2.StoragePlugin.SQLITE3
            writer = rosbag2.Writer(path, version=9, storage_plugin=plugin)
            if compression:
                mode = rosbag2.CompressionMode[compression.upper()]
                writer.set_compression(mode, rosbag2.CompressionFormat.ZSTD)
        with writer:
            connections = {t: writer.add_connection(t, m, typestore=self.types) for t, m in self.topics.items()}
            for topic, msgtype, recorded, message in self.messages:
                serialize = self.types.serialize_ros1 if self.ros1 else self.types.serialize_cdr
                writer.write(connections[topic], round(recorded * 1e9), serialize(message, msgtype))
        return path
