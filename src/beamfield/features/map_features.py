"""The features that a grid map would show: walls and corners of noise-free scans cast in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError
from beamfield.features.corners import Corner, find_corners
from beamfield.features.lines import find_lines
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import FloatArray, transform_points
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, Scan

# Beams of a scan all around, and how near a wall a scan may be taken, metres.
N_BEAMS, CLEARANCE = 360, 0.3
# Slanted walls of a grid are stairs: with noise of a cell they stay whole. With 0.4 cells the walls of Wean Hall told
# 209 nats of where 17 scans were taken, with one cell 267.
STAIRS = 1.0
# Shorter walls are more often furniture and noise of the map, metres.
MIN_LENGTH = 0.5
# Two pieces are one wall if they differ by less than this: direction, distance of end points, hole between them.
SAME_DIRECTION, SAME_PLACE_CELLS, SAME_PLACE, WIDEST_HOLE = np.radians(4.0), 1.5, 0.06, 0.4
# A wall that a single scan shows may be an accident of its rays. Corners this close, in metres, are one.
FEWEST_SIGHTINGS, SAME_CORNER = 2, 0.25


@dataclass(frozen=True, eq=False)
class MapFeatures:
    """The walls and corners of a map.

    Parameters
    ----------
    lines
        With end points; None if there is no straight wall.
    corners
        With their opening angle (radians) as signature; None if there is none.
    """

    lines: LineMap | None
    corners: LandmarkMap | None


def map_features(grid: OccupancyGrid, *, spacing: float = 1.5, max_range: float = 10.0) -> MapFeatures:
    """Return the walls and corners that scans taken all over a grid map show.

    A scan without noise is cast at every free place of a lattice; its lines and corners are brought into the map frame,
    and what several scans show is kept once.

    Parameters
    ----------
    grid
        The map. Rays pass unknown cells.
    spacing
        Between places, metres. What is hidden from all of them is not found.
    max_range
        Of the scans, metres.

    Raises
    ------
    InvalidInputError
        If a number is not positive, or no place is free.
    """
    if not (0.0 < spacing < np.inf and 0.0 < max_range < np.inf):
        raise InvalidInputError(f"spacing, max_range: expected positive metres, got {spacing}, {max_range}")
    finder = RangeFinder.from_bearings(2.0 * np.pi * np.arange(N_BEAMS) / N_BEAMS, max_range)
    noise = RangeNoise(STAIRS * grid.resolution)
    places = _free_places(grid, spacing)
    ranges = RayCaster(grid).expected_ranges(places, finder)
    roomy = ranges.min(axis=1) > CLEARANCE
    segments: list[FloatArray] = []
    corners: list[FloatArray] = []
    for place, scan in zip(places[roomy], ranges[roomy], strict=True):
        lines = find_lines(Scan(scan, finder), noise, min_length=MIN_LENGTH)
        segments += [transform_points(place, [line.start, line.end]).ravel() for line in lines]
        corners += _corners_in_map(place, find_corners(lines))
    walls = merged_segments(np.reshape(segments, (-1, 4)), grid.resolution)
    kept = merged_corners(np.reshape(corners, (-1, 4)))
    return MapFeatures(
        LineMap.from_segments(walls) if len(walls) else None,
        LandmarkMap(kept[:, :2], signatures=kept[:, 2]) if len(kept) else None,
    )


def merged_segments(segments: FloatArray, resolution: float) -> FloatArray:
    """Return one segment (m, 4) per wall with at least two pieces (n, 4), as far as they reach, metres.

    The longest piece gives the line; the resolution is the side of the map's cells.
    """
    near = SAME_PLACE + SAME_PLACE_CELLS * resolution
    left = segments[np.argsort(-np.hypot(*(segments[:, 2:] - segments[:, :2]).T))]
    walls = []
    while len(left):
        start, along = left[0, :2], left[0, 2:] - left[0, :2]
        along = along / np.hypot(*along)
        direction = left[:, 2:] - left[:, :2]
        parallel = np.abs(direction @ [-along[1], along[0]]) < np.sin(SAME_DIRECTION) * np.hypot(*direction.T)
        ends = left.reshape(-1, 2, 2) - start
        beside = np.abs(ends @ [-along[1], along[0]]).max(axis=1) < near
        extents = np.sort(ends @ along, axis=1)
        mine = np.flatnonzero(parallel & beside)
        low, high = float(extents[0, 0]), float(extents[0, 1])
        # Piece by piece, as the wall grows at its end and at its start.
        for i in mine[np.argsort(extents[mine, 0])]:
            high = max(high, extents[i, 1]) if extents[i, 0] <= high + WIDEST_HOLE and extents[i, 1] >= low else high
        for i in mine[np.argsort(-extents[mine, 1])]:
            low = min(low, extents[i, 0]) if extents[i, 1] >= low - WIDEST_HOLE and extents[i, 0] <= high else low
        taken = parallel & beside & (extents[:, 0] >= low) & (extents[:, 1] <= high)
        if taken.sum() >= FEWEST_SIGHTINGS:
            walls.append(np.concatenate([start + low * along, start + high * along]))
        left = left[~taken]
    return np.reshape(walls, (-1, 4))


def merged_corners(corners: FloatArray) -> FloatArray:
    """Return the corners (m, 3) x, y, opening of sightings (n, 4), which have the variance of the place, metres^2, too.

    The surest sighting is kept; the opening is in radians.
    """
    left = corners[np.argsort(corners[:, 3])]
    kept = []
    while len(left):
        same = np.hypot(*(left[:, :2] - left[0, :2]).T) < SAME_CORNER
        kept.append(left[0, :3])
        left = left[~same]
    return np.reshape(kept, (-1, 3))


def _free_places(grid: OccupancyGrid, spacing: float) -> FloatArray:
    step = max(1, round(spacing / grid.resolution))
    rows, cols = (np.arange(step // 2, n, step) for n in grid.shape)
    free: NDArray[np.bool_] = grid.free[np.ix_(rows, cols)]
    if not free.any():
        raise InvalidInputError(f"spacing: no free place in steps of {spacing:g} m")
    row, col = np.nonzero(free)
    points = grid.to_map(np.column_stack([cols[col], rows[row]]) + 0.5)
    return np.column_stack([points, np.zeros(len(points))])


def _corners_in_map(place: FloatArray, corners: Sequence[Corner]) -> list[FloatArray]:
    return [
        np.array([*transform_points(place, corner.position), corner.signature, _place_variance(corner)])
        for corner in corners
    ]


def _place_variance(corner: Corner) -> float:
    along, across = corner.covariance[0, 0], corner.covariance[1, 1] * corner.measurement[0] ** 2
    return float(along + across)
