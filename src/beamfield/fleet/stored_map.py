"""Maps in a catalogue: one file each, named by its content, so that runs on one map share it."""

from __future__ import annotations

import hashlib
import math
import zlib

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError
from beamfield.fleet.folder import Folder
from beamfield.fleet.run_record import MapInfo
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid

MAPS = "maps"
# Numbers before the cells: resolution, origin and thresholds.
FRAME = 6


def map_info(grid: OccupancyGrid) -> MapInfo:
    """Return what a record says of a map."""
    x, y, yaw = (float(value) for value in grid.origin)
    return MapInfo(grid.resolution, (x, y, yaw), grid.shape, _content_hash(grid))


def store_map(folder: Folder, grid: OccupancyGrid, info: MapInfo) -> None:
    """Write a map, unless it is there: its frame and its cells, compressed."""
    name = _name(info)
    if not folder.exists(name):
        folder.write(name, zlib.compress(_frame(grid).tobytes() + _cells(grid).tobytes()))


def load_map(folder: Folder, info: MapInfo) -> OccupancyGrid:
    """Return a map; FormatError if the file is not there, is damaged, or is another map."""
    shown = folder.shown_path(_name(info))
    expected = 8 * FRAME + 4 * math.prod(info.shape)
    try:
        # No more than there should be, whatever the file would unpack to.
        content = zlib.decompressobj().decompress(folder.read(_name(info)), expected + 1)
        if len(content) != expected:
            raise ValueError(f"it unpacks to {len(content)} bytes or more, not to {expected}")
        resolution, *origin, occupied, free = np.frombuffer(content, "<f8", FRAME).tolist()
        cells = np.frombuffer(content, "<f4", offset=8 * FRAME).reshape(info.shape)
        grid = OccupancyGrid(cells, resolution, np.array(origin), occupied, free)
    except FileNotFoundError:
        raise FormatError(shown, "the map of a run is not there") from None
    except (ValueError, zlib.error) as error:
        raise FormatError(shown, f"expected the map of a run, got something else: {error}") from error
    if _content_hash(grid) != info.content:
        raise FormatError(shown, "the map's content is not what its name says")
    return grid


def _name(info: MapInfo) -> str:
    return f"{MAPS}/{info.content}.z"


def _frame(grid: OccupancyGrid) -> FloatArray:
    return np.array([grid.resolution, *grid.origin, grid.occupied_thresh, grid.free_thresh], "<f8")


def _cells(grid: OccupancyGrid) -> NDArray[np.float32]:
    # NaN has many bit patterns.
    return np.where(np.isnan(grid.probability), np.float32(np.nan), grid.probability).astype("<f4", copy=False)


def _content_hash(grid: OccupancyGrid) -> str:
    digest = hashlib.sha256(repr(grid.shape).encode())
    digest.update(_frame(grid).tobytes())
    digest.update(_cells(grid).tobytes())
    return digest.hexdigest()
