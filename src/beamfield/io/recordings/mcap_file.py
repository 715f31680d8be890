"""Write a recording as an mcap of standard ROS 2 messages, for Foxglove, RViz and whatever reads bags."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.io.bags.messages import Message, MessageMaker, even_bearings, load_typestore, write_messages
from beamfield.io.files.atomic import atomic_file
from beamfield.io.recordings.recording import COLOURS, Recording, entity

MAP, BASE, LASER = "map", "base_link", "laser"
POINT_SIZE = 0.06  # metres
# Of visualization_msgs/Marker.
POINTS, ADD = 8, 0


def write_mcap(path: str | Path, recording: Recording) -> None:
    """Write a recording as one .mcap file of ROS 2 messages, whole or not at all.

    `/map` is a nav_msgs/OccupancyGrid, `/scan` sensor_msgs/LaserScan in the frame of the sensor, which /tf places in
    the map along the first path. Each path has a topic of geometry_msgs/PoseWithCovarianceStamped and, whole, of
    nav_msgs/Path; `/particles` is a geometry_msgs/PoseArray, `/causes` a visualization_msgs/MarkerArray of the readings
    coloured by their cause, and each number a topic of std_msgs/Float64. Foxglove and RViz show them as they are.

    InvalidInputError if the sensor cannot be a LaserScan (beams from several points, or uneven bearings), or a stamp is
    no ROS 2 time; MissingDependencyError if rosbags is not installed.
    """
    typestore = load_typestore()
    messages = sorted(_Messages(recording, MessageMaker(typestore)).all(), key=lambda message: message.nanoseconds)
    with atomic_file(path) as part:
        # The writer makes a folder with metadata; the mcap in it describes itself.
        folder = part.with_suffix("")
        # What late listeners need: viewers may start anywhere in the recording.
        latched = ("/map", "/tf_static", *(f"/{entity(name)}/path" for name in recording.paths))
        write_messages(folder, messages, typestore, latched=latched)
        next(folder.glob("*.mcap")).rename(part)


@dataclass(frozen=True)
class _Messages:
    """What goes where."""

    recording: Recording
    make: MessageMaker

    def all(self) -> Iterator[Message]:
        recording, log = self.recording, self.recording.log
        start = float(log.stamps[0])
        yield self.make.at(start, "/map", self._map(start))
        mount = log.finder.mounts[0]
        fixed = [self.make.transform(BASE, LASER, start, (mount[0], mount[1], 0.0))]
        yield self.make.at(start, "/tf_static", self.make.new("tf2_msgs/msg/TFMessage", fixed))
        bearings = even_bearings(log.finder, "scan")
        for i, stamp in enumerate(log.stamps):
            scan = self.make.laser_scan(stamp, LASER, log.ranges[i], log.finder, bearings)
            yield self.make.at(stamp, "/scan", scan)
        for number, (name, poses) in enumerate(recording.paths.items()):
            yield from self._path(name, poses, None if number else recording.covariances, carries=not number)
        for i, particles in recording.particles:
            stamp = float(log.stamps[i])
            header = self.make.header(stamp, MAP)
            cloud = self.make.new("geometry_msgs/msg/PoseArray", header, [self.make.pose(pose) for pose in particles])
            yield self.make.at(stamp, "/particles", cloud)
        for name, values in recording.numbers.items():
            for stamp, value in zip(log.stamps, values, strict=True):
                if np.isfinite(value):
                    number = self.make.new("std_msgs/msg/Float64", float(value))
                    yield self.make.at(float(stamp), f"/{entity(name)}", number)
        if recording.causes is not None:
            yield from self._causes()

    def _map(self, stamp: float) -> Any:
        grid = self.recording.grid
        rows, cols = grid.shape
        cells = np.full(grid.shape, -1, np.int8)
        cells[grid.free] = 0
        cells[grid.occupied] = 100
        about = self.make.new(
            "nav_msgs/msg/MapMetaData", self.make.time(stamp), grid.resolution, cols, rows, self.make.pose(grid.origin)
        )
        return self.make.new("nav_msgs/msg/OccupancyGrid", self.make.header(stamp, MAP), about, cells.ravel())

    def _path(
        self, name: str, poses: FloatArray, covariances: FloatArray | None, *, carries: bool
    ) -> Iterator[Message]:
        stamps = self.recording.log.stamps
        known = np.flatnonzero(np.isfinite(poses).all(axis=1))
        way = []
        for i in known:
            stamp = float(stamps[i])
            covariance = None if covariances is None or np.isnan(covariances[i]).any() else covariances[i]
            posed = self.make.pose_with_covariance(stamp, MAP, poses[i], covariance)
            yield self.make.at(stamp, f"/{entity(name)}", posed)
            header = self.make.header(stamp, MAP)
            way.append(self.make.new("geometry_msgs/msg/PoseStamped", header, self.make.pose(poses[i])))
            if carries:
                yield self.make.tf(MAP, BASE, stamp, poses[i])
        start = float(stamps[0])
        path = self.make.new("nav_msgs/msg/Path", self.make.header(start, MAP), way)
        yield self.make.at(start, f"/{entity(name)}/path", path)

    def _causes(self) -> Iterator[Message]:
        for i, stamp in enumerate(self.recording.log.stamps):
            points, causes = self.recording.scan_points(i)
            if causes is not None:
                marker = self._points(float(stamp), points, causes)
                yield self.make.at(
                    float(stamp), "/causes", self.make.new("visualization_msgs/msg/MarkerArray", [marker])
                )

    def _points(self, stamp: float, points: FloatArray, causes: Any) -> Any:
        make = self.make
        palette = [make.new("std_msgs/msg/ColorRGBA", *(value / 255.0 for value in colour), 1.0) for colour in COLOURS]
        empty_image = make.new("sensor_msgs/msg/CompressedImage", make.header(stamp, ""), "", np.empty(0, np.uint8))
        return make.new(
            "visualization_msgs/msg/Marker",
            make.header(stamp, MAP), "causes", 0, POINTS, ADD, make.pose((0.0, 0.0, 0.0)),
            make.vector(POINT_SIZE, POINT_SIZE, 0.0), palette[0],
            make.new("builtin_interfaces/msg/Duration", 0, 0), False,
            [make.vector(x, y, 0.0, "Point") for x, y in points], [palette[max(int(cause), 0)] for cause in causes],
            "", empty_image, [], "", "", make.new("visualization_msgs/msg/MeshFile", "", np.empty(0, np.uint8)), False,
        )  # fmt: skip
