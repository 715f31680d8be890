"""The best heading of a beam model at every place of a lattice, from one fan of rays per place."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, transform_points
from beamfield.kernels.heading_search import fill_heading_scores
from beamfield.kernels.threads import run_in_blocks
from beamfield.localization.shared_fan import SharedFan
from beamfield.maps.occupancy import BoolArray
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_log_density
from beamfield.sensors import Scan, usable_ranges

# Expected ranges in memory at a time (8 bytes each).
RANGES_PER_CHUNK = 2_000_000
# Nodes of a beam's table within sigma_hit: interpolation then errs by 1 / 512 nats near the peak of p_hit. Tables
# longer than MAX_NODES do not stay in the cache.
NODES_PER_SIGMA, MAX_NODES = 8.0, 1 << 14
# Stands for log 0 in the tables.
LEAST = -1e30
LOOK_UPS_PER_WORK_UNIT = 16


def fan_headings(
    model: BeamModel,
    scan: Scan,
    fan: SharedFan,
    mask: BoolArray,
    origin: FloatArray,
    resolution: float,
    progress: Callable[[int, int], None] | None = None,
) -> NDArray[np.int16]:
    """Return the best heading in each cell of a lattice, without casting the beams of every pose.

    Parameters
    ----------
    model
        The model.
    scan
        The scan with the beams that count.
    fan
        The rays that stand for its beams.
    mask
        (rows, cols) the cells in which the robot may be.
    origin
        (3,) pose of the lattice's corner in the map frame.
    resolution
        Side of the lattice's cells, metres.
    progress
        Called with the number of places done and in total.

    Returns
    -------
    (rows, cols) index of the heading; the first of equals; -1 outside the mask.
    """
    tables, step_of_table = _beam_tables(model, scan)
    best = _BestHeadings(mask)
    # The sensor may stand outside the cells in which the robot may be, and off the map.
    margin = int(np.abs(fan.offsets).max())
    groups = fan.headings_by_offset()
    rows, cols = np.nonzero(_sensor_places(np.pad(mask, margin), [offset for offset, _ in groups]))
    rows, cols = rows - margin, cols - margin
    index = np.ascontiguousarray(fan.index.T)
    step = max(1, RANGES_PER_CHUNK // fan.rays.n_beams)
    for start in range(0, len(rows), step):
        row, col = rows[start : start + step], cols[start : start + step]
        places = np.zeros((len(row), 3))
        places[:, :2] = transform_points(origin, (np.column_stack([col, row]) + 0.5) * resolution)
        ranges = model.expected(places, fan.rays)
        scores = np.empty((len(row), len(fan.index)))
        run_in_blocks(
            lambda a, b, ranges=ranges, scores=scores: fill_heading_scores(  # type: ignore[misc]
                ranges[a:b], index, tables, step_of_table, scores[a:b]
            ),
            len(row),
            work_per_row=fan.index.size // LOOK_UPS_PER_WORK_UNIT,
        )
        for (d_row, d_col), headings in groups:
            best.keep_larger(scores[:, headings], headings, row - d_row, col - d_col)
        if progress is not None:
            progress(min(start + step, len(rows)), len(rows))
    return best.index


def _sensor_places(mask: BoolArray, offsets: list[tuple[int, int]]) -> BoolArray:
    """Return where the sensor may be, if the robot may be in the cells of the mask."""
    places = np.zeros_like(mask)
    for offset in offsets:
        places |= np.roll(mask, offset, axis=(0, 1))
    return places


def _beam_tables(model: BeamModel, scan: Scan) -> tuple[NDArray[np.float32], float]:
    """Return log p(z^k | z*) for each beam at equally spaced expected ranges z*, and the spacing in metres."""
    limit = scan.finder.max_range
    n = int(np.clip(limit / (model.parameters.sigma_hit / NODES_PER_SIGMA), 2, MAX_NODES))
    nodes = np.linspace(0.0, limit, n + 1)
    ranges = usable_ranges(scan.ranges, scan.finder)
    values = beam_log_density(ranges[:, None], nodes, limit, model.parameters, min_range=scan.finder.min_range)
    # Differences of infinities would be NaN.
    return np.maximum(values, LEAST).astype(np.float32), limit / n


class _BestHeadings:
    """The best heading so far in each cell of a mask, and its score."""

    def __init__(self, mask: BoolArray) -> None:
        self.mask = mask
        self.index = np.where(mask, 0, -1).astype(np.int16)
        self.score = np.full(mask.shape, -np.inf)

    def keep_larger(
        self, scores: FloatArray, headings: NDArray[np.int64], rows: NDArray[np.int64], cols: NDArray[np.int64]
    ) -> None:
        """Enter the best of scores (n, h) of these headings in cells (n,), where it is larger than what is there."""
        inside = (rows >= 0) & (cols >= 0) & (rows < self.mask.shape[0]) & (cols < self.mask.shape[1])
        inside[inside] = self.mask[rows[inside], cols[inside]]
        rows, cols, scores = rows[inside], cols[inside], scores[inside]
        best = np.argmax(scores, axis=1)
        largest = scores[np.arange(len(rows)), best]
        larger = largest > self.score[rows, cols]
        self.score[rows[larger], cols[larger]] = largest[larger]
        self.index[rows[larger], cols[larger]] = headings[best[larger]]
