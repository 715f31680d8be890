"""Maps in a catalogue: one file each, named by its content, so that runs on one map share it."""

from __future__ import annotations

import hashlib
import io
import math
import zipfile
import zlib

import numpy as np

from beamfield.errors import FormatError
from beamfield.fleet.folder import Folder
from beamfield.fleet.run_record import MapInfo
from beamfield.geometry import FloatArray
from beamfield.io.maps.map_image import MAX_PIXELS
from beamfield.maps.occupancy import OccupancyGrid

MAPS = "maps"


def map_info(grid: OccupancyGrid) -> MapInfo:
    """Return what a record says of a map."""
    x, y, yaw = (float(value) for value in grid.origin)
    return MapInfo(grid.resolution, (x, y, yaw), grid.shape, _content_hash(grid))


def store_map(folder: Folder, grid: OccupancyGrid, info: MapInfo) -> None:
    """Write a map, unless it is there."""
    name = f"{MAPS}/{info.content}.npz"
    if folder.exists(name):
        return
    content = io.BytesIO()
    np.savez_compressed(content, probability=grid.probability, frame=_frame(grid))
    folder.write(name, content.getvalue())


def load_map(folder: Folder, info: MapInfo) -> OccupancyGrid:
    """Return a map.

    Parameters
    ----------
    folder
        The catalogue's.
    info
        Of the record.

    Raises
    ------
    FormatError
        If the file is not there, is damaged, or is another map.
    """
    name = f"{MAPS}/{info.content}.npz"
    shown = folder.shown_path(name)
    cells = math.prod(info.shape)
    try:
        content = folder.read(name)
    except FileNotFoundError:
        raise FormatError(shown, "the map of a run is not there") from None
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as packed:
            unpacked = sum(part.file_size for part in packed.infolist())
        if not 0 < cells <= MAX_PIXELS or unpacked > 4 * cells + 4096:
            raise ValueError(f"it unpacks to {unpacked} bytes")
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            resolution, x, y, yaw, occupied, free = (float(value) for value in arrays["frame"])
            grid = OccupancyGrid(arrays["probability"], resolution, np.array([x, y, yaw]), occupied, free)
    except (ValueError, KeyError, OSError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise FormatError(shown, f"expected the map of a run, got something else: {error}") from error
    if _content_hash(grid) != info.content:
        raise FormatError(shown, "the map's content is not what its name says")
    return grid


def _frame(grid: OccupancyGrid) -> FloatArray:
    return np.array([grid.resolution, *grid.origin, grid.occupied_thresh, grid.free_thresh])


def _content_hash(grid: OccupancyGrid) -> str:
    digest = hashlib.sha256(repr(grid.shape).encode())
    digest.update(_frame(grid).astype("<f8").tobytes())
    digest.update(grid.probability.astype("<f4", copy=False).tobytes())
    return digest.hexdigest()
