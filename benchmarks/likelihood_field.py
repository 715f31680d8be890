"""The likelihood field's look-ups written with NumPy in single precision, for `make bench`, and its gradient's time.

Run: python benchmarks/likelihood_field.py
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from beam_model import N_BEAMS, anywhere, least_ns, near, office, row
from beamfield.kernels.threads import set_threads
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan
from tables import print_table

MAX_RANGE = 20.0
BEAM_PARAMETERS = BeamParameters(z_hit=0.6, z_short=0.15, z_max=0.05, z_rand=0.2, sigma_hit=0.2, lambda_short=0.1)
PARAMETERS = LikelihoodFieldParameters.from_beam_parameters(BEAM_PARAMETERS)


def run() -> list[dict[str, Any]]:
    """Return one row of the gradient per pattern of poses."""
    rng = np.random.default_rng(7)
    grid = office(rng)
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, N_BEAMS, endpoint=False), MAX_RANGE)
    truth = np.array([25.0, 25.0, 0.3])
    scan = BeamModel(grid, BEAM_PARAMETERS).sample(truth, finder, rng)[0]
    model = LikelihoodFieldModel(grid, PARAMETERS, interpolation="bilinear")
    patterns = {"one, as in climbing": truth[None], "track": near(truth, rng), "global": anywhere(grid, rng)}
    rows = []
    for name, poses in patterns.items():
        call = partial(model.log_likelihood_gradient, scan, poses)
        ns = least_ns(call, len(poses) * N_BEAMS)
        rows.append(row("gradient, bilinear", name, len(poses), 1, ns, None))
    return rows


def main() -> None:
    """Print the rows as a Markdown table."""
    print_table(run())


def numpy_model(grid: OccupancyGrid) -> Callable[[Scan, np.ndarray], np.ndarray]:
    """Return the same look-up with whole arrays: a table of logarithms, end points and indices in single precision.

    It already does what the kernels do to be quick: logarithms in the table, a frame around it and limits instead of
    masks, one flat index, arrays changed in place.
    """
    p = PARAMETERS
    distance = LikelihoodFieldModel(grid, p).distances
    hit = p.z_hit / (p.sigma_hit * np.sqrt(2.0 * np.pi)) * np.exp(-0.5 * (distance.distance / p.sigma_hit) ** 2)
    far = np.log(p.z_rand / MAX_RANGE)
    table = np.pad(np.log(hit + p.z_rand / MAX_RANGE), 1, constant_values=far).astype(np.float32)
    rows, cols = table.shape
    offset, scale = np.float32(distance.margin_cells + 1), 1.0 / grid.resolution

    def log_likelihood(scan: Scan, poses: np.ndarray) -> np.ndarray:
        u, v = end_points(scan, poses, scale, offset)
        np.clip(u, 0, cols - 1, out=u)
        np.clip(v, 0, rows - 1, out=v)
        cells = v.astype(np.int32)
        cells *= cols
        cells += u.astype(np.int32)
        return table.take(cells).sum(axis=1)

    return log_likelihood


def numpy_interpolated(grid: OccupancyGrid) -> Callable[[Scan, np.ndarray], np.ndarray]:
    """Return the look-up by interpolated distance with whole arrays in single precision, in place where it can be."""
    p = PARAMETERS
    field = LikelihoodFieldModel(grid, p).distances
    distance = np.pad(field.distance, 1, mode="edge")
    rows, cols = distance.shape
    # From the centre of the frame's first cell. What lies off the field is far from everything either way.
    offset, scale = np.float32(field.margin_cells + 0.5), 1.0 / grid.resolution
    peak = np.float32(p.z_hit / (p.sigma_hit * np.sqrt(2.0 * np.pi)))
    factor, rand = np.float32(-0.5 / p.sigma_hit**2), np.float32(p.z_rand / MAX_RANGE)

    def log_likelihood(scan: Scan, poses: np.ndarray) -> np.ndarray:
        u, v = end_points(scan, poses, scale, offset)
        np.clip(u, 0, cols - 1.5, out=u)
        np.clip(v, 0, rows - 1.5, out=v)
        col, row = u.astype(np.int32), v.astype(np.int32)
        u -= col
        v -= row
        row *= cols
        row += col
        low, high = distance.take(row), distance.take(row + cols)
        low += u * (distance.take(row + 1) - low)
        high += u * (distance.take(row + (cols + 1)) - high)
        high -= low
        high *= v
        low += high
        low *= low
        low *= factor
        np.exp(low, out=low)
        low *= peak
        low += rand
        return np.log(low, out=low).sum(axis=1)

    return log_likelihood


def end_points(scan: Scan, poses: np.ndarray, scale: float, offset: np.float32) -> tuple[np.ndarray, np.ndarray]:
    """Return the end points (n, k) of all beams that have one, in cells and single precision."""
    keep = scan.ranges < MAX_RANGE
    ranges, bearings = scan.ranges[keep] * scale, scan.finder.bearings[keep]
    along = (ranges * np.cos(bearings)).astype(np.float32)
    across = (ranges * np.sin(bearings)).astype(np.float32)
    heading = poses[:, 2].astype(np.float32)[:, None]
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = (poses[:, :2] * scale).astype(np.float32).T[..., None] + offset
    u = cos * along
    u -= sin * across
    u += x
    v = sin * along
    v += cos * across
    v += y
    return u, v


if __name__ == "__main__":
    set_threads(1)
    main()
