"""Read a log of landmark sightings with true poses, and the landmarks they are of."""

from __future__ import annotations

from pathlib import Path

from beamfield.detection_log import DetectionLog
from beamfield.io.landmarks.landmark_files import read_landmarks
from beamfield.io.landmarks.sightings import read_sightings
from beamfield.maps.landmarks import LandmarkMap


def read_sightings_log(path: str | Path, landmarks: str | Path) -> tuple[LandmarkMap, DetectionLog]:
    """Read a CSV file of sightings and the CSV file of their landmarks.

    Parameters
    ----------
    path
        Sightings, as for `read_sightings`.
    landmarks
        The map, as for `read_landmarks`.

    Returns
    -------
    landmarks, log
        The map, and observations with poses.

    Raises
    ------
    FormatError, OSError
        As for the two readers.
    """
    return read_landmarks(landmarks), read_sightings(path)
