"""Recall, precision and errors of features from scans of a simulated room, at several noise levels.

Run: python benchmarks/features.py [--picture PATH]

The room has straight walls, a box and three poles. A wall must be found when at least 12 neighbouring beams see 0.5 m
of it, a corner when such pieces of both its walls come within 0.1 m of it, a pole when 4 beams hit it and those beside
them reach 0.3 m farther, a local minimum where the perpendicular on a wall ends, with 16 degrees of it on both sides.
Errors are those of what must be found; precision forgives whatever else is there. With --picture, one scan of the room
is drawn with its features instead.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.features.corners import find_corners
from beamfield.features.feature import Feature
from beamfield.features.lines import find_lines
from beamfield.features.minima import find_local_minima
from beamfield.features.poles import find_poles
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import compose, invert, transform_points, wrap_angle
from beamfield.plot import draw_features, draw_scan
from beamfield.sensors import RangeFinder, Scan
from rooms import Room, l_shaped_room
from tables import print_table

NOISE_LEVELS = (0.002, 0.005, 0.01, 0.02, 0.03, 0.05)
N_SCANS = 200
FINDER = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 720, endpoint=False), 12.0, mount=(0.15, 0.0, 0.0))
# A find belongs to a truth within these differences of range (m) and bearing (rad), or within six deviations.
NEAR = np.array([0.15, 0.1])
# 95% of chi-square with two degrees of freedom: range and bearing.
CHI_SQUARE_95 = 5.991
KINDS = ("line", "corner", "pole", "local minimum")


def run(n_scans: int = N_SCANS, levels: tuple[float, ...] = NOISE_LEVELS) -> list[dict[str, Any]]:
    """Return one row per noise level and kind of feature."""
    room = l_shaped_room()
    rows = []
    for sigma in levels:
        rng = np.random.default_rng(6)
        tallies = {kind: Tally() for kind in KINDS}
        for _ in range(n_scans):
            pose = free_pose(room, rng)
            exact, hit = room.cast(pose, FINDER)
            scan = Scan(exact + rng.normal(0.0, sigma, len(exact)), FINDER)
            start = time.perf_counter()
            found = extract(scan, RangeNoise(sigma))
            seconds = time.perf_counter() - start
            truths = visible(room, pose, exact, hit)
            for kind, tally in tallies.items():
                tally.add(truths[kind], found[kind], seconds)
        rows += [{"sigma (m)": sigma, "feature": kind} | tally.row() for kind, tally in tallies.items()]
    return rows


def main() -> None:
    """Print the rows as a Markdown table, or draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--picture", type=Path)
    picture = parser.parse_args().picture
    if picture is not None:
        draw(picture)
        return
    print_table(run())


def draw(path: Path) -> None:
    """Draw the features of one scan over it."""
    import matplotlib

    from beamfield.report.drawing import legend, new_figure, style

    matplotlib.rcParams["svg.hashsalt"] = "beamfield"
    room, pose, noise = l_shaped_room(), np.array([2.6, 2.6, 0.3]), RangeNoise(0.01)
    exact, _ = room.cast(pose, FINDER)
    scan = Scan(exact + np.random.default_rng(3).normal(0.0, noise.sigma_range, len(exact)), FINDER)
    figure = new_figure(8.0, 5.6)
    ax = figure.subplots()
    draw_scan(scan, pose, ax, size=5.0)
    draw_features([feature for found in extract(scan, noise).values() for feature in found], pose, ax)
    ax.plot(*pose[:2], "k^", markersize=9, linestyle="none", label="robot")
    style(ax, title="A scan of 720 beams in a simulated room, noise 1 cm", x="x [m]", y="y [m]", grid="none")
    legend(ax, loc="upper right")
    figure.savefig(path, metadata={"Date": None})


class Tally:
    """Finds of one kind counted against the truth."""

    def __init__(self) -> None:
        self.there = self.recalled = self.found = self.right = 0
        self.errors: list[np.ndarray] = []
        self.squares: list[float] = []
        self.seconds: list[float] = []

    def add(self, truths: list[tuple[np.ndarray, bool]], found: list[Feature], seconds: float) -> None:
        """Match the finds of a scan; a truth is (range, bearing, signature) and whether it must be found."""
        self.seconds.append(seconds)
        self.there += sum(must for _, must in truths)
        self.found += len(found)
        recalled = set()
        for feature in found:
            errors = [difference(feature, truth) for truth, _ in truths]
            fitting = [i for i, error in enumerate(errors) if matches(feature, error)]
            if fitting:
                best = min(fitting, key=lambda i: float(np.abs(errors[i][:2] / NEAR).max()))
                recalled.add(best)
                self.right += 1
                if truths[best][1]:
                    self.errors.append(errors[best])
                    self.squares.append(
                        float(errors[best][:2] @ np.linalg.solve(feature.covariance[:2, :2], errors[best][:2]))
                    )
        self.recalled += sum(truths[i][1] for i in recalled)

    def row(self) -> dict[str, Any]:
        """Return the counts as shares, and robust sizes of the errors."""
        if not self.errors:
            return {}
        errors = np.abs(self.errors)
        typical = [
            1.4826 * np.median(column[np.isfinite(column)]) if np.isfinite(column).any() else np.nan
            for column in errors.T
        ]
        return {
            "there": self.there,
            "recall": f"{self.recalled / max(self.there, 1):.3f}",
            "precision": f"{self.right / max(self.found, 1):.3f}",
            "range error (mm)": f"{1e3 * typical[0]:.1f}",
            "bearing error (mrad)": f"{1e3 * typical[1]:.1f}",
            "signature error": "" if np.isnan(typical[2]) else f"{typical[2]:.4f}",
            "in 95% ellipse": f"{np.mean(np.array(self.squares) < CHI_SQUARE_95):.3f}",
            "ms per scan, all kinds": f"{1e3 * np.median(self.seconds):.0f}",
        }


def difference(feature: Feature, truth: np.ndarray) -> np.ndarray:
    """Return measurement minus truth, the bearing wrapped."""
    error = feature.measurement - truth
    error[1] = wrap_angle(error[1])
    return error


def matches(feature: Feature, error: np.ndarray) -> bool:
    """Return whether a find belongs to a truth."""
    return bool(np.all(np.abs(error[:2]) < np.minimum(NEAR, 6.0 * np.sqrt(np.diag(feature.covariance)[:2]) + 0.02)))


def extract(scan: Scan, noise: RangeNoise) -> dict[str, list[Feature]]:
    """Return all features of a scan by kind."""
    lines = find_lines(scan, noise)
    return {
        "line": list(lines),
        "corner": list(find_corners(lines)),
        "pole": list(find_poles(scan, noise)),
        "local minimum": list(find_local_minima(scan, noise)),
    }


def free_pose(room: Room, rng: np.random.Generator) -> np.ndarray:
    """Return a pose with 0.5 m around it, inside the room."""
    while True:
        pose = rng.uniform([0.5, 0.5, -np.pi], [7.5, 5.5, np.pi])
        inside = pose[0] < 4.5 or pose[1] < 3.5
        in_box = 5.3 < pose[0] < 7.3 and 0.5 < pose[1] < 2.5
        if inside and not in_box and room.cast(pose, FINDER)[0].min() > 0.5:
            return pose


def visible(room: Room, pose: np.ndarray, exact: np.ndarray, hit: np.ndarray) -> dict[str, list[Any]]:
    """Return what there is to see by kind: (range, bearing, signature) from the robot, and whether it must be found."""
    rays = compose(pose, FINDER.mounts)
    points = rays[:, :2] + exact[:, None] * np.column_stack([np.cos(rays[:, 2]), np.sin(rays[:, 2])])
    n_walls = len(room.walls)
    return {
        "line": [wall_truth(room, pose, points, hit, wall) for wall in range(n_walls) if np.any(hit == wall)],
        "corner": corner_truths(room, pose, points, hit),
        "pole": [pole_truth(room, pose, exact, hit, j) for j in range(len(room.poles)) if np.any(hit == n_walls + j)],
        "local minimum": minimum_truths(room, pose, rays, exact, hit),
    }


def polar(pose: np.ndarray, place: np.ndarray) -> tuple[float, float]:
    """Return range and bearing of a place in the map as the robot at a pose sees it."""
    x, y = transform_points(invert(pose), place)
    return float(np.hypot(x, y)), float(np.arctan2(y, x))


def runs(mask: np.ndarray) -> list[np.ndarray]:
    """Return the runs of neighbouring beams in a mask, around the turn."""
    if mask.all():
        return [np.arange(len(mask))]
    start = int(np.argmin(mask))
    order = np.roll(np.arange(len(mask)), -start)
    seen = np.flatnonzero(mask[order])
    return [order[run] for run in np.split(seen, np.flatnonzero(np.diff(seen) > 1) + 1)]


def foot(room: Room, wall: int, origin: np.ndarray) -> np.ndarray:
    """Return the point of a wall's line nearest to the origin."""
    start, along = room.walls[wall, :2], room.walls[wall, 2:] - room.walls[wall, :2]
    return start + along * ((origin - start) @ along) / (along @ along)


def wall_truth(room: Room, pose: np.ndarray, points: np.ndarray, hit: np.ndarray, wall: int) -> tuple[Any, bool]:
    """Return a wall; its length depends on what hides it and is not judged."""
    must = any(is_long(run, points) for run in runs(hit == wall))
    return np.array([*polar(pose, foot(room, wall, pose[:2])), np.nan]), must


def is_long(run: np.ndarray, points: np.ndarray) -> bool:
    """Return whether so much of a wall is seen that it must be found."""
    return len(run) >= 12 and bool(np.hypot(*(points[run[-1]] - points[run[0]])) > 0.5)


def corner_truths(room: Room, pose: np.ndarray, points: np.ndarray, hit: np.ndarray) -> list[tuple[Any, bool]]:
    """Return the corners; one must be found if a long piece of each of its walls reaches it."""
    truths = []
    for one in range(len(room.walls)):
        for two in np.flatnonzero(np.all(room.walls[:, :2] == room.walls[one, 2:], axis=1)):
            place = room.walls[one, 2:]
            near = np.hypot(*(points - place).T) < 0.1
            must = all(
                any(is_long(run, points) and near[run].any() for run in runs(hit == wall)) for wall in (one, two)
            )
            truths.append((np.array([*polar(pose, place), opening(room, one, int(two), pose)]), must))
    return truths


def opening(room: Room, one: int, two: int, pose: np.ndarray) -> float:
    """Return the angle between two walls on the robot's side."""
    first, second = room.walls[one], room.walls[two]
    turn = float(
        wrap_angle(
            np.arctan2(second[3] - second[1], second[2] - second[0])
            - np.arctan2(first[3] - first[1], first[2] - first[0])
        )
    )
    along, to_robot = first[2:] - first[:2], pose[:2] - first[:2]
    on_left = along[0] * to_robot[1] - along[1] * to_robot[0] > 0
    return np.pi - turn if on_left else np.pi + turn


def pole_truth(room: Room, pose: np.ndarray, exact: np.ndarray, hit: np.ndarray, pole: int) -> tuple[Any, bool]:
    """Return a pole with its diameter."""
    [run, *others] = runs(hit == len(room.walls) + pole)
    before, after = (run[0] - 1) % len(exact), (run[-1] + 1) % len(exact)
    free = exact[before] > exact[run[0]] + 0.3 and exact[after] > exact[run[-1]] + 0.3
    x, y, radius = room.poles[pole]
    return np.array([*polar(pose, np.array([x, y])), 2 * radius]), bool(free and len(run) >= 4 and not others)


def minimum_truths(
    room: Room, pose: np.ndarray, rays: np.ndarray, exact: np.ndarray, hit: np.ndarray
) -> list[tuple[Any, bool]]:
    """Return the perpendiculars on walls, which must be found, and what else is nearer than its surroundings."""
    truths = []
    sensor = rays[0, :2]
    for wall in range(len(room.walls)):
        place = foot(room, wall, sensor)
        bearing = np.arctan2(*(place - sensor)[::-1])
        near = np.abs(wrap_angle(rays[:, 2] - bearing)) < np.deg2rad(16)
        must = bool(np.all(hit[near] == wall))
        if must:
            truths.append((np.array([*polar(pose, place), np.hypot(*(place - sensor))]), True))
    points = rays[:, :2] + exact[:, None] * np.column_stack([np.cos(rays[:, 2]), np.sin(rays[:, 2])])
    for truth, _ in truths:
        # A perpendicular is the least reading there: one truth, not two.
        place = transform_points(pose, truth[0] * np.array([np.cos(truth[1]), np.sin(truth[1])]))
        exact = np.where(np.hypot(*(points - place).T) < 0.1, np.nan, exact)
    least = (exact <= np.roll(exact, 1)) & (exact <= np.roll(exact, -1))
    truths += [(np.array([*polar(pose, place), np.nan]), False) for place in points[least]]
    return truths


if __name__ == "__main__":
    main()
