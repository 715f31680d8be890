"""Read a log of landmark sightings with true poses, whatever its format."""

from __future__ import annotations

import re
from pathlib import Path

from beamfield.detection_log import DetectionLog
from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.landmark_files import read_landmarks, read_mrclam_landmarks
from beamfield.io.mat_file import read_mat_arrays
from beamfield.io.mrclam_instant import read_mrclam_instant
from beamfield.io.mrclam_raw import read_mrclam_barcodes, read_mrclam_measurements
from beamfield.io.plaza import read_plaza
from beamfield.io.roh_bearings import read_roh_bearings
from beamfield.io.sightings import read_sightings
from beamfield.maps.landmarks import LandmarkMap

SUPPORTED = (
    "a CSV file of sightings (stamp,x,y,theta,id,range,bearing); an MRCLAM .mat file (landmark, groundtruth, "
    "measurement) or Robot*_Measurement.dat beside its other files; a Plaza .mat file (TL, TD, GT); a folder with "
    "landmark.csv and (Xa,Yb).csv"
)
_MEASUREMENT = re.compile(r"(Robot\d+)_Measurement\.dat(\.gz)?")


def read_sightings_log(path: str | Path, landmarks: str | Path | None = None) -> tuple[LandmarkMap, DetectionLog]:
    """Read sightings and the landmarks they are of; the format is recognised by content and name.

    Parameters
    ----------
    path
        One of `SUPPORTED`.
    landmarks
        CSV file of the map; needed for a CSV file of sightings, and instead of the map that other formats carry.

    Returns
    -------
    landmarks, log
        The map, and observations with poses.

    Raises
    ------
    InvalidInputError
        If a CSV file of sightings comes without a map.
    FormatError
        If the content is none of these, or not what its format promises.
    OSError
        As the file system says.
    """
    source = Path(path)
    given = None if landmarks is None else read_landmarks(landmarks)
    if source.is_dir():
        carried, log = read_roh_bearings(source)
    elif (match := _MEASUREMENT.fullmatch(source.name)) is not None:
        return _read_mrclam(source, match[1], given)
    elif _is_binary(source):
        names = set(read_mat_arrays(source))
        if {"groundtruth", "measurement"} <= names:
            carried, log = read_mrclam_instant(source)
        elif {"TL", "TD"} <= names:
            carried, log = read_plaza(source)
        else:
            found = ", ".join(sorted(names)) or "none"
            raise FormatError(source, f"expected {SUPPORTED}; got a .mat file with the arrays {found[:200]}")
    else:
        if given is None:
            raise InvalidInputError(f"{source}: a CSV file of sightings needs a map of landmarks")
        return given, read_sightings(source)
    return carried if given is None else given, log


def _read_mrclam(source: Path, robot: str, given: LandmarkMap | None) -> tuple[LandmarkMap, DetectionLog]:
    carried = given if given is not None else read_mrclam_landmarks(_beside(source, "Landmark_Groundtruth.dat"))
    barcodes = read_mrclam_barcodes(_beside(source, "Barcodes.dat"))
    return carried, read_mrclam_measurements(
        source, barcodes, carried, groundtruth=_beside(source, f"{robot}_Groundtruth.dat")
    )


def _beside(source: Path, name: str) -> Path:
    """Return a file of the same folder, plain or gzip."""
    plain, packed = source.with_name(name), source.with_name(f"{name}.gz")
    return packed if packed.exists() and not plain.exists() else plain


def _is_binary(path: Path) -> bool:
    with path.open("rb") as file:
        start = file.read(128)
    return b"\0" in start and start[:2] != b"\x1f\x8b"
