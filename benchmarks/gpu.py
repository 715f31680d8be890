"""device="cuda" beside the CPU: `python benchmarks/gpu.py [POSES]`; without a GPU it says that nothing was measured.

The map is the building of `raycast.py`, with 60 beams at each pose; learning passes over as many beams. *Whole* is a
call with poses and results in the host's memory; *kernel* what the GPU does of it, on what is in its memory already.
The share of the bandwidth counts 32 bytes, the least that memory hands out, for each look-up or jump, and the 16 of a
beam to learn from: near 1 memory is the limit, beyond 1 the caches serve, far below it instructions are the limit.
Compiling comes before and is timed apart.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numba import cuda

import beamfield as bf
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, theta_of
from beamfield.errors import InvalidInputError, MissingDependencyError
from beamfield.kernels.device import IN_SIMULATOR, require_device

if __package__:
    from benchmarks import raycast
    from benchmarks.measure import least_elapsed
    from benchmarks.tables import print_table
else:
    import raycast
    from measure import least_elapsed
    from tables import print_table

SECTOR_BYTES = 32
# Of a ray in that building; see docs/evidence/raycasting.md.
JUMPS_PER_RAY = 2.4
COPIED_BYTES = 2**30
BEAM_SECTORS = 2 * 8 / SECTOR_BYTES

# Calls on the CPU and on the GPU, one of the kernel alone, and loads of SECTOR_BYTES for each beam.
Work = tuple[list[Callable[[], Any]], Callable[[], Any] | None, float]


def main(n_poses: int) -> None:
    """Print the table, or why there is none."""
    try:
        require_device("cuda")
    except (InvalidInputError, MissingDependencyError) as error:
        print(f"Not measured: {error}")
        return
    if IN_SIMULATOR:
        print("Not measured: NUMBA_ENABLE_CUDASIM is set, and times of the simulator mean nothing.")
        return
    print(f"{cuda.get_current_device().name}, {n_poses} poses, {raycast.N_BEAMS} beams\n")
    print_table(list(run(n_poses)), digits=3)


def run(n_poses: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of the table."""
    rng = np.random.default_rng(1)
    occupied = raycast.building(rng)
    grid = bf.OccupancyGrid(occupied.astype(np.float32), raycast.RESOLUTION)
    half = raycast.FIELD_OF_VIEW / 2
    finder = bf.RangeFinder.from_bearings(np.linspace(-half, half, raycast.N_BEAMS), raycast.MAX_RANGE)
    row, col = np.nonzero(~occupied)
    place = rng.integers(0, len(row), n_poses)
    xy = (np.column_stack([col, row])[place] + rng.random((n_poses, 2))) * raycast.RESOLUTION
    poses = np.column_stack([xy, rng.uniform(-np.pi, np.pi, n_poses)])
    beams = bf.BeamParameters(0.7, 0.1, 0.1, 0.1, sigma_hit=0.1, lambda_short=0.5)
    usual = bf.LikelihoodFieldParameters(0.8, 0.2, 0.1)
    casters = [bf.RayCaster(grid, device=device) for device in ("cpu", "cuda")]
    # Without noise, end points would lie on borders of cells, where rounding alone chooses the cell that is read.
    noise = rng.normal(0.0, 0.02, raycast.N_BEAMS)
    scan = bf.Scan(np.maximum(casters[0].expected_ranges(poses[0], finder) + noise, 0.0), finder)
    models = [bf.BeamModel(grid, beams, caster=caster, device=caster.device) for caster in casters]
    fields = [bf.LikelihoodFieldModel(grid, usual, device=device) for device in ("cpu", "cuda")]
    bandwidth = _bandwidth()
    work: dict[str, Work] = {
        "rays": (
            [lambda c=c: c.expected_ranges(poses, finder) for c in casters],
            _cast_alone(casters[1], poses, finder),
            JUMPS_PER_RAY,
        ),
        "beam model": ([lambda m=m: m.log_likelihood(scan, poses) for m in models], None, JUMPS_PER_RAY),
        "field look-ups": (
            [lambda f=f: f.log_likelihood(scan, poses) for f in fields],
            _look_up_alone(fields[1], scan, poses),
            1.0,
        ),
    }
    work |= _learning(beams, n_poses * raycast.N_BEAMS, rng)
    for name, ((on_cpu, on_gpu), alone, loads) in work.items():
        yield _row(name, on_cpu, on_gpu, alone, loads, n_poses * raycast.N_BEAMS, bandwidth)


def _row(
    name: str, on_cpu: Callable[[], Any], on_gpu: Callable[[], Any], alone: Callable[[], Any] | None, loads: float,
    n: int, bandwidth: float,
) -> dict[str, Any]:  # fmt: skip
    start = time.perf_counter()
    result = on_gpu()
    first = time.perf_counter() - start
    errors = np.abs(result - on_cpu())
    seconds = {"CPU": least_elapsed(on_cpu, 3), "whole": least_elapsed(on_gpu, 7)}
    if alone is not None:
        seconds["kernel"] = least_elapsed(alone, 7)
    row = {"what": name, **{f"{what} [10^9/s]": n / s / 1e9 for what, s in seconds.items()}}
    share = n / seconds["kernel"] * loads * SECTOR_BYTES / bandwidth if alone is not None else ""
    row |= {"largest difference": float(errors.max()), "share beyond 1e-4": float(np.mean(errors > 1e-4))}
    return row | {"first call [s]": first, "share of bandwidth": share}


def _cast_alone(caster: bf.RayCaster, poses: np.ndarray, finder: bf.RangeFinder) -> Callable[[], None]:
    """Return a call that casts at as many of the poses as are in the GPU's memory at a time, and repeats it for all."""
    from beamfield.kernels import cuda_raycast
    from beamfield.kernels.cuda_target import launch
    from beamfield.maps.raycast import _fan, frame_of

    fan, _ = _fan(finder, caster.grid.resolution)
    terrain = caster._terrain(finder.max_range)._replace(table=caster._on_device)
    parts = list(cuda_raycast._placed_parts(poses, frame_of(caster.grid), terrain.resolution, finder.n_beams))
    sensor = cuda.to_device(fan)
    outs = [cuda.device_array((stop - start) * finder.n_beams, np.float64) for start, stop, _ in parts]

    def call() -> None:
        for (_, _, placed), out in zip(parts, outs, strict=True):
            launch(cuda_raycast._cast, out.size, placed, sensor, *terrain, out)
        cuda.synchronize()

    return call


def _look_up_alone(model: bf.LikelihoodFieldModel, scan: bf.Scan, poses: np.ndarray) -> Callable[[], None]:
    """Return a call that adds up codes at all poses."""
    from beamfield.kernels import cuda_field
    from beamfield.kernels.cuda_target import launch

    table, codes = model._look_ups.tables.table_on_device(scan.finder.max_range)
    _, ends = model._look_ups.end_points(scan)
    sent, frame = cuda.to_device(poses), model._look_ups.tables.framed
    beams, sums = cuda.to_device(ends.astype(np.float32)), cuda.device_array(len(poses), np.float64)

    def call() -> None:
        rest = codes, table.codes.shape, table.low, table.step, sums
        launch(cuda_field._add_codes, len(poses), sent, frame, beams, *rest)
        cuda.synchronize()

    return call


def _learning(truth: bf.BeamParameters, n: int, rng: np.random.Generator) -> dict[str, Work]:
    """Return the passes over n beams; their results are per beam."""
    expected = rng.uniform(0.1, raycast.MAX_RANGE, n)
    z = np.where(rng.random(n) < truth.z_hit, rng.normal(expected, truth.sigma_hit), rng.uniform(0.0, expected))
    z, theta = np.clip(z, 0.0, raycast.MAX_RANGE), theta_of(truth)
    both = [IntrinsicLikelihood(z, expected, raycast.MAX_RANGE, device=device) for device in ("cpu", "cuda")]

    def em_pass(likelihood: IntrinsicLikelihood) -> np.ndarray:
        statistics = likelihood.expected_statistics(theta)
        return np.array([statistics.log_likelihood, *statistics.counts]) / n

    def newton_pass(likelihood: IntrinsicLikelihood) -> np.ndarray:
        value, gradient, _ = likelihood.derivatives(theta)
        return np.array([value, *gradient]) / n

    calls = {"EM pass": em_pass, "Newton pass": newton_pass}
    return {
        name: ([lambda x=x, call=call: call(x) for x in both], _pass_alone(both[1], theta, name), BEAM_SECTORS)
        for name, call in calls.items()
    }


def _pass_alone(likelihood: IntrinsicLikelihood, theta: np.ndarray, name: str) -> Callable[[], None]:
    """Return a call of the kernel over bins that are cut and sent already."""
    from beamfield.kernels import cuda_em

    kernel, n_sums = (cuda_em._em, cuda_em.EM_SUMS) if name == "EM pass" else (cuda_em._newton, cuda_em.NEWTON_SUMS)
    bins, mixture, beams = likelihood._cut(theta), likelihood._mixture(theta), likelihood._on_device
    sums, bins = cuda.device_array((len(bins.starts), n_sums), np.float64), bins._make(map(cuda.to_device, bins))

    def call() -> None:
        cuda_em.launch_over_bins(kernel, beams, mixture, bins, sums)
        cuda.synchronize()

    return call


def _bandwidth() -> float:
    """Return how many bytes per second the GPU's memory reads and writes in a copy."""
    source, target = (cuda.device_array(COPIED_BYTES, np.uint8) for _ in range(2))

    def copy() -> None:
        target.copy_to_device(source)
        cuda.synchronize()

    return 2 * COPIED_BYTES / least_elapsed(copy, 5)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200_000)
