"""Occupancy maps from scans with poses, by log-odds: local maps (Figure 6.12) and maps of whole logs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import as_count, as_floats, checked, require
from beamfield.errors import TooLittleDataError
from beamfield.geometry import FloatArray, compose, invert
from beamfield.indices import as_indices
from beamfield.maps.cone_mapping import build_cone_map
from beamfield.maps.end_points import hit_points
from beamfield.maps.inverse_sensor import CONFIDENT as CONFIDENT
from beamfield.maps.inverse_sensor import InverseSensorModel as InverseSensorModel
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.occupancy_mapper import MAX_CELLS, OccupancyMapper
from beamfield.sensors import Scan, SensorLog

Progress = Callable[[int, int], None]

SCANS_PER_CHUNK = 128


@checked
def build_map(
    log: SensorLog,
    *,
    resolution: float = 0.05,
    poses: ArrayLike | None = None,
    scans: ArrayLike | None = None,
    inverse_model: InverseSensorModel | None = None,
    max_cells: int = MAX_CELLS,
    progress: Progress | None = None,
) -> OccupancyGrid:
    """Build the occupancy map of a log whose poses are known.

    Each cell holds the log-odds l of being occupied; a scan adds log(p / (1 - p)) of the inverse sensor model. A scan
    changes a cell at most once, however many of its beams cross it, and a hit counts before a pass: else the many beams
    that cross the cells near the robot, and graze the cells of a wall, would count as independent evidence. A sensor
    with an opening angle is mapped by its cones, see `beamfield.maps.cone_mapping.build_cone_map`.

    Parameters
    ----------
    log
        The scans.
    resolution
        Side of a cell, metres. Cell borders lie at its multiples.
    poses
        (t, 3) poses of the robot, one per scan of the log; None takes the log's reference poses. Scans whose pose is
        NaN are left out.
    scans
        Indices or mask of the scans to use; None uses all.
    inverse_model
        What a reading says about cells.
    max_cells
        Largest map, in cells of 8 bytes.
    progress
        Called with the number of scans done and in total.

    Returns
    -------
    OccupancyGrid
        The smallest grid that holds every cell that was seen; NaN where nothing was. One unknown cell if no reading
        says anything. The order in which scans come matters only where a cell reached its bounds.

    Raises
    ------
    TooLittleDataError
        If no scan has a pose.
    InvalidInputError
        If the poses do not fit, or the map would have more than `max_cells` cells; nothing is allocated then.

    References
    ----------
    Probabilistic Robotics, 6.5: local maps from scans, and the warning of maps that see "through walls". The update in
    log-odds is that of Moravec and Elfes (1985).

    Examples
    --------
    A robot drives towards a wall and sees it twice with one beam:

    >>> from beamfield.sensors import RangeFinder
    >>> finder = RangeFinder.from_bearings([0.0], max_range=8.0)
    >>> poses = [[0.25, 0.25, 0.0], [0.75, 0.25, 0.0]]
    >>> log = SensorLog(finder, [0.0, 1.0], [[1.5], [1.0]], poses, np.full((2, 3), np.nan))
    >>> build_map(log, resolution=0.5).probability.round(2).tolist()
    [[0.4..., 0.3..., 0.3..., 0.8...]]
    """
    track = _poses_of(log, poses)
    chosen = np.arange(len(log)) if scans is None else as_indices(scans, len(log), "scans")
    chosen = chosen[np.isfinite(track[chosen]).all(axis=-1)]
    if len(chosen) == 0:
        raise TooLittleDataError("building a map: none of the chosen scans has a pose")
    if log.finder.opening_angle > 0.0:
        return build_cone_map(
            log.ranges[chosen], log.finder, track[chosen], resolution=resolution,
            inverse_model=inverse_model or InverseSensorModel(), max_cells=max_cells, progress=progress,
        )  # fmt: skip
    mapper = OccupancyMapper(resolution, inverse_model=inverse_model, max_cells=max_cells)
    chunks = [chosen[i : i + SCANS_PER_CHUNK] for i in range(0, len(chosen), SCANS_PER_CHUNK)]
    for part in chunks:
        mapper.make_room(log.ranges[part], log.finder, track[part])
    done = 0
    for part in chunks:
        mapper.add(log.ranges[part], log.finder, track[part])
        done += len(part)
        if progress is not None:
            progress(done, len(chosen))
    return mapper.to_grid()


@checked
def local_map(
    log: SensorLog,
    index: int,
    *,
    n: int = 10,
    resolution: float = 0.05,
    poses: ArrayLike | None = None,
) -> OccupancyGrid:
    """Build a local map from the last n scans, in the robot's frame at the last of them (Figure 6.12).

    A reading says more about a cell than in `build_map` (0.97 and 0.03), because few scans see it.

    Parameters
    ----------
    log
        The scans.
    index
        The last scan.
    n
        Number of scans; fewer at the start of the log.
    resolution
        Side of a cell, metres.
    poses
        (t, 3) poses of the robot, one per scan of the log; only their differences matter, so `log.odometry` will do.
        None takes the log's reference poses.

    Returns
    -------
    OccupancyGrid
        Its frame is the robot's. NaN where no beam passed or ended.

    Raises
    ------
    InvalidInputError
        If there is no such scan, or n < 1.
    TooLittleDataError
        If the scan has no pose. Earlier scans without pose are left out.

    Examples
    --------
    >>> from beamfield.sensors import RangeFinder
    >>> finder = RangeFinder.from_bearings([0.0], max_range=8.0)
    >>> poses = [[0.25, 0.25, 0.0], [0.75, 0.25, 0.0]]
    >>> log = SensorLog(finder, [0.0, 1.0], [[1.6], [1.1]], poses, np.full((2, 3), np.nan))
    >>> local_map(log, 1, n=2, resolution=0.5).occupied.tolist()
    [[False, False, False, True]]
    """
    n = as_count(n, "n", least=1)
    require(len(log), "log", "at least one scan", 0)
    index = as_count(index, "index", least=0, most=len(log) - 1)
    track = _poses_of(log, poses)
    if not np.isfinite(track[index]).all():
        raise TooLittleDataError(f"building a local map: scan {index} has no pose")
    part = np.arange(max(0, index - n + 1), index + 1)
    seen_from = compose(invert(track[index]), track[part])
    return build_map(log.select(part), resolution=resolution, poses=seen_from, inverse_model=CONFIDENT)


@checked
def scan_map(scan: Scan, *, resolution: float) -> OccupancyGrid:
    """Build the local map of a single scan, in the robot's frame, by a confident inverse model.

    Parameters
    ----------
    scan
        The scan.
    resolution
        Side of a cell, metres.

    Returns
    -------
    OccupancyGrid
        One unknown cell if no reading of the scan says anything.

    Raises
    ------
    InvalidInputError
        If the resolution is not positive.

    Examples
    --------
    >>> from beamfield.sensors import RangeFinder
    >>> scan = Scan([1.1], RangeFinder.from_bearings([0.0], max_range=8.0))
    >>> scan_map(scan, resolution=0.5).occupied.tolist()
    [[False, False, True]]
    """
    mapper = OccupancyMapper(resolution, inverse_model=CONFIDENT)
    mapper.add(scan.ranges[None], scan.finder, np.zeros((1, 3)))
    return mapper.to_grid()


def share_of_hits_in_obstacles(grid: OccupancyGrid, log: SensorLog) -> float:
    """Return how many of a log's hits end in an occupied cell of a map, or in one beside it.

    A measure of sharpness: where poses are wrong, walls are drawn twice, beams pass what others hit, and hits end in
    cells that the map holds for free. Moving objects and glass lower it too.

    Parameters
    ----------
    grid
        The map.
    log
        The scans, with reference poses.

    Returns
    -------
    Share in [0, 1] of the readings below max_range; 0 if there are none.
    """
    from scipy.ndimage import maximum_filter  # takes a third of a second to import

    near = maximum_filter(grid.occupied, 3, mode="constant")
    hits = inside = 0
    for start in range(0, len(log), SCANS_PER_CHUNK):
        part = slice(start, start + SCANS_PER_CHUNK)
        points = hit_points(log.ranges[part], log.finder, log.poses[part])
        hits += len(points)
        inside += int(np.count_nonzero(grid.look_up(near, points)))
    return inside / max(hits, 1)


def _poses_of(log: SensorLog, poses: ArrayLike | None) -> FloatArray:
    track = log.poses if poses is None else as_floats(poses, "poses")
    require(track.shape == (len(log), 3), "poses", f"shape ({len(log)}, 3), one per scan", track.shape)
    return track
