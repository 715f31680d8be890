"""UTIAS MRCLAM sets as moments with true poses: .mat files of landmark, groundtruth and measurement."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.detection_log import DetectionLog, group_detections
from beamfield.io.landmarks.mat_file import read_mat_arrays
from beamfield.io.landmarks.mat_table import mat_ids, mat_landmarks, mat_table, require_known, require_rising
from beamfield.maps.landmarks import LandmarkMap

NOTE = "The file has no times: stamps are the numbers of the moments, and stretches of the run are missing."


def read_mrclam_instant(path: str | Path) -> tuple[LandmarkMap, DetectionLog]:
    """Read the landmarks, and what was seen of them at moments with poses from motion capture.

    Variables are ``landmark`` [id x y], ``groundtruth`` [moment x y theta] and ``measurement`` [moment id range
    bearing], metres and radians.

    Parameters
    ----------
    path
        A MATLAB 5 file.

    Returns
    -------
    landmarks, log
        The map, and one observation per moment; its stamps are the moments' numbers.

    Raises
    ------
    FormatError
        If a variable is missing, has other columns or a number that is not finite, moments do not rise, a landmark
        appears twice, or a measurement names a moment or a landmark that the file has not.
    OSError
        As the file system says.

    Notes
    -----
    Whoever made these sets left out what was off by more than 0.5 m or 0.25 rad (so the residuals say), and moments
    with fewer than three landmarks: learn with ``truncated_at=(0.5, 0.25)``.

    References
    ----------
    Leung, Halpern, Barfoot, Liu, "The UTIAS multi-robot cooperative localization and mapping dataset", International
    Journal of Robotics Research 30(8), 2011.
    """
    source = Path(path)
    arrays = read_mat_arrays(source)
    landmarks = mat_landmarks(source, arrays, "landmark")
    truth = mat_table(source, arrays, "groundtruth", "moment x y theta")
    seen = mat_table(source, arrays, "measurement", "moment id range bearing")
    moments = mat_ids(source, truth, 0, "groundtruth", "moment")
    require_rising(source, moments, "groundtruth", "moments")
    named, ids = (mat_ids(source, seen, i, "measurement", what) for i, what in enumerate(("moment", "id")))
    require_known(source, named, moments, "measurement", "moment of the file")
    require_known(source, ids, landmarks.ids, "measurement", "landmark of the file")
    detections = group_detections(np.searchsorted(moments, named), moments, seen[:, 2], seen[:, 3], ids)
    return landmarks, DetectionLog(truth[:, 1:], detections, notes=(NOTE,))
