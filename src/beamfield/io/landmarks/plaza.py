"""The Plaza sets of ranging radios: .mat files of beacons (TL), ranges (TD) and GPS poses (GT)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.detection_log import DetectionLog, group_detections
from beamfield.errors import FormatError
from beamfield.geometry import interpolate_poses
from beamfield.io.landmarks.mat_file import read_mat_arrays
from beamfield.io.landmarks.mat_table import mat_ids, mat_landmarks, mat_table, require_known, require_rising
from beamfield.maps.landmarks import LandmarkMap

# GPS poses come five or ten times a second; over longer gaps a mower's path is not a straight line.
LONGEST_GAP_S = 1.0


def read_plaza(path: str | Path) -> tuple[LandmarkMap, DetectionLog]:
    """Read the beacons, and the ranges to them, with poses interpolated between those of the GPS.

    Variables are ``TL`` [id x y], ``TD`` [time sender receiver range], where the receiver is the beacon, and ``GT``
    [time x y heading]; metres, seconds and radians.

    Parameters
    ----------
    path
        A MATLAB 5 file.

    Returns
    -------
    landmarks, log
        The beacons, and one observation per range, in the order of time. A pose is NaN where GPS poses are more than a
        second apart.

    Raises
    ------
    FormatError
        If a variable is missing, has other columns or a number that is not finite, times of poses do not rise, a
        beacon appears twice, or a range names a beacon that the file has not or was sent by two senders.
    OSError
        As the file system says.

    Notes
    -----
    Ranges are the only thing measured; headings are those of the file, which in the second set point backwards.

    References
    ----------
    Djugash, Hamner, Roth, "Navigating with ranging radios: five data sets with ground truth", Journal of Field Robotics
    26(9), 2009.
    """
    source = Path(path)
    arrays = read_mat_arrays(source)
    landmarks = mat_landmarks(source, arrays, "TL")
    heard = mat_table(source, arrays, "TD", "time sender receiver range")
    track = mat_table(source, arrays, "GT", "time x y heading")
    require_rising(source, track[:, 0], "GT", "times")
    ids = mat_ids(source, heard, 2, "TD", "receiver")
    require_known(source, ids, landmarks.ids, "TD", "beacon of TL")
    if np.ptp(heard[:, 1]) > 0.0:
        row = int((heard[:, 1] != heard[0, 1]).argmax())
        text = f"row {row + 1}: expected one sender, the robot, got {heard[row, 1]:g} after {heard[0, 1]:g}"
        raise FormatError(source, text, field="TD")
    order = np.argsort(heard[:, 0], kind="stable")
    heard, ids, n = heard[order], ids[order], len(heard)
    poses = interpolate_poses(track[:, 0], track[:, 1:], heard[:, 0], max_gap=LONGEST_GAP_S)
    detections = group_detections(np.arange(n), heard[:, 0], heard[:, 3], np.full(n, np.nan), ids)
    return landmarks, DetectionLog(poses, detections, notes=_notes(order, int(np.isnan(poses[:, 0]).sum())))


def _notes(order: NDArray[np.int64], n_without: int) -> tuple[str, ...]:
    notes = []
    steps_back = int((np.diff(np.argsort(order)) < 0).sum())
    if steps_back:
        notes.append(f"Ranges are sorted by time: their times step back {steps_back} times in the file.")
    if n_without:
        notes.append(f"{n_without} ranges have no pose: the GPS has none within a second.")
    return tuple(notes)
