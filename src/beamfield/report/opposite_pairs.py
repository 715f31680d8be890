"""The pairs of opposite beams behind `OppositeBeams`, to draw them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.reference_checks import NEAR_WALL, NEAR_WALL_SHARE, OPPOSITE_TOLERANCE, SAME_ORIGIN
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.sensors import SensorLog


def opposite_pairs(log: SensorLog, table: BeamTable) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows of the table that are opposite beams of one scan and both see a mapped wall.

    The same pairs as `opposite_beams` summarises (a test compares them).

    Parameters
    ----------
    log
        The log that the table was built from.
    table
        Beams.

    Returns
    -------
    (p,) rows of the first and (p,) rows of the second beam of each pair.
    """
    partner = _partners(log.finder.mounts)
    row_of = np.full((len(log), log.finder.n_beams), -1, dtype=np.int64)
    row_of[table.scan, table.beam] = np.arange(len(table))
    near = np.abs(table.ranges - table.expected_ranges) < NEAR_WALL + NEAR_WALL_SHARE * table.expected_ranges
    near &= (table.ranges < table.max_range) & ~table.hits_nothing
    first = np.flatnonzero(near & (partner[table.beam] > table.beam))
    second = row_of[table.scan[first], partner[table.beam[first]]]
    both = (second >= 0) & near[second]
    return first[both], second[both]


def _partners(mounts: FloatArray) -> NDArray[np.int64]:
    """(k,) the beam that points the opposite way from the same place, if both see it so; -1 otherwise."""
    apart = np.hypot(mounts[:, None, 0] - mounts[None, :, 0], mounts[:, None, 1] - mounts[None, :, 1])
    turn = np.abs(wrap_angle(mounts[:, None, 2] - mounts[None, :, 2] + np.pi))
    turn = np.where(apart > SAME_ORIGIN, np.inf, turn)
    best = turn.argmin(axis=1)
    beam = np.arange(len(best))
    return np.where((turn[beam, best] < OPPOSITE_TOLERANCE) & (best[best] == beam), best, -1)
