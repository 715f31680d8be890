"""Scans of three buildings align better than odometry, by what people have verified."""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from benchmarks.relations import read_relations

from beamfield.geometry import between

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    """The benchmark's way to find scans and verified relations that belong together."""
    return load("alignment")


def load(name: str) -> ModuleType:
    """Load a benchmark, which finds what stands beside it as a script does."""
    folder = str(Path(__file__).resolve().parents[2] / "benchmarks")
    sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    finally:
        sys.path.remove(folder)


def median_errors(truth: np.ndarray, poses: np.ndarray) -> tuple[float, float]:
    error = between(truth, poses)
    return float(np.median(np.hypot(error[:, 0], error[:, 1]))), float(np.median(np.abs(error[:, 2])))


@cache
def pairs_of(log: str, data: Path) -> Any:
    """The pairs of a log; to read one takes up to two seconds."""
    return getattr(load("alignment"), f"{log}_pairs")(data)


def every_fifth(pairs: Any) -> Any:
    """Return fewer pairs, from the whole of the log: enough for medians."""
    rows = slice(None, None, 5)
    return replace(
        pairs, onto=pairs.onto[rows], scans=pairs.scans[rows], truth=pairs.truth[rows], starts=pairs.starts[rows],
        corrected=None, numbers=None,
    )  # fmt: skip


def test_intel_aligns_three_times_better_than_its_odometry(data: Path, benchmark: ModuleType) -> None:
    pairs = pairs_of("intel", data)
    assert len(pairs.truth) > 190
    results = benchmark.align_all(pairs)
    translation, rotation = median_errors(pairs.truth, np.array([result.pose for result in results]))
    odometry_translation, odometry_rotation = median_errors(pairs.truth, pairs.starts)
    assert translation < odometry_translation / 3.0
    assert rotation < odometry_rotation / 10.0
    assert benchmark.sure_and_wrong(pairs.truth, results).sum() <= 4


def test_fr079_aligns_from_perturbed_poses(data: Path, benchmark: ModuleType) -> None:
    pairs = every_fifth(pairs_of("fr079", data))
    assert len(pairs.truth) > 185
    results = benchmark.align_all(pairs)
    translation, rotation = median_errors(pairs.truth, np.array([result.pose for result in results]))
    start_translation, start_rotation = median_errors(pairs.truth, pairs.starts)
    assert translation < min(start_translation / 5.0, 0.025)
    assert rotation < min(start_rotation / 10.0, np.radians(0.35))


def test_killian_aligns_though_nothing_was_chosen_on_it(data: Path, benchmark: ModuleType) -> None:
    pairs = every_fifth(pairs_of("killian", data))
    assert len(pairs.truth) > 108
    results = benchmark.align_all(pairs)
    translation, rotation = median_errors(pairs.truth, np.array([result.pose for result in results]))
    assert translation < 0.025
    assert rotation < np.radians(0.3)
    # Its corridors leave some pairs undetermined, but not many.
    assert np.mean([len(result.undetermined) > 0 for result in results]) < 0.1
    assert benchmark.sure_and_wrong(pairs.truth, results).mean() < 0.01


def test_two_halves_of_a_scan_agree_as_their_covariances_say(data: Path) -> None:
    """The halves see other surfaces. NEES would be 3; it was 0.3 with 1.5 cm and 5 mrad for what cannot be told."""
    covariance = load("alignment_covariance")
    pairs = pairs_of("intel", data)
    found = [
        covariance.align_halves(*pair) for pair in list(zip(pairs.scans, pairs.onto, pairs.starts, strict=True))[:120]
    ]
    halves = [half for half in found if half is not None]
    assert len(halves) > 50
    difference = np.array([even.pose - odd.pose for even, odd in halves])
    sums = np.array([even.covariance + odd.covariance for even, odd in halves])
    squares = np.einsum("ni,ni->n", difference, np.linalg.solve(sums, difference[..., None])[..., 0])
    # Both means and tails: wrong optima, which no covariance covers, do not count.
    near = covariance.are_near(difference)
    assert near.mean() > 0.85
    # Of sixty pairs, the mean has a standard error of 0.3: it is about 2.3.
    assert 1.5 < squares[near].mean() < 4.0
    assert np.mean(squares[near] < 7.815) > 0.88


@pytest.mark.parametrize(("name", "n"), [("intel", 2984), ("fr079", 1685), ("mit-killian", 4677)])
def test_all_relations_of_the_benchmark_are_read(data: Path, name: str, n: int) -> None:
    relations = read_relations(data / "slam_benchmark_relations" / f"{name}.relations.gz")
    assert len(relations) == n
    moments, steps = relations.steps()
    assert len(steps) == len(moments) - 1
    assert np.isfinite(steps).all(axis=1).mean() > 0.9
