"""Occupancy maps from scans with poses, by log-odds: local maps (Figure 6.12) and maps of whole logs."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray, as_poses, compose, invert, transform_points
from beamfield.kernels import mapping as kernels
from beamfield.maps.cone_mapping import build_cone_map
from beamfield.maps.inverse_sensor import CONFIDENT as CONFIDENT
from beamfield.maps.inverse_sensor import InverseSensorModel as InverseSensorModel
from beamfield.maps.inverse_sensor import log_odds_steps
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan, SensorLog, usable_ranges

Progress = Callable[[int, int], None]

# Eight bytes per cell: 800 MB.
MAX_CELLS = 100_000_000
SCANS_PER_CHUNK = 128


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
    """
    track = _poses_of(log, poses)
    chosen = np.arange(len(log))[slice(None) if scans is None else np.asarray(scans)]
    chosen = chosen[np.isfinite(track[chosen]).all(axis=-1)]
    if len(chosen) == 0:
        raise TooLittleDataError("building a map: no scan that was chosen has a pose")
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


def local_map(
    log: SensorLog,
    index: int,
    *,
    n: int = 10,
    resolution: float = 0.05,
    poses: ArrayLike | None = None,
    inverse_model: InverseSensorModel | None = None,
) -> OccupancyGrid:
    """Build a local map from the last n scans, in the robot's frame at the last of them (Figure 6.12).

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
    inverse_model
        What a reading says about cells; by default the confident one, because few scans see a cell.

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
    """
    if n < 1:
        raise InvalidInputError(f"n: expected at least 1 scan, got {n}")
    if not 0 <= index < len(log):
        raise InvalidInputError(f"index: expected 0 to {len(log) - 1}, got {index}")
    track = _poses_of(log, poses)
    if not np.isfinite(track[index]).all():
        raise TooLittleDataError(f"building a local map: scan {index} has no pose")
    part = np.arange(max(0, index - n + 1), index + 1)
    return build_map(
        log.select(part),
        resolution=resolution,
        poses=compose(invert(track[index]), track[part]),
        inverse_model=CONFIDENT if inverse_model is None else inverse_model,
    )


def scan_map(scan: Scan, *, resolution: float, inverse_model: InverseSensorModel | None = None) -> OccupancyGrid:
    """Build the local map of a single scan, in the robot's frame.

    Parameters
    ----------
    scan
        The scan.
    resolution
        Side of a cell, metres.
    inverse_model
        What a reading says about cells; by default the confident one.

    Returns
    -------
    OccupancyGrid
        One unknown cell if no reading of the scan says anything.
    """
    mapper = OccupancyMapper(resolution, inverse_model=CONFIDENT if inverse_model is None else inverse_model)
    mapper.add(scan.ranges[None], scan.finder, np.zeros((1, 3)))
    return mapper.to_grid()


def share_of_hits_in_obstacles(
    grid: OccupancyGrid, log: SensorLog, *, poses: ArrayLike | None = None, tolerance: float | None = None
) -> float:
    """Return how many of a log's hits end in an occupied cell of a map, or within `tolerance` of one.

    A measure of sharpness: where poses are wrong, walls are drawn twice, beams pass what others hit, and hits end in
    cells that the map holds for free. Moving objects and glass lower it too.

    Parameters
    ----------
    grid
        The map.
    log
        The scans.
    poses
        (t, 3) poses of the robot; None takes the log's reference poses.
    tolerance
        Metres; by default one cell.

    Returns
    -------
    Share in [0, 1] of the readings below max_range; 0 if there are none.
    """
    radius = 1 if tolerance is None else int(np.ceil(tolerance / grid.resolution))
    near = _dilated(grid.occupied, radius)
    hits = inside = 0
    track = _poses_of(log, poses)
    for start in range(0, len(log), SCANS_PER_CHUNK):
        part = slice(start, start + SCANS_PER_CHUNK)
        points = end_points(log.ranges[part], log.finder, track[part])
        hits += len(points)
        inside += int(np.count_nonzero(grid.look_up(near, points)))
    return inside / max(hits, 1)


def end_points(ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike) -> FloatArray:
    """Return the points (n, 2) at which the readings below max_range end (6.32), scan by scan, in the poses' frame.

    Parameters
    ----------
    ranges
        (t, k) metres in the conventions of `Scan`.
    finder
        The sensor.
    poses
        (t, 3) poses of the robot; NaN leaves a scan out.
    """
    z = usable_ranges(ranges, finder)
    track = np.asarray(poses, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        hits = (z < finder.max_range) & np.isfinite(track).all(axis=-1, keepdims=True)
    scan, beam = np.nonzero(hits)
    along = np.stack([z[hits], np.zeros(len(scan))], axis=-1)
    return transform_points(track[scan], transform_points(finder.mounts[beam], along))


class OccupancyMapper:
    """A map that grows as scans come; see `build_map` for what it does with them.

    Parameters
    ----------
    resolution
        Side of a cell, metres.
    inverse_model
        What a reading says about cells.
    max_cells
        Largest map, in cells of 8 bytes.

    Raises
    ------
    InvalidInputError
        If the resolution is not positive.

    Examples
    --------
    >>> finder = RangeFinder.from_bearings([0.0], max_range=8.0)
    >>> mapper = OccupancyMapper(0.5, inverse_model=InverseSensorModel(hit=0.9, passed=0.2))
    >>> mapper.add([[1.6]], finder, [[0.25, 0.25, 0.0]])
    >>> mapper.to_grid().occupied.tolist()
    [[False, False, False, True]]
    """

    def __init__(
        self, resolution: float, *, inverse_model: InverseSensorModel | None = None, max_cells: int = MAX_CELLS
    ) -> None:
        if not 0.0 < resolution < np.inf:
            raise InvalidInputError(f"resolution: expected a positive number of metres, got {resolution}")
        self.resolution = float(resolution)
        self.inverse_model = InverseSensorModel() if inverse_model is None else inverse_model
        self.max_cells = max_cells
        self.n_scans = 0
        # (col, row) of the array's first cell, in cells from the map's zero.
        self._first = np.zeros(2, np.int64)
        self._log_odds = np.zeros((0, 0), np.float32)
        self._stamps = np.zeros((0, 0), np.int32)

    def add(self, ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike) -> None:
        """Enter scans.

        Parameters
        ----------
        ranges
            (t, k) metres in the conventions of `Scan`.
        finder
            The sensor.
        poses
            (t, 3) poses of the robot, metres and radians.

        Raises
        ------
        InvalidInputError
            If shapes do not fit, poses are not finite, or the map would grow beyond its limit.
        """
        beams = self._follow(ranges, finder, poses)
        self._grow(beams)
        starts = beams.starts.copy()
        starts[:, :2] -= self._first
        outside = kernels.update_log_odds(
            starts, beams.fan, beams.lengths, beams.kinds, log_odds_steps(self.inverse_model), 2 * self.n_scans,
            self._log_odds, self._stamps,
        )  # fmt: skip
        if outside:
            raise RuntimeError(f"{outside} beams leave the grid that was made for them")
        self.n_scans += len(starts)

    def make_room(self, ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike) -> None:
        """Grow so that these scans fit, without entering them; parameters and errors as for `add`."""
        self._grow(self._follow(ranges, finder, poses))

    def to_grid(self) -> OccupancyGrid:
        """Return the map so far: the smallest grid with all cells that were seen, or one unknown cell."""
        seen = self._stamps >= 0
        rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        if len(rows) == 0:
            return OccupancyGrid(np.full((1, 1), np.nan, np.float32), self.resolution)
        part = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
        probability = np.float32(1.0) / (np.float32(1.0) + np.exp(-self._log_odds[part]))
        probability[~seen[part]] = np.nan
        first = self._first + np.array([cols[0], rows[0]])
        return OccupancyGrid(probability, self.resolution, np.array([*(first * self.resolution), 0.0]))

    def _follow(self, ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike) -> _Beams:
        """Say where beams start, how far they are followed, and what their last cell is."""
        robots = as_poses(poses)
        z = usable_ranges(ranges, finder)
        if robots.ndim != 2 or z.shape != (len(robots), finder.n_beams):
            raise InvalidInputError(
                f"scans: expected ranges (t, {finder.n_beams}) and poses (t, 3), got {z.shape} and {robots.shape}"
            )
        model = self.inverse_model
        kinds = np.full(z.shape, kernels.HIT, np.uint8)
        kinds[np.isnan(z)] = kernels.SKIP
        lost = z == finder.max_range
        kinds[lost] = kernels.PASS if model.clear_without_return > 0 else kernels.SKIP
        z[lost] = min(model.clear_without_return, finder.max_range)
        if model.longest_hit is not None:
            with np.errstate(invalid="ignore"):
                far = z > model.longest_hit
            kinds[far & (kinds == kernels.HIT)] = kernels.PASS
            z[far] = model.longest_hit
        z[kinds == kernels.SKIP] = 0.0
        mounts = finder.mounts
        starts = np.column_stack([robots[:, :2] / self.resolution, np.cos(robots[:, 2]), np.sin(robots[:, 2])])
        fan = np.stack(
            [mounts[:, 0] / self.resolution, mounts[:, 1] / self.resolution, np.cos(mounts[:, 2]), np.sin(mounts[:, 2])]
        )
        return _Beams(starts, fan, z / self.resolution, kinds)

    def _grow(self, beams: _Beams) -> None:
        """Make the array hold all cells of the beams."""
        extent = _extent(beams)
        if extent is None:
            return
        low, high = extent
        rows, cols = self._log_odds.shape
        last = self._first + np.array([cols, rows]) - 1
        if rows > 0:
            if (low >= self._first).all() and (high <= last).all():
                return
            # A quarter more where it grows, so that a stream of scans is not copied each time.
            slack = np.array([cols, rows]) / 4.0
            with_slack = (
                np.where(low < self._first, low - slack, self._first),
                np.where(high > last, high + slack, last),
            )
            low, high = np.minimum(low, self._first), np.maximum(high, last)
            if np.prod(with_slack[1] - with_slack[0] + 1) <= self.max_cells:
                low, high = with_slack
        size = np.floor(high) - np.floor(low) + 1
        if not np.prod(size) <= self.max_cells:
            wide, tall = size * self.resolution
            raise InvalidInputError(
                f"building a map: {wide:.6g} m x {tall:.6g} m at {self.resolution:g} m are {size[1]:.0f} x "
                f"{size[0]:.0f} cells, and the limit is {self.max_cells}; use a coarser resolution or a longest_hit"
            )
        first = np.floor(low).astype(np.int64)
        shape = int(size[1]), int(size[0])
        log_odds, stamps = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
        if rows > 0:
            col, row = self._first - first
            log_odds[row : row + rows, col : col + cols] = self._log_odds
            stamps[row : row + rows, col : col + cols] = self._stamps
        self._first, self._log_odds, self._stamps = first, log_odds, stamps


class _Beams(NamedTuple):
    """Beams of scans as the kernel takes them; lengths in cells, from the map's zero."""

    starts: FloatArray
    fan: FloatArray
    lengths: FloatArray
    kinds: NDArray[np.uint8]


def _extent(beams: _Beams) -> tuple[FloatArray, FloatArray] | None:
    """Return lowest and highest (col, row) that the beams can touch, as whole floats; None if they touch none."""
    used = beams.kinds != kernels.SKIP
    if not used.any():
        return None
    x, y, c, s = (beams.starts[:, i, None] for i in range(4))
    start_x, start_y = x + c * beams.fan[0] - s * beams.fan[1], y + s * beams.fan[0] + c * beams.fan[1]
    end_x = start_x + beams.lengths * (c * beams.fan[2] - s * beams.fan[3])
    end_y = start_y + beams.lengths * (s * beams.fan[2] + c * beams.fan[3])
    # One cell more on each side, for end points on a border.
    low = np.array([min(a[used].min(), b[used].min()) for a, b in ((start_x, end_x), (start_y, end_y))])
    high = np.array([max(a[used].max(), b[used].max()) for a, b in ((start_x, end_x), (start_y, end_y))])
    return np.floor(low) - 1.0, np.floor(high) + 1.0


def _poses_of(log: SensorLog, poses: ArrayLike | None) -> FloatArray:
    track = log.poses if poses is None else np.asarray(poses, dtype=np.float64)
    if track.shape != (len(log), 3):
        raise InvalidInputError(f"poses: expected shape ({len(log)}, 3), one per scan, got {track.shape}")
    return track


def _dilated(mask: NDArray[np.bool_], radius: int) -> NDArray[np.bool_]:
    """Return the mask grown by a square of `radius` cells to each side."""
    grown = mask.copy()
    for axis in (0, 1):
        source = grown.copy()
        for shift in range(1, radius + 1):
            ahead, behind = [slice(None)] * 2, [slice(None)] * 2
            ahead[axis], behind[axis] = slice(shift, None), slice(None, -shift)
            grown[tuple(ahead)] |= source[tuple(behind)]
            grown[tuple(behind)] |= source[tuple(ahead)]
    return grown
