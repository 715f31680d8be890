"""Maps that a bag carries: nav_msgs/OccupancyGrid."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

import numpy as np

from beamfield.arguments import checked
from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import yaw_from_quaternion
from beamfield.io.bags.bag_file import BagFile, BagMessage
from beamfield.maps.occupancy import OccupancyGrid

OCCUPANCY_GRID = "nav_msgs/msg/OccupancyGrid"


def read_bag_map(path: str | Path, topic: str | None = None) -> OccupancyGrid:
    """Read the map of a bag: the last nav_msgs/OccupancyGrid of a topic.

    If no topic is named, it is the only one of that type, or ``/map`` if there are several. The origin has the yaw of
    the message's quaternion (four zeros, as ROS 1 leaves it, are no rotation).

    FormatError if there is no such message, its size does not fit its data, or its values, resolution or origin are
    wrong; InvalidInputError if the topic is not there or holds something else.
    """
    with BagFile(path) as bag:
        chosen = bag.only_topic("map topic", topic, OCCUPANCY_GRID, preferred="/map")
        last: BagMessage | None = None
        for last in bag.messages([chosen]):  # noqa: B007 - the last one counts
            pass
        if last is None:
            raise FormatError(path, "the topic holds no message", field=chosen)
        with bag.quoting(last):
            return grid_from_message(last.content)


class OccupancyGridMessage(Protocol):
    """What has the fields of nav_msgs/OccupancyGrid: a message of rclpy, rospy or rosbags."""

    @property
    def info(self) -> Any:
        """Width, height, resolution and origin."""

    @property
    def data(self) -> Any:
        """-1 for unknown, or percent, row by row from the lowest y."""


@checked
def grid_from_message(message: OccupancyGridMessage) -> OccupancyGrid:
    """Turn a message of nav_msgs/OccupancyGrid into a grid, as a callback of rclpy gets it; ROS is not needed.

    Parameters
    ----------
    message
        Any object with the fields of the message.

    Returns
    -------
    The grid; its origin has the yaw of the message's quaternion (four zeros, as ROS 1 leaves it, are no rotation).

    Raises
    ------
    InvalidInputError
        If something is not a message, its size does not fit its data, or its values, resolution or origin are wrong.
    """
    info, data = message.info, np.asarray(message.data)
    if info.width * info.height != len(data) or len(data) == 0:
        raise InvalidInputError(f"expected width {info.width} x height {info.height} cells, got {len(data)}")
    p, q = info.origin.position, info.origin.orientation
    quaternion = np.array([q.x, q.y, q.z, q.w])
    if not quaternion.any():
        quaternion = np.array([0.0, 0.0, 0.0, 1.0])
    if not (np.abs(quaternion) < 2.0).all() or abs(np.linalg.norm(quaternion) - 1.0) >= 0.01:
        raise InvalidInputError(f"origin: expected a quaternion of length 1, got {quaternion.tolist()}")
    if np.hypot(quaternion[0], quaternion[1]) > 0.01:
        raise InvalidInputError(f"origin: expected a rotation about z only, got the quaternion {quaternion.tolist()}")
    origin = np.array([p.x, p.y, float(yaw_from_quaternion(*quaternion))])
    return OccupancyGrid.from_ros(data.reshape(info.height, info.width), float(info.resolution), origin)
