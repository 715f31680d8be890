"""Ray casting on a GPU, one ray a thread: `exact_rays._trace_ray`, the exact walk in float64, from the same source.

Poses are placed by the CPU's kernel, and no product that makes a ray is fused with a sum: so ranges have the same bits
as the CPU's. In the walk, fusing may change the guess of `_edges_before`, which is corrected, and the last digit of the
difference that is compared with TIE.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from beamfield.kernels import beam, exact_rays
from beamfield.kernels.beam import BeamView
from beamfield.kernels.cuda_target import allocate, download, launch, on_device, product, upload
from beamfield.kernels.elementary import split as cpu_split
from beamfield.kernels.exact_rays import Terrain
from beamfield.kernels.placed_poses import place_poses
from beamfield.kernels.threads import run_in_blocks

Floats = NDArray[np.float64]
log_mixture, split, trace_ray = on_device(beam.log_mixture), on_device(cpu_split), on_device(exact_rays._trace_ray)

# Rays whose ranges are in the GPU's memory at a time: 128 MB.
RAYS_TOGETHER = 2**24
# Poses are placed that much quicker than rays are cast on the CPU.
PLACED_PER_WORK_UNIT = 4


def cast_fan(poses: Floats, frame: tuple[float, float, float], fan: Floats, terrain: Terrain, out: Floats) -> None:
    """Do what `raycast.cast_fan` does; `terrain.table` is on the device."""
    k = fan.shape[1] - 8
    sensor = upload(fan)
    for start, stop, placed in _placed_parts(poses, frame, terrain.resolution, k):
        ranges = allocate((stop - start) * k)
        launch(_cast, ranges.size, placed, sensor, *terrain, ranges)
        download(ranges, out[start * k : stop * k])


def fill_scan_log_likelihood(
    poses: Floats, frame: tuple[float, float, float], fan: Floats, terrain: Terrain, ranges: Floats, view: BeamView,
    out: Floats,
) -> None:  # fmt: skip
    """Do what `many_beams.fill_scan_log_likelihood` does at poses (n, 3), whose expected ranges never leave the device.

    `ranges` (k,) are counted from `view.min_range`; the ranges of `terrain` are not.
    """
    k = fan.shape[1] - 8
    sensor, readings = upload(fan), upload(ranges)
    parameters = upload(np.array(view, np.float64))
    for start, stop, placed in _placed_parts(poses, frame, terrain.resolution, k):
        each, sums = allocate(stop - start, k), allocate(stop - start)
        launch(_score, each.size, placed, sensor, *terrain, readings, parameters, each)
        launch(_add_up, sums.size, each, sums)
        download(sums, out[start:stop])


def _placed_parts(
    poses: Floats, frame: tuple[float, float, float], resolution: float, k: int
) -> Iterator[tuple[int, int, Any]]:
    """Yield start and stop of parts of the poses, and these poses placed, on the device."""
    step = max(1, RAYS_TOGETHER // k)
    for start in range(0, len(poses), step):
        part = poses[start : start + step]
        placed = np.empty((len(part), 4))
        work = partial(_place, part, frame, resolution, placed)
        run_in_blocks(work, len(part), work_per_row=1.0 / PLACED_PER_WORK_UNIT)
        yield start, start + len(part), upload(placed)


def _place(
    poses: Floats, frame: tuple[float, float, float], resolution: float, out: Floats, start: int, stop: int
) -> None:
    place_poses(poses[start:stop], frame, resolution, out[start:stop])


@cuda.jit(device=True)
def _range(placed, fan, r, terrain):  # type: ignore[no-untyped-def]
    """Return the range of ray r in metres: as `exact_rays.trace_fan`."""
    k = fan.shape[1] - 8
    i = r // k
    b = r - i * k
    x, y, c, s = placed[i, 0], placed[i, 1], placed[i, 2], placed[i, 3]
    fan_x, fan_y, fan_c, fan_s = fan[0, b], fan[1, b], fan[2, b], fan[3, b]
    cell_x, offset_x = split(x + (product(c, fan_x) - product(s, fan_y)))
    cell_y, offset_y = split(y + (product(s, fan_x) + product(c, fan_y)))
    beam_c, beam_s = product(c, fan_c) - product(s, fan_s), product(s, fan_c) + product(c, fan_s)
    metres, _, _ = trace_ray(cell_x, cell_y, offset_x, offset_y, beam_c, beam_s, terrain)
    return metres


@cuda.jit
def _cast(placed, fan, table, rows, cols, resolution, max_range, max_cells, out):  # type: ignore[no-untyped-def]
    """Fill out (n k,) with the ranges of k beams from n placed poses."""
    r = cuda.grid(1)
    if r < out.size:
        out[r] = _range(placed, fan, r, Terrain(table, rows, cols, resolution, max_range, max_cells))


@cuda.jit
def _score(placed, fan, table, rows, cols, resolution, max_range, max_cells, readings, p, out):  # type: ignore[no-untyped-def]
    """Fill out (n, k) with the logarithm of the mixture for each beam."""
    r = cuda.grid(1)
    if r < out.size:
        terrain = Terrain(table, rows, cols, resolution, max_range, max_cells)
        view = BeamView(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9])
        z_star = max(_range(placed, fan, r, terrain) - view.min_range, 0.0)
        i = r // out.shape[1]
        b = r - i * out.shape[1]
        out[i, b] = log_mixture(readings[b], min(z_star, view.max_range), view)


@cuda.jit
def _add_up(each, out):  # type: ignore[no-untyped-def]
    """Fill out (n,) with the sums of the rows of each (n, k), in order."""
    i = cuda.grid(1)
    if i < out.size:
        total = 0.0
        for b in range(each.shape[1]):
            total += each[i, b]
        out[i] = total
