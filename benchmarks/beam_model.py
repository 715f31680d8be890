"""Time the mixture of the beam model for given ranges, in ns per pose x beam, beside the same written with NumPy.

Run: python benchmarks/beam_model.py
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.special import erf

from beamfield.kernels.many_beams import fill_scan_log_likelihood
from beamfield.kernels.threads import set_threads
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import as_view, beam_log_density, beam_responsibilities
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.sensors import RangeFinder, Scan
from measure import Call, least_seconds
from tables import print_table

MAX_RANGE = 20.0
PARAMETERS = BeamParameters(z_hit=0.6, z_short=0.15, z_max=0.05, z_rand=0.2, sigma_hit=0.2, lambda_short=0.1)
N_BEAMS = 60
N_POSES = 2000


def run() -> list[dict[str, Any]]:
    """Return one row per measurement: what, poses, threads, ns per pose x beam, times faster than NumPy."""
    rng = np.random.default_rng(7)
    grid = office(rng)
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, N_BEAMS, endpoint=False), MAX_RANGE)
    truth = np.array([25.0, 25.0, 0.3])
    model = BeamModel(grid, PARAMETERS)
    scan = model.sample(truth, finder, rng)[0]
    places = {"track": near(truth, rng), "global": anywhere(grid, rng)}
    return [row for name, poses in places.items() for row in given_ranges(name, scan, model.expected(poses, finder))]


def main() -> None:
    """Print the rows as a Markdown table."""
    print_table(run())


def given_ranges(name: str, scan: Scan, expected: np.ndarray) -> list[dict[str, Any]]:
    """Time the mixture alone: expected ranges are there already."""
    view = as_view(PARAMETERS, MAX_RANGE)
    out = np.empty(len(expected))

    def fused() -> np.ndarray:
        fill_scan_log_likelihood(scan.ranges, expected, view, out)
        return out

    closed_form = numpy_log_likelihood(scan.ranges, expected)
    np.testing.assert_allclose(fused(), closed_form, atol=1e-9)
    baseline = least_ns(lambda: numpy_log_likelihood(scan.ranges, expected), expected.size)
    timings = {
        "NumPy closed form": baseline,
        "sum of log densities": least_ns(fused, expected.size),
        "log density per beam": least_ns(
            lambda: beam_log_density(scan.ranges, expected, MAX_RANGE, PARAMETERS), expected.size
        ),
        "responsibilities": least_ns(
            lambda: beam_responsibilities(scan.ranges, expected, MAX_RANGE, PARAMETERS), expected.size
        ),
        "drawing samples": least_ns(
            lambda: sample_beams(expected, MAX_RANGE, PARAMETERS, np.random.default_rng(1)), expected.size
        ),
    }
    return [row(what, name, len(expected), 1, ns, baseline) for what, ns in timings.items()]


def numpy_log_likelihood(ranges: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the same sum written with whole arrays, for ranges below MAX_RANGE or equal to it."""
    p, sigma, rate = PARAMETERS, PARAMETERS.sigma_hit, PARAMETERS.lambda_short
    scale = 1.0 / (sigma * np.sqrt(2.0))
    mass = 0.5 * (erf((MAX_RANGE - expected) * scale) + erf(expected * scale))
    hit = np.exp(-(((ranges - expected) * scale) ** 2)) / (sigma * np.sqrt(2.0 * np.pi) * mass)
    decay = rate * np.exp(-rate * ranges)
    with np.errstate(divide="ignore", invalid="ignore"):
        short = np.where(ranges <= expected, decay / -np.expm1(-rate * expected), 0.0)
    density = p.z_hit * hit + p.z_short * short + p.z_rand / MAX_RANGE
    return np.log(np.where(ranges >= MAX_RANGE, p.z_max, density)).sum(axis=-1)


def office(rng: np.random.Generator) -> OccupancyGrid:
    """Return 1000 x 1000 cells of 5 cm: rooms of 2.5 to 7.5 m with doors and some furniture."""
    cells = np.zeros((1000, 1000), dtype=np.int8)
    walls = np.cumsum(rng.integers(50, 150, 20))
    walls = walls[walls < 990]
    cells[[0, -1], :] = cells[:, [0, -1]] = 100
    cells[walls, :] = cells[:, walls] = 100
    doors = np.concatenate([[0], walls])
    for wall in walls:
        for start in doors:
            cells[wall, start + 10 : start + 30] = 0
            cells[start + 10 : start + 30, wall] = 0
    for row_, col in rng.integers(10, 980, (150, 2)):
        cells[row_ : row_ + 8, col : col + 8] = 100
    cells[490:515, 490:515] = 0
    return OccupancyGrid.from_ros(cells, 0.05)


def near(truth: np.ndarray, rng: np.random.Generator, n: int = N_POSES) -> np.ndarray:
    """Return poses of a filter that tracks."""
    return truth + rng.normal(0.0, [0.15, 0.15, 0.05], (n, 3))


def anywhere(grid: OccupancyGrid, rng: np.random.Generator, n: int = N_POSES) -> np.ndarray:
    """Return poses over all free space."""
    free = np.argwhere(grid.free)
    row_col = free[rng.integers(0, len(free), n)] + rng.uniform(0.0, 1.0, (n, 2))
    return np.column_stack([row_col[:, ::-1] * grid.resolution, rng.uniform(-np.pi, np.pi, n)])


def row(what: str, poses: str, n: int, threads: int | str, ns: float, baseline: float | None) -> dict[str, Any]:
    """Return one line of the table."""
    faster = "" if baseline is None else f"{baseline / ns:.1f}"
    return {
        "what": what,
        "poses": f"{n} {poses}",
        "threads": threads,
        "ns per pose x beam": round(ns, 1),
        "times NumPy": faster,
    }


def least_ns(call: Call, n: int) -> float:
    """Return the least processor time of a call over n pairs, in ns each."""
    return least_seconds(call) / n * 1e9


if __name__ == "__main__":
    set_threads(1)
    main()
