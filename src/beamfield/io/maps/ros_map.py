"""Maps of ROS's map_server: a YAML file beside a picture, in and out."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError
from beamfield.io.files.atomic import atomic_files
from beamfield.io.files.yaml_file import YamlFile, read_yaml, shorten
from beamfield.io.maps.map_image import MAX_PIXELS, MapImage, read_map_image
from beamfield.maps.occupancy import OccupancyGrid

MODES = ("trinary", "scale", "raw")

# Grey levels that map_server itself writes: nearly white, black, and what it calls unknown.
_FREE_GREY, _OCCUPIED_GREY, _UNKNOWN_GREY = 254, 0, 205
_RAW_UNKNOWN = 255

_PIXELS_PER_BAND = 1_000_000

_TRUE, _FALSE = ("true", "yes", "on", "y"), ("false", "no", "off", "n")


def read_ros_map(path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS) -> OccupancyGrid:
    """Read a map_server map.

    With grey level g in 0 to 255 the occupancy is p = 1 - g / 255, or p = g / 255 if `negate`. Then, by `mode`,

    - trinary: p >= occupied_thresh is occupied, p <= free_thresh free, the rest unknown;
    - scale: the same, and in between round(100 (p - free_thresh) / (occupied_thresh - free_thresh)) percent;
    - raw: g itself is percent, from 101 on unknown; `negate` and transparency do not count.

    In trinary and scale a pixel that is not fully opaque is unknown.

    Parameters
    ----------
    path
        The YAML file: `image` (relative to it, absolute, or from ``~/``), `resolution` (metres per pixel), `origin`
        ([x, y, yaw] of the lower-left corner, metres and radians), `negate`, `occupied_thresh`, `free_thresh` and,
        if not trinary, `mode`.
    max_pixels
        Pictures with more pixels are refused before they are decoded.

    Returns
    -------
    The grid, lowest row first. Its probability is 0, 1 or NaN in trinary mode, else percent / 100 or NaN. It keeps the
    thresholds of the file; in scale mode they are 1 and 0, for which its categories are those of the values 100 and 0.

    Raises
    ------
    FormatError
        If a key is missing or wrong (with its line), or the picture is missing, too large or damaged.
    OSError
        As the file system says.

    Notes
    -----
    The rules are those of nav2's map_io.cpp, with p in double precision; it compares with >= and <=. ROS 1 differs in
    scale mode (99 instead of 100).
    """
    yaml = read_yaml(path)
    resolution = yaml.number("resolution")
    if resolution <= 0:
        raise yaml.error(f"expected a positive number of metres, got {resolution!r}", "resolution")
    origin = _origin(yaml)
    rule = _read_rule(yaml)
    image = read_map_image(_image_path(yaml), max_pixels=max_pixels)
    opaque = None if rule.mode == "raw" else image.opaque
    occupied, free = (1.0, 0.0) if rule.mode == "scale" else (rule.occupied, rule.free)
    probability = _probability(image.grey, opaque, _levels(rule))
    return OccupancyGrid(probability, resolution, origin, occupied_thresh=occupied, free_thresh=free)


def image_path(path: str | os.PathLike[str]) -> Path:
    """Return the picture that a map_server YAML file names.

    Parameters
    ----------
    path
        The YAML file.

    Raises
    ------
    FormatError
        If the file names none, or it does not exist.
    """
    return _image_path(read_yaml(path))


def write_map(grid: OccupancyGrid, path: str | os.PathLike[str], *, mode: str | None = None) -> None:
    """Save a grid as a map_server map: a YAML file and a PGM picture of the same name, both or none.

    Read again, the map has the same probability, categories, origin, resolution and thresholds.

    Parameters
    ----------
    grid
        The grid.
    path
        The YAML file, ending in .yaml or .yml; the picture gets the ending .pgm.
    mode
        "trinary" keeps only the category of each cell; "raw" keeps whole percents and rounds to them. None takes
        trinary for a grid of 0, 1 and NaN, raw for a grid of whole percents, and refuses any other.

    Raises
    ------
    InvalidInputError
        If the grid holds other values and no mode is given; if the mode is neither; if the ending is wrong; or if the
        thresholds leave no grey level for unknown cells in trinary mode.
    OSError
        As the file system says; existing files stay as they were.
    """
    yaml_path = Path(path)
    if yaml_path.suffix not in (".yaml", ".yml"):
        raise InvalidInputError(f"path of a map: expected a name ending in .yaml or .yml, got {yaml_path.name!r}")
    if mode is None:
        mode = _lossless_mode(grid)
    if mode == "trinary":
        grey = _trinary_grey(grid)
    elif mode == "raw":
        grey = _raw_grey(grid)
    else:
        raise InvalidInputError(f"mode: expected 'trinary' or 'raw', got {mode!r}")
    image_path = yaml_path.with_suffix(".pgm")
    with atomic_files([image_path, yaml_path]) as (image_part, yaml_part):
        rows, cols = grey.shape
        image_part.write_bytes(f"P5\n{cols} {rows}\n255\n".encode("ascii") + grey[::-1].tobytes())
        yaml_part.write_text(_yaml_text(grid, image_path.name, mode), encoding="utf-8")


def moved_map_text(path: str | os.PathLike[str], step: tuple[float, float], image: str) -> str:
    """Return the text of a map_server YAML file for the same map with its origin moved.

    Parameters
    ----------
    path
        The YAML file.
    step
        Added to the origin's x and y, metres.
    image
        What the file is to call the picture: relative to where it will lie, or absolute.

    Raises
    ------
    FormatError
        If a key is missing or wrong, with its line.
    InvalidInputError
        If the picture's name is not printable.
    OSError
        As the file system says.
    """
    yaml = read_yaml(path)
    rule, origin = _read_rule(yaml), _origin(yaml) + np.array([*step, 0.0])
    return (
        f"image: {_yaml_name(image)}\n"
        f"mode: {rule.mode}\n"
        f"resolution: {_number(yaml.number('resolution'))}\n"
        f"origin: [{', '.join(map(_number, np.round(origin, 9)))}]\n"
        f"negate: {int(rule.negate)}\n"
        f"occupied_thresh: {_number(rule.occupied)}\n"
        f"free_thresh: {_number(rule.free)}\n"
    )


def ros_map_notes(path: str | os.PathLike[str]) -> list[str]:
    """Return what a user should know about a map_server file, one sentence each.

    Parameters
    ----------
    path
        The YAML file.

    Raises
    ------
    FormatError, OSError
        As for `read_ros_map`.

    Notes
    -----
    map_saver writes 205 for unknown, which is p = 0.1961. ROS 1 saved free_thresh 0.196 with it, nav2 saves 0.25: with
    that, every unknown cell of the map reads as free, here as in nav2.
    """
    yaml = read_yaml(path)
    rule = _read_rule(yaml)
    if rule.mode == "raw" or rule.p[_UNKNOWN_GREY] > rule.free:
        return []
    counts = _grey_counts(MapImage(read_map_image(_image_path(yaml)).grey))
    share = float(counts[_UNKNOWN_GREY] / counts.sum())
    if share == 0.0:
        return []
    note = (
        f"{share:.1%} of the pixels have grey {_UNKNOWN_GREY}, which map_saver writes for unknown; with free_thresh "
        f"{rule.free:g} they count as free, here and in nav2 (0.196 keeps them unknown)"
    )
    return [note]


def between_share(path: str | os.PathLike[str]) -> float:
    """Return the share of a map's pixels between its two thresholds, without those that stand for unknown.

    These are of the grey that map savers write for unknown, 205, of the one that `write_map` does, midway between the
    thresholds, or of the only level that there is between them.

    Parameters
    ----------
    path
        The YAML file.

    Returns
    -------
    0 for maps in "raw" mode, which have no thresholds. Trinary mode makes these pixels unknown.

    Raises
    ------
    FormatError, OSError
        As for `read_ros_map`.
    """
    yaml = read_yaml(path)
    rule = _read_rule(yaml)
    if rule.mode == "raw":
        return 0.0
    image = read_map_image(_image_path(yaml))
    counts = np.where((rule.p > rule.free) & (rule.p < rule.occupied), _grey_counts(image), 0)
    counts[_UNKNOWN_GREY] = 0
    if not rule.negate:
        counts[_middle_grey(rule.free, rule.occupied)] = 0
    if np.count_nonzero(counts) == 1:
        return 0.0
    return float(counts.sum() / image.grey.size)


# ------------------------------------------------------------------------------------------------------- the YAML file


class _Rule(NamedTuple):
    """How the grey levels of the picture become probabilities."""

    negate: bool
    occupied: float
    free: float
    mode: str

    @property
    def p(self) -> NDArray[np.float64]:
        """(256,) of each grey level, in double precision: comparisons are exact whatever the grid stores."""
        shade = np.arange(256) / 255.0
        return shade if self.negate else 1.0 - shade


def _read_rule(yaml: YamlFile) -> _Rule:
    return _Rule(_negate(yaml), *_thresholds(yaml), _mode(yaml))


def _origin(yaml: YamlFile) -> NDArray[np.float64]:
    value = yaml.value("origin")
    if not isinstance(value, list) or len(value) != 3:
        raise yaml.error(f"expected three numbers [x, y, yaw], got {shorten(value)}", "origin")
    return np.array([yaml.number("origin", i) for i in range(3)])


def _negate(yaml: YamlFile) -> bool:
    value = yaml.value("negate")
    if isinstance(value, bool) or (isinstance(value, int) and value in (0, 1)):
        return bool(value)
    # Words that YAML 1.1 took for truth values.
    if isinstance(value, str) and value.lower() in _TRUE + _FALSE:
        return value.lower() in _TRUE
    raise yaml.error(f"expected 0, 1, true or false, got {shorten(value)}", "negate")


def _thresholds(yaml: YamlFile) -> tuple[float, float]:
    occupied, free = yaml.number("occupied_thresh"), yaml.number("free_thresh")
    for name, value in (("occupied_thresh", occupied), ("free_thresh", free)):
        if not 0.0 <= value <= 1.0:
            raise yaml.error(f"expected a number from 0 to 1, got {value!r}", name)
    if free >= occupied:
        raise yaml.error(f"expected less than occupied_thresh, {occupied!r}, got {free!r}", "free_thresh")
    return occupied, free


def _mode(yaml: YamlFile) -> str:
    if "mode" not in yaml.values:
        return "trinary"
    mode = yaml.text("mode")
    if mode.lower() not in MODES:
        raise yaml.error(f"expected one of {', '.join(MODES)}, got {shorten(mode)}", "mode")
    return mode.lower()


def _image_path(yaml: YamlFile) -> Path:
    name = yaml.text("image")
    if "\0" in name:
        raise yaml.error(f"expected the name of a file, got {shorten(name)}", "image")
    image = Path(name)
    if name.startswith("~/"):
        image = image.expanduser()
    image = yaml.path.parent / image
    if not image.exists():
        raise yaml.error(f"the picture {str(image)!r} does not exist", "image")
    if not image.is_file():
        raise yaml.error(f"the picture {str(image)!r} is not a regular file", "image")
    return image


# --------------------------------------------------------------------------------------------------------- the picture


def _levels(rule: _Rule) -> NDArray[np.float32]:
    """Return the probability of each grey level."""
    of_grey = np.full(256, np.nan)
    if rule.mode == "raw":
        of_grey[:101] = np.arange(101) / 100.0
        return of_grey.astype(np.float32)
    if rule.mode == "scale":
        of_grey = np.floor(100.0 * (rule.p - rule.free) / (rule.occupied - rule.free) + 0.5) / 100.0
    of_grey[rule.p >= rule.occupied] = 1.0
    of_grey[rule.p <= rule.free] = 0.0
    return of_grey.astype(np.float32)


def _probability(
    grey: NDArray[np.uint8], opaque: NDArray[np.bool_] | None, of_grey: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the cells' probabilities, lowest row first; read-only, so that a grid takes them as they are."""
    probability = np.empty(grey.shape, np.float32)
    upside_down = probability[::-1]
    for band in _bands(grey.shape):
        upside_down[band] = of_grey[grey[band]]
        if opaque is not None:
            upside_down[band][~opaque[band]] = np.nan
    probability.flags.writeable = False
    return probability


def _grey_counts(image: MapImage) -> NDArray[np.int64]:
    """Return how many opaque pixels have each grey level."""
    counts = np.zeros(256, np.int64)
    for band in _bands(image.grey.shape):
        levels = image.grey[band]
        counts += np.bincount(levels.ravel() if image.opaque is None else levels[image.opaque[band]], minlength=256)
    return counts


def _bands(shape: tuple[int, ...]) -> Iterator[slice]:
    """Yield the rows of a picture in bands: look-ups make an eight-byte index of every grey level."""
    step = max(1, _PIXELS_PER_BAND // shape[1])
    for first in range(0, shape[0], step):
        yield slice(first, first + step)


# --------------------------------------------------------------------------------------------------------------- saving


def _lossless_mode(grid: OccupancyGrid) -> str:
    known = grid.probability[~np.isnan(grid.probability)]
    if np.isin(known, (0.0, 1.0)).all() and _unknown_grey(grid) is not None:
        return "trinary"
    if (known == _percent(known) / np.float32(100.0)).all():
        return "raw"
    raise InvalidInputError(
        "saving a map: map_server's files carry whole percents only, and this grid has other probabilities; "
        "give mode='raw' to round them or mode='trinary' to keep free, occupied and unknown"
    )


def _percent(probability: NDArray[np.float32]) -> NDArray[Any]:
    return np.floor(probability.astype(np.float64) * 100.0 + 0.5).astype(np.float32)


def _trinary_grey(grid: OccupancyGrid) -> NDArray[np.uint8]:
    unknown_grey = _unknown_grey(grid)
    if unknown_grey is None:
        raise InvalidInputError(
            f"saving a map: no grey level lies between free_thresh {grid.free_thresh} and occupied_thresh "
            f"{grid.occupied_thresh} for unknown cells; give mode='raw'"
        )
    grey = np.full(grid.shape, unknown_grey, dtype=np.uint8)
    grey[grid.occupied] = _OCCUPIED_GREY
    grey[grid.free] = _FREE_GREY if grid.free_thresh >= 1.0 - _FREE_GREY / 255.0 else 255
    return grey


def _unknown_grey(grid: OccupancyGrid) -> int | None:
    """Return a grey level that reads as unknown: map_server's own, which 0.25 would take for free, or the middle."""
    for grey in (_UNKNOWN_GREY, _middle_grey(grid.free_thresh, grid.occupied_thresh)):
        if grid.free_thresh < 1.0 - grey / 255.0 < grid.occupied_thresh:
            return grey
    return None


def _middle_grey(free_thresh: float, occupied_thresh: float) -> int:
    return round(255 * (1.0 - (free_thresh + occupied_thresh) / 2.0))


def _raw_grey(grid: OccupancyGrid) -> NDArray[np.uint8]:
    known = ~np.isnan(grid.probability)
    grey = np.full(grid.shape, _RAW_UNKNOWN, dtype=np.uint8)
    grey[known] = _percent(grid.probability[known]).astype(np.uint8)
    return grey


def _yaml_text(grid: OccupancyGrid, image_name: str, mode: str) -> str:
    x, y, yaw = (_number(value) for value in grid.origin)
    return (
        f"image: {_yaml_name(image_name)}\n"
        f"mode: {mode}\n"
        f"resolution: {_number(grid.resolution)}\n"
        f"origin: [{x}, {y}, {yaw}]\n"
        "negate: 0\n"
        f"occupied_thresh: {_number(grid.occupied_thresh)}\n"
        f"free_thresh: {_number(grid.free_thresh)}\n"
    )


def _number(value: float) -> str:
    # All digits. YAML 1.1 takes 1e-07 for text, but not 1.0e-07.
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _yaml_name(name: str) -> str:
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]*", name):
        return name
    if not name.isprintable():
        raise InvalidInputError(f"path of a map: expected a printable name, got {name!r}")
    escaped = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
