"""What a landmark sensor measured beside what the map lets expect: one row per feature of known landmark."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.calibration.time_split import time_blocks
from beamfield.detection_log import DetectionLog
from beamfield.detections import SPURIOUS, UNKNOWN
from beamfield.geometry import FloatArray, as_mount, compose, wrap_angle
from beamfield.indices import subset_of
from beamfield.maps.landmarks import LandmarkMap

# Errors stay while a robot sees the same landmarks from nearly the same place, for minutes in a room; 20 s, as for
# laser beams, would make intervals too narrow. Fewer blocks than these tell too little of how blocks vary.
USUAL_BLOCKS = 24


@dataclass(frozen=True, eq=False)
class SightingTable:
    """Features in rows.

    Parameters
    ----------
    ranges, bearings
        (n,) what was measured, metres and radians; NaN where it was not.
    expected_ranges, expected_bearings
        (n,) true range and bearing of the feature's landmark, without bias; NaN for a feature of no landmark.
    landmarks
        (n,) index in the map; -1 for a feature known to be of no landmark.
    stamps
        (n,) seconds.
    blocks
        (n,) number of the stretch of time or place that the feature belongs to, from 0 on.
    n_unknown, n_without_pose
        Features left out because their landmark, or the pose, is not known.
    """

    ranges: FloatArray
    bearings: FloatArray
    expected_ranges: FloatArray
    expected_bearings: FloatArray
    landmarks: NDArray[np.int64]
    stamps: FloatArray
    blocks: NDArray[np.int64]
    n_unknown: int = 0
    n_without_pose: int = 0

    def __len__(self) -> int:
        return len(self.ranges)

    @property
    def range_residuals(self) -> FloatArray:
        """(n,) measured minus true range, metres."""
        return self.ranges - self.expected_ranges

    @property
    def bearing_residuals(self) -> FloatArray:
        """(n,) measured minus true bearing, radians in (-pi, pi]."""
        return wrap_angle(self.bearings - self.expected_bearings)

    def subset(self, rows: ArrayLike) -> SightingTable:
        """Return only the given rows, indices or a mask (n,), in the given order; as many features stay left out."""
        columns = ("ranges", "bearings", "expected_ranges", "expected_bearings", "landmarks", "stamps", "blocks")
        return subset_of(self, rows, len(self), "rows", columns)


def sighting_table(
    landmark_map: LandmarkMap, log: DetectionLog, *, mount: ArrayLike = (0.0, 0.0, 0.0), block_s: float | None = None
) -> SightingTable:
    """Put every feature whose landmark and pose are known beside its true range and bearing.

    The mount (3,) is the pose of the sensor on the robot. A block is block_s seconds long; None: the log's places where
    it has them, else a 24th of the log.

    One row per feature with a range or a bearing; what is of no landmark has NaN as its true range and bearing.
    InvalidInputError names an id that is not in the map.
    """
    sensor = as_mount(mount)
    blocks = _blocks(log, block_s)
    counts = [len(seen) for seen in log.detections]
    which = np.repeat(np.arange(len(log)), counts)
    ids = _joined([np.full(len(z), UNKNOWN) if z.ids is None else z.ids for z in log.detections]).astype(np.int64)
    ranges, bearings = (_joined([getattr(z, name) for z in log.detections]) for name in ("ranges", "bearings"))
    has_pose = ~np.isnan(log.poses[which, 0])
    known, measured = ids != UNKNOWN, ~(np.isnan(ranges) & np.isnan(bearings))
    used = known & has_pose & measured
    which, ids, ranges, bearings = which[used], ids[used], ranges[used], bearings[used]
    real = ids != SPURIOUS
    landmarks = np.full(len(ids), -1, dtype=np.int64)
    landmarks[real] = landmark_map.indices_of(ids[real])
    at = compose(log.poses[which], sensor)
    away = landmark_map.positions[landmarks] - at[:, :2]
    distance = np.hypot(away[:, 0], away[:, 1])
    # As in the model: a landmark at the sensor counts as straight ahead.
    angle = np.where(distance == 0.0, 0.0, np.arctan2(away[:, 1], away[:, 0]) - at[:, 2])
    return SightingTable(
        ranges,
        bearings,
        np.where(real, distance, np.nan),
        np.where(real, wrap_angle(angle), np.nan),
        landmarks,
        log.stamps[which],
        blocks[which],
        int((~known).sum()),
        int((known & ~has_pose).sum()),
    )


def _blocks(log: DetectionLog, block_s: float | None) -> NDArray[np.int64]:
    if block_s is None and log.places is not None:
        return np.asarray(np.unique(log.places, return_inverse=True)[1], dtype=np.int64)
    stamps = log.stamps
    if block_s is None and len(stamps) and np.ptp(stamps) > 0.0:
        block_s = float(np.ptp(stamps)) / USUAL_BLOCKS
    return time_blocks(stamps, block_s)


def _joined(columns: list[NDArray[np.float64]] | list[NDArray[np.int64]]) -> FloatArray:
    return np.concatenate([np.empty(0), *columns])
