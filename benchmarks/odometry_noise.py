"""Odometry calibrated on simulated logs of known errors, and on real logs.

Simulated, COUNT logs a row: a drive of 300 update steps of about 0.27 m, one in four with a turn. AMCL's motion model
with known alphas, or odometry whose error grows with the root of the distance and with wrong scales, and reference
poses with noise of 0.02 m and 0.005 rad, which is told to the calibration. Printed: how often the 95% intervals hold
the truth, the median of estimate over truth, and which family was chosen.

Real: Wean Hall 1, 3, 5, intel and fr079 of FOLDER (default: ../shared/data beside the checkout). They are other
people's data and not part of this repository. fr079's odometry steps come from the pairs of ODOM lines that GMapping
wrote.

Run: python benchmarks/odometry_noise.py [COUNT [FOLDER]]     (40 logs a row)
"""

from __future__ import annotations

import gzip
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from beamfield.calibration.odometry.learning import calibrate_odometry
from beamfield.calibration.odometry.result import Estimate, OdometryCalibration, OdometryOptions
from beamfield.geometry import FloatArray, between, compose
from beamfield.io.read_log import read_log
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.odometry import OdometryNoise, noisy_odometry
from tables import print_table

STEPS = 300
REFERENCE = np.array([0.02, 0.02, 0.005])
OPTIONS = OdometryOptions(update_min_d=0.0, update_min_a=0.0, reference_error=0.02)
LASER = RangeFinder.from_bearings([0.0], max_range=8.0)
ALPHAS = ((0.005,) * 4, (0.02,) * 4, (0.05,) * 4, (0.2,) * 4, (0.05, 0.05, 0.01, 0.01), (0.1, 0.01, 0.02, 0.05))


def simulated_log(alphas: tuple[float, ...], seed: int) -> SensorLog:
    """Return a log whose truth follows from its odometry by AMCL's motion model."""
    rng = np.random.default_rng(seed)
    odometry, poses, model = [np.zeros(3)], [np.zeros(3)], DifferentialMotion(*alphas)
    for step in drive(rng):
        odometry.append(compose(odometry[-1], step))
        poses.append(model.sample(poses[-1][None], np.array(odometry[-2:]), rng)[0])
    return as_log(np.array(poses), np.array(odometry), rng)


def drifting_log(noise: OdometryNoise, seed: int) -> SensorLog:
    """Return a log whose odometry has wrong scales, and noise that grows with the root of the distance."""
    rng = np.random.default_rng(seed)
    poses = [np.zeros(3)]
    for step in drive(rng):
        poses.append(compose(poses[-1], step))
    return as_log(np.array(poses), noisy_odometry(poses, rng, noise), rng)


def drive(rng: np.random.Generator) -> FloatArray:
    """Return steps (n, 3) seen from their beginnings."""
    turns = rng.choice([0.0, 0.0, 0.0, 1.0], STEPS) * rng.normal(0.0, 0.4, STEPS)
    return np.column_stack([rng.uniform(0.24, 0.3, STEPS), np.zeros(STEPS), turns])


def as_log(poses: FloatArray, odometry: FloatArray, rng: np.random.Generator) -> SensorLog:
    """Return a log with noisy reference poses."""
    noisy = poses + REFERENCE * rng.standard_normal(poses.shape)
    return SensorLog(LASER, np.arange(len(poses), dtype=float), np.ones((len(poses), 1)), noisy, odometry)


def alpha_rows(count: int) -> list[tuple[str, ...]]:
    """Return a row per set of alphas."""
    rows = []
    for alphas in ALPHAS:
        results = [calibrate_odometry(simulated_log(alphas, seed), OPTIONS) for seed in range(count)]
        names = [result.chosen.name.split(":")[0].split()[0] for result in results]
        chosen = ", ".join(f"{name} {names.count(name)}" for name in ("one", "two", "four"))
        one, two, four = ([result.candidates[i].levels for result in results] for i in (1, 2, 3))
        common = alphas[0] if len(set(alphas)) == 1 else None
        pairs = (alphas[0], alphas[2]) if alphas[0] == alphas[1] and alphas[2] == alphas[3] else None
        rows.append(
            (
                " ".join(f"{alpha:g}" for alpha in alphas),
                "" if common is None else held([levels[0] for levels in one], common),
                "" if pairs is None else "; ".join(held([levels[i] for levels in two], pairs[i]) for i in (0, 1)),
                "; ".join(held([levels[i] for levels in four], alphas[i]) for i in range(4)),
                chosen,
                f"{np.mean([result.coverage for result in results]):.3f}",
                f"{np.mean([len(result.fault_stamps) for result in results]):.1f}",
            )
        )
    return rows


def held(estimates: list[Estimate], truth: float) -> str:
    """Return how many intervals hold the truth, and the median of estimate over truth."""
    inside = sum(one.low <= truth <= one.high for one in estimates)
    return f"{inside}/{len(estimates)} (x{np.median([one.value for one in estimates]) / truth:.2f})"


def systematic_rows(count: int) -> list[tuple[str, ...]]:
    """Return a row per systematic error."""
    noise = OdometryNoise(distance_scale=0.02, turn_scale=-0.03)
    results = [calibrate_odometry(drifting_log(noise, seed), OPTIONS) for seed in range(count)]
    truths = {"distance_scale": 1.0 / 1.02 - 1.0, "turn_scale": 1.0 / 0.97 - 1.0, "drift": 0.0, "yaw": 0.0}
    rows = []
    for name, truth in truths.items():
        found = [result.systematic[name] for result in results if name in result.systematic]
        inside = sum(one.low <= truth <= one.high for one in found)
        values = [one.value for one in found]
        means = f"{np.mean(values):+.4f}", f"{np.std(values):.4f}"
        rows.append((name, f"{truth:+.4f}", f"{inside}/{len(found)}", *means))
    return rows


def real_logs(folder: Path) -> dict[str, SensorLog]:
    """Return the logs with raw odometry and reference poses."""
    logs = {}
    for i in (1, 3, 5):
        log = read_log(folder / f"wean_hall/robotdata{i}.log.gz")
        logs[f"Wean {i}"] = attach_poses(
            log, read_trajectory(folder / f"wean_hall/reference_robotdata{i}.csv.gz")
        ).only_sensor()
    logs["intel"] = read_log(folder / "intel_gfs/derived_intel_rawodom.log.gz").only_sensor()
    logs["fr079"] = fr079(folder / "carmen_radish_corrected/freiburg-079-corrected.log.gz")
    logs["fr079, signs repaired"] = with_signs_of_reference(logs["fr079"])
    return logs


def fr079(path: Path) -> SensorLog:
    """Return the log with the odometry by which each pose was predicted from the one before.

    ODOM lines hold poses of the laser here, as FLASER's do.
    """
    log, predicted = read_log(path).only_sensor(), []
    with gzip.open(path, "rt") as file:
        for words in map(str.split, file):
            if words[:1] == ["ODOM"]:
                last = [float(word) for word in words[1:4]]
            elif words[:1] == ["FLASER"]:
                predicted.append(last)
    robot = compose(np.array(predicted), [-log.finder.mounts[0, 0], 0.0, 0.0])
    return replace(log, odometry=chained(between(log.poses[:-1], robot[1:])))


def with_signs_of_reference(log: SensorLog) -> SensorLog:
    """Return the log with steps turned round that go forwards where the reference goes back."""
    shown, steps = between(log.poses[:-1], log.poses[1:]), between(log.odometry[:-1], log.odometry[1:])
    lost = (steps[:, 0] * shown[:, 0] < 0.0) & (np.abs(shown[:, 0]) > 0.02)
    steps[lost, :2] *= -1.0
    return replace(log, odometry=chained(steps))


def chained(steps: FloatArray) -> FloatArray:
    """Return the poses that steps lead to, from the origin."""
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def real_row(name: str, result: OdometryCalibration) -> tuple[str, ...]:
    """Return what was learned from a log."""
    one = result.candidates[1].levels[0]
    advised = " ".join(f"{getattr(result.alphas, f'alpha{i}'):.3g}" for i in range(1, 5))
    levels = " ".join(f"{level.value:.2g}" for level in result.chosen.levels)
    errors = ", ".join(
        f"{key} {error.value:+.3f}" for key, error in result.systematic.items() if not error.low <= 0.0 <= error.high
    )
    return (
        name, f"{result.n_steps}", f"{one.value:.2g} [{one.low:.2g}, {one.high:.2g}]", f"{result.corrected_alpha:.2g}",
        f"{result.chosen.name.split(':')[0]}: {levels}", f"{result.chosen.gain:+.2f} ± {result.chosen.gain_se:.2f}",
        advised, errors, f"{result.coverage:.2f}", f"{len(result.fault_stamps)}",
    )  # fmt: skip


def show(header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table."""
    print_table([dict(zip(header, row, strict=True)) for row in rows])


def main(count: int, folder: Path) -> None:
    """Print the tables."""
    if count:
        header = ("alphas", "one", "two", "four", "chosen", "coverage", "faults")
        show(header, alpha_rows(count))
        print()
        show(("systematic error", "truth", "held", "mean", "s.d."), systematic_rows(count))
        print()
    if folder.is_dir():
        logs = real_logs(folder)
        header = ("log", "steps", "one alpha", "corrected", "chosen", "gain over 0.2, nats per window", "advised",
                  "systematic errors", "coverage", "faults")  # fmt: skip
        results = {name: calibrate_odometry(log) for name, log in logs.items()}
        show(header, [real_row(name, result) for name, result in results.items()])
        for name, result in results.items():
            print(f"\n{name}: {'; '.join(finding.text for finding in result.findings)}")


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    main(
        int(sys.argv[1]) if len(sys.argv) > 1 else 40,
        Path(sys.argv[2]) if len(sys.argv) > 2 else here.parent / "shared" / "data",
    )
