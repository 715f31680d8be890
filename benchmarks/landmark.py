"""Time the landmark model, in ns per pose x detection, beside the same formula written with NumPy.

Run: python benchmarks/landmark.py
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from beamfield.detections import Detections
from beamfield.kernels.threads import set_threads
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from tables import least_seconds, print_table

N_POSES, N_DETECTIONS = 20_000, 20
N_ASSIGNMENT_POSES = 500
PARAMETERS = LandmarkParameters(sigma_range=0.2, sigma_bearing=0.03, spurious_rate=0.05, max_range=30.0)


def run() -> list[dict[str, Any]]:
    """Return one row per correspondence: what, poses, detections, threads, ns per pose x detection."""
    rng = np.random.default_rng(7)
    landmarks = LandmarkMap(rng.uniform(0.0, 20.0, (N_DETECTIONS, 2)))
    truth = np.array([9.0, 8.0, 0.7])
    poses = truth + rng.normal(0.0, [1.0, 1.0, 0.5], (N_POSES, 3))
    known = LandmarkModel(landmarks, PARAMETERS, correspondence="known")
    z = known.sample(truth, rng)[0]
    np.testing.assert_allclose(known.log_likelihood(z, poses), numpy_log_likelihood(landmarks, z, poses), rtol=1e-9)
    rows = [row("known, NumPy closed form", N_POSES, 1, lambda: numpy_log_likelihood(landmarks, z, poses))]
    rows.append(row("known", N_POSES, 1, lambda: known.log_likelihood(z, poses)))
    with set_threads(None):
        rows.append(row("known", N_POSES, "all", lambda: known.log_likelihood(z, poses)))
    unknown = z.without_ids()
    for how, n in (("nearest", N_POSES), ("sum", N_POSES), ("assignment", N_ASSIGNMENT_POSES)):
        model = LandmarkModel(landmarks, PARAMETERS, correspondence=how)
        rows.append(
            row(f"{how}, {N_DETECTIONS} landmarks", n, 1, lambda m=model, n=n: m.log_likelihood(unknown, poses[:n]))
        )
    return rows


def main() -> None:
    """Print the rows as a Markdown table."""
    print_table(run())


def row(what: str, n_poses: int, threads: Any, call: Callable[[], object]) -> dict[str, Any]:
    seconds = least_seconds(call, 7)
    return {
        "correspondence": what,
        "poses": n_poses,
        "detections": N_DETECTIONS,
        "threads": threads,
        "ns per pose x detection": round(seconds / (n_poses * N_DETECTIONS) * 1e9, 1),
    }


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
