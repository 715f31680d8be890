"""Align scans of real logs and of simulated worlds, and compare with relative poses that are verified or exact.

Run: python benchmarks/alignment.py [FOLDER WITH DATA]

- Intel has raw odometry. Part of the relations' moments are moments of the log, to 1.5 ms; pairs of neighbouring scans
  are used whose moments are joined by at most six relations (chained: the truth's error grows with them).
- FR079's log has corrected poses only, and its stamps come from the logger, up to 0.2 s late. Each moment is given the
  scan near it whose corrected poses agree best with the relations (dynamic programming over the whole drive; our
  alignment takes no part in it). Starts are the relation plus noise: 0.15 m in x and y, 8 degrees.
- Killian has the poses of an optimised graph. Pairs are the single relations whose two moments are moments of scans.
  Starts as for FR079. It had no part in choosing any constant of `align`.
- Corridors and rooms of straight walls are those of `alignment_worlds`, the office is a simulated drive. Starts are the
  truth plus noise: 0.1 m in x and y, 4 degrees.

Where a relation and the log's own corrected pose differ by more than 6 cm or 1.5 degrees, one of the two is wrong:
"agreeing" are the other pairs.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beamfield.geometry import between, compose, invert
from beamfield.io.read_log import read_log
from beamfield.localization.alignment import AlignmentResult, align
from beamfield.maps.scan_field import ScanField
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, Scan, SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from relations import chain, read_relations
from tables import print_table

if TYPE_CHECKING:
    from alignment_worlds import ScanPair

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FR079_CLOCK = 1211.36
# The relations are those of a laser 0.1 m ahead of the centre about which Intel's odometry turns: turns on the spot
# have relations that move, and there the odometry's median error is smallest.
INTEL_LEVER = np.array([0.1, 0.0, 0.0])
# 95%, 80% and 50% of chi-square with three degrees of freedom.
CHI_SQUARE = {95: 7.815, 80: 4.642, 50: 2.366}
# Relations and corrected poses agree to this many metres and radians.
AGREEING = (0.06, np.radians(1.5))
REAL_START_NOISE = np.array([0.15, 0.15, np.radians(8.0)])
SIMULATED_SEEDS, SIMULATED_PAIRS = range(301, 305), 100


@dataclass(frozen=True, eq=False)
class Pairs:
    """Scans to align onto others, the true relative poses and where to start; of a log, its poses and scan numbers."""

    onto: list[Scan]
    scans: list[Scan]
    truth: np.ndarray
    starts: np.ndarray
    corrected: np.ndarray | None = None
    numbers: np.ndarray | None = None

    def agreeing(self) -> np.ndarray:
        """Return where truth and corrected poses agree; everywhere for exact truth."""
        if self.corrected is None:
            return np.ones(len(self.truth), dtype=bool)
        error = between(self.truth, self.corrected)
        return (np.hypot(error[:, 0], error[:, 1]) <= AGREEING[0]) & (np.abs(error[:, 2]) <= AGREEING[1])


def run(data: Path = DATA) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return one row per log and source of relative poses, and one per log on who errs how far."""
    intel = intel_pairs(data)
    laser = compose(invert(INTEL_LEVER), compose(intel.starts, INTEL_LEVER))
    real = {"Intel": intel, "FR079": fr079_pairs(data), "Killian": killian_pairs(data)}
    rows, shares = [], []
    for name, pairs in (real | simulated_pairs()).items():
        start = "odometry" if name == "Intel" else "perturbed start"
        rows.append(error_row(name, start, pairs.truth, pairs.starts))
        if name == "Intel":
            rows.append(error_row(name, "odometry, moved to the laser", pairs.truth, laser))
        if pairs.corrected is not None:
            rows.append(error_row(name, "corrected poses of the log", pairs.truth, pairs.corrected))
        results, per_pair = timed(pairs)
        rows.append(result_row(name, pairs, results) | {"ms per pair": f"{per_pair:.2f}"})
        if pairs.corrected is not None:
            poses = np.array([result.pose for result in results])
            shares.append(three_way_row(name, pairs, poses) | closure_row(pairs, poses))
    return rows, shares


def main() -> None:
    """Print the rows as Markdown tables."""
    for rows in run(Path(sys.argv[1]) if len(sys.argv) > 1 and Path(sys.argv[1]).is_dir() else DATA):
        print_table(rows, columns=list(rows[-1]))
        print()


def intel_pairs(data: Path) -> Pairs:
    """Return neighbouring scans of Intel with verified relations and raw odometry."""
    log = read_log(data / "intel_gfs" / "derived_intel_rawodom.log.gz").only_sensor()
    moments, steps = read_relations(data / "slam_benchmark_relations" / "intel.relations.gz").steps()
    scan = nearest(log.stamps, moments)
    known = np.flatnonzero(np.abs(log.stamps[scan] - moments) < 1.5e-3)
    found = [
        (scan[a], scan[b], *chain(steps[a:b]))
        for a, b in pairwise(known)
        if b - a <= 6 and scan[b] - scan[a] == 1 and np.isfinite(steps[a:b]).all()
    ]
    table = np.array(found)
    first, second = table[:, 0].astype(int), table[:, 1].astype(int)
    return pairs_of_log(log, first, second, table[:, 2:], between(log.odometry[first], log.odometry[second]))


def fr079_pairs(data: Path) -> Pairs:
    """Return scans of FR079 with verified relations and perturbed starts."""
    log = read_log(data / "carmen_radish_corrected" / "freiburg-079-corrected.log.gz").only_sensor()
    moments, steps = read_relations(data / "slam_benchmark_relations" / "fr079.relations.gz").steps()
    scan = likely_scans(log, moments - FR079_CLOCK, steps)
    known = np.flatnonzero(np.isfinite(steps).all(axis=1))
    rng = np.random.default_rng(1)
    starts = steps[known] + rng.normal(size=(len(known), 3)) * REAL_START_NOISE
    return pairs_of_log(log, scan[known], scan[known + 1], steps[known], starts)


def killian_pairs(data: Path) -> Pairs:
    """Return scans of Killian with verified relations and perturbed starts."""
    log = read_log(data / "killian_g2o" / "killian.g2o.gz").only_sensor()
    moments, steps = read_relations(data / "slam_benchmark_relations" / "mit-killian.relations.gz").steps()
    scan = nearest(log.stamps, moments)
    met = np.abs(log.stamps[scan] - moments) < 1.5e-3
    known = np.flatnonzero(met[:-1] & met[1:] & np.isfinite(steps).all(axis=1))
    rng = np.random.default_rng(1)
    starts = steps[known] + rng.normal(size=(len(known), 3)) * REAL_START_NOISE
    return pairs_of_log(log, scan[known], scan[known + 1], steps[known], starts)


def pairs_of_log(log: SensorLog, first: np.ndarray, second: np.ndarray, truth: np.ndarray,
                 starts: np.ndarray) -> Pairs:  # fmt: skip
    """Return pairs of a log's scans."""
    corrected = between(log.poses[first], log.poses[second])
    numbers = np.column_stack([first, second])
    return Pairs([log.scan(i) for i in first], [log.scan(i) for i in second], truth, starts, corrected, numbers)


def simulated_pairs() -> dict[str, Pairs]:
    """Return pairs with exact truth."""
    # Tests load this file without its folder on the path.
    from alignment_worlds import corridor_pairs, room_pairs

    worlds = {}
    for name, make in {"corridors": corridor_pairs, "rooms": room_pairs}.items():
        found = [pair for seed in SIMULATED_SEEDS for pair in make(SIMULATED_PAIRS, seed)]
        worlds[name] = pairs_of_worlds(found)
    return worlds | {"office": office_pairs()}


def pairs_of_worlds(found: list[ScanPair]) -> Pairs:
    """Return the pairs of simulated worlds in one."""
    return Pairs(
        [pair.onto for pair in found], [pair.scan for pair in found],
        np.array([pair.truth for pair in found]), np.array([pair.start for pair in found]),
    )  # fmt: skip


def office_pairs() -> Pairs:
    """Return scans half a second apart of drives through simulated offices."""
    laser = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.0)), max_range=20.0)
    noise = BeamParameters(z_hit=0.91, z_short=0.05, z_max=0.01, z_rand=0.03, sigma_hit=0.02, lambda_short=0.5)
    onto, scans, truth = [], [], []
    for seed in SIMULATED_SEEDS:
        plan = draw_floor_plan(seed=seed)
        log = simulate_log(plan, laser, noise, duration=80.0, scan_rate=2.0, seed=seed).only_sensor()
        for i in range(0, len(log) - 1, 2):
            onto.append(log.scan(i))
            scans.append(log.scan(i + 1))
            truth.append(between(log.poses[i], log.poses[i + 1]))
    steps = np.array(truth)
    noise_of_start = np.random.default_rng(1).normal(size=steps.shape) * (0.1, 0.1, np.radians(4.0))
    return Pairs(onto, scans, steps, steps + noise_of_start)


def nearest(stamps: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """Return the index of the stamp nearest to each moment."""
    return np.abs(stamps[None] - moments[:, None]).argmin(axis=1)


def likely_scans(log: SensorLog, moments: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Return each moment's scan: late by 0.1 s, give or take, and with corrected poses that agree with the steps."""
    around = np.clip(np.searchsorted(log.stamps, moments)[:, None] + np.arange(-4, 4), 0, len(log) - 1)
    clock = 0.5 * ((log.stamps[around] - moments[:, None] + 0.1) / 0.12) ** 2
    cost, choices = clock[0], []
    for k, step in enumerate(steps):
        total = np.repeat(cost[:, None], around.shape[1], axis=1)
        if np.isfinite(step).all():
            error = between(step, between(log.poses[around[k]][:, None], log.poses[around[k + 1]][None]))
            total = total + np.minimum(0.5 * np.sum((error / (0.03, 0.03, 0.015)) ** 2, axis=-1), 30.0)
        choices.append(total.argmin(axis=0))
        cost = total.min(axis=0) + clock[k + 1]
    path = [int(cost.argmin())]
    for choice in reversed(choices):
        path.append(int(choice[path[-1]]))
    return around[np.arange(len(moments)), path[::-1]]


def align_all(pairs: Pairs) -> list[AlignmentResult]:
    """Align every scan onto the field of its partner."""
    return [
        align(scan, ScanField.from_scan(onto), start)
        for onto, scan, start in zip(pairs.onto, pairs.scans, pairs.starts, strict=True)
    ]


def timed(pairs: Pairs) -> tuple[list[AlignmentResult], float]:
    """Return the results and the median over 100 pairs of the shortest of five times, field included, in ms."""
    results = align_all(pairs)
    times = np.empty((5, min(100, len(results))))
    for run_times in times:
        for i in range(len(run_times)):
            began = time.perf_counter()
            align(pairs.scans[i], ScanField.from_scan(pairs.onto[i]), pairs.starts[i])
            run_times[i] = time.perf_counter() - began
    return results, float(np.median(times.min(axis=0))) * 1e3


def result_row(name: str, pairs: Pairs, results: list[AlignmentResult]) -> dict[str, Any]:
    """Return quantiles of the errors, how many truths the ellipses hold, and what was flagged."""
    poses = np.array([result.pose for result in results])
    row = error_row(name, "align", pairs.truth, poses)
    squares = mahalanobis_squares(pairs.truth, results)
    row |= {f"in {level}%": f"{np.mean(squares < limit):.3f}" for level, limit in CHI_SQUARE.items()}
    agreeing = pairs.agreeing()
    row["agreeing"] = int(agreeing.sum())
    row["of them in 95%"] = f"{np.mean(squares[agreeing] < CHI_SQUARE[95]):.3f}"
    for problem in ("undetermined", "ambiguous"):
        row[problem] = f"{np.mean([result.problem == problem for result in results]):.3f}"
    row["sure and wrong"] = int(sure_and_wrong(pairs.truth, results).sum())
    return row


def sure_and_wrong(truth: np.ndarray, results: list[AlignmentResult]) -> np.ndarray:
    """Return which alignments are more than 0.1 m off and more than three of their own worst deviations."""
    error = between(truth, np.array([result.pose for result in results]))
    distance = np.hypot(error[:, 0], error[:, 1])
    worst = np.array([np.sqrt(np.linalg.eigvalsh(result.covariance[:2, :2])[-1]) for result in results])
    return (distance > 0.1) & (distance > 3.0 * worst)


def three_way_row(name: str, pairs: Pairs, poses: np.ndarray) -> dict[str, Any]:
    """Return the deviations per axis that relations, corrected poses and alignments have, if they err independently."""
    row: dict[str, Any] = {"log": name}
    own = own_variances(pairs, poses)
    for unit, axes, factor in (("m", [0, 1], 1.0), ("deg", [2], np.degrees(1.0))):
        for one, variances in own.items():
            variance = float(variances[axes].mean())
            row[f"{one}, {unit}"] = f"{factor * np.sqrt(variance):.4f}" if variance > 0.0 else "0"
    return row


def own_variances(pairs: Pairs, poses: np.ndarray) -> dict[str, np.ndarray]:
    """Return the variances (3,) of relations, corrected poses and alignments, if they err independently.

    Of three sources, the variances of the three differences give each source's own: var a = (ab + ac - bc) / 2.
    Variances come from medians of absolute differences, so that wrong relations and wrong optima do not count. They may
    come out negative.
    """
    sources = {"relations": pairs.truth, "corrected poses": pairs.corrected, "align": poses}

    def between_sources(a: str, b: str) -> np.ndarray:
        difference = between(sources[a], sources[b])
        return np.array([_variance(difference[:, axis]) for axis in range(3)])

    own = {}
    for one in sources:
        other, third = (name for name in sources if name != one)
        shared = between_sources(one, other) + between_sources(one, third) - between_sources(other, third)
        own[one] = 0.5 * shared
    return own


def closure_row(pairs: Pairs, poses: np.ndarray) -> dict[str, Any]:
    """Return the deviation of one alignment, from how well two in a row agree with the one across both.

    No truth is needed; errors that all three share do not show.
    """
    follows = np.flatnonzero(pairs.numbers[:-1, 1] == pairs.numbers[1:, 0])
    gaps = []
    for i in follows:
        both = compose(poses[i], poses[i + 1])
        gaps.append(between(align(pairs.scans[i + 1], ScanField.from_scan(pairs.onto[i]), both).pose, both))
    gap = np.array(gaps)
    share = np.sqrt(3.0)
    return {
        "triples": len(gap),
        "align by closure, m": f"{np.sqrt(0.5 * (_variance(gap[:, 0]) + _variance(gap[:, 1]))) / share:.4f}",
        "align by closure, deg": f"{np.degrees(np.sqrt(_variance(gap[:, 2]))) / share:.4f}",
    }


def _variance(difference: np.ndarray) -> float:
    return float((1.4826 * np.median(np.abs(difference - np.median(difference)))) ** 2)


def error_row(name: str, source: str, truth: np.ndarray, poses: np.ndarray) -> dict[str, Any]:
    """Return the quantiles of translation and rotation errors."""
    error = between(truth, poses)
    translation, rotation = np.hypot(error[:, 0], error[:, 1]), np.degrees(np.abs(error[:, 2]))
    return {
        "log": name,
        "source": source,
        "pairs": len(truth),
        "median m": f"{np.median(translation):.4f}",
        "95% m": f"{np.quantile(translation, 0.95):.4f}",
        "median deg": f"{np.median(rotation):.3f}",
        "95% deg": f"{np.quantile(rotation, 0.95):.3f}",
    }


def mahalanobis_squares(truth: np.ndarray, results: list[AlignmentResult]) -> np.ndarray:
    """Return the squared distances of the truth in the results' covariances."""
    error = truth - np.array([result.pose for result in results])
    error[:, 2] = np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2]))
    covariances = np.array([result.covariance for result in results])
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariances, error[..., None])[..., 0])


if __name__ == "__main__":
    main()
