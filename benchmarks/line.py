"""Time the model of straight lines, in ns per pose x line, beside the same formula written with NumPy.

Run: python benchmarks/line.py
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from beamfield.kernels.threads import set_threads
from beamfield.maps.lines import LineMap
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from measure import least_seconds
from tables import print_table

N_POSES, N_LINES = 20_000, 20
N_ASSIGNMENT_POSES = 500
PARAMETERS = LineParameters(sigma_rho=0.05, sigma_alpha=0.03, spurious_rate=0.05, max_range=30.0)


def run() -> list[dict[str, Any]]:
    """Return one row per correspondence: what, poses, lines, threads, ns per pose x line."""
    rng = np.random.default_rng(7)
    walls = LineMap.from_segments(rng.uniform(0.0, 20.0, (N_LINES, 4)))
    truth = np.array([9.0, 8.0, 0.7])
    poses = truth + rng.normal(0.0, [1.0, 1.0, 0.5], (N_POSES, 3))
    known = LineModel(walls, PARAMETERS, correspondence="known")
    seen = known.sample(truth, rng)[0]
    ends = np.tile([0.0, 0.0, 1.0, 0.0], (N_LINES, 1))
    z = LineDetections(seen.lines, segments=ends, ids=seen.ids)
    np.testing.assert_allclose(known.log_likelihood(z, poses), numpy_log_likelihood(walls, z, poses), rtol=1e-9)
    rows = [row("known, NumPy", N_POSES, 1, lambda: numpy_log_likelihood(walls, z, poses))]
    rows.append(row("known", N_POSES, 1, lambda: known.log_likelihood(z, poses)))
    unknown = z.without_ids()
    for how, n, overlap in (
        ("nearest", N_POSES, None),
        ("nearest", N_POSES, 0.5),
        ("sum", N_POSES, None),
        ("assignment", N_ASSIGNMENT_POSES, None),
    ):
        model = LineModel(walls, PARAMETERS, correspondence=how, min_overlap=overlap)
        what = f"{how}, {N_LINES} mapped lines" + (", min_overlap" if overlap else "")
        rows.append(row(what, n, 1, lambda m=model, n=n: m.log_likelihood(unknown, poses[:n])))
    return rows


def main() -> None:
    """Print the rows as a Markdown table."""
    print_table(run())


def row(what: str, n_poses: int, threads: Any, call: Callable[[], object]) -> dict[str, Any]:
    seconds = least_seconds(call)
    return {
        "correspondence": what,
        "poses": n_poses,
        "lines": N_LINES,
        "threads": threads,
        "ns per pose x line": round(seconds / (n_poses * N_LINES) * 1e9, 1),
    }


def numpy_log_likelihood(walls: LineMap, z: LineDetections, poses: np.ndarray) -> np.ndarray:
    rho, alpha = walls.lines[walls.indices_of(z.ids)].T
    d = rho - poses[:, :1] * np.cos(alpha) - poses[:, 1:2] * np.sin(alpha)
    turn = z.lines[:, 1] - alpha + poses[:, 2:]
    one, other = (np.mod(angle + np.pi, 2.0 * np.pi) - np.pi for angle in (turn, turn + np.pi))
    squares = [
        ((z.lines[:, 0] - signed) / PARAMETERS.sigma_rho) ** 2 + (error / PARAMETERS.sigma_alpha) ** 2
        for signed, error in ((d, one), (-d, other))
    ]
    constant = np.log(2.0 * np.pi * PARAMETERS.sigma_rho * PARAMETERS.sigma_alpha)
    return (np.logaddexp(-0.5 * squares[0], -0.5 * squares[1]) - constant).sum(axis=1)


if __name__ == "__main__":
    set_threads(1)
    main()
