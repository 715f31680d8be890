"""Residuals of landmark sightings in groups: per landmark and by distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.landmark_noise.sighting_table import SightingTable


@dataclass(frozen=True)
class ResidualGroup:
    """What remains of a group of sightings after bias and scale are taken out.

    Parameters
    ----------
    name
        The landmark's id, or the distances in metres.
    n
        Sightings, counted by how probably they are of their landmark.
    range_mean, range_std, bearing_mean, bearing_std
        Mean and standard deviation, metres and radians; NaN where nothing was measured.
    range_mean_se, bearing_mean_se
        Standard errors of the means from block to block; NaN for fewer than 4 blocks.
    """

    name: str
    n: float
    range_mean: float
    range_std: float
    range_mean_se: float
    bearing_mean: float
    bearing_std: float
    bearing_mean_se: float


# Fewer blocks than these give no standard error.
FEWEST_BLOCKS = 4
# A mean of fewer sightings says little.
FEWEST_SIGHTINGS = 10
BINS_BY_DISTANCE = 4


def groups_by_landmark(
    table: SightingTable, ids: NDArray[np.int64], ranges: FloatArray, bearings: FloatArray, weights: FloatArray
) -> tuple[ResidualGroup, ...]:
    """Return one group per landmark with at least 10 sightings, in the map's order.

    Parameters
    ----------
    table
        The sightings.
    ids
        (N,) ids of the map's landmarks.
    ranges, bearings
        (n,) residuals, bias and scale taken out; NaN where not measured.
    weights
        (n,) how probably each sighting is of its landmark.

    Returns
    -------
    Groups named by the landmarks' ids.
    """
    return tuple(
        _group(str(which), table.landmarks == j, table.blocks, ranges, bearings, weights)
        for j, which in enumerate(ids.tolist())
        if weights[table.landmarks == j].sum() >= FEWEST_SIGHTINGS
    )


def groups_by_distance(
    table: SightingTable, ranges: FloatArray, bearings: FloatArray, weights: FloatArray
) -> tuple[ResidualGroup, ...]:
    """Return the quarters of the sightings from near to far; none where all are at one distance.

    Parameters
    ----------
    table, ranges, bearings, weights
        As for `groups_by_landmark`.

    Returns
    -------
    At most four groups, named by their distances in metres; none with too few sightings.
    """
    real = table.landmarks >= 0
    distances = table.expected_ranges[real]
    edges = np.unique(np.quantile(distances, np.linspace(0.0, 1.0, BINS_BY_DISTANCE + 1)))
    if len(edges) < 2 or weights[real].sum() < BINS_BY_DISTANCE * FEWEST_SIGHTINGS:
        return ()
    number = np.full(len(table), -1)
    number[real] = np.clip(np.searchsorted(edges, distances, side="right") - 1, 0, len(edges) - 2)
    return tuple(
        _group(f"{edges[i]:.3g} to {edges[i + 1]:.3g}", number == i, table.blocks, ranges, bearings, weights)
        for i in range(len(edges) - 1)
        if weights[number == i].sum() > 0.0
    )


def _group(
    name: str,
    mine: NDArray[np.bool_],
    blocks: NDArray[np.int64],
    ranges: FloatArray,
    bearings: FloatArray,
    w: FloatArray,
) -> ResidualGroup:
    r = _moments(ranges[mine], w[mine], blocks[mine])
    b = _moments(bearings[mine], w[mine], blocks[mine])
    return ResidualGroup(name, float(w[mine].sum()), *r, *b)


def _moments(values: FloatArray, w: FloatArray, blocks: NDArray[np.int64]) -> tuple[float, float, float]:
    """Return mean, standard deviation, and the mean's standard error from block to block."""
    used = ~np.isnan(values) & (w > 0.0)
    if not used.any():
        return np.nan, np.nan, np.nan
    e, w = values[used], w[used]
    mean = float((w * e).sum() / w.sum())
    std = float(np.sqrt((w * np.square(e - mean)).sum() / w.sum()))
    _, number = np.unique(blocks[used], return_inverse=True)
    b = int(number.max()) + 1
    if b < FEWEST_BLOCKS:
        return mean, std, np.nan
    off = np.bincount(number, w * (e - mean))
    return mean, std, float(np.sqrt(np.square(off).sum() * b / (b - 1.0)) / w.sum())
