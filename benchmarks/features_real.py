"""Features of real logs: how many are found again in the next scan, and whether their covariances are honest.

Run: python benchmarks/features_real.py [FOLDER WITH DATA] [--out DIR]

Consecutive scans are aligned by their likelihood fields (not by features), starting from the log's own poses. Every
feature of the one scan is moved by the relative pose. It counts if the next scan looks at where it was seen (nine of
ten of its end points, for a wall half of them: inside the view, and not behind what that scan measured). It is found
again if the next scan has a feature of its kind within fixed gates, whatever the covariances say.

"In 95%" is the share of those found whose difference lies in the ellipse of both covariances, first as if the
relative pose were exact, then with its covariance. The second table needs no alignment: the relative pose is the one
that fits all the pair's walls best, so that chi-square per degree of freedom is 1 where covariances are honest. Its
last two columns tell whose covariances are too small: each wall is predicted by the pose that fits the *other* walls
best (three or more), with that pose's covariance, and by the alignment, with its own.

With --out, the features of some scans are drawn over them, one SVG per log, for looking at.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.features.corners import find_corners
from beamfield.features.feature import Feature, polar_jacobian
from beamfield.features.lines import find_lines
from beamfield.features.minima import find_local_minima
from beamfield.features.poles import find_poles
from beamfield.features.straight_line import Line
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import between, invert, transform_points, wrap_angle
from beamfield.io.read_log import read_log
from beamfield.localization.alignment import align
from beamfield.maps.end_points import end_points
from beamfield.plot import draw_features, draw_scan
from beamfield.sensors import Scan, SensorLog, usable_ranges

if __package__:
    from benchmarks.tables import print_table
else:
    from tables import print_table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
# By third differences of neighbouring readings: 5 mm near by, and 4 mm more per metre in all three logs. The rest is
# for walls that are not quite flat.
NOISE = RangeNoise(sigma_range=0.01, sigma_slope=0.004)
# What the rows count: a kind of feature, and for lines the least length of the first one (metres).
KINDS = {
    "line": ("line", 0.0),
    "line of 1 m or more": ("line", 1.0),
    "corner": ("corner", 0.0),
    "local minimum": ("local minimum", 0.0),
    "pole": ("pole", 0.0),
}
# Found again within these: (rho in m, alpha in rad) of walls, else (metres, difference of signatures).
GATES = {"line": (0.15, 0.1), "corner": (0.2, 0.3), "local minimum": (0.2, np.inf), "pole": (0.2, 0.1)}
# Two walls of one line are the same if the middle of the one is no further past the end of the other.
PAST_END = 0.3
# An end point so much behind what the next scan measured there was not looked at.
HIDDEN = 0.2
SEEN = {"line": 0.5, "corner": 0.9, "local minimum": 0.9, "pole": 0.9}
LONGEST_STEP = 1.0
CHI_SQUARE_95 = 5.991
N_DRAWN = 6


@dataclass(frozen=True)
class RealLog:
    """A log, and which scans are compared: at least `spacing` metres apart, turning by at most `turn_rate` rad/s."""

    path: str
    spacing: float = 0.0
    turn_rate: float = np.inf


LOGS = {
    "Intel": RealLog("carmen_radish_corrected/intel-corrected.log.gz"),
    "Belgioioso": RealLog("carmen_radish_corrected/belgioioso-corrected.log.gz"),
    "TurtleBot 4": RealLog("olin_mac_tb4/mac_take_2_bag_pf", 0.1),
    "TurtleBot 4, straight on": RealLog("olin_mac_tb4/mac_take_2_bag_pf", 0.1, 0.05),
}


@dataclass(frozen=True, eq=False)
class Pair:
    """Two scans, and the pose of the second one's robot as the first one's sees it, with covariance."""

    first: Scan
    second: Scan
    pose: np.ndarray
    covariance: np.ndarray


@dataclass(frozen=True, eq=False)
class Match:
    """Second feature minus moved first one (2,), the covariance of both (2, 2), the derivative in the pose (2, 3)."""

    difference: np.ndarray
    covariance: np.ndarray
    by_pose: np.ndarray

    def square(self, pose_covariance: np.ndarray | None = None) -> float:
        """Return the squared Mahalanobis distance."""
        total = self.covariance
        if pose_covariance is not None:
            total = total + self.by_pose @ pose_covariance @ self.by_pose.T
        return float(self.difference @ np.linalg.solve(total, self.difference))


@dataclass(eq=False)
class Tally:
    """One kind of feature over all pairs of a log."""

    seen: int = 0
    looked_at: int = 0
    matches: list[tuple[Match, Pair]] = field(default_factory=list)

    def row(self, n_pairs: int) -> dict[str, Any]:
        """Return shares and sizes."""
        row = {
            "per scan": f"{self.seen / n_pairs:.2f}",
            "looked at again": self.looked_at,
            "found again": f"{len(self.matches) / max(self.looked_at, 1):.3f}",
        }
        if not self.matches:
            return row
        alone = np.array([match.square() for match, _ in self.matches])
        posed = np.array([match.square(pair.covariance) for match, pair in self.matches])
        return row | {
            "difference (mm)": f"{1e3 * np.median([length(match) for match, _ in self.matches]):.0f}",
            "in 95%, pose exact": f"{np.mean(alone < CHI_SQUARE_95):.3f}",
            "in 95%, with the pose's": f"{np.mean(posed < CHI_SQUARE_95):.3f}",
        }


def length(match: Match) -> float:
    """Return a typical difference in metres: (x, y), or rho alone, since the other entry is an angle."""
    is_line = match.by_pose[1, 0] == 0.0 and match.by_pose[1, 1] == 0.0
    return float(abs(match.difference[0]) if is_line else np.hypot(*match.difference))


def run(name: str, data: Path = DATA, n_pairs: int | None = None) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the rows of a log by kind of feature, and the row of its walls with the pose that fits them best."""
    tallies = {kind: Tally() for kind in KINDS}
    fits, predicted = [], []
    pairs = list(islice(aligned_pairs(load(name, data), LOGS[name].spacing, LOGS[name].turn_rate), n_pairs))
    for pair in pairs:
        first, second = extract(pair.first), extract(pair.second)
        for name_of_kind, tally in tallies.items():
            kind, shortest = KINDS[name_of_kind]
            chosen = [feature for feature in first[kind] if kind != "line" or feature.length >= shortest]
            tally.seen += len(chosen)
            looked_at = [feature for feature in chosen if in_view(feature, pair) >= SEEN[kind]]
            tally.looked_at += len(looked_at)
            matches = [match for feature in looked_at if (match := find_again(feature, second[kind], kind, pair))]
            tally.matches += [(match, pair) for match in matches]
            if name_of_kind == "line" and len(matches) >= 3:
                fits.append(fit_pose(matches, pair)[2] / (2 * len(matches) - 3))
            if name_of_kind == "line" and len(matches) >= 4:
                predicted += predict(matches, pair)
    rows = [{"log": name, "pairs": len(pairs), "feature": kind} | t.row(len(pairs)) for kind, t in tallies.items()]
    low, middle, high = np.percentile(fits, [25, 50, 75])
    by_others, by_align = np.mean(np.array(predicted) < CHI_SQUARE_95, axis=0)
    honest = {
        "log": name,
        "pairs with three walls": len(fits),
        "chi-square per degree": f"{middle:.2f}",
        "half of the pairs": f"{low:.2f} to {high:.2f}",
        "deviations are too small by": f"{np.sqrt(middle):.2f}",
        "in 95%, by the other walls": f"{by_others:.3f}",
        "in 95%, by align": f"{by_align:.3f}",
    }
    return rows, honest


def main() -> None:
    """Print both tables as Markdown, and draw if asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path, default=DATA)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    results = [run(name, options.data) for name in LOGS]
    print_table([row for rows, _ in results for row in rows])
    print()
    print_table([honest for _, honest in results])
    if options.out is not None:
        options.out.mkdir(parents=True, exist_ok=True)
        for name in list(LOGS)[:3]:
            draw(name, options.data, options.out / f"{name.lower().replace(' ', '_')}.svg")


def draw(name: str, data: Path, path: Path) -> None:
    """Draw the features of some scans over them."""
    from matplotlib.figure import Figure

    log = load(name, data)
    figure = Figure(figsize=(24.0, 15.0), layout="constrained")
    chosen = np.linspace(0, len(log) - 1, N_DRAWN + 2).astype(int)[1:-1].tolist()
    for index, ax in zip(chosen, figure.subplots(2, N_DRAWN // 2).ravel(), strict=True):
        scan = log.scan(index)
        draw_scan(scan, np.zeros(3), ax, size=5.0)
        draw_features([f for found in extract(scan).values() for f in found], np.zeros(3), ax)
        ax.set_title(f"{name}, scan {index}")
        ax.legend(fontsize=8)
    figure.savefig(path)


def load(name: str, data: Path) -> SensorLog:
    """Read a log."""
    return read_once(data / LOGS[name].path)


@cache
def read_once(path: Path) -> SensorLog:
    """Read a log, of which several choices of pairs are compared."""
    return read_log(path).only_sensor()


def aligned_pairs(log: SensorLog, spacing: float, turn_rate: float) -> Iterator[Pair]:
    """Yield consecutive scans that overlap and align, at least `spacing` apart and hardly turned against each other."""
    last = 0
    for i in range(1, len(log)):
        step = between(log.poses[last], log.poses[i])
        if np.isfinite(step).all() and np.hypot(*step[:2]) < spacing:
            continue
        first, second, last = log.scan(last), log.scan(i), i
        turn_limit = turn_rate * max(second.stamp - first.stamp, 0.0) if np.isfinite(turn_rate) else np.inf
        if np.isfinite(step).all() and np.hypot(*step[:2]) < LONGEST_STEP and abs(step[2]) < turn_limit:
            result = align(second, first, step)
            if not result.problem and result.overlap > 0.5:
                yield Pair(first, second, result.pose, result.covariance)


def extract(scan: Scan) -> dict[str, list[Feature]]:
    """Return all features of a scan by kind."""
    lines = find_lines(scan, NOISE)
    return {
        "line": list(lines),
        "corner": list(find_corners(lines)),
        "local minimum": list(find_local_minima(scan, NOISE)),
        "pole": list(find_poles(scan, NOISE)),
    }


def in_view(feature: Feature, pair: Pair) -> float:
    """Return the share of a feature's end points that the second scan looks at."""
    ends = end_points(pair.first.ranges, pair.first.finder)[feature.beams]
    finder = pair.second.finder
    away = transform_points(invert(pair.pose), ends) - finder.mounts[0, :2]
    distance, bearing = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
    off = np.abs(wrap_angle(bearing[:, None] - finder.bearings))
    spacing = np.abs(np.median(np.diff(finder.bearings)))
    measured = usable_ranges(pair.second.ranges, finder)[off.argmin(axis=1)]
    inside = (off.min(axis=1) < 1.5 * spacing) & (distance < finder.max_range - HIDDEN)
    return float(np.mean(inside & (measured > distance - HIDDEN)))


def find_again(feature: Feature, candidates: list[Feature], kind: str, pair: Pair) -> Match | None:
    """Return the nearest match within the gates, or None."""
    near = []
    for candidate in candidates:
        match = compare_lines(feature, candidate, pair) if kind == "line" else compare_points(feature, candidate, pair)
        size = match.difference if kind == "line" else [length(match), candidate.signature - feature.signature]
        if np.all(np.abs(size) < GATES[kind]) and (kind != "line" or same_place(feature, candidate, pair)):
            near.append(match)
    return min(near, key=lambda match: float(np.abs(match.difference).sum()), default=None)


def compare_points(one: Feature, two: Feature, pair: Pair) -> Match:
    """Compare positions in the second robot's frame."""
    moved = transform_points(invert(pair.pose), one.position)
    cos, sin = np.cos(pair.pose[2]), np.sin(pair.pose[2])
    turn = np.array([[cos, sin], [-sin, cos]])
    covariance = turn @ in_metres(one) @ turn.T + in_metres(two)
    return Match(two.position - moved, covariance, np.column_stack([turn, [-moved[1], moved[0]]]))


def in_metres(feature: Feature) -> np.ndarray:
    """Return the covariance (2, 2) of a feature's position."""
    from_polar = np.linalg.inv(polar_jacobian(feature.position))
    return from_polar @ feature.covariance[:2, :2] @ from_polar.T


def compare_lines(one: Feature, two: Feature, pair: Pair) -> Match:
    """Compare (rho, alpha) in the second robot's frame."""
    rho, alpha = one.measurement[:2]
    normal, tangent = np.array([np.cos(alpha), np.sin(alpha)]), np.array([-np.sin(alpha), np.cos(alpha)])
    moved = rho - normal @ pair.pose[:2]
    sign = -1.0 if moved < 0.0 else 1.0
    by_line = np.array([[sign, -sign * tangent @ pair.pose[:2]], [0.0, 1.0]])
    heading = alpha - pair.pose[2] + (np.pi if moved < 0.0 else 0.0)
    difference = np.array([two.measurement[0] - abs(moved), float(wrap_angle(two.measurement[1] - heading))])
    by_pose = np.array([[*(sign * normal), 0.0], [0.0, 0.0, 1.0]])
    return Match(difference, by_line @ one.covariance[:2, :2] @ by_line.T + two.covariance[:2, :2], by_pose)


def same_place(one: Line, two: Line, pair: Pair) -> bool:
    """Return whether the middle of a moved wall lies along the other one, not far past its ends."""
    middle = transform_points(invert(pair.pose), (one.start + one.end) / 2.0)
    along = (middle - (two.start + two.end) / 2.0) @ (two.end - two.start) / two.length
    return bool(abs(along) < two.length / 2.0 + PAST_END)


def fit_pose(matches: list[Match], pair: Pair) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the shift (3,) of the pose that fits the matches best, its covariance (3, 3) and chi-square.

    Parallel walls leave it open: a hundred times the alignment's covariance keeps it in place.
    """
    roots = [np.linalg.cholesky(np.linalg.inv(match.covariance)).T for match in matches]
    differences = np.concatenate([root @ m.difference for root, m in zip(roots, matches, strict=True)])
    design = np.vstack([root @ m.by_pose for root, m in zip(roots, matches, strict=True)])
    information = design.T @ design + np.linalg.inv(100.0 * pair.covariance)
    shift = np.linalg.solve(information, design.T @ differences)
    return shift, np.linalg.inv(information), float(np.sum((differences - design @ shift) ** 2))


def predict(matches: list[Match], pair: Pair) -> Iterator[tuple[float, float]]:
    """Yield each match's squared Mahalanobis distance by the pose that fits the others best, and by the alignment."""
    for i, match in enumerate(matches):
        shift, covariance, _ = fit_pose(matches[:i] + matches[i + 1 :], pair)
        moved = Match(match.difference - match.by_pose @ shift, match.covariance, match.by_pose)
        yield moved.square(covariance), match.square(pair.covariance)


if __name__ == "__main__":
    main()
