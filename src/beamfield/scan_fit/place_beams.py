"""What each beam of a log says about the map: as mapped, short of it, beyond it, or without return."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable, build_beam_table
from beamfield.calibration.pose_windows import REFERENCE_LEVER
from beamfield.calibration.time_split import time_blocks
from beamfield.geometry import FloatArray, compose
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.end_points import points_along
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_density import beam_responsibilities
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import SensorLog
from beamfield.short_repr import short_repr

# Scans are thinned beyond so many beams: neighbouring scans say the same.
MOST_BEAMS = 500_000
# Pose and range may be off by so many standard deviations before a reading disagrees with the map.
TOLERATED_SIGMAS = 3.0
# Rays around the reference ray, in standard deviations of place and heading together.
FAN = (-2.0, -1.0, 1.0, 2.0)
# The noise of no laser grows faster with range; a model with more has learned errors of the heading, which count here
# where they belong, at right angles to the beam: its 1 m at 8 m (Wean Hall) would explain any furniture.
MOST_SLOPE = 0.02
# Below this probability the model does not call a reading a hit.
HIT_PROBABILITY = 0.5


@dataclass(frozen=True, eq=False)
class PlaceBeams:
    """Beams as columns of length n.

    Parameters
    ----------
    visit
        Block of time, from 0.
    rays
        (n, 3) start and direction in the map frame, metres and radians.
    followed
        How far the beam surely went, metres; 0 where that is not known.
    ends, walls
        (n, 2) where the reading ends, and where the ray meets the mapped obstacle, metres in the map frame.
    short
        The reading ends where the map has free space, farther from every obstacle than errors explain.
    tested
        The beam says whether the mapped obstacle is there: errors cannot make it pass by, and nothing stood before it.
    through, silent
        Of the tested ones: the reading lies beyond the obstacle; there was no return.
    """

    visit: NDArray[np.int64]
    rays: FloatArray
    followed: FloatArray
    ends: FloatArray
    walls: FloatArray
    short: NDArray[np.bool_]
    tested: NDArray[np.bool_]
    through: NDArray[np.bool_]
    silent: NDArray[np.bool_]

    __repr__ = short_repr


def judge_beams(
    log: SensorLog,
    grid: OccupancyGrid,
    parameters: BeamParameters,
    scans: NDArray[np.int64],
    *,
    reference_error: float,
    longest_error: float,
    block_s: float,
) -> PlaceBeams:
    """Compare every beam with the map, with what the sensor's noise and the reference poses may be off in mind.

    The reference error is the standard deviation of the poses per axis in metres, and a quarter of it in radians; beams
    are followed until it has moved them aside by `longest_error` metres. A block of time, which counts as one visit, is
    block_s seconds long; 0 where no time passes. The scans are indices. One row per beam whose expected range is known.
    """
    table = build_beam_table(log, grid, scans[:: 1 + len(scans) * log.finder.n_beams // MOST_BEAMS])
    rays = compose(log.poses[table.scan], log.finder.mounts[table.beam])
    visit = time_blocks(table.stamps, block_s or None)
    return judge_table(
        table, rays, visit, grid, parameters, reference_error=reference_error, longest_error=longest_error
    )


def judge_table(
    table: BeamTable,
    rays: FloatArray,
    visit: NDArray[np.int64],
    grid: OccupancyGrid,
    parameters: BeamParameters,
    *,
    reference_error: float,
    longest_error: float,
) -> PlaceBeams:
    """Compare beams whose expected ranges are known with the map; see `judge_beams`.

    Rays (n, 3) are start and direction of each in the map frame, metres and radians; visit (n,) is its block of time.
    """
    parameters = replace(parameters, sigma_slope=min(parameters.sigma_slope, MOST_SLOPE))
    reach = np.sqrt(max(longest_error**2 / reference_error**2 - 1.0, 0.0)) * REFERENCE_LEVER
    z, expected = table.ranges, table.expected_ranges
    returned = z < table.max_range
    measured = z - np.where(returned, parameters.range_offset, 0.0)
    share = beam_responsibilities(z, expected, table.max_range, parameters, min_range=table.min_range)
    strange = share[:, 0] < HIT_PROBABILITY
    ends, walls = points_along(rays, measured), points_along(rays, expected)
    nearest, farthest = _range_of_expected(grid, rays, table, reference_error)
    tolerated = _tolerated(expected, parameters, reference_error)
    clear = _distance_to_map(grid, ends) > _tolerated(measured, parameters, reference_error)
    short = strange & returned & (measured < expected) & clear & (measured <= reach)
    tested = (
        ~table.hits_nothing
        & (expected <= reach)
        & (farthest <= expected + tolerated)
        & (measured >= nearest - tolerated)
        & ~short
    )
    # Nothing is known of the path of a beam that did not return from an obstacle.
    known = returned | table.hits_nothing
    return PlaceBeams(
        visit=visit,
        rays=rays,
        followed=np.where(known, np.minimum(measured, reach), 0.0),
        ends=ends,
        walls=walls,
        short=short,
        tested=tested,
        through=tested & strange & returned & (measured > farthest + tolerated),
        silent=tested & ~returned,
    )


def _tolerated(ranges: FloatArray, parameters: BeamParameters, reference_error: float) -> FloatArray:
    """Return how far end points at these ranges may be off, metres."""
    sigma = np.hypot(parameters.sigma_hit, parameters.sigma_slope * ranges)
    pose = reference_error * np.hypot(1.0, ranges / REFERENCE_LEVER)
    return np.asarray(TOLERATED_SIGMAS * np.hypot(pose, sigma))


def _range_of_expected(
    grid: OccupancyGrid, rays: FloatArray, table: BeamTable, reference_error: float
) -> tuple[FloatArray, FloatArray]:
    """Return the shortest and the longest expected range over rays beside the reference ray."""
    caster = RayCaster(grid)
    nearest, farthest = table.expected_ranges.copy(), table.expected_ranges.copy()
    aside = np.column_stack([-np.sin(rays[:, 2]), np.cos(rays[:, 2]), np.full(len(rays), 1.0 / REFERENCE_LEVER)])
    for sigmas in FAN:
        expected = caster.cast(rays + sigmas * reference_error * aside, table.max_range)
        np.minimum(nearest, expected, out=nearest)
        np.maximum(farthest, expected, out=farthest)
    return nearest, farthest


def _distance_to_map(grid: OccupancyGrid, points: FloatArray) -> FloatArray:
    """Return the distance of points to the surface of the nearest mapped obstacle, metres; 0 off the map."""
    found = grid.look_up(distance_to_obstacles(grid), points, outside=0.0)
    # From centre to centre: the surfaces are nearer by up to a cell.
    return np.maximum(found - grid.resolution, 0.0)
