"""Occupancy mapping, map correlation and global search, cell by cell and pose by pose: slow, plain and independent."""

from __future__ import annotations

import math

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid


def crossed_cells(start: tuple[float, float], end: tuple[float, float]) -> set[tuple[int, int]]:
    """Return (row, col) of the cells whose inside a segment crosses, by clipping it to each cell; unit cells."""
    (x0, y0), (x1, y1) = start, end
    cells = set()
    for row in range(math.floor(min(y0, y1)), math.floor(max(y0, y1)) + 1):
        for col in range(math.floor(min(x0, x1)), math.floor(max(x0, x1)) + 1):
            enter, leave = 0.0, 1.0
            for a, b, low in ((x0, x1, col), (y0, y1, row)):
                if a == b:
                    enter, leave = (enter, leave) if low <= a < low + 1 else (1.0, 0.0)
                else:
                    first, last = sorted(((low - a) / (b - a), (low + 1 - a) / (b - a)))
                    enter, leave = max(enter, first), min(leave, last)
            if leave - enter > 1e-9:
                cells.add((row, col))
    return cells


def log_odds_map(scans, poses, bearings, max_range, resolution, hit, passed, low, high):
    """Return {(row, col): log-odds} of scans (t, k) from a sensor in the robot's centre; cells from the map's zero."""
    odds: dict[tuple[int, int], float] = {}
    for ranges, (x, y, theta) in zip(scans, poses, strict=True):
        hits, passes = set(), set()
        for z, bearing in zip(ranges, bearings, strict=True):
            if not z < max_range:
                continue
            a = theta + bearing
            end = ((x + z * math.cos(a)) / resolution, (y + z * math.sin(a)) / resolution)
            last = (math.floor(end[1]), math.floor(end[0]))
            hits.add(last)
            passes |= crossed_cells((x / resolution, y / resolution), end) - {last}
        for cells, p in ((hits, hit), (passes - hits, passed)):
            for cell in cells:
                value = odds.get(cell, 0.0) + math.log(p / (1.0 - p))
                odds[cell] = min(max(value, math.log(low / (1.0 - low))), math.log(high / (1.0 - high)))
    return odds


def pairs_by_local_cells(grid: OccupancyGrid, local: OccupancyGrid, pose) -> list[tuple[float, float]]:
    """Return (map, local) values of the cells defined in both: each local cell and the map cell its centre falls in."""
    x, y, theta = pose
    pairs = []
    for row, col in np.argwhere(~np.isnan(local.probability)):
        px, py = local.to_map([col + 0.5, row + 0.5])
        wx = x + math.cos(theta) * px - math.sin(theta) * py
        wy = y + math.sin(theta) * px + math.cos(theta) * py
        c, r = np.floor(grid.to_cells([wx, wy]) + 1e-9).astype(int)
        if 0 <= r < grid.shape[0] and 0 <= c < grid.shape[1] and not np.isnan(grid.probability[r, c]):
            pairs.append((float(grid.probability[r, c]), float(local.probability[row, col])))
    return pairs


def pairs_by_map_cells(grid: OccupancyGrid, local: OccupancyGrid, pose) -> list[tuple[float, float]]:
    """Return them as the chapter's m_x,y,local(x_t) reads: each map cell and the local cell its centre falls in."""
    x, y, theta = pose
    pairs = []
    for row, col in np.argwhere(~np.isnan(grid.probability)):
        wx, wy = grid.to_map([col + 0.5, row + 0.5])
        px = math.cos(theta) * (wx - x) + math.sin(theta) * (wy - y)
        py = -math.sin(theta) * (wx - x) + math.cos(theta) * (wy - y)
        c, r = np.floor(local.to_cells([px, py])).astype(int)
        if 0 <= r < local.shape[0] and 0 <= c < local.shape[1] and not np.isnan(local.probability[r, c]):
            pairs.append((float(grid.probability[row, col]), float(local.probability[r, c])))
    return pairs


def correlation(pairs: list[tuple[float, float]]) -> float:
    """Return (6.35) with the mean of (6.36) over both maps."""
    m, local = np.array(pairs).T
    mean = (m + local).sum() / (2 * len(pairs))
    return float(((m - mean) * (local - mean)).sum() / math.sqrt(((m - mean) ** 2).sum() * ((local - mean) ** 2).sum()))


def every_pose(field: np.ndarray, grid: OccupancyGrid, points: np.ndarray, xs, ys, headings) -> np.ndarray:
    """Return (headings, ys, xs) sums of an integer field in the cells of the points, for a grid without yaw."""
    total = np.zeros((len(headings), len(ys), len(xs)), np.int64)
    for k, heading in enumerate(headings):
        c, s = math.cos(heading), math.sin(heading)
        for px, py in points:
            col = np.floor((xs + c * px - s * py - grid.origin[0]) / grid.resolution + 1e-9).astype(int)
            row = np.floor((ys + s * px + c * py - grid.origin[1]) / grid.resolution + 1e-9).astype(int)
            inside = ((row >= 0) & (row < field.shape[0]))[:, None] & ((col >= 0) & (col < field.shape[1]))
            value = field[np.clip(row, 0, field.shape[0] - 1)[:, None], np.clip(col, 0, field.shape[1] - 1)]
            total[k] += np.where(inside, value, 0)
    return total
