"""Align consecutive scans of real logs and compare with relations that people have verified.

Run: python benchmarks/alignment.py [FOLDER WITH DATA]

- Intel has raw odometry. Part of the relations' moments are moments of the log, to 1.5 ms; pairs of neighbouring scans
  are used whose moments are joined by at most six relations (chained: the truth's error grows with them).
- FR079's log has corrected poses only, and its stamps come from the logger, up to 0.2 s late. Each moment is given the
  scan near it whose corrected poses agree best with the relations (dynamic programming over the whole drive; our
  alignment takes no part in it). Starts are the relation plus noise: 0.15 m in x and y, 8 degrees.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.geometry import between, compose, invert
from beamfield.io.read_log import read_log
from beamfield.io.relations import chain, read_relations
from beamfield.localization.alignment import AlignmentResult, align
from beamfield.maps.scan_field import ScanField
from beamfield.sensors import SensorLog

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
FR079_CLOCK = 1211.36
# The relations are those of a laser 0.1 m ahead of the centre about which Intel's odometry turns: turns on the spot
# have relations that move, and there the odometry's median error is smallest.
INTEL_LEVER = np.array([0.1, 0.0, 0.0])
# 95 %, 80 % and 50 % of chi-square with three degrees of freedom.
CHI_SQUARE = {95: 7.815, 80: 4.642, 50: 2.366}


@dataclass(frozen=True, eq=False)
class Pairs:
    """Scans `first` and `second` of a log, the verified relative poses and where to start."""

    log: SensorLog
    first: np.ndarray
    second: np.ndarray
    truth: np.ndarray
    starts: np.ndarray


def run(data: Path = DATA) -> list[dict[str, Any]]:
    """Return one row per log and source of relative poses."""
    rows = []
    for name, pairs in {"Intel": intel_pairs(data), "FR079": fr079_pairs(data)}.items():
        if name == "Intel":
            rows.append(error_row(name, "odometry", pairs.truth, pairs.starts))
            laser = compose(invert(INTEL_LEVER), compose(pairs.starts, INTEL_LEVER))
            rows.append(error_row(name, "odometry, moved to the laser", pairs.truth, laser))
        else:
            rows.append(error_row(name, "perturbed start", pairs.truth, pairs.starts))
        corrected = between(pairs.log.poses[pairs.first], pairs.log.poses[pairs.second])
        rows.append(error_row(name, "corrected poses of the log", pairs.truth, corrected))
        results, per_pair = timed(pairs)
        poses = np.array([result.pose for result in results])
        row = error_row(name, "align", pairs.truth, poses)
        distances = mahalanobis_squares(pairs.truth, results)
        row |= {f"in {level} %": f"{np.mean(distances < limit):.3f}" for level, limit in CHI_SQUARE.items()}
        row["undetermined"] = sum(len(result.undetermined) > 0 for result in results)
        row["ms per pair"] = f"{per_pair:.2f}"
        # How far the relations themselves are to blame: is the truth or the log's corrected pose in the ellipse?
        either = np.minimum(distances, mahalanobis_squares(corrected, results))
        row["truth or corrected in 95 %"] = f"{np.mean(either < CHI_SQUARE[95]):.3f}"
        rows.append(row)
    return rows


def main() -> None:
    """Print the rows as a Markdown table."""
    rows = run(Path(sys.argv[1]) if len(sys.argv) > 1 and Path(sys.argv[1]).is_dir() else DATA)
    columns = list(rows[-1])
    print(f"| {' | '.join(columns)} |")
    print(f"|{'---|' * len(columns)}")
    for row in rows:
        print(f"| {' | '.join(str(row.get(column, '')) for column in columns)} |")


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
    return Pairs(log, first, second, table[:, 2:], between(log.odometry[first], log.odometry[second]))


def fr079_pairs(data: Path) -> Pairs:
    """Return scans of FR079 with verified relations and perturbed starts."""
    log = read_log(data / "carmen_radish_corrected" / "freiburg-079-corrected.log.gz").only_sensor()
    moments, steps = read_relations(data / "slam_benchmark_relations" / "fr079.relations.gz").steps()
    scan = likely_scans(log, moments - FR079_CLOCK, steps)
    known = np.flatnonzero(np.isfinite(steps).all(axis=1))
    rng = np.random.default_rng(1)
    starts = steps[known] + rng.normal(size=(len(known), 3)) * (0.15, 0.15, np.radians(8.0))
    return Pairs(log, scan[known], scan[known + 1], steps[known], starts)


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
    """Align every second scan onto the field of the first."""
    return [
        align(pairs.log.scan(second), ScanField.from_scan(pairs.log.scan(first)), start)
        for first, second, start in zip(pairs.first, pairs.second, pairs.starts, strict=True)
    ]


def timed(pairs: Pairs) -> tuple[list[AlignmentResult], float]:
    """Return the results and the median over 100 pairs of the shortest of five times, field included, in ms."""
    results = align_all(pairs)
    times = np.empty((5, min(100, len(results))))
    for run_times in times:
        for i in range(len(run_times)):
            one = replace(
                pairs, first=pairs.first[i : i + 1], second=pairs.second[i : i + 1], starts=pairs.starts[i : i + 1]
            )
            began = time.perf_counter()
            align_all(one)
            run_times[i] = time.perf_counter() - began
    return results, float(np.median(times.min(axis=0))) * 1e3


def error_row(name: str, source: str, truth: np.ndarray, poses: np.ndarray) -> dict[str, Any]:
    """Return the quantiles of translation and rotation errors."""
    error = between(truth, poses)
    translation, rotation = np.hypot(error[:, 0], error[:, 1]), np.degrees(np.abs(error[:, 2]))
    return {
        "log": name,
        "source": source,
        "pairs": len(truth),
        "median m": f"{np.median(translation):.4f}",
        "90 % m": f"{np.quantile(translation, 0.9):.4f}",
        "median deg": f"{np.median(rotation):.3f}",
        "90 % deg": f"{np.quantile(rotation, 0.9):.3f}",
    }


def mahalanobis_squares(truth: np.ndarray, results: list[AlignmentResult]) -> np.ndarray:
    """Return the squared distances of the truth in the results' covariances."""
    error = truth - np.array([result.pose for result in results])
    error[:, 2] = np.arctan2(np.sin(error[:, 2]), np.cos(error[:, 2]))
    covariances = np.array([result.covariance for result in results])
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariances, error[..., None])[..., 0])


if __name__ == "__main__":
    main()
