"""Corridors and rooms with exactly known truth, and pairs of scans in them that are as disturbed as real ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamfield.geometry import compose
from beamfield.sensors import RangeFinder, Scan

FINDERS = (
    RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.5)), 30.0),
    RangeFinder.from_bearings(np.radians(np.arange(0.0, 360.0)), 12.0),
    RangeFinder.from_bearings(np.radians(np.arange(-135.0, 135.0, 0.5)), 30.0),
)
# Share of short, random and lost readings, and people per scan.
Z_SHORT, Z_RAND, Z_MAX, PEOPLE = 0.05, 0.03, 0.01, 1.0
START_NOISE = np.array([0.1, 0.1, np.radians(4.0)])


@dataclass(frozen=True, eq=False)
class Conditions:
    """What pairs have in common: sensors and noise (drawn for each if None), outliers, people and how far they turn."""

    onto: RangeFinder | None = None
    scan: RangeFinder | None = None
    sigma: float | None = None
    outliers: float = 1.0
    people: float = PEOPLE
    turn: float = 0.15


USUAL = Conditions()


@dataclass(frozen=True, eq=False)
class ScanPair:
    """Two scans, the second's pose seen from the first and where to start."""

    onto: Scan
    scan: Scan
    truth: np.ndarray
    start: np.ndarray


def corridor_pairs(n: int, seed: int, conditions: Conditions = USUAL) -> list[ScanPair]:
    """Return pairs in corridors 1.6 to 3 m wide and 12 to 100 m long, a third of them without a door."""
    rng = np.random.default_rng(seed)
    pairs: list[ScanPair] = []
    while len(pairs) < n:
        walls = corridor(rng)
        along = rng.normal() * 0.15 + np.pi * rng.integers(2) if rng.random() < 0.8 else rng.uniform(-np.pi, np.pi)
        pairs += _pair(walls, np.array([0.0, rng.uniform(-0.4, 0.4), along]), rng, conditions)
    return pairs


def room_pairs(n: int, seed: int, conditions: Conditions = USUAL) -> list[ScanPair]:
    """Return pairs in rooms 3 to 9 m long and wide with boxes and legs."""
    rng = np.random.default_rng(seed)
    pairs: list[ScanPair] = []
    while len(pairs) < n:
        walls = room(rng)
        pairs += _pair(walls, np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(-np.pi, np.pi)]), rng, conditions)
    return pairs


def corridor(rng: np.random.Generator) -> np.ndarray:
    """Return walls (m, 4) along x: x1, y1, x2, y2 in metres."""
    half = rng.uniform(0.8, 1.5)
    left, right = rng.uniform(6.0, 50.0, 2)
    doors_per_metre = rng.choice([0.0, 0.1, 0.3])
    walls = [(-left, -half, -left, half), (right, -half, right, half)]
    for side in (1.0, -1.0):
        walls += _side_wall(-left, right, side * half, doors_per_metre, rng)
    for _ in range(rng.poisson(0.7)):
        x, side = rng.uniform(-6.0, 6.0), rng.choice([-1.0, 1.0])
        walls += _box(x, side * (half - 0.2), rng.uniform(0.3, 0.8), 0.4)
    return np.array(walls)


def room(rng: np.random.Generator) -> np.ndarray:
    """Return walls (m, 4) around the origin."""
    width, height = rng.uniform(3.0, 9.0, 2)
    walls = _box(0.0, 0.0, width, height)
    for _ in range(rng.integers(2, 9)):
        x, y = rng.uniform(-0.5, 0.5, 2) * (width, height)
        if np.hypot(x, y) < 1.6:
            continue
        turn = rng.uniform(0.0, 3.0)
        if rng.random() < 0.4:
            walls += _box(x, y, 0.05, 0.05, turn)
        else:
            walls += _box(x, y, *rng.uniform(0.3, 1.5, 2), turn if rng.random() < 0.5 else 0.0)
    return np.array(walls)


def _side_wall(x: float, end: float, y: float, doors_per_metre: float, rng: np.random.Generator) -> list[tuple]:
    """Return a wall along x with doors set back by 4 cm to 1.5 m."""
    walls = []
    while doors_per_metre > 0.0:
        door, width = x + rng.exponential(1.0 / doors_per_metre), rng.uniform(0.8, 1.2)
        if door + width >= end:
            break
        back = y + np.sign(y) * rng.choice([0.04, 0.08, 0.15, 0.3, 1.5])
        after = door + width
        walls += [(x, y, door, y), (door, y, door, back), (door, back, after, back), (after, back, after, y)]
        x = after
    return [*walls, (x, y, end, y)]


def _box(x: float, y: float, width: float, height: float, turn: float = 0.0) -> list[tuple]:
    """Return the four sides of a box around (x, y)."""
    corners = np.array([(-width, -height), (width, -height), (width, height), (-width, height)]) / 2.0
    cos, sin = np.cos(turn), np.sin(turn)
    corners = corners @ np.array([(cos, sin), (-sin, cos)]) + (x, y)
    return [(*corners[i], *corners[(i + 1) % 4]) for i in range(4)]


def _pair(walls: np.ndarray, first: np.ndarray, rng: np.random.Generator, conditions: Conditions) -> list[ScanPair]:
    """Return a pair of disturbed scans, or none if the robot would touch a wall."""
    drawn = FINDERS[rng.integers(len(FINDERS))]
    finders = (conditions.onto or drawn, conditions.scan or drawn)
    motion = np.array([rng.uniform(0.0, 0.6), 0.05 * rng.normal(), conditions.turn * rng.normal()])
    poses = (first, compose(first, motion))
    exact = [cast(walls, pose, finder) for pose, finder in zip(poses, finders, strict=True)]
    if min(ranges.min() for ranges in exact) < 0.15:
        return []
    sigma = rng.choice([0.01, 0.02, 0.03])
    sigma = sigma if conditions.sigma is None else conditions.sigma
    onto, scan = (
        Scan(_disturb(ranges, finder, sigma, rng, conditions), finder)
        for ranges, finder in zip(exact, finders, strict=True)
    )
    return [ScanPair(onto, scan, motion, motion + START_NOISE * rng.normal(size=3))]


def cast(walls: np.ndarray, pose: np.ndarray, finder: RangeFinder) -> np.ndarray:
    """Return the exact ranges (k,) from a pose to the walls; inf where there is none."""
    mounts = compose(pose, finder.mounts)
    cos, sin = np.cos(mounts[:, 2])[:, None], np.sin(mounts[:, 2])[:, None]
    ax, ay = walls[:, 0] - mounts[:, :1], walls[:, 1] - mounts[:, 1:2]
    dx, dy = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = cos * dy - sin * dx
        distance = (ax * dy - ay * dx) / cross
        along = (ax * sin - ay * cos) / cross
    return np.where((distance > 0) & (along >= 0) & (along <= 1), distance, np.inf).min(axis=1)


def _disturb(exact: np.ndarray, finder: RangeFinder, sigma: float, rng: np.random.Generator,
             conditions: Conditions) -> np.ndarray:  # fmt: skip
    """Return readings: normal noise, short, random and lost ones, and people who stand before the walls."""
    n, max_range = len(exact), finder.max_range
    nearest = np.minimum(exact, max_range)
    ranges = exact + sigma * rng.normal(size=n)
    kind = rng.random(n)
    ranges = np.where(kind < conditions.outliers * Z_SHORT, rng.random(n) ** 2 * nearest, ranges)
    ranges = np.where((kind >= 0.5) & (kind < 0.5 + conditions.outliers * Z_RAND), rng.random(n) * max_range, ranges)
    ranges = np.where(kind >= 1.0 - conditions.outliers * Z_MAX, np.inf, ranges)
    for _ in range(rng.poisson(conditions.people)):
        bearing, distance = finder.bearings[rng.integers(n)], rng.uniform(0.7, 5.0)
        beside = np.abs(np.angle(np.exp(1j * (finder.bearings - bearing))))
        hidden = (beside < np.arctan(0.2 / distance)) & (ranges > distance)
        ranges[hidden] = distance + 0.03 * rng.normal(size=hidden.sum())
    return np.where(ranges < max_range, np.maximum(ranges, 0.05), np.inf)
