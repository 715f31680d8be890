"""Measure what tells scans that fit from scans that do not: ``python benchmarks/scan_fit.py [FOLDER]``.

Each statistic gets its 5% threshold from one good drive, and is then tried on another: on its scans at right poses, at
wrong ones (kidnapped), and in maps that are out of date. FOLDER holds real logs (default: ../shared/data beside the
checkout); without it only simulated worlds are measured.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy import ndimage
from scipy.stats import rankdata

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.time_split import time_blocks
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.conformal import conformal_p_values
from beamfield.scan_fit.lost import lost_probability
from beamfield.scan_fit.reference import ScanFitReference, calibrate_scan_fit
from beamfield.scan_fit.statistics import fit_statistics
from beamfield.scan_fit.wrong_poses import wrong_poses
from beamfield.sensors import RangeFinder, SensorLog, usable_ranges
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log

# None of these was looked at while the statistics were chosen.
SEEDS = range(20, 26)
TRUTH = BeamParameters(0.78, 0.12, 0.03, 0.07, 0.05, 0.6)
FINDER = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 91), 12.0, name="laser")
# Wrong readings come in bursts, and the reference poses are some centimetres and a degree off.
DEPENDENCE = Dependence(angle=np.radians(6.0), time=1.0)
POSE_NOISE = np.array([0.04, 0.04, 0.015])
OPTIONS = CalibrationOptions(refine=False)
STATISTICS = ("mean likelihood", "mean log-likelihood", "surprise", "misfit")
# A scan is in a changed map if so many of its beams should now be so much longer or shorter.
SEEN_SHARE, SEEN_M = 0.1, 0.3


@dataclass(frozen=True)
class Trial:
    """A log to judge: statistics by name, and the lost probability, per scan."""

    values: dict[str, np.ndarray]
    lost: np.ndarray


def judge(model: BeamModel, reference: ScanFitReference, log: SensorLog) -> Trial:
    """Return all statistics of a log's scans; larger is stranger."""
    found = fit_statistics(model, log.ranges, log.finder, log.poses)
    z = usable_ranges(log.ranges, log.finder)
    density = beam_log_density(z, model.expected(log.poses, log.finder), log.finder.max_range, model.parameters)
    n = np.maximum(np.isfinite(z).sum(axis=1), 1)
    values = {
        "mean likelihood": -np.where(np.isfinite(z), np.exp(density), 0.0).sum(axis=1) / n,
        "mean log-likelihood": -density.sum(axis=1) / n,
        "surprise": found.surprise,
        "misfit": found.misfit,
    }
    return Trial(values, lost_probability(found.surprise, log.stamps, reference.evidence))


def area(good: np.ndarray, bad: np.ndarray) -> float:
    """Area under the ROC curve."""
    ranks = rankdata(np.concatenate([good, bad]))
    return float((ranks[len(good) :].sum() - len(bad) * (len(bad) + 1) / 2) / (len(good) * len(bad)))


def compare(own: Trial, good: Trial, bad: Trial, scans: np.ndarray | None = None) -> dict[str, tuple[float, ...]]:
    """Return per statistic: area, TPR at 5% false alarms, and false alarms and TPR at the own drive's threshold."""
    rows = {}
    chosen = slice(None) if scans is None else scans
    for name in STATISTICS:
        g, b = good.values[name], bad.values[name][chosen]
        g, b = g[~np.isnan(g)], b[~np.isnan(b)]
        p_good, p_bad = (conformal_p_values(v, own.values[name]) for v in (g, b))
        detected = float((b > np.quantile(g, 0.95)).mean())
        rows[name] = (area(g, b), detected, float((p_good <= 0.05).mean()), float((p_bad <= 0.05).mean()))
    g, b = good.lost, bad.lost[chosen]
    rows["lost probability"] = (
        area(g, b), float((b > np.quantile(g, 0.95)).mean()), float((g > 0.5).mean()), float((b > 0.5).mean()),
    )  # fmt: skip
    return rows


def simulated(seed: int) -> tuple[dict[str, dict[str, tuple[float, ...]]], ScanFitReference]:
    """Return the comparison for each kind of trouble in one simulated building."""
    grid, bare = draw_floor_plan(seed=seed), draw_floor_plan(seed=seed, furnished=False)
    first, _ = drive(grid, seed + 1, 240.0)
    second, truth = drive(grid, seed + 1001, 360.0)
    model = BeamModel(grid, calibrate(first, grid, OPTIONS).parameters)
    reference = calibrate_scan_fit(model, first)
    own, good = judge(model, reference, first), judge(model, reference, second)
    rng = np.random.default_rng(seed)
    results = {}
    stretch = time_blocks(second.stamps, 10.0)
    for name, share in (("kidnapped, near", 1.0), ("kidnapped, anywhere", 0.0)):
        poses = wrong_poses(second.poses, stretch, grid, rng, share_near=share)
        results[name] = compare(own, good, judge(model, reference, second.with_poses(poses)))
    expected = model.expected(truth, second.finder)
    for name, old in (
        ("furniture moved", furniture_moved(grid, bare, rng)),
        ("wall missing", walls_missing(grid, bare, rng)),
        ("wrong height", table_tops(grid, bare)),
    ):
        there = BeamModel(old, model.parameters)
        seen = (np.abs(there.expected(truth, second.finder) - expected) > SEEN_M).mean(axis=1) > SEEN_SHARE
        results[name] = compare(own, good, judge(there, reference, second), seen)
    return results, reference


def drive(grid: OccupancyGrid, seed: int, duration: float) -> tuple[SensorLog, np.ndarray]:
    """Return a log whose reference poses are a little off, and the true poses."""
    log = simulate_log(
        grid, FINDER, TRUTH, duration=duration, scan_rate=4.0, seed=seed, dependence=DEPENDENCE
    ).only_sensor()  # fmt: skip
    error = np.random.default_rng(seed + 77).standard_normal((len(log), 3))
    keep = np.exp(-0.25 / 2.0)
    for i in range(1, len(error)):
        error[i] = keep * error[i - 1] + np.sqrt(1.0 - keep**2) * error[i]
    return log.with_poses(log.poses + error * POSE_NOISE), log.poses


def furniture_moved(grid: OccupancyGrid, bare: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """Return the map as it was when half of the furniture stood up to 1.5 m elsewhere and a fifth was not there."""
    # The inside of a cupboard is unknown to a map, and moves with it.
    furniture = bare.free & ~grid.free
    things, n = ndimage.label(ndimage.binary_dilation(furniture, iterations=6))
    things[~furniture] = 0
    occupied = np.zeros(grid.shape, bool)
    for number in range(1, n + 1):
        rows, cols = np.nonzero(things == number)
        fate = rng.random()
        if fate < 0.2:
            continue
        if fate < 0.7:
            step = rng.integers(-30, 31, 2)
            moved = np.clip(rows + step[0], 0, grid.shape[0] - 1), np.clip(cols + step[1], 0, grid.shape[1] - 1)
            if bare.free[moved].all():
                rows, cols = moved
        occupied[rows, cols] = True
    return redrawn(bare, occupied)


def walls_missing(grid: OccupancyGrid, bare: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """Return the map with twelve holes of 3 m in its walls: the walls were built later."""
    probability = np.array(grid.probability)
    half, edge = 30, 40
    inner = np.zeros(grid.shape, bool)
    inner[edge:-edge, edge:-edge] = bare.occupied[edge:-edge, edge:-edge]
    for row, col in rng.permutation(np.argwhere(inner))[:12]:
        probability[row - half : row + half, col - half : col + half] = 0.0
    return replace(grid, probability=probability)


def table_tops(grid: OccupancyGrid, bare: OccupancyGrid) -> OccupancyGrid:
    """Return the map as seen at the height of table tops: what lies between legs within 1.2 m is occupied."""
    furniture = np.pad(bare.free & ~grid.free, 20)
    tops = ndimage.binary_closing(furniture, np.ones((3, 3)), iterations=12)[20:-20, 20:-20]
    return redrawn(bare, tops & bare.free)


def redrawn(bare: OccupancyGrid, furniture: np.ndarray) -> OccupancyGrid:
    """Return the building with this furniture."""
    probability = np.array(bare.probability)
    probability[furniture] = 1.0
    return replace(bare, probability=probability)


def real(folder: Path) -> dict[str, dict[str, tuple[float, ...]]]:
    """Return the comparison at wrong poses of real logs."""
    cases = []
    grid = read_map(folder / "wean_hall/derived_wean.yaml")
    paths = {n: (f"wean_hall/robotdata{n}.log.gz", f"wean_hall/reference_robotdata{n}.csv.gz") for n in (1, 3, 5)}
    wean = {n: posed(folder, *paths[n], max_range=81.83) for n in paths}
    cases += [(f"Wean Hall 1, tried on {n}", grid, wean[1], wean[n]) for n in (3, 5)]
    grid = read_map(folder / "olin_mac_tb4/map/mac_1st_floor_final.yaml")
    log = posed(folder, "olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/derived_ref_take_2.csv.gz")
    half = len(log) // 2
    halves = log.select(np.arange(half)), log.select(np.arange(half, len(log)))
    cases += [
        ("TurtleBot 4, first half on second", grid, *halves),
        ("TurtleBot 4, second half on first", grid, *halves[::-1]),
    ]
    return {name: one_real(*case) for name, *case in cases}


def one_real(grid: OccupancyGrid, first: SensorLog, second: SensorLog) -> dict[str, tuple[float, ...]]:
    model = BeamModel(grid, calibrate(first, grid, OPTIONS).parameters)
    reference = calibrate_scan_fit(model, first)
    rng = np.random.default_rng(0)
    rounds = []
    for _ in range(5):
        poses = wrong_poses(second.poses, time_blocks(second.stamps, 5.0), grid, rng)
        trials = [judge(model, reference, log) for log in (first, second, second.with_poses(poses))]
        rounds.append(compare(*trials))
    return {name: tuple(np.mean([r[name] for r in rounds], axis=0)) for name in rounds[0]}


def posed(folder: Path, log: str, poses: str, **options: float) -> SensorLog:
    read = attach_poses(read_log(folder / log, **options), read_trajectory(folder / poses)).only_sensor()
    return read.select(np.isfinite(read.poses).all(axis=1))


def print_tables(results: dict[str, dict[str, tuple[float, ...]]]) -> None:
    print("| trouble | statistic | area | TPR at 5% false alarms | false alarms at its own 5% | TPR there |")
    print("|---|---|---|---|---|---|")
    for trouble, rows in results.items():
        for name, values in rows.items():
            print(f"| {trouble} | {name} | " + " | ".join(f"{v:.3f}" for v in values) + " |")


def print_reliability(references: list[ScanFitReference]) -> None:
    rows = [row for reference in references for row in reference.reliability]
    edges = np.array([0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.01])
    print("\n| lost probability | was lost | scans |\n|---|---|---|")
    for low, high in pairwise(edges):
        mine = [row for row in rows if low <= row.predicted < high]
        n = sum(row.n for row in mine)
        if n:
            predicted, observed = (sum(getattr(r, key) * r.n for r in mine) / n for key in ("predicted", "observed"))
            print(f"| {predicted:.3f} | {observed:.3f} | {n} |")


def main(folder: Path) -> None:
    worlds, references = zip(*(simulated(seed) for seed in SEEDS), strict=True)
    print(f"Simulated: {len(worlds)} buildings. The last two columns of the lost probability are at 0.5.\n")
    print_tables({t: {s: tuple(np.mean([w[t][s] for w in worlds], axis=0)) for s in worlds[0][t]} for t in worlds[0]})
    print_reliability(list(references))
    if folder.is_dir():
        print("\nReal logs at wrong poses, five draws each.\n")
        print_tables(real(folder))


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared" / "data")
