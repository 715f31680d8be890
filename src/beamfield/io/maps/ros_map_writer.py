"""Saving maps for ROS's map_server."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import checked, require
from beamfield.errors import InvalidInputError
from beamfield.io.files.atomic import atomic_files
from beamfield.io.files.yaml_file import read_yaml
from beamfield.io.maps.ros_map import UNKNOWN_GREY, Rule, middle_grey, read_origin, read_rule
from beamfield.maps.occupancy import OccupancyGrid

# Grey levels that map_server itself writes: nearly white, and black.
_FREE_GREY, _OCCUPIED_GREY = 254, 0
_RAW_UNKNOWN = 255


@checked
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
    image_path = yaml_path.with_suffix(".pgm")
    require(yaml_path.suffix in (".yaml", ".yml"), "path of a map", "a name ending in .yaml or .yml", yaml_path.name)
    text, image = map_files(grid, image_path.name, mode)
    with atomic_files([image_path, yaml_path]) as (image_part, yaml_part):
        image_part.write_bytes(image)
        yaml_part.write_text(text, encoding="utf-8")


def map_files(grid: OccupancyGrid, image_name: str, mode: str | None = None) -> tuple[str, bytes]:
    """Return the text of a map_server YAML file and its PGM picture, as `write_map` writes them."""
    if mode is None:
        mode = _lossless_mode(grid)
    if mode == "trinary":
        grey = _trinary_grey(grid)
    elif mode == "raw":
        grey = _raw_grey(grid)
    else:
        raise InvalidInputError(f"mode: expected 'trinary' or 'raw', got {mode!r}")
    rule = Rule(False, grid.occupied_thresh, grid.free_thresh, mode)
    rows, cols = grey.shape
    image = f"P5\n{cols} {rows}\n255\n".encode("ascii") + grey[::-1].tobytes()
    return _yaml_text(image_name, rule, grid.resolution, grid.origin), image


def moved_map_text(path: str | os.PathLike[str], step: tuple[float, float], image: str) -> str:
    """Return the text of a map_server YAML file for the same map with its origin moved by a step in x and y, metres.

    `image` is what it is to call the picture: relative to where it will lie, or absolute. FormatError names the line if
    a key is missing or wrong; InvalidInputError if the picture's name is not printable.
    """
    yaml = read_yaml(path)
    rule, origin = read_rule(yaml), np.round(read_origin(yaml) + np.array([*step, 0.0]), 9)
    return _yaml_text(image, rule, yaml.number("resolution"), origin)


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
    for grey in (UNKNOWN_GREY, middle_grey(grid.free_thresh, grid.occupied_thresh)):
        if grid.free_thresh < 1.0 - grey / 255.0 < grid.occupied_thresh:
            return grey
    return None


def _raw_grey(grid: OccupancyGrid) -> NDArray[np.uint8]:
    known = ~np.isnan(grid.probability)
    grey = np.full(grid.shape, _RAW_UNKNOWN, dtype=np.uint8)
    grey[known] = _percent(grid.probability[known]).astype(np.uint8)
    return grey


def _yaml_text(image: str, rule: Rule, resolution: float, origin: NDArray[np.float64]) -> str:
    return (
        f"image: {_yaml_name(image)}\n"
        f"mode: {rule.mode}\n"
        f"resolution: {_number(resolution)}\n"
        f"origin: [{', '.join(map(_number, origin))}]\n"
        f"negate: {int(rule.negate)}\n"
        f"occupied_thresh: {_number(rule.occupied)}\n"
        f"free_thresh: {_number(rule.free)}\n"
    )


def _number(value: float) -> str:
    # All digits. YAML 1.1 takes 1e-07 for text, but not 1.0e-07.
    text = repr(float(value))
    return text if "." in text else text.replace("e", ".0e")


def _yaml_name(name: str) -> str:
    if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]*", name):
        return name
    require(name.isprintable(), "path of a map", "a printable name", name)
    escaped = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
