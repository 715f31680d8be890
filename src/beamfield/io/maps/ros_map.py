"""Maps of ROS's map_server: a YAML file beside a picture."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import LARGEST, SMALLEST
from beamfield.io.files.yaml_file import YamlFile, read_yaml, shorten
from beamfield.io.maps.map_image import MAX_PIXELS, MapImage, read_map_image
from beamfield.maps.occupancy import OccupancyGrid

MODES = ("trinary", "scale", "raw")

# What map_server itself writes for unknown.
UNKNOWN_GREY = 205

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
    if not SMALLEST <= resolution <= LARGEST:
        raise yaml.error(f"expected metres per pixel, {SMALLEST:g} to {LARGEST:g}, got {resolution!r}", "resolution")
    origin = read_origin(yaml)
    rule = read_rule(yaml)
    image = read_map_image(_image_path(yaml), max_pixels=max_pixels)
    opaque = None if rule.mode == "raw" else image.opaque
    occupied, free = (1.0, 0.0) if rule.mode == "scale" else (rule.occupied, rule.free)
    probability = _probability(image.grey, opaque, _levels(rule))
    return OccupancyGrid(probability, resolution, origin, occupied_thresh=occupied, free_thresh=free)


def image_path(path: str | os.PathLike[str]) -> Path:
    """Return the picture that a map_server YAML file names; FormatError if it names none, or it does not exist."""
    return _image_path(read_yaml(path))


def ros_map_notes(path: str | os.PathLike[str]) -> list[str]:
    """Return what a user should know about a map_server file, one sentence each.

    Notes
    -----
    map_saver writes 205 for unknown, which is p = 0.1961. ROS 1 saved free_thresh 0.196 with it, nav2 saves 0.25: with
    that, every unknown cell of the map reads as free, here as in nav2.
    """
    yaml = read_yaml(path)
    rule = read_rule(yaml)
    if rule.mode == "raw" or rule.p[UNKNOWN_GREY] > rule.free:
        return []
    image = read_map_image(_image_path(yaml))
    share = float(_grey_counts(image)[UNKNOWN_GREY] / image.grey.size)
    if share == 0.0:
        return []
    note = (
        f"{share:.1%} of the pixels have grey {UNKNOWN_GREY}, which map_saver writes for unknown; with free_thresh "
        f"{rule.free:g} they count as free, here and in nav2 (0.196 keeps them unknown)"
    )
    return [note]


def between_share(path: str | os.PathLike[str]) -> float:
    """Return the share of a map's pixels between its two thresholds, without those that stand for unknown.

    These are of the grey that map savers write for unknown, 205, of the one that `write_map` does, midway between the
    thresholds, or of the only level that there is between them. 0 for maps in "raw" mode, which have no thresholds.
    Trinary mode makes these pixels unknown.
    """
    yaml = read_yaml(path)
    rule = read_rule(yaml)
    if rule.mode == "raw":
        return 0.0
    image = read_map_image(_image_path(yaml))
    counts = np.where((rule.p > rule.free) & (rule.p < rule.occupied), _grey_counts(image), 0)
    counts[UNKNOWN_GREY] = 0
    if not rule.negate:
        counts[middle_grey(rule.free, rule.occupied)] = 0
    if np.count_nonzero(counts) == 1:
        return 0.0
    return float(counts.sum() / image.grey.size)


class Rule(NamedTuple):
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


def read_rule(yaml: YamlFile) -> Rule:
    """Return what a YAML file says of the grey levels."""
    return Rule(_negate(yaml), *_thresholds(yaml), _mode(yaml))


def read_origin(yaml: YamlFile) -> NDArray[np.float64]:
    """Return the pose (3,) of the lower-left corner."""
    value = yaml.value("origin")
    if not isinstance(value, list) or len(value) != 3:
        raise yaml.error(f"expected three numbers [x, y, yaw], got {shorten(value)}", "origin")
    origin = np.array([yaml.number("origin", i) for i in range(3)])
    if np.abs(origin).max() > LARGEST:
        raise yaml.error(f"expected metres and radians up to {LARGEST:g}, got {shorten(value)}", "origin")
    return origin


def middle_grey(free_thresh: float, occupied_thresh: float) -> int:
    """Return the grey level midway between the thresholds."""
    return round(255 * (1.0 - (free_thresh + occupied_thresh) / 2.0))


# ------------------------------------------------------------------------------------------------------- the YAML file


def _negate(yaml: YamlFile) -> bool:
    value = yaml.value("negate")
    if isinstance(value, int) and value in (0, 1):  # also false and true
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
        # ROS 1's map_saver writes the folder where the map was saved, which other computers do not have.
        is_beside = (yaml.path.parent / image.name).is_file()
        hint = f", but {image.name!r} lies beside the file: write that" if is_beside else ""
        raise yaml.error(f"the picture {str(image)!r} does not exist{hint}", "image")
    if not image.is_file():
        raise yaml.error(f"the picture {str(image)!r} is not a regular file", "image")
    return image


# --------------------------------------------------------------------------------------------------------- the picture


def _levels(rule: Rule) -> NDArray[np.float32]:
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
