"""Drives of a robot with differential drive through the free space of a map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from beamfield.arguments import check_fields, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, compose, wrap_angle
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Track

# Distance between points of a smoothed path, metres.
STEP = 0.05
# Paths are planned on cells of about this size, metres: finer ones cost time and change nothing after smoothing.
PLANNING_CELL = 0.1
# Places to visit are at least this far apart, count as seen from this near, and leave no gap wider; metres.
PLACE_SPACING = 2.5
PLACE_SEEN = 1.6
LARGEST_GAP = 4.0
# Closer goals than this are no better, or the robot would dither in open halls; metres.
NEAR = 6.0
# The robot drives on through a place if the next leg turns by less than this (radians), seen over so many planning
# cells before and behind it, unless the stretch has so many cells already.
JOIN_TURN = 1.75
JOIN_POINTS = 8
JOIN_LIMIT = 400
# Distance to obstacles that the robot seeks where there is room, metres.
COMFORT = 0.7
# Its fastest turn, rad/s, how quickly its speed changes, m/s^2, and how long it stands at each place, seconds.
TURN_RATE, ACCELERATION, PAUSE = 1.0, 0.6, 0.4


@dataclass(frozen=True)
class DriveOptions:
    """How the robot drives: its radius, which it keeps from cells that are not free, metres, and its top speed, m/s."""

    robot_radius: float = 0.25
    speed: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("robot_radius", "speed"):
            require(0.0 < getattr(self, name) < np.inf, name, "a positive number", getattr(self, name))


def drive_through(
    grid: OccupancyGrid, stamps: NDArray[np.float64], *, seed: int = 0, options: DriveOptions | None = None
) -> Track:
    """Drive from place to place through the largest free region of a map.

    The robot starts at the most open place and goes on to near places that it has not seen yet, so that a longer drive
    sees more of the map. Where the next path leads back, it stops and turns on the spot. Paths are shortest on a graph
    of cells where closeness to obstacles costs, then smoothed without coming closer than allowed. Unknown cells count
    as obstacles.

    The poses, heading along the path, are those at the stamps (t,), which increase. InvalidInputError if they do not,
    or the map has no room for a drive of this robot.
    """
    options = options or DriveOptions()
    times = np.array(stamps, dtype=np.float64)
    if times.ndim != 1 or len(times) == 0 or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise InvalidInputError(f"stamps: expected increasing finite seconds, shape (t,), got shape {times.shape}")
    at = times - times[0]
    clock, drive = np.zeros(1), np.zeros((0, 3))
    space = _FreeSpace(grid, options.robot_radius)
    for durations, poses in _motions(space, np.random.default_rng(seed), options.speed):
        clock = np.concatenate([clock, clock[-1] + durations])
        drive = np.concatenate([drive, poses])
        if clock[-1] >= at[-1]:
            break
    in_grid = np.column_stack([np.interp(at, clock[1:], drive[:, i]) for i in range(3)])
    return Track(times, compose(grid.origin, in_grid))


def clearance_map(grid: OccupancyGrid) -> FloatArray:
    """Return a lower bound (rows, cols) of the distance from each free cell's centre to what is not free, metres.

    What lies beyond the map's border is not free; cells that are not free are negative.
    """
    inside = ndimage.distance_transform_edt(np.pad(grid.free, 1))[1:-1, 1:-1]
    # From centre to centre; the obstacle reaches up to half a diagonal closer.
    return np.asarray((inside - np.sqrt(0.5)) * grid.resolution)


class _FreeSpace:
    """Where the robot fits, which places are worth a visit, and paths between them; metres in the grid's frame."""

    def __init__(self, grid: OccupancyGrid, robot_radius: float) -> None:
        self.resolution = grid.resolution
        self.clearance = clearance_map(grid)
        # Between two points of a path the clearance falls by half a step at most, and again when it is resampled.
        self.needed = robot_radius + STEP + 0.01
        # First: blocks of cells that are far too small would not fit into memory.
        if self.clearance.max() < self.needed:
            self._refuse(robot_radius)
        factor = max(1, round(PLANNING_CELL / grid.resolution))
        self.cell = factor * grid.resolution
        coarse = _block_minimum(self.clearance, factor)
        room = coarse >= self.needed + np.sqrt(0.5) * self.cell
        labels, n_regions = ndimage.label(room, structure=np.ones((3, 3)))
        if n_regions == 0:
            self._refuse(robot_radius)
        self.region = labels == 1 + np.argmax(np.bincount(labels.ravel())[1:])
        self.cells = np.argwhere(self.region)
        self.graph = _planning_graph(self.region, coarse, self.cell, COMFORT)
        self.places = self._open_places(np.where(self.region, coarse, 0.0))
        if len(self.places) < 2:
            raise InvalidInputError(
                "map: the largest region that the robot fits in is too small to drive through: "
                f"{len(self.cells) * self.cell**2:.1f} m^2"
            )

    def _refuse(self, robot_radius: float) -> NoReturn:
        raise InvalidInputError(
            f"map: no free place for a robot of radius {robot_radius:g} m; "
            f"the largest clearance is {self.clearance.max():.2f} m"
        )

    def centres(self, nodes: NDArray[np.int64]) -> FloatArray:
        """Return (x, y) of nodes of the graph."""
        return np.asarray((self.cells[nodes][:, ::-1] + 0.5) * self.cell)

    def clearance_at(self, points: FloatArray) -> FloatArray:
        """Return the clearance at points (n, 2), between cell centres bilinearly."""
        col_row = points / self.resolution - 0.5
        return np.asarray(ndimage.map_coordinates(self.clearance, col_row[:, ::-1].T, order=1, mode="nearest"))

    def _open_places(self, clearance: FloatArray) -> NDArray[np.int64]:
        """Nodes where clearance has a local maximum, the most open first, and more where these leave gaps."""
        size = max(3, round(PLACE_SPACING / self.cell) | 1)
        peaks = self.region & (clearance == ndimage.maximum_filter(clearance, size=size))
        nodes = np.flatnonzero(peaks[self.region])
        nodes = nodes[np.argsort(-clearance[self.region][nodes], kind="stable")]
        centres = self.centres(nodes)
        kept: list[int] = []
        for i in range(len(nodes)):
            if not kept or np.hypot(*(centres[kept] - centres[i]).T).min() >= PLACE_SPACING:
                kept.append(i)
        places = [int(node) for node in nodes[kept]]
        everywhere = self.centres(np.arange(len(self.cells)))
        gap = np.full(len(everywhere), np.inf)
        for place in places:  # which grows where gaps are left
            gap = np.minimum(gap, np.hypot(*(everywhere - everywhere[place]).T))
            if place == places[-1] and gap.max() > LARGEST_GAP:
                places.append(int(np.argmax(gap)))
        return np.array(places)


def _block_minimum(values: FloatArray, factor: int) -> FloatArray:
    """Return the smallest value of each block of factor x factor cells; -inf beyond the border."""
    rows, cols = (-(-n // factor) for n in values.shape)
    padded = np.full((rows * factor, cols * factor), -np.inf)
    padded[: values.shape[0], : values.shape[1]] = values
    return np.asarray(padded.reshape(rows, factor, cols, factor).min(axis=(1, 3)))


def _planning_graph(region: NDArray[np.bool_], clearance: FloatArray, cell: float, comfort: float) -> sparse.csr_array:
    """Return the graph of eight neighbours; an edge costs its length, and more where obstacles are too close."""
    # SciPy before 1.13 finds no paths in graphs with longer indices.
    node = np.full(region.shape, -1, dtype=np.int32)
    node[region] = np.arange(np.count_nonzero(region))
    lack = np.clip(1.0 - clearance / comfort, 0.0, 1.0) if comfort > 0.0 else np.zeros(region.shape)
    price = 1.0 + 8.0 * lack**2
    rows, cols = region.shape
    starts, ends, costs = [], [], []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = (slice(0, rows - dr), slice(max(0, -dc), cols - max(0, dc)))
        b = (slice(dr, rows), slice(max(0, dc), cols - max(0, -dc)))
        both = region[a] & region[b]
        starts.append(node[a][both])
        ends.append(node[b][both])
        costs.append(cell * np.hypot(dr, dc) * 0.5 * (price[a][both] + price[b][both]))
    shape = (int(region.sum()),) * 2
    edges = (np.concatenate(starts), np.concatenate(ends))
    return sparse.csr_array(sparse.coo_array((np.concatenate(costs), edges), shape=shape))


def _motions(space: _FreeSpace, rng: np.random.Generator, speed: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield pieces of an endless drive: seconds since the piece began (m,) and poses (m, 3), headings unwrapped."""
    last: FloatArray | None = None
    for stretch in _stretches(_legs(space, rng)):
        path = _smooth(stretch, space)
        heading = _headings(path)
        if last is not None:
            heading += last[2] + wrap_angle(heading[0] - last[2]) - heading[0]
            yield _turn_in_place(last, float(heading[0]))
        poses = np.column_stack([path, heading])
        yield _travel_times(poses, speed), poses
        last = poses[-1]


def _stretches(legs: Iterator[FloatArray]) -> Iterator[FloatArray]:
    """Join legs that go on in about the same direction, so that the robot does not stop between them."""
    stretch = next(legs)
    for leg in legs:
        arriving = stretch[-1] - stretch[-min(len(stretch), JOIN_POINTS)]
        leaving = leg[min(len(leg), JOIN_POINTS) - 1] - leg[0]
        turn = wrap_angle(np.arctan2(leaving[1], leaving[0]) - np.arctan2(arriving[1], arriving[0]))
        if abs(turn) <= JOIN_TURN and len(stretch) < JOIN_LIMIT:
            stretch = np.concatenate([stretch, leg[1:]])
        else:
            yield stretch
            stretch = leg


def _legs(space: _FreeSpace, rng: np.random.Generator) -> Iterator[FloatArray]:
    """Yield paths (n, 2) from place to place without end; near places not seen yet are likely next."""
    here = int(space.places[0])
    where = space.centres(space.places)
    seen = np.zeros(len(where), dtype=bool)
    seen[0] = True
    while True:
        cost, before = csgraph.dijkstra(space.graph, directed=False, indices=here, return_predecessors=True)
        if seen.all():
            seen = space.places == here
        distance = np.maximum(cost[space.places], NEAR) * np.exp(rng.normal(0.0, 0.8, len(where)))
        goal = int(space.places[np.argmin(np.where(seen, np.inf, distance))])
        nodes = [goal]
        while nodes[-1] != here:
            nodes.append(int(before[nodes[-1]]))
        path = space.centres(np.array(nodes[::-1]))
        for place in np.flatnonzero(~seen):
            seen[place] = np.hypot(*(path - where[place]).T).min() <= PLACE_SEEN
        here = goal
        yield path


def _smooth(path: FloatArray, space: _FreeSpace) -> FloatArray:
    """Return the path as a smooth line with points every STEP metres, nowhere closer to obstacles than allowed.

    Every point moves towards the middle of its neighbours unless that brings it too close; a wider berth is kept first
    and given up only for the last touch.
    """
    for berth, rounds in ((0.2, 3), (0.1, 2), (0.0, 1)):
        for _ in range(rounds):
            path = _resample(path)
            clearance = space.clearance_at(path)
            for _ in range(120):
                moved = path.copy()
                moved[1:-1] = 0.5 * path[1:-1] + 0.25 * (path[:-2] + path[2:])
                reached = space.clearance_at(moved)
                good = reached >= np.minimum(clearance, space.needed + berth)
                path = np.where(good[:, None], moved, path)
                clearance = np.where(good, reached, clearance)
    return _resample(path)


def _resample(path: FloatArray) -> FloatArray:
    """Return points of the same line with equal distances of about STEP; at least three."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    wanted = np.linspace(0.0, along[-1], max(3, 1 + round(along[-1] / STEP)))
    return np.column_stack([np.interp(wanted, along, path[:, i]) for i in range(2)])


def _headings(path: FloatArray) -> FloatArray:
    """Return the direction of the path at each point, without jumps of a full turn."""
    along = np.gradient(path, axis=0)
    return np.asarray(np.unwrap(np.arctan2(along[:, 1], along[:, 0])))


def _turn_in_place(last: FloatArray, heading: float) -> tuple[FloatArray, FloatArray]:
    """Pause, then turn with a rate that rises and falls smoothly."""
    turn = heading - last[2]
    # 3 u^2 - 2 u^3 is steepest in the middle, with slope 3/2.
    duration = 1.5 * abs(turn) / TURN_RATE
    u = np.linspace(0.0, 1.0, 2 + int(duration / 0.05))
    poses = np.repeat(last[None], len(u), axis=0)
    poses[:, 2] += turn * u**2 * (3.0 - 2.0 * u)
    return PAUSE + duration * u, poses


def _travel_times(poses: FloatArray, fastest: float) -> FloatArray:
    """Return when each pose of a leg is reached: from rest to rest, within the limits of speed, acceleration, turn."""
    step = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    turn = np.abs(np.diff(poses[:, 2]))
    between_points = np.minimum(fastest, TURN_RATE * step / np.maximum(turn, 1e-9))
    speed = np.zeros(len(poses))
    speed[1:-1] = np.minimum(between_points[:-1], between_points[1:])
    gain = 2.0 * ACCELERATION * step
    for i in range(1, len(speed)):
        speed[i] = min(speed[i], np.sqrt(speed[i - 1] ** 2 + gain[i - 1]))
    for i in range(len(speed) - 2, -1, -1):
        speed[i] = min(speed[i], np.sqrt(speed[i + 1] ** 2 + gain[i]))
    duration = np.maximum(2.0 * step / (speed[:-1] + speed[1:]), turn / TURN_RATE)
    return np.concatenate([[0.0], np.cumsum(duration)])
