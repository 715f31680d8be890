"""The record of one run in a catalogue: what was read, what came of it, and where its beams are."""

from __future__ import annotations

import datetime
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np

from beamfield.arguments import check_fields, require
from beamfield.errors import FormatError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.io.maps.map_image import MAX_PIXELS
from beamfield.sensors import RangeFinder
from beamfield.short_repr import short_repr


@dataclass(frozen=True)
class ShardFile:
    """One file of beams of a run: those of one day (UTC).

    Parameters
    ----------
    path
        In the catalogue.
    day
        As 2026-11-22.
    rows, size
        Beams, and bytes.
    """

    path: str
    day: str
    rows: int
    size: int

    def __post_init__(self) -> None:
        check_fields(self)
        datetime.date.fromisoformat(self.day)
        # Files of old records are removed: only such as a scan writes.
        inside = self.path.startswith("beams/") and ".." not in self.path.split("/") and "\\" not in self.path
        require(inside, "path", "a file in beams/", self.path)


@dataclass(frozen=True)
class MapInfo:
    """The map of a run.

    Parameters
    ----------
    resolution
        Side of a cell, metres.
    origin
        x, y and yaw of the corner of cell (0, 0), metres and radians.
    shape
        Rows and columns.
    content
        Hash of its cells and frame: the name of its copy in the catalogue.
    """

    resolution: float
    origin: tuple[float, float, float]
    shape: tuple[int, int]
    content: str

    def __post_init__(self) -> None:
        check_fields(self)
        require(np.isfinite([self.resolution, *self.origin]).all(), "origin", "finite numbers", self.origin)
        rows, cols = self.shape
        require(rows > 0 < cols and rows * cols <= MAX_PIXELS, "shape", f"1 to {MAX_PIXELS} cells", self.shape)
        require(re.fullmatch("[0-9a-f]{64}", self.content), "content", "a hash", self.content)


@dataclass(frozen=True)
class OdometryErrors:
    """Systematic errors of a run's odometry, see `OdometryCalibration.systematic`.

    Parameters
    ----------
    names
        Among "distance_scale", "turn_scale", "drift" (rad/m) and "yaw" (rad): those that the drive shows.
    values
        One per name.
    covariance
        Of the values, by the jackknife over blocks of time.
    """

    names: tuple[str, ...]
    values: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        check_fields(self)
        n = len(self.names)
        square = len(self.covariance) == n and all(len(row) == n for row in self.covariance)
        require(len(self.values) == n and square, "covariance", f"{n} values and a matrix of that size", self)
        require(np.isfinite([self.values, *self.covariance]).all(), "covariance", "finite numbers", self)

    def estimate(self, name: str) -> tuple[float, float] | None:
        """Return the value and the standard deviation of one error; None if the drive does not show it."""
        if name not in self.names:
            return None
        i = self.names.index(name)
        return self.values[i], float(np.sqrt(self.covariance[i][i]))


@dataclass(frozen=True)
class RunRecord:
    """One run of a robot.

    Parameters
    ----------
    run
        Its name in the catalogue.
    robot, site
        As the manifest names them.
    key
        Hash of everything that its beams come from; "" for a log that could not be read, which is tried again.
    log, map, poses
        Addresses as the manifest gives them, without secrets; poses "" if it gives none.
    log_sensor
        The log's sensor as the manifest names it; "": the only one.
    log_hash
        SHA-256 of the log; "" if it could not be read.
    status, reason
        Whether its beams are used, or why it was left out.
    first_stamp, last_stamp
        Of its scans that are used, seconds; NaN if left out.
    scans, beams
        Scans used, and rows in its files.
    files
        One per day.
    sensor
        Mounts (k, 3), max_range, min_range, opening_angle and name of the sensor.
    map_info
        The map.
    pose_source
        Where the poses come from: the "log", a "file", or "fitted" to the map.
    share_trusted
        Of fitted poses: share of the log's scans with a pose that is trusted; 1 otherwise.
    odometry, odometry_reason
        Systematic errors, or why there are none.
    selection
        How many scans were used ("used"), and dropped by reason.
    left_out
        Readings of the scans used that are in no file, by reason.
    findings
        Warnings about its poses and its odometry.
    notes
        How its log was read.
    """

    run: str
    robot: str
    site: str
    key: str
    log: str
    map: str
    poses: str
    log_sensor: str
    log_hash: str
    status: Literal["used", "left out"]
    reason: str = ""
    first_stamp: float = float("nan")
    last_stamp: float = float("nan")
    scans: int = 0
    beams: int = 0
    files: tuple[ShardFile, ...] = ()
    sensor: Mapping[str, Any] = field(default_factory=dict)
    map_info: MapInfo | None = None
    pose_source: Literal["", "log", "file", "fitted"] = ""
    share_trusted: float = 0.0
    odometry: OdometryErrors | None = None
    odometry_reason: str = ""
    selection: Mapping[str, int] = field(default_factory=dict)
    left_out: Mapping[str, int] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.status in ("used", "left out"), "status", "'used' or 'left out'", self.status)
        require(0.0 <= self.share_trusted <= 1.0, "share_trusted", "a share", self.share_trusted)
        for name, counts in (("selection", self.selection), ("left_out", self.left_out)):
            require(all(type(n) is int and n >= 0 for n in counts.values()), name, "counts", counts)
        for finding in self.findings:
            check_fields(finding)
            numbers = all(type(value) is float and np.isfinite(value) for value in finding.values.values())
            require(numbers, "findings", "finite numbers as values", finding.values)
        require(all(isinstance(note, str) for note in self.notes), "notes", "texts", self.notes)
        require(self.is_used == bool(self.sensor), "sensor", "one of runs that are used", self.sensor)
        if self.is_used:
            _ = self.finder
            require(self.map_info is not None, "map_info", "a map", None)

    @property
    def is_used(self) -> bool:
        """Whether its beams are used."""
        return self.status == "used"

    @property
    def mounts(self) -> FloatArray:
        """(k, 3) of the sensor's beams in the robot frame, metres and radians; the column `beam` counts them."""
        return np.array(self.sensor["mounts"], dtype=np.float64)

    @property
    def finder(self) -> RangeFinder:
        """The sensor."""
        return RangeFinder(**{**self.sensor, "mounts": self.mounts})

    def to_json(self) -> bytes:
        """Return the record as a file has it."""
        values = asdict(self)
        for name in ("first_stamp", "last_stamp"):
            values[name] = values[name] if np.isfinite(values[name]) else None
        return (json.dumps(values, allow_nan=False) + "\n").encode()


def record_from_json(content: bytes, path: str, sensors: dict[str, Mapping[str, Any]] | None = None) -> RunRecord:
    """Return the record of a file, or raise FormatError.

    Sensors of other records, by what they say, are shared if equal: mounts are nearly all of a record.
    """
    try:
        values = json.loads(content)
        for name in ("first_stamp", "last_stamp"):
            values[name] = float("nan") if values[name] is None else float(values[name])
        if sensors is not None:
            values["sensor"] = sensors.setdefault(json.dumps(values["sensor"]), values["sensor"])
        values["files"] = tuple(ShardFile(**one) for one in values["files"])
        if values["map_info"] is not None:
            given = values["map_info"]
            values["map_info"] = MapInfo(
                float(given["resolution"]), tuple(given["origin"]), tuple(given["shape"]), given["content"]
            )
        if values["odometry"] is not None:
            given = values["odometry"]
            covariance = tuple(tuple(row) for row in given["covariance"])
            values["odometry"] = OdometryErrors(tuple(given["names"]), tuple(given["values"]), covariance)
        values["findings"] = tuple(Finding(**one) for one in values["findings"])
        values["notes"] = tuple(values.get("notes", ()))
        return RunRecord(**values)
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError) as error:
        raise FormatError(path, f"expected the record of a run, got something else: {error}") from error
