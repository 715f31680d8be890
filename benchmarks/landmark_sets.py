"""Readers of other people's landmark data: MRCLAM moments, the Plaza radios, Roh's infrared beacons.

The sets are not part of this repository; files are trusted to be what their makers published.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from beamfield.detection_log import DetectionLog, group_detections
from beamfield.geometry import interpolate_poses
from beamfield.maps.landmarks import LandmarkMap

# GPS poses come five or ten times a second; over longer gaps a mower's path is not a straight line.
LONGEST_GAP_S = 1.0
PLACE = re.compile(r"\(X(-?[\d.]+),Y(-?[\d.]+)\)\.csv")


def read_mrclam(path: Path) -> tuple[LandmarkMap, DetectionLog]:
    """Read landmark [id x y], groundtruth [moment x y theta] and measurement [moment id range bearing].

    Stamps are the moments' numbers. What was off by more than 0.5 m or 0.25 rad, and moments with fewer than three
    landmarks, were left out by whoever made the files (so the residuals say).

    References
    ----------
    Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping dataset", International
    Journal of Robotics Research 30(8), 2011.
    """
    content = loadmat(path)
    truth, seen = content["groundtruth"], content["measurement"]
    which = np.searchsorted(truth[:, 0], seen[:, 0])
    detections = group_detections(which, truth[:, 0], seen[:, 2], seen[:, 3], seen[:, 1].astype(np.int64))
    return _landmarks(content["landmark"]), DetectionLog(truth[:, 1:], detections)


def read_plaza(path: Path) -> tuple[LandmarkMap, DetectionLog]:
    """Read TL [id x y], TD [time sender receiver range] and GT [time x y heading], ranges in the order of time.

    Poses are NaN where those of the GPS are more than a second apart; headings of the second set point backwards.

    References
    ----------
    Djugash, Hamner, Roth, "Navigating with ranging radios: five data sets with ground truth", Journal of Field Robotics
    26(9), 2009.
    """
    content = loadmat(path)
    heard, track = content["TD"], content["GT"]
    heard = heard[np.argsort(heard[:, 0], kind="stable")]
    n, ids = len(heard), heard[:, 2].astype(np.int64)
    poses = interpolate_poses(track[:, 0], track[:, 1:], heard[:, 0], max_gap=LONGEST_GAP_S)
    detections = group_detections(np.arange(n), heard[:, 0], heard[:, 3], np.full(n, np.nan), ids)
    return _landmarks(content["TL"]), DetectionLog(poses, detections)


def read_roh(folder: Path) -> tuple[LandmarkMap, DetectionLog]:
    """Read landmark.csv, rows x, y, and (Xa,Yb).csv, rows of one bearing in degrees per beacon, seen from (a, b).

    The robot's heading was +90 degrees; there are no times, so that stamps count rows, place after place.
    """
    landmarks = LandmarkMap(np.loadtxt(folder / "landmark.csv", delimiter=",", ndmin=2))
    files = [(match, path) for path in sorted(folder.iterdir()) if (match := PLACE.fullmatch(path.name))]
    rows = [np.deg2rad(np.loadtxt(path, delimiter=",", ndmin=2)) for _, path in files]
    where = [[float(match[1]), float(match[2]), np.pi / 2.0] for match, _ in files]
    places = np.repeat(np.arange(len(files)), [len(table) for table in rows])
    angles = np.concatenate(rows)
    t, k = angles.shape
    detections = group_detections(
        np.repeat(np.arange(t), k), np.arange(t), np.full(t * k, np.nan), angles.ravel(), np.tile(landmarks.ids, t)
    )
    return landmarks, DetectionLog(np.array(where)[places], detections, places)


def _landmarks(table: np.ndarray) -> LandmarkMap:
    return LandmarkMap(table[:, 1:], table[:, 0].astype(np.int64))
