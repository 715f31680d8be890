"""Time the landmark model for features of unknown id on one thread: docs/landmarks.md, Speed.

Run: python benchmarks/landmark.py
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from beamfield.detections import Detections
from beamfield.kernels.threads import set_threads
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from measure import least_seconds
from tables import print_table

N_POSES = 20_000
PARAMETERS = LandmarkParameters(sigma_range=0.2, sigma_bearing=0.03, spurious_rate=0.05, max_range=30.0)


def main() -> None:
    """Print the rows as a Markdown table."""
    rng = np.random.default_rng(7)
    truth = np.array([9.0, 8.0, 0.7])
    poses = truth + rng.normal(0.0, [1.0, 1.0, 0.5], (N_POSES, 3))
    print_table(many_poses(truth, poses, rng), digits=3)


def many_poses(truth: np.ndarray, poses: np.ndarray, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return one row per correspondence: what, landmarks, detections, poses, ns per pose x detection."""
    rows = []
    for how, n, k, few in (
        ("nearest", 20, 20, poses), ("nearest", 500, 5, poses[:2000]),
        ("sum", 20, 20, poses), ("assignment", 20, 20, poses[:500]),
    ):  # fmt: skip
        landmarks, z = world(n, k, truth, rng)
        model, z = LandmarkModel(landmarks, PARAMETERS, correspondence=how), z.without_ids()
        rows.append(row(how, n, z, few, partial(model.log_likelihood, z, few)))
    return rows


def world(n: int, k: int, truth: np.ndarray, rng: np.random.Generator) -> tuple[LandmarkMap, Detections]:
    """Return a map of n landmarks, and what is seen of k of them."""
    landmarks = LandmarkMap(rng.uniform(0.0, 20.0, (n, 2)))
    seen = landmarks.ids[:: n // k]
    return landmarks, LandmarkModel(landmarks, PARAMETERS, correspondence="known").sample(truth, rng, ids=seen)[0]


def row(what: str, n: int, z: Detections, poses: np.ndarray, call: Callable[[], object]) -> dict[str, Any]:
    ns = least_seconds(call) / (len(poses) * len(z)) * 1e9
    shape = {"landmarks": n, "detections": len(z), "poses": len(poses)}
    return {"correspondence": what, **shape, "ns per pose x detection": ns}


def numpy_log_likelihood(landmarks: LandmarkMap, z: Detections, poses: np.ndarray) -> np.ndarray:
    away = landmarks.positions[landmarks.indices_of(z.ids)] - poses[:, None, :2]
    a = (np.hypot(away[..., 0], away[..., 1]) - z.ranges) / PARAMETERS.sigma_range
    turn = np.arctan2(away[..., 1], away[..., 0]) - poses[:, None, 2] - z.bearings
    b = (np.mod(turn + np.pi, 2.0 * np.pi) - np.pi) / PARAMETERS.sigma_bearing
    constant = np.log(2.0 * np.pi * PARAMETERS.sigma_range * PARAMETERS.sigma_bearing)
    return (-0.5 * (a * a + b * b) - constant).sum(axis=1)


if __name__ == "__main__":
    set_threads(1)
    main()
