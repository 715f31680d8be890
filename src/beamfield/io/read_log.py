"""Read a log of scans, whatever its format."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import checked
from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files.bag_storage import BAG_SUFFIXES, is_packed_storage, storage_of
from beamfield.io.files.text_lines import is_number, read_lines
from beamfield.io.logs.carmen import read_carmen
from beamfield.io.logs.carmen_messages import CARMEN_SCANS
from beamfield.io.logs.coreslam import N_BEAMS, RANGES_FROM, read_coreslam
from beamfield.io.logs.g2o import read_g2o
from beamfield.io.logs.gfs import read_gfs
from beamfield.io.logs.scan_stamps import StampRule
from beamfield.io.logs.sonar_log import MEASUREMENTS, POSES, is_sonar_log, read_sonar_log
from beamfield.io.logs.text_scans import LonePoses, TextOptions
from beamfield.io.logs.wean_log import read_wean_log
from beamfield.io.no_return import NoReturnRule
from beamfield.sensors import ScanLog

SUPPORTED = (
    "CARMEN (FLASER, RLASER, ROBOTLASERn, RAWLASERn), Wean Hall O and L lines, GMapping .gfs, .g2o with ROBOTLASER1, "
    "CoreSLAM .dat (each plain or gzip), a folder with measurement.txt and poses.txt, ROS 1 .bag (or the folder of one "
    "that was split), ROS 2 folders, .db3 and .mcap"
)

# The first line of a range table; its module would load the numerical libraries.
RANGE_TABLE = "beamfield range table"
# Radians: bearings of single precision lie so close to the ends of a sector that they are meant to be in.
EDGE = 1e-6
# Lines without any known word after which a file is given up; odometry may come long before the first scan.
UNKNOWN_LINES = 100

_Reader = Callable[[Path, TextOptions], ScanLog]


@checked
def read_log(
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
    opening_angle: float | None = None,
    mask: Sequence[tuple[float, float]] = (),
    stamps: StampRule = "file",
    lone_poses: LonePoses = "reference",
) -> ScanLog:
    """Read a log of range scans; the format is recognised by the content.

    Parameters
    ----------
    path
        CARMEN, Wean Hall, GMapping (.gfs), g2o or CoreSLAM text, plain or gzip; a folder with measurement.txt and
        poses.txt; a ROS 1 .bag, a ROS 2 folder, .db3 or .mcap (with the extra ``ros``).
    sensor_topic
        Topic or message name of the sensor, or several; all if None.
    poses_topic, map_frame, base_frame
        Where a bag's reference poses are; see `beamfield.io.bags.reader.read_bag`. Text logs have no such choice.
    mount
        (3,) the sensor's pose on the robot, metres and radians, for a bag that does not say; text logs say.
    no_return
        "detect" the values that mean "no return", "none", or the values in metres, of which one may be NaN.
    max_range, min_range
        The sensor's limits in metres, instead of what the file or the data say.
    opening_angle
        Full width of the sensor's cones in radians, instead of what the file or the format says; 0 for beams.
    mask
        Sectors (from, to) of bearings in radians, counter-clockwise, whose readings become NaN: parts of the robot.
    stamps
        Text logs only: "file", or "order" to number the scans, one second apart.
    lone_poses
        Text logs only: what the poses are in a log that has one per scan, "reference" or "odometry".

    Returns
    -------
    The log. Its notes say what was not obvious: values for "no return", lost stamps, poses that may be odometry.

    Raises
    ------
    FormatError
        If the format is unknown or the content is damaged: file, line and value are named.
    InvalidInputError
        If an option does not fit the log, or there is no sensor of that name.
    MissingDependencyError
        If a bag is given and rosbags is not installed.
    OSError
        As the file system says.

    Examples
    --------
    >>> read_log("corridor.log.gz").only_sensor().finder.n_beams  # doctest: +SKIP
    180
    """
    source = Path(path)
    if min_range is not None and not 0.0 <= min_range < float("inf"):
        raise InvalidInputError(f"min_range: expected a finite number of metres >= 0, got {min_range!r}")
    if opening_angle is not None and not 0.0 <= opening_angle < math.pi:
        raise InvalidInputError(f"opening_angle: expected [0, pi) radians, got {opening_angle!r}")
    limits: dict[str, Any] = {"no_return": no_return, "max_range": max_range, "min_range": min_range}
    bag_only: dict[str, Any] = {
        "poses_topic": poses_topic, "map_frame": map_frame, "base_frame": base_frame, "mount": mount
    }  # fmt: skip
    if _is_bag(source):
        # Text logs need neither rosbags nor the time to import it.
        from beamfield.io.bags.reader import read_bag

        if stamps != "file" or lone_poses != "reference":
            given = f"stamps={stamps!r}" if stamps != "file" else f"lone_poses={lone_poses!r}"
            raise InvalidInputError(f"{source}: {given} is for text logs, this is a bag")
        return _adjusted(read_bag(source, sensor_topic=sensor_topic, **bag_only, **limits), mask, opening_angle)
    for name, value in bag_only.items():
        if value is not None:
            raise InvalidInputError(
                f"{name}: is for bags; {source} is text, has no topics or frames, and says where the sensor is"
            )
    asked = (sensor_topic,) if isinstance(sensor_topic, str) else None if sensor_topic is None else tuple(sensor_topic)
    options = TextOptions(asked, stamps=stamps, lone_poses=lone_poses, **limits)
    reader = _text_reader(source)
    log = _adjusted(reader(source, options), mask, opening_angle)
    if asked is None:
        return log
    if not set(asked) <= set(log.sensors):
        # Read once more without the choice, to say what there is to choose from.
        log = reader(source, replace(options, sensors=None))
    return _only(log, asked)


def _adjusted(log: ScanLog, mask: Sequence[tuple[float, float]], opening_angle: float | None) -> ScanLog:
    """Return the log without the readings of some sectors, and with another opening angle if one is given."""
    if not len(mask) and opening_angle is None:
        return log
    sensors, notes = dict(log.sensors), list(log.notes)
    for name, sensor in log.sensors.items():
        finder, ranges = sensor.finder, sensor.ranges
        if opening_angle is not None:
            finder = replace(finder, opening_angle=opening_angle)
        if len(mask):
            blind = np.zeros(finder.n_beams, dtype=bool)
            for first, last in mask:
                if not (math.isfinite(first) and math.isfinite(last)):
                    raise InvalidInputError(f"mask: expected finite bearings in radians, got {(first, last)!r}")
                turn = 2.0 * math.pi
                width = (last - first) % turn if last - first < turn - EDGE else turn
                blind |= (finder.bearings - first + EDGE) % turn <= width + 2.0 * EDGE
            ranges = np.where(blind, np.nan, ranges)
            notes.append(f"{name}: {blind.sum()} of {len(blind)} beams masked")
        sensors[name] = replace(sensor, finder=finder, ranges=ranges)
    return replace(log, sensors=sensors, notes=tuple(notes))


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return any(file.name == "metadata.yaml" or _is_named_as_bag(file) for file in path.iterdir())
    return _is_named_as_bag(path) or storage_of(path) is not None


def _is_named_as_bag(path: Path) -> bool:
    return path.suffix in BAG_SUFFIXES or is_packed_storage(path)


def folder_of_log(path: Path) -> Path | None:
    """Return the folder that is read for a log, also where one file of a bag is named; None if a file is read alone."""
    if path.is_dir():
        return path
    # Here, because only few files are bags.
    from beamfield.io.bags.bag_file import listed_in_metadata

    return path.parent if _is_named_as_bag(path) and listed_in_metadata(path) else None


def files_of_folder(folder: Path) -> list[Path]:
    """Return the files that a log may be read from in a folder of any format."""
    names = ("metadata.yaml", MEASUREMENTS, POSES)
    return [file for file in folder.iterdir() if file.name in names or _is_named_as_bag(file)]


def _only(log: ScanLog, asked: tuple[str, ...]) -> ScanLog:
    sensors = {name: log.sensors[name] for name in asked if name in log.sensors}
    if len(sensors) < len(asked):
        missing = ", ".join(repr(name) for name in asked if name not in log.sensors)
        known = ", ".join(repr(name) for name in log.sensors)
        raise InvalidInputError(f"{log.source}: no sensor {missing}; the log has {known}")
    return replace(log, sensors=sensors)


def _text_reader(path: Path) -> _Reader:
    """Return the reader for the first line that shows the format."""
    if path.is_dir():
        if is_sonar_log(path):
            return read_sonar_log
        raise FormatError(
            path, f"a folder without metadata.yaml (ROS 2 bag) or measurement.txt; supported: {SUPPORTED}"
        )
    carmen_like = False
    first: tuple[int, str] | None = None
    unknown = 0
    for line, text in read_lines(path):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        if text.rstrip("\n") == RANGE_TABLE:
            raise FormatError(
                path, "this is a range table: give it with --range-table to beamfield localize or likelihood"
            )
        first = first or (line, text)
        reader = _reader_of(words, first[0] == line)
        if reader is not None:
            return reader
        carmen_like |= words[0] in ("PARAM", "ODOM", "TRUEPOS", "SYNC")
        unknown += not carmen_like
        if unknown > UNKNOWN_LINES:
            break
    if carmen_like:
        return read_carmen
    if first is None:
        raise FormatError(path, "no scans: the file is empty")
    start = " ".join(islice(first[1].split(), 4))[:60]
    raise FormatError(path, f"unknown format, the text starts with {start!r}; supported: {SUPPORTED}", line=first[0])


def _reader_of(words: list[str], is_first: bool) -> _Reader | None:
    kind = words[0]
    if CARMEN_SCANS.match(kind):
        return read_carmen
    if kind in ("LASER_READING", "SM_UPDATE", "ODO_UPDATE"):
        return read_gfs
    if kind in ("VERTEX_SE2", "EDGE_SE2"):
        return read_g2o
    if kind in ("O", "L") and len(words) > 3 and all(map(is_number, words[1:4])):
        return read_wean_log
    if is_first and len(words) >= RANGES_FROM + N_BEAMS // 2 and all(map(is_number, words[:4])):
        return read_coreslam
    return None
