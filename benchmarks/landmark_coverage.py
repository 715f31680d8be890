"""How often the 95% intervals of a learned landmark sensor hold the truth, on simulated logs of few blocks.

A robot visits places and sees six landmarks from each, with known noise; three ways:

- independent: every sighting on its own
- dependent: half of the errors' variance is shared by all sightings of a block
- rare: as dependent, with one spurious sighting in 200

Run: python benchmarks/landmark_coverage.py [LOGS [BLOCKS ...]]     (200 logs a row, of 4, 6, 12 and 24 blocks)
"""

from __future__ import annotations

import sys

import numpy as np

from beamfield.detection_log import DetectionLog
from beamfield.detections import Detections
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.kernels.threads import set_threads
from beamfield.landmark_noise.learning import learn_landmark_parameters
from beamfield.maps.landmarks import LandmarkMap
from tables import print_table

LANDMARKS = np.array([[0.0, 0.0], [8.0, 0.0], [8.0, 6.0], [0.0, 6.0], [4.0, 7.0], [4.0, -1.0]])
TRUTH = {"range_bias": 0.05, "sigma_range": 0.1, "bearing_bias": -0.01, "sigma_bearing": 0.03, "spurious_rate": 0.05}
MAX_RANGE, PLACES_PER_BLOCK, BLOCK_S = 12.0, 8, 10.0
KINDS = {"independent": (0.0, 0.05), "dependent": (0.5, 0.05), "rare": (0.5, 0.005)}


def simulate(n_blocks: int, shared: float, spurious_rate: float, rng: np.random.Generator) -> DetectionLog:
    """Return a log; the part `shared` of the errors' variance is common to a block of time."""
    poses, seen = [], []
    for block in range(n_blocks):
        common = rng.normal(size=(2, 1)) * np.sqrt(shared)
        for place in range(PLACES_PER_BLOCK):
            pose = rng.uniform([1.0, 1.0, -3.0], [7.0, 5.0, 3.0])
            errors = common + rng.normal(size=(2, len(LANDMARKS))) * np.sqrt(1.0 - shared)
            ranges, bearings = _sight(pose, errors, spurious_rate, rng)
            poses.append(pose)
            stamp = BLOCK_S * (block + (place + 0.5) / PLACES_PER_BLOCK)
            seen.append(Detections(ranges, bearings, ids=np.arange(1, len(LANDMARKS) + 1), stamp=stamp))
    return DetectionLog(np.array(poses), seen)


def _sight(
    pose: FloatArray, errors: FloatArray, spurious_rate: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    dx, dy = (LANDMARKS - pose[:2]).T
    ranges = np.hypot(dx, dy) + TRUTH["range_bias"] + TRUTH["sigma_range"] * errors[0]
    bearings = np.arctan2(dy, dx) - pose[2] + TRUTH["bearing_bias"] + TRUTH["sigma_bearing"] * errors[1]
    spurious = rng.random(len(ranges)) < spurious_rate
    ranges = np.where(spurious, rng.uniform(0.0, MAX_RANGE, len(ranges)), ranges)
    bearings = np.where(spurious, rng.uniform(-np.pi, np.pi, len(ranges)), bearings)
    return ranges, wrap_angle(bearings)


def row(kind: str, n_blocks: int, n_logs: int) -> dict[str, str]:
    """Return shares of intervals that hold the truth, per parameter."""
    shared, spurious_rate = KINDS[kind]
    truth = {**TRUTH, "spurious_rate": spurious_rate}
    landmarks = LandmarkMap(LANDMARKS)
    held = dict.fromkeys(truth, 0)
    for i in range(n_logs):
        log = simulate(n_blocks, shared, spurious_rate, np.random.default_rng([i, n_blocks, list(KINDS).index(kind)]))
        result = learn_landmark_parameters(
            landmarks, log, fit_scale=False, max_range=MAX_RANGE, block_s=BLOCK_S, seed=i
        )
        for name, value in truth.items():
            low, high = result.intervals[name]
            held[name] += low <= value <= high
    shares = {name: f"{100.0 * n / n_logs:.0f}" for name, n in held.items()}
    print(kind, n_blocks, shares, file=sys.stderr, flush=True)
    return {"sightings": kind, "blocks": str(n_blocks), **shares}


def main() -> None:
    """Print the table."""
    n_logs = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    blocks = [int(word) for word in sys.argv[2:]] or (4, 6, 12, 24)
    print_table([row(kind, n_blocks, n_logs) for kind in KINDS for n_blocks in blocks])


if __name__ == "__main__":
    set_threads(1)
    main()
