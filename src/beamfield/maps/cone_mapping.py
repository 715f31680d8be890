"""Occupancy maps from wide cones: a reading says that something is on an arc, and nothing before it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_magnitude, checked
from beamfield.geometry import FloatArray, compose
from beamfield.kernels import mapping as kernels
from beamfield.maps.inverse_sensor import InverseSensorModel, log_odds_steps
from beamfield.maps.log_odds import check_size, grid_of_log_odds, lengths_and_kinds
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder

SCANS_PER_CHUNK = 128
# The arc lies so many cells behind the reading, which is the near surface of the cell that reflects. Measured in a room
# of perfect cones, drawn and cast again: ranges come out a cell too short at 0, right from 0.25 to 1; with noise of
# half a cell, nine in ten are within 0.01 m at 0.5 and 0.06 m at 0.25.
BEHIND_READING = 0.5


@checked
def build_cone_map(
    ranges: FloatArray,
    finder: RangeFinder,
    poses: FloatArray,
    *,
    resolution: float,
    inverse_model: InverseSensorModel,
    max_cells: int,
    progress: Callable[[int, int], None] | None = None,
) -> OccupancyGrid:
    """Build the map of scans of a sensor with an opening angle: the smallest that holds all seen cells, NaN elsewhere.

    A sonar's reading z says two things: no cell of the cone is occupied nearer than z, and at least one cell on the arc
    is, which begins at z (it is drawn half a cell behind it). Which one it is, other readings tell: a cell that other
    cones passed is not it. So there are two rounds over the log.

    1. Every scan passes the cells in its cones that are nearer than the reading.
    2. Every reading is a hit of those cells of its arc that were passed least; other cells of the arc get a part of a
       hit, (passed / (1 - passed))^d where they were passed d times more often.

    A cell's log-odds is the sum of its hits and passes, to which the inverse model's bounds are applied, so that the
    order of scans never matters. Arcs end beside the wall that they come from; where no other cone clears these ends,
    they stay in the map, mostly behind the wall.

    `ranges` (t, k) are in the conventions of `Scan`, `poses` (t, 3) finite, the map's borders at multiples of its
    `resolution` in metres. InvalidInputError if that is not positive or the map has more than `max_cells`, of 16 bytes.

    Moravec and Elfes, "High resolution maps from wide angle sonar", ICRA 1985, weigh evidence of occupancy on the arc
    against evidence of emptiness before they enter it.
    """
    check_magnitude("resolution", resolution)
    readings = _readings(ranges, finder, resolution, inverse_model)
    first, shape = _extent(readings, finder, poses, resolution, max_cells)
    starts = np.column_stack([poses[:, :2] / resolution - first, np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    cones = finder.mounts / np.array([resolution, resolution, 1.0])
    half = finder.opening_angle / 2.0
    passes, hits = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    seen = np.full(shape, -1, np.int32)
    hit, passed, low, high = (float(step) for step in log_odds_steps(inverse_model))
    chunks = [slice(i, i + SCANS_PER_CHUNK) for i in range(0, len(starts), SCANS_PER_CHUNK)]
    for number, part in enumerate(chunks):
        kernels.count_passes(
            starts[part], cones, half, readings.lengths[part], readings.kinds[part], 2 * part.start, passes, seen
        )
        _report(progress, len(starts) * (number + 1) // (2 * len(chunks)), len(starts))
    marks = np.full(shape, -1, np.int32)
    for number, part in enumerate(chunks):
        kernels.share_hits(
            starts[part], cones, half, readings.lengths[part], readings.kinds[part],
            part.start * finder.n_beams, passed, passes, hits, marks,
        )  # fmt: skip
        _report(progress, len(starts) * (len(chunks) + number + 1) // (2 * len(chunks)), len(starts))
    log_odds = np.clip(hits * hit + passes * passed, low, high)
    return grid_of_log_odds(log_odds, seen >= 0, first, resolution)


class _Readings(NamedTuple):
    """How far each cone is followed, in cells, and what its end is."""

    lengths: FloatArray
    kinds: NDArray[np.uint8]


def _readings(ranges: FloatArray, finder: RangeFinder, resolution: float, model: InverseSensorModel) -> _Readings:
    z, kinds = lengths_and_kinds(ranges, finder, model)
    return _Readings(z / resolution + np.where(kinds == kernels.HIT, BEHIND_READING, 0.0), kinds)


def _extent(
    readings: _Readings, finder: RangeFinder, poses: FloatArray, resolution: float, max_cells: int
) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return (col, row) of the first cell and (rows, cols) of a grid that holds all cones, whatever they face."""
    used = readings.kinds != kernels.SKIP
    if not used.any():
        return np.zeros(2, np.int64), (1, 1)
    apex = (compose(poses[:, None], finder.mounts)[..., :2] / resolution)[used]
    reach = readings.lengths[used][:, None] + 2.0
    low, high = np.floor((apex - reach).min(axis=0)), np.ceil((apex + reach).max(axis=0))
    size = high - low
    check_size(size, resolution, max_cells)
    return low.astype(np.int64), (int(size[1]), int(size[0]))


def _report(progress: Callable[[int, int], None] | None, done: int, total: int) -> None:
    if progress is not None:
        progress(done, total)
