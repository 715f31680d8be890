"""How scans agree with the map along their beams, which end points alone do not tell: what stands in the way counts."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, Scan, SensorLog, usable_ranges

# So many scans with so many beams tell enough.
SCANS, BEAMS = 200, 60
# A reading agrees within so many metres, or cells if they are larger, and this share of its length.
TOLERANCE, TOLERANCE_CELLS, TOLERANCE_SHARE = 0.25, 3.0, 0.02
# Of the readings of a scan, this share has to be expected where its place is right.
EXPECTED = 0.75
# A sensor is sparse, as slices of point clouds are, and says nothing by beams without return, if more than this share
# of the beams between two that return, so many radians apart at most, does not: 0.60 where bins are finer than the
# points, in real scans of lasers 0.021 or less, in simulated ones 0.15.
SPARSE, CLOSE = 0.25, float(np.radians(5.0))
# Below this in the median scan, poses or map are wrong. Between runs with wrong odometry or an unlike building's map
# (at most 0.43; up to 0.70 in offices that are alike) and those that follow the robot (at least 0.53): real and
# simulated logs with two filters (docs/evidence/localization.md). At reference poses: at most 0.43 on wrong maps, at
# least 0.59 on right ones.
LEAST_AGREEMENT = 0.45


class RayAgreement(NamedTuple):
    """Shares of the beams that should hit something.

    Parameters
    ----------
    agrees
        The reading is about as long as the map says.
    through
        It is longer, or missing: the beam passed where the map has a wall.
    """

    agrees: float
    through: float


def ray_agreement(log: SensorLog, grid: OccupancyGrid, poses: FloatArray, scans: NDArray[np.int64]) -> RayAgreement:
    """Compare scans (n,), by index, with the map along their beams from poses (n, 3).

    Agreement is 0 and the rest 1 if no beam should hit anything.
    """
    chosen = _spread(np.arange(len(scans)), SCANS)
    z, expected = _readings(log, RayCaster(grid), poses[chosen], scans[chosen])
    counted = np.isfinite(z) & (expected < log.finder.max_range)
    z, expected = z[counted], expected[counted]
    if not len(z):
        return RayAgreement(0.0, 1.0)
    tolerance = _tolerance(grid, expected)
    return RayAgreement(float(np.mean(np.abs(z - expected) <= tolerance)), float(np.mean(z - expected > tolerance)))


def scan_agreement(
    log: SensorLog, grid: OccupancyGrid, poses: FloatArray, *, most: int = SCANS, caster: RayCaster | None = None
) -> FloatArray:
    """Return the share of each scan's beams (t,) that are as long as the map says, of `most` scans spread over the log.

    It is the share of the beams that should hit something, or of three quarters of those that do where that is more:
    where most beams should see nothing, readings of people would outvote the walls. Of sparse sensors only beams that
    return count. NaN for scans without such beams or a pose (t, 3), and for those that are left out. The caster is of
    the map, where it is there already.
    """
    scans = _spread(np.flatnonzero(np.isfinite(poses).all(axis=1)), most)
    z, expected = _readings(log, caster or RayCaster(grid), poses[scans], scans)
    shares: FloatArray = np.full(len(log), np.nan)
    shares[scans] = _agreeing(z, expected, grid, log.finder.max_range)
    return shares


def agreement_at(scan: Scan, caster: RayCaster, pose: FloatArray) -> float:
    """Return `scan_agreement` of one scan at a pose (3,), in the map of a caster."""
    beams, finder = _thinned(scan.finder)
    z, expected = _telling(scan.ranges, scan.finder)[beams], caster.expected_ranges(pose, finder)
    return float(_agreeing(z, expected, caster.grid, finder.max_range))


def passing_shares(z: FloatArray, expected: FloatArray, grid: OccupancyGrid, max_range: float) -> FloatArray:
    """Return the share of a scan's beams that would have passed through a wall, at many poses (n,).

    Readings z (k,) are max_range where nothing returned; `expected` (n, k) are ranges by the map. Beams are counted as
    by `scan_agreement`; 0 where there are none.
    """
    passes = ((expected < max_range) & (z - expected > _tolerance(grid, expected))).sum(axis=1)
    return np.asarray(passes / np.maximum(_counted(z, expected, max_range), 0.5))


def _agreeing(z: FloatArray, expected: FloatArray, grid: OccupancyGrid, max_range: float) -> FloatArray:
    """Return the share of each scan's beams (..., k) that are as long as the map says; NaN without such beams."""
    counted = _counted(z, expected, max_range)
    agrees = (expected < max_range) & (np.abs(z - expected) <= _tolerance(grid, expected))
    return np.where(counted > 0.0, agrees.sum(axis=-1) / np.maximum(counted, 0.5), np.nan)


def _counted(z: FloatArray, expected: FloatArray, max_range: float) -> FloatArray:
    """Return how many beams should hit something, or three quarters of those that do where that is more."""
    read = np.isfinite(z)
    should, does = (read & (expected < max_range)).sum(axis=-1), (read & (z < max_range)).sum(axis=-1)
    return np.asarray(np.maximum(should, EXPECTED * does))


def _readings(
    log: SensorLog, caster: RayCaster, poses: FloatArray, scans: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    """Return measured and expected ranges of some beams of scans at poses (n, 3)."""
    if not len(scans):
        return np.empty((0, 1)), np.empty((0, 1))
    beams, finder = _thinned(log.finder)
    return _telling(log.ranges[scans], log.finder)[:, beams], caster.expected_ranges(poses, finder)


def _telling(ranges: FloatArray, finder: RangeFinder) -> FloatArray:
    """Return usable readings of scans (..., k), NaN for what says nothing: of a sparse sensor, what did not return."""
    z = usable_ranges(ranges, finder)
    order = np.argsort(finder.bearings)
    bearings, around = finder.bearings[order], z[..., order]
    returned = around < finder.max_range
    between = returned[..., :-2] & returned[..., 2:] & (bearings[2:] - bearings[:-2] <= CLOSE)
    missing = between & (around[..., 1:-1] >= finder.max_range)
    if np.count_nonzero(missing) > SPARSE * np.count_nonzero(between):
        z[z >= finder.max_range] = np.nan
    return z


# A filter asks for it with each scan.
@lru_cache(maxsize=16)
def _thinned(finder: RangeFinder) -> tuple[NDArray[np.int64], RangeFinder]:
    beams = np.unique(np.linspace(0, finder.n_beams - 1, BEAMS).astype(np.int64))
    return beams, finder.subset(beams)


def _spread(scans: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    return scans[np.unique(np.linspace(0, len(scans) - 1, most).astype(np.int64))] if len(scans) else scans


def _tolerance(grid: OccupancyGrid, expected: FloatArray) -> FloatArray:
    return max(TOLERANCE, TOLERANCE_CELLS * grid.resolution) + TOLERANCE_SHARE * expected
