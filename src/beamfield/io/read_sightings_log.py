"""Read a log of landmark sightings with true poses, whatever its format."""

from __future__ import annotations

import re
from pathlib import Path

from beamfield.detection_log import DetectionLog
from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.landmarks.landmark_files import read_landmarks, read_mrclam_landmarks
from beamfield.io.landmarks.mat_file import read_mat_arrays
from beamfield.io.landmarks.mrclam_instant import read_mrclam_instant
from beamfield.io.landmarks.mrclam_raw import read_mrclam_barcodes, read_mrclam_measurements
from beamfield.io.landmarks.plaza import read_plaza
from beamfield.io.landmarks.roh_bearings import read_roh_bearings
from beamfield.io.landmarks.sightings import read_sightings
from beamfield.maps.landmarks import LandmarkMap

SUPPORTED = (
    "a CSV file of sightings (stamp,x,y,theta,id,range,bearing); an MRCLAM .mat file (landmark, groundtruth, "
    "measurement) or Robot*_Measurement.dat beside Robot*_Groundtruth.dat, Barcodes.dat and Landmark_Groundtruth.dat; "
    "a Plaza .mat file (TL, TD, GT); a folder with landmark.csv and (Xa,Yb).csv"
)
_MEASUREMENT = re.compile(r"(Robot\d+)_Measurement\.dat(\.gz)?")
_TRUE_POSES = re.compile(r"Robot\d+_Groundtruth\.dat(\.gz)?")
# More names than these of a folder's files do not help.
_MOST_NAMES = 5


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
        If the content is none of these, or not what its format promises, or the set has no true poses.
    OSError
        As the file system says.
    """
    source = Path(path)
    given = None if landmarks is None else read_landmarks(landmarks)
    if source.is_dir():
        _refuse_other_folders(source)
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


def _refuse_other_folders(folder: Path) -> None:
    """Say which file of the folder to give, or why it has nothing to learn from."""
    names = sorted(path.name for path in folder.iterdir() if path.is_file())
    if "landmark.csv" in names:
        return
    measurements = [name for name in names if _MEASUREMENT.fullmatch(name)]
    arrays = [name for name in names if name.endswith(".mat")]
    if measurements and not any(_TRUE_POSES.fullmatch(name) for name in names):
        raise FormatError(folder, "an MRCLAM set without Robot*_Groundtruth.dat: it has no true poses to learn from")
    if measurements or arrays:
        raise FormatError(folder, f"expected one of the folder's files: {_listed(measurements or arrays)}")
    if {"world.dat", "sensor_data.dat"} <= set(names):
        raise FormatError(folder, "a Freiburg course log: it has odometry but no true poses to learn from")
    raise FormatError(folder, f"expected {SUPPORTED}; got a folder with {_listed(names) or 'no files'}")


def _listed(names: list[str]) -> str:
    return ", ".join(names[:_MOST_NAMES]) + (
        f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
    )


def _read_mrclam(source: Path, robot: str, given: LandmarkMap | None) -> tuple[LandmarkMap, DetectionLog]:
    groundtruth = _beside(source, f"{robot}_Groundtruth.dat")
    if source.exists() and not groundtruth.exists():
        raise FormatError(source, f"expected {groundtruth.name} beside it: there are no true poses to learn from")
    carried = given if given is not None else read_mrclam_landmarks(_beside(source, "Landmark_Groundtruth.dat"))
    barcodes = read_mrclam_barcodes(_beside(source, "Barcodes.dat"))
    return carried, read_mrclam_measurements(source, barcodes, carried, groundtruth=groundtruth)


def _beside(source: Path, name: str) -> Path:
    """Return a file of the same folder, plain or gzip."""
    plain, packed = source.with_name(name), source.with_name(f"{name}.gz")
    return packed if packed.exists() and not plain.exists() else plain


def _is_binary(path: Path) -> bool:
    with path.open("rb") as file:
        start = file.read(128)
    return b"\0" in start and start[:2] != b"\x1f\x8b"
