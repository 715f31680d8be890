"""Run by `test_cuda`: how far results of device="cuda" are from the CPU's, as JSON.

On a GPU, or in Numba's CUDA simulator, as the environment says.
"""

from __future__ import annotations

import json
import pickle
import sys
from typing import Any
from unittest import mock

import numpy as np
from numba import cuda

import beamfield as bf
from beamfield.calibration.intrinsic.likelihood import ExpectedStatistics, IntrinsicLikelihood
from beamfield.errors import InvalidInputError

ROOM = """
########################
#......................#
#......................#
#...##.................#
#...##........#........#
#..............#.......#
#..................????#
#.....#............????#
#.......................
########################
"""


def results() -> dict[str, Any]:
    cells = {"#": 100, ".": 0, "?": -1}
    room = np.array([[cells[cell] for cell in row] for row in ROOM.split()])
    grid = bf.OccupancyGrid.from_ros(room, resolution=0.1, origin=(0.3, -0.2, 0.4))
    rng = np.random.default_rng(13)
    poses = np.column_stack([rng.uniform(-0.5, 2.5, (24, 2)), rng.uniform(-9.0, 9.0, 24)])
    # On a cell's corner; off the map; after many turns.
    poses[:3] = (0.3, -0.2, 0.4 + np.pi / 4), (-9.0, -9.0, 0.8), (1.3, 0.7, 3e6)
    mounts = np.column_stack([rng.uniform(-0.2, 0.2, (9, 2)), np.linspace(-2.0, 2.0, 9)])
    finder = bf.RangeFinder(mounts, max_range=2.0, min_range=0.1)
    scan = bf.Scan([np.nan, 2.5, 0.05, 0.3, 0.7, 1.0, 1.4, 1.9, 0.11], finder)
    found = _rays(grid, poses, finder) | _beam_model(grid, poses, scan) | _fields(grid, poses, scan) | _learning(rng)
    return found | _without_memory(grid)


def _without_memory(grid: bf.OccupancyGrid) -> dict[str, str]:
    with mock.patch.object(cuda, "to_device", side_effect=RuntimeError("CUDA_ERROR_OUT_OF_MEMORY")):
        try:
            bf.RayCaster(grid, device="cuda")
        except InvalidInputError as error:
            return {"without memory": str(error)}
    return {}


def _rays(grid: bf.OccupancyGrid, poses: np.ndarray, finder: bf.RangeFinder) -> dict[str, float]:
    cpu = [bf.RayCaster(grid, unknown=unknown) for unknown in ("free", "occupied")]
    found = {"CUDA is loaded for the CPU": int("beamfield.kernels.cuda_target" in sys.modules)}
    gpu = [bf.RayCaster(grid, unknown=caster.unknown, device="cuda") for caster in cpu]
    gpu[0] = pickle.loads(pickle.dumps(gpu[0]))
    pairs = list(zip(cpu, gpu, strict=True))
    fans = [(a.expected_ranges(poses, finder), b.expected_ranges(poses, finder)) for a, b in pairs]
    single = [(a.cast(poses, 2.0), b.cast(poses, 2.0)) for a, b in pairs]
    found["ranges that differ"] = sum(int(np.sum(a != b)) for a, b in fans + single)
    found["ranges of walls"] = int(np.sum(fans[0][1] < 2.0))
    return found


def _beam_model(grid: bf.OccupancyGrid, poses: np.ndarray, scan: bf.Scan) -> dict[str, float]:
    parameters = bf.BeamParameters(0.7, 0.1, 0.1, 0.1, sigma_hit=0.05, lambda_short=0.5)
    certain = bf.BeamParameters(0.9, 0.0, 0.1, 0.0, sigma_hit=0.02, lambda_short=0.5)
    found = {}
    for name, given in (("mixture", parameters), ("only hits", certain)):
        cpu, gpu = (bf.BeamModel(grid, given, exponent=0.5, n_beams=5, device=device) for device in ("cpu", "cuda"))
        found[name] = _error(cpu.log_likelihood(scan, poses), gpu.log_likelihood(scan, poses))
    return found


def _fields(grid: bf.OccupancyGrid, poses: np.ndarray, scan: bf.Scan) -> dict[str, float]:
    usual, certain = bf.LikelihoodFieldParameters(0.8, 0.2, 0.05), bf.LikelihoodFieldParameters(1.0, 0.0, 0.01)
    found, impossible = {}, 0
    for name, parameters, unknown in (("field", usual, "uniform"), ("impossible", certain, "free")):
        cpu, gpu = (bf.LikelihoodFieldModel(grid, parameters, unknown=unknown, device=d) for d in ("cpu", "cuda"))
        expected = cpu.log_likelihood(scan, poses)
        found[name] = _error(expected, gpu.log_likelihood(scan, poses))
        impossible += int(np.sum(expected == -np.inf))
        empty = bf.Scan(np.full(scan.finder.n_beams, np.nan), scan.finder)
        found[f"no scan, {name}"] = float(np.abs(gpu.log_likelihood(empty, poses)).max())
    return found | {"scans that are impossible": impossible}


def _learning(rng: np.random.Generator) -> dict[str, float]:
    # A bin where hits are cut at 0, one between, one where they are cut at the maximum range; fewer beams than threads,
    # and more.
    expected = np.repeat([0.15, 0.9, 1.92], [20, 70, 40]) + rng.uniform(0.0, 1e-3, 130)
    z = np.clip(rng.normal(expected, 0.03), 0.1, 2.0)
    z[::5] = rng.uniform(0.1, 2.0, 26)
    counts = rng.integers(0, 3, 130).astype(float)
    found = {}
    for name, theta, min_range, weights in (
        ("mixture", [0.6, 0.2, 0.1, 0.1, 1e-3, 0.0, 0.0, 0.5], 0.0, counts),
        ("slope", [0.6, 0.2, 0.1, 0.1, 1e-3, 1e-4, 0.01, 0.0], 0.1, None),
        ("far too narrow", [0.9, 0.0, 0.1, 0.0, 3e-4, 0.0, 0.0, 3.0], 0.0, None),
        ("impossible", [0.0, 0.9, 0.1, 0.0, 1e-3, 0.0, 0.0, 1.0], 0.0, None),
    ):
        cpu, gpu = (
            IntrinsicLikelihood(z, expected, 2.0, min_range=min_range, weights=weights, device=device)
            for device in ("cpu", "cuda")
        )
        a, b = (likelihood.expected_statistics(np.array(theta), slope_is_free=True) for likelihood in (cpu, gpu))
        found[f"E-step, {name}"] = max(_error(u, v) for u, v in zip(_numbers(a), _numbers(b), strict=True))
        a, b = (_scaled(*likelihood.derivatives(np.array(theta))) for likelihood in (cpu, gpu))
        found[f"Newton, {name}"] = max(_error(u, v) for u, v in zip(a, b, strict=True))
    a, b = (
        bf.learn_intrinsic_parameters(z, expected, 2.0, n_starts=1, tolerance=1e-3, device=device)
        for device in ("cpu", "cuda")
    )
    found["fit"] = _error(
        *(np.array([x.log_likelihood, *x.parameters.weights, x.parameters.sigma_hit]) for x in (a, b))
    )
    found["iterations"], found["iterations on the CPU"] = b.iterations, a.iterations
    nothing = IntrinsicLikelihood(np.full(3, 2.0), expected[:3], 2.0, device="cuda")
    found["no returns"] = nothing.expected_statistics(np.array(theta)).log_likelihood - 3.0 * np.log(0.1)
    return found


def _numbers(statistics: ExpectedStatistics) -> list[np.ndarray]:
    return [np.asarray(number, float) for number in vars(statistics).values()]


def _scaled(value: float, gradient: np.ndarray, hessian: np.ndarray) -> list[np.ndarray]:
    # An entry off the diagonal may cancel out; it is as exact as those on the diagonal let it be.
    root = np.sqrt(np.maximum(np.abs(np.diag(hessian)), 1.0))
    return [np.asarray(value), gradient, hessian / np.outer(root, root)]


def _error(expected: np.ndarray, got: np.ndarray) -> float:
    """Return the largest difference, relative where numbers are large; inf if -inf is not at the same places."""
    if not np.array_equal(np.isinf(expected), np.isinf(got)) or np.isnan(got).any():
        return np.inf
    finite = np.isfinite(expected)
    expected, got = expected[finite], got[finite]
    return float(np.max(np.abs(expected - got) / np.maximum(1.0, np.abs(expected)), initial=0.0))


if __name__ == "__main__":
    print(json.dumps(results()))  # noqa: T201
