"""Scans of three buildings align better than odometry, by what people have verified."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from beamfield.geometry import between
from beamfield.io.relations import read_relations

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def benchmark() -> ModuleType:
    """The benchmark's way to find scans and verified relations that belong together."""
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "alignment.py"
    spec = importlib.util.spec_from_file_location("alignment_benchmark", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    # A script finds what stands beside it.
    sys.path.insert(0, str(path.parent))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(path.parent))
    return module


def median_errors(truth: np.ndarray, poses: np.ndarray) -> tuple[float, float]:
    error = between(truth, poses)
    return float(np.median(np.hypot(error[:, 0], error[:, 1]))), float(np.median(np.abs(error[:, 2])))


def test_intel_aligns_three_times_better_than_its_odometry(data: Path, benchmark: ModuleType) -> None:
    pairs = benchmark.intel_pairs(data)
    assert len(pairs.truth) > 190
    results = benchmark.align_all(pairs)
    translation, rotation = median_errors(pairs.truth, np.array([result.pose for result in results]))
    odometry_translation, odometry_rotation = median_errors(pairs.truth, pairs.starts)
    assert translation < odometry_translation / 3.0
    assert rotation < odometry_rotation / 10.0
    assert 0.9 <= share_held(benchmark, pairs, results) <= 0.98
    assert benchmark.sure_and_wrong(pairs.truth, results).sum() <= 4


def test_fr079_aligns_from_perturbed_poses(data: Path, benchmark: ModuleType) -> None:
    pairs = benchmark.fr079_pairs(data)
    assert len(pairs.truth) > 950
    results = benchmark.align_all(pairs)
    translation, rotation = median_errors(pairs.truth, np.array([result.pose for result in results]))
    start_translation, start_rotation = median_errors(pairs.truth, pairs.starts)
    assert translation < min(start_translation / 5.0, 0.025)
    assert rotation < min(start_rotation / 10.0, np.radians(0.35))
    assert 0.9 <= share_held(benchmark, pairs, results) <= 0.98


def test_killian_aligns_though_nothing_was_chosen_on_it(data: Path, benchmark: ModuleType) -> None:
    pairs = benchmark.killian_pairs(data)
    assert len(pairs.truth) > 550
    results = benchmark.align_all(pairs)
    translation, rotation = median_errors(pairs.truth, np.array([result.pose for result in results]))
    assert translation < 0.025
    assert rotation < np.radians(0.3)
    assert share_held(benchmark, pairs, results) >= 0.9
    # Its corridors leave some pairs undetermined, but not many.
    assert np.mean([len(result.undetermined) > 0 for result in results]) < 0.1
    assert benchmark.sure_and_wrong(pairs.truth, results).mean() < 0.01


def share_held(benchmark: ModuleType, pairs: Any, results: list[Any]) -> float:
    """Share of the pairs whose verified pose lies in the 95 % ellipse."""
    return float(np.mean(benchmark.mahalanobis_squares(pairs.truth, results) < benchmark.CHI_SQUARE[95]))


@pytest.mark.parametrize(("name", "n"), [("intel", 2984), ("fr079", 1685), ("mit-killian", 4677)])
def test_all_relations_of_the_benchmark_are_read(data: Path, name: str, n: int) -> None:
    relations = read_relations(data / "slam_benchmark_relations" / f"{name}.relations.gz")
    assert len(relations) == n
    moments, steps = relations.steps()
    assert len(steps) == len(moments) - 1
    assert np.isfinite(steps).all(axis=1).mean() > 0.9
