"""Where a drive may have begun: poses found by global search at several places, each followed through the whole log."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, chained, compose, invert, transform_points, wrap_angle
from beamfield.kernels import trajectory as kernels
from beamfield.kernels.trajectory import HitNoise, StepNoise, Walls
from beamfield.localization.drive import Drive
from beamfield.localization.global_search import GlobalSearch
from beamfield.localization.search_window import SearchWindow
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_scale import longest_in
from beamfield.maps.solids import DEEPEST_HIT, hollowed

# Places along the way from which the map is searched, and how far around each its scans make one local map, metres: a
# short way bears poor odometry, a long one shows enough where the sensor sees little.
PLACES, LOCAL_WAYS = 8, (1.5, 6.0)
LOCAL_POINTS = 150
# Cells and headings of the search, and the width of its field: maps and odometry need not be better.
SEARCH_CELL, SEARCH_SIGMA, SEARCH_STEP = 0.1, 0.2, np.radians(2.0)
# Hypotheses are followed once by each of these: where many small things stand, the wide one is drawn from one to the
# next; where the map is wrong by more, the narrow one loses the walls. Both are judged by the wide one.
FOLLOW_HITS = (HitNoise(0.1, 0.02, -0.2, 0.0), HitNoise(0.2, 0.02, -DEEPEST_HIT, 0.0))
# Meanwhile odometry errs by so much.
TRACK_STEPS = StepNoise(0.05**2, 0.03**2, 0.03**2, 0.1**2, 0.02**2, 1e-6)
# What is taken to be known about its systematic errors: of distances and turns, relative, radians turned per metre, and
# radians between where the robot heads and where it drives, as with a laser whose mount is wrong. Or none: who learns
# them from few walls is led astray more easily.
TRACK_SYSTEMATIC = ((0.0, 0.0, 0.0, 0.0), (0.15, 0.1, 0.05, 0.05))
# A scan is worth so many independent readings when hypotheses are compared.
INDEPENDENT = 6.0
# How uncertain a pose of the search is: metres, radians.
SEARCH_DEVIATION = (0.15, np.radians(2.0))
# So many of the cheapest are followed again, from either end of the log: what slid along a corridor at first may know
# at its end where it is.
FROM_ENDS = 4
# A pose that another hypothesis passes this near at its place is not followed again: metres, radians.
SAME = (0.05, np.radians(1.0))
# Nats that a jump from one hypothesis to another costs: a robot is seldom carried away.
SWITCH = 200.0
# Nats that a course costs if it begins elsewhere than at the start that is given.
ELSEWHERE = 2000.0
# A robot was carried, or its odometry failed, where the course differs from it by more; less is a slip.
CARRIED, CARRIED_TURN = 0.7, np.radians(30.0)
# Two hypotheses are apart where they differ by more than this, metres and radians; others count as one.
APART, APART_TURN = 1.0, np.radians(30.0)
# A start that is given is meant to be about right: metres, radians.
NEAR_START, NEAR_START_TURN = 2.0, np.radians(45.0)


@dataclass(frozen=True, eq=False)
class Followed:
    """A hypothesis followed through the log.

    Parameters
    ----------
    poses, costs
        (n, 3) and (n,): pose of and cost in nats at each scan held to the map.
    """

    poses: FloatArray
    costs: FloatArray


@dataclass(frozen=True, eq=False)
class Course:
    """A way through hypotheses: which one holds at each scan.

    Parameters
    ----------
    poses
        (n, 3) at each scan held to the map.
    cost
        Nats: the scans' costs and those of changing the hypothesis.
    costs
        (n,) of each scan, nats.
    jumps
        Indices i of scans held to the map where the robot would have been carried between i - 1 and i.
    which
        (n,) the hypothesis at each scan.
    """

    poses: FloatArray
    cost: float
    costs: FloatArray
    jumps: NDArray[np.int64]
    which: NDArray[np.int64]


def follow_hypotheses(drive: Drive, grid: OccupancyGrid, walls: Walls, start: FloatArray | None,
                      progress: Callable[[int, int], None]) -> list[list[list[Followed]]]:  # fmt: skip
    """Search the map at several places of the log, and follow what is found forwards and backwards.

    The start (3,) is where the first scan was taken, roughly; None if that is not known. For each of `TRACK_SYSTEMATIC`
    the hypotheses are those that each of `FOLLOW_HITS` follows.
    """
    search, begun = GlobalSearch(_coarse(hollowed(grid)), sigma=SEARCH_SIGMA, angle_step=SEARCH_STEP), []
    places = _places(drive)
    for done, place in enumerate(places):
        window, poses = SearchWindow.whole_map(search.grid), []
        if start is not None and done == 0:
            window = SearchWindow(start, 2.0 * NEAR_START, 2.0 * NEAR_START, 2.0 * NEAR_START_TURN)
            poses.append(start)
        for way in LOCAL_WAYS:
            points = _local_points(drive, place, way)
            # Longer readings are of no wall of this map, and a search among them takes memory without limit.
            points = points[np.hypot(*points.T) <= longest_in(grid)]
            if len(points):
                found = search.search(_as_grid(points), window, apart=(APART, APART_TURN))
                poses += [one.pose for one in (found.best, found.runner_up) if found.found and one is not None]
        begun += [(place, pose) for pose in poses]
        progress(done + 1, len(places))
    ways = [hits._replace(low=max(hits.low, -walls.deepest)) for hits in FOLLOW_HITS]
    return [
        [_follow_all(drive, walls, begun, hits, ways[-1], systematic) for hits in ways]
        for systematic in TRACK_SYSTEMATIC
    ]


def cheapest_course(drive: Drive, followed: list[Followed], start: FloatArray | None) -> Course:
    """Return the cheapest way through hypotheses, with jumps from one to another where that pays."""
    costs = np.array([one.costs for one in followed])
    n = costs.shape[1]
    total = costs[:, 0].copy()
    total[[not is_at(one.poses[0], start) for one in followed]] += ELSEWHERE
    came_from = np.empty((n, len(followed)), np.int64)
    for i in range(1, n):
        cheapest = int(np.argmin(total))
        stays = total <= total[cheapest] + SWITCH
        came_from[i] = np.where(stays, np.arange(len(followed)), cheapest)
        total = np.minimum(total, total[cheapest] + SWITCH) + costs[:, i]
    which = np.empty(n, np.int64)
    which[-1] = np.argmin(total)
    for i in range(n - 1, 0, -1):
        which[i - 1] = came_from[i, which[i]]
    return course_through(drive, followed, which, start)


def course_through(
    drive: Drive, followed: list[Followed], which: NDArray[np.int64], start: FloatArray | None
) -> Course:
    """Return the course on which these (n,) hypotheses hold."""
    scans = np.arange(len(which))
    poses = np.array([one.poses for one in followed])[which, scans]
    costs = np.array([one.costs for one in followed])[which, scans]
    expected = compose(poses[:-1], drive.steps_between_scans)
    changes = np.flatnonzero(np.diff(which)) + 1
    jumps = [i for i in changes if not _near(expected[i - 1], poses[i], CARRIED, CARRIED_TURN)]
    cost = float(costs.sum()) + SWITCH * len(changes) + (0.0 if is_at(poses[0], start) else ELSEWHERE)
    return Course(poses, cost, costs, np.array(jumps, dtype=np.int64), which)


def other_courses(followed: list[Followed], best: Course | None, start: FloatArray | None) -> list[Course]:
    """Return the hypotheses that are elsewhere most of the time, cheapest first, each as a course without jumps.

    Of a start that is given, only those that begin there.
    """
    others: list[Course] = []
    known = [] if best is None else [best]
    for cost, which in sorted((float(one.costs.sum()), which) for which, one in enumerate(followed)):
        one = followed[which]
        if is_at(one.poses[0], start) and all(
            _share_apart(one.poses, course.poses) > 0.5 for course in [*known, *others]
        ):
            others.append(Course(one.poses, cost, one.costs, np.empty(0, np.int64), np.full(len(one.costs), which)))
    return others


def is_at(pose: FloatArray, start: FloatArray | None) -> bool:
    """Return whether a log may have begun at a pose, by the start that is given if one is."""
    return start is None or _near(pose, start, NEAR_START, NEAR_START_TURN)


def _share_apart(a: FloatArray, b: FloatArray) -> float:
    far = np.hypot(*(a - b)[:, :2].T) > APART
    return float(np.mean(far | (np.abs(wrap_angle(a[:, 2] - b[:, 2])) > APART_TURN)))


def _near(a: FloatArray, b: FloatArray, distance: float, turn: float) -> bool:
    return bool(np.hypot(*(a - b)[:2]) <= distance and abs(float(wrap_angle(a[2] - b[2]))) <= turn)


def _follow_all(
    drive: Drive,
    walls: Walls,
    begun: list[tuple[int, FloatArray]],
    hits: HitNoise,
    judged: HitNoise,
    systematic: tuple[float, ...],
) -> list[Followed]:
    """Follow poses at places of the log, each hypothesis once."""
    followed: list[Followed] = []
    for place, pose in begun:
        if not any(_near(one.poses[place], pose, *SAME) for one in followed):
            followed.append(_follow(drive, walls, place, pose, hits, judged, systematic))
    for one in sorted(followed, key=lambda one: float(one.costs.sum()))[:FROM_ENDS]:
        ends = (0, len(one.poses) - 1)
        followed += [_follow(drive, walls, end, one.poses[end], hits, judged, systematic) for end in ends]
    return followed


def _follow(drive: Drive, walls: Walls, place: int, pose: FloatArray, hits: HitNoise, judged: HitNoise,
            systematic: tuple[float, ...]) -> Followed:  # fmt: skip
    n = len(drive.scans)
    poses, costs = np.empty((n, 3)), np.empty(n)
    steps = drive.steps_between_scans
    for direction in (-1, 1):
        poses[place] = pose
        x_y, heading = SEARCH_DEVIATION
        covariance = np.diag(np.square([x_y, x_y, heading, *systematic]))
        kernels.track(drive.points, drive.first, steps, walls, hits, judged, TRACK_STEPS, INDEPENDENT, place,
                      direction, poses, covariance, costs)  # fmt: skip
    return Followed(poses, costs)


def _places(drive: Drive) -> list[int]:
    """Return scans at equal parts of the way, the first included."""
    way = drive.way[drive.scans]
    n = max(1, min(PLACES, len(way)))
    wanted = np.linspace(way[0], way[-1], n)
    return [int(i) for i in np.unique(np.searchsorted(way, wanted).clip(max=len(way) - 1))]


def _local_points(drive: Drive, place: int, reach: float) -> FloatArray:
    """Return end points seen so many metres before and after a place, in the robot's frame there."""
    way = drive.way[drive.scans]
    near = np.flatnonzero(np.abs(way - way[place]) <= reach)
    path = chained(np.zeros(3), drive.steps)[drive.scans]
    path = compose(invert(path[place]), path[near])
    kept = [transform_points(pose, drive.points[drive.first[i] : drive.first[i + 1], :2])
            for pose, i in zip(path, near, strict=True)]  # fmt: skip
    points = np.concatenate(kept)
    # One point for each cell: walls seen often do not outvote others. The cells hit most often are walls; people and
    # random readings hit others.
    _, index, count = np.unique(
        np.floor(points / SEARCH_CELL).astype(np.int64), axis=0, return_index=True, return_counts=True
    )
    index = np.sort(index[np.argsort(-count, kind="stable")[: 2 * LOCAL_POINTS]])
    return points[index[np.linspace(0, len(index) - 1, min(len(index), LOCAL_POINTS)).astype(np.int64)]]


def _as_grid(points: FloatArray) -> OccupancyGrid:
    """Return points as a local map, which is what the search takes."""
    low = np.floor(points.min(axis=0) / SEARCH_CELL)
    cells = (np.floor(points / SEARCH_CELL) - low).astype(np.int64)
    cols, rows = (int(side) for side in cells.max(axis=0) + 1)
    probability = np.zeros((rows, cols), np.float32)
    probability[cells[:, 1], cells[:, 0]] = 1.0
    return OccupancyGrid(probability, SEARCH_CELL, np.array([*(low * SEARCH_CELL), 0.0]))


def _coarse(grid: OccupancyGrid) -> OccupancyGrid:
    """Return a map with cells of about SEARCH_CELL, occupied where any of its cells is."""
    factor = max(1, round(SEARCH_CELL / grid.resolution))
    rows, cols = (-(-n // factor) for n in grid.shape)
    padded = np.zeros((rows * factor, cols * factor), bool)
    padded[: grid.shape[0], : grid.shape[1]] = grid.occupied
    occupied = padded.reshape(rows, factor, cols, factor).any(axis=(1, 3))
    return OccupancyGrid(np.asarray(occupied, np.float32), factor * grid.resolution, grid.origin)
