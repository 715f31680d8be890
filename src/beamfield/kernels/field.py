"""Likelihood fields (section 6.4): distances, the value of one beam, its table over all cells, and sums over beams.

The look-up here is the nearest one: it reads a table of the beam's logarithm, one 32-bit integer per cell, so that a
beam costs a rotation and a load, no exp and no log. `smooth_field` interpolates the distance instead.

Positions in a table are (col, row) in cells from its lower-left corner. The table of codes has a frame of one cell for
all that lies off it, so that limits replace branches.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import quick_sin_cos
from beamfield.kernels.jit import fast_kernel, inlined_fast_kernel, kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Codes = NDArray[np.int32]

INV_SQRT_2PI = 0.3989422804014327
# exp underflows to 0 below this: Table 6.3 in double precision calls such a reading impossible, and so do we.
SMALLEST_EXPONENT = -745.0
# Codes lie in [0, LARGEST_CODE], so that four of them can be added in 32 bits; this other one stands for -inf.
LARGEST_CODE = 2**29 - 1
IMPOSSIBLE = -1
# Poses that are scored together, beam by beam: what one beam of them reads lies close together if they do, and their
# coordinates stay in a near cache. 256 to 1024 are equally fast.
BLOCK = 512
# Beams whose codes are added in one go: fewer loads and stores of the sums.
GROUP = 4
# Positions are limited to this many cells: far off any table, and far from the limits of single precision.
FAR_OFF = 1e9

# Up to this many cells, a distance whose last digit is wrong still tells its whole square.
WHOLE_SQUARES = 1024.0

# Beyond this heading the reduction to a quarter turn loses digits; such poses take the library's functions.
LARGE_HEADING = 1e5


class FieldView(NamedTuple):
    """What one beam's value depends on besides the distance."""

    z_hit: float
    sigma_hit: float
    rand: float
    """z_rand / z_max, the constant of line 8 of Table 6.3."""
    log_rand: float
    """Its logarithm; -inf for 0."""
    reach: float
    """Distance from which on a hit cannot be told from nothing; inf to compute it everywhere."""


class FrameView(NamedTuple):
    """How the map frame becomes coordinates of a table."""

    x: float
    y: float
    cos: float
    sin: float
    yaw: float
    cells_per_metre: float
    offset: float
    """Width of what surrounds the map in the table, in cells."""


# --- distances --------------------------------------------------------------------------------------------------------


@kernel
def _exact_distance(cells: float) -> float:
    """Return a distance between cells' centres, given in single precision and in cells, in double precision.

    Its square is a whole number, which is found again. Any other distance (cut off, or too large) is returned as it is.
    """
    square = cells * cells
    whole = np.floor(square + 0.5)
    return math.sqrt(whole) if cells < WHOLE_SQUARES and abs(square - whole) <= 4e-7 * square else cells


# --- one beam ---------------------------------------------------------------------------------------------------------


@kernel
def log_value(distance: float, view: FieldView) -> float:
    """Return log(z_hit prob(dist, sigma_hit) + z_rand / z_max): line 8 of Table 6.3; -inf where that is 0."""
    if distance >= view.reach or view.z_hit == 0.0:
        return view.log_rand
    u = distance / view.sigma_hit
    exponent = -0.5 * u * u
    peak = view.z_hit * INV_SQRT_2PI / view.sigma_hit
    if view.rand > 0.0:
        return math.log(peak * math.exp(exponent) + view.rand)
    return math.log(peak) + exponent if exponent > SMALLEST_EXPONENT else -math.inf


@kernel
def fill_end_points(ranges: Floats, mounts: Floats, shortest: float, longest: float, cells_per_metre: float,
                    beams: NDArray[np.int64], out: Floats) -> int:  # fmt: skip
    """Fill in which beams have an end point, and the end points (2, m) in the robot frame, in cells: (6.32) at pose 0.

    `beams` (k,) and `out` (2, k) offer room for all; the number that was needed is returned.
    """
    m = 0
    for k in range(ranges.size):
        if shortest <= ranges[k] < longest:
            theta = mounts[k, 2]
            sine, cosine = quick_sin_cos(theta) if abs(theta) < LARGE_HEADING else (math.sin(theta), math.cos(theta))
            u = (mounts[k, 0] + ranges[k] * cosine) * cells_per_metre
            v = (mounts[k, 1] + ranges[k] * sine) * cells_per_metre
            out[0, m], out[1, m] = min(max(u, -FAR_OFF), FAR_OFF), min(max(v, -FAR_OFF), FAR_OFF)
            beams[m] = k
            m += 1
    return m


# --- nearest cell: tables ---------------------------------------------------------------------------------------------


@kernel
def encode(value: float, low: float, step: float) -> int:
    """Return the code of a logarithm: multiples of `step` above `low`."""
    return IMPOSSIBLE if value == -math.inf else math.floor((value - low) / step + 0.5)


@kernel
def fill_codes(distance: Singles, resolution: float, view: FieldView, low: float, step: float, out: Codes) -> None:
    """Fill out (rows, cols) with the codes of `log_value`. Neighbours often repeat a distance, which is then free."""
    for i in range(distance.shape[0]):
        last, code = -1.0, 0
        for j in range(distance.shape[1]):
            d = distance[i, j]
            if d != last:
                metres = _exact_distance(d / resolution) * resolution
                last, code = d, encode(log_value(metres, view), low, step)
            out[i, j] = code


@kernel
def place(poses: Floats, frame: FrameView, x: Singles, y: Singles, c: Singles, s: Singles) -> bool:
    """Fill x, y, c, s (n,) with position in the table and direction of poses (n, 3), in single precision.

    Return whether all poses are finite; those that are not are placed far off.
    """
    # Copied first: only loops over arrays without gaps are vectorised.
    n = x.size
    px, py, heading = np.empty(n), np.empty(n), np.empty(n)
    # Comparisons are written so that they are False for NaN.
    usual = 0
    for i in range(n):
        px[i], py[i], heading[i] = poses[i, 0] - frame.x, poses[i, 1] - frame.y, poses[i, 2] - frame.yaw
        usual += 1 if abs(heading[i]) < LARGE_HEADING else 0
    for i in range(n):
        u = (px[i] * frame.cos + py[i] * frame.sin) * frame.cells_per_metre + frame.offset
        v = (py[i] * frame.cos - px[i] * frame.sin) * frame.cells_per_metre + frame.offset
        usual += 1 if abs(u) < FAR_OFF else 0
        usual += 1 if abs(v) < FAR_OFF else 0
        x[i] = np.float32(u if abs(u) < FAR_OFF else FAR_OFF)
        y[i] = np.float32(v if abs(v) < FAR_OFF else FAR_OFF)
    for i in range(n):
        sine, cosine = quick_sin_cos(heading[i])
        s[i], c[i] = np.float32(sine), np.float32(cosine)
    return usual == 3 * n or _place_unusual(poses, heading, x, y, c, s)


@kernel
def _place_unusual(poses: Floats, heading: Floats, x: Singles, y: Singles, c: Singles, s: Singles) -> bool:
    """Do as `place` for the directions of large headings and for poses that are not finite."""
    all_finite = True
    for i in range(x.size):
        if math.isfinite(poses[i, 0]) and math.isfinite(poses[i, 1]) and math.isfinite(heading[i]):
            s[i], c[i] = np.float32(math.sin(heading[i])), np.float32(math.cos(heading[i]))
        else:
            all_finite = False
            x[i], y[i], s[i], c[i] = FAR_OFF, FAR_OFF, 0.0, 1.0
    return all_finite


@inlined_fast_kernel
def cell_of(x: np.float32, y: np.float32, c: np.float32, s: np.float32, along: np.float32, across: np.float32,
            limits: tuple[int, int]) -> np.uint32:  # fmt: skip
    """Return the index of the cell that holds the end point of a beam (6.32); see `_fill_cells`."""
    zero, stride = np.float32(0.0), np.int32(limits[1])
    top, right = np.float32(limits[0] - 1), np.float32(limits[1] - 1)
    u = x + c * along - s * across
    v = y + s * along + c * across
    u = u if u > zero else zero
    u = u if u < right else right
    v = v if v > zero else zero
    v = v if v < top else top
    return np.uint32(np.int32(v) * stride + np.int32(u))


@fast_kernel
def _fill_cells(x: Singles, y: Singles, c: Singles, s: Singles, along: np.float32, across: np.float32,
               limits: tuple[int, int], out: NDArray[np.uint32]) -> None:  # fmt: skip
    """Fill out (n,) with the index of the cell that holds the end point of one beam (6.32), seen from n poses.

    `along` and `across` are the end point in the robot frame, in cells, at most FAR_OFF; `limits` the table's rows and
    columns.
    """
    for i in range(x.size):
        out[i] = cell_of(x[i], y[i], c[i], s[i], along, across, limits)


@kernel
def fill_scan_sums(poses: Floats, frame: FrameView, ends: Singles, codes: Codes, low: float, step: float, out: Floats
                   ) -> bool:  # fmt: skip
    """Fill out (n,) with the sum over beams of the table's values, for end points (2, k) in the robot frame, in cells.

    The codes are added as integers: exactly, whatever the order. No code may be IMPOSSIBLE. Return whether all poses
    are finite; the sums of others mean nothing.
    """
    x, y = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    c, s = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    # Whole pairs are read, the last one even if only half of it is in use.
    cells, total = np.zeros((GROUP, BLOCK), np.uint32), np.empty(BLOCK, np.int64)
    pairs = cells.view(np.uint64)
    flat, limits, k = codes.ravel(), codes.shape, ends.shape[1]
    grouped, all_finite = k - k % GROUP, True
    for start in range(0, poses.shape[0], BLOCK):
        n = min(BLOCK, poses.shape[0] - start)
        all_finite &= place(poses[start : start + n], frame, x[:n], y[:n], c[:n], s[:n])
        total[:] = 0
        for j in range(0, grouped, GROUP):
            for g in range(GROUP):
                _fill_cells(x[:n], y[:n], c[:n], s[:n], ends[0, j + g], ends[1, j + g], limits, cells[g, :n])
            m = (n + 1) // 2
            _add_four(flat, pairs[0, :m], pairs[1, :m], pairs[2, :m], pairs[3, :m], total)
        for j in range(grouped, k):
            _fill_cells(x[:n], y[:n], c[:n], s[:n], ends[0, j], ends[1, j], limits, cells[0, :n])
            for i in range(n):
                total[i] += np.int64(flat[cells[0, i]])
        for i in range(n):
            out[start + i] = k * low + step * total[i]
    return all_finite


@kernel
def fill_range_sums(poses: Floats, packed: Floats, ranges: Floats, mounts: Floats, shortest: float, longest: float,
                    codes: Codes, out: Floats) -> bool:  # fmt: skip
    """Do as `fill_scan_sums` for ranges (k,) and mounts (k, 3); frame, low and step come in one array (9,).

    All in one kernel, and few arguments: for 2000 poses handing over takes a tenth of the time otherwise.
    """
    frame = FrameView(packed[0], packed[1], packed[2], packed[3], packed[4], packed[5], packed[6])
    singles = np.empty((2, ranges.size), np.float32)
    n = _fill_single_ends(ranges, mounts, shortest, longest, frame.cells_per_metre, singles)
    return fill_scan_sums(poses, frame, singles[:, :n], codes, packed[7], packed[8], out)


@kernel
def _fill_single_ends(ranges: Floats, mounts: Floats, shortest: float, longest: float, cells_per_metre: float,
                     out: Singles) -> int:  # fmt: skip
    """Fill out (2, n <= k) as `fill_end_points` does, in single precision; return n."""
    ends, beams = np.empty((2, ranges.size)), np.empty(ranges.size, np.int64)
    n = fill_end_points(ranges, mounts, shortest, longest, cells_per_metre, beams, ends)
    for j in range(n):
        out[0, j], out[1, j] = np.float32(ends[0, j]), np.float32(ends[1, j])
    return n


@kernel
def _add_four(flat: Codes, c0: NDArray[np.uint64], c1: NDArray[np.uint64], c2: NDArray[np.uint64],
             c3: NDArray[np.uint64], total: NDArray[np.int64]) -> None:  # fmt: skip
    """Add the codes of four beams to total (2 n,), for (n,) pairs of 32-bit indices.

    The loads of indices and codes are what takes the time: a pair of indices is one load, and four codes, each below
    2^29, are added before they are widened.
    """
    high = np.uint64(32)
    for i in range(c0.size):
        a, b, c, d = c0[i], c1[i], c2[i], c3[i]
        pair = np.int32(flat[np.uint32(a)] + flat[np.uint32(b)])
        total[2 * i] += np.int64(np.int32(pair + np.int32(flat[np.uint32(c)] + flat[np.uint32(d)])))
        pair = np.int32(flat[a >> high] + flat[b >> high])
        total[2 * i + 1] += np.int64(np.int32(pair + np.int32(flat[c >> high] + flat[d >> high])))


@kernel
def fill_beam_values(poses: Floats, frame: FrameView, ends: Singles, codes: Codes, low: float, step: float, out: Floats
                     ) -> None:  # fmt: skip
    """Fill out (n, k) with the table's value for each beam; -inf for IMPOSSIBLE."""
    x, y = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    c, s = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    cells, flat = np.empty(BLOCK, np.uint32), codes.ravel()
    for start in range(0, poses.shape[0], BLOCK):
        n = min(BLOCK, poses.shape[0] - start)
        place(poses[start : start + n], frame, x[:n], y[:n], c[:n], s[:n])
        for j in range(ends.shape[1]):
            _fill_cells(x[:n], y[:n], c[:n], s[:n], ends[0, j], ends[1, j], codes.shape, cells[:n])
            for i in range(n):
                code = flat[cells[i]]
                out[start + i, j] = -math.inf if code == IMPOSSIBLE else low + step * code


# --- distances at end points ------------------------------------------------------------------------------------------


@kernel
def to_table(pose: Floats, frame: FrameView) -> tuple[float, float, float, float]:
    """Return position in the table and direction (cos, sin) of one pose in double precision."""
    dx, dy = pose[0] - frame.x, pose[1] - frame.y
    x = (dx * frame.cos + dy * frame.sin) * frame.cells_per_metre + frame.offset
    y = (dy * frame.cos - dx * frame.sin) * frame.cells_per_metre + frame.offset
    return x, y, math.cos(pose[2] - frame.yaw), math.sin(pose[2] - frame.yaw)


@kernel
def fill_distances(poses: Floats, frame: FrameView, ends: Floats, distance: Singles, far: float, out: Floats) -> None:
    """Fill out (n, k) with the distance of the cell that holds each end point; `far` off the field."""
    rows, cols = distance.shape
    for i in range(poses.shape[0]):
        x, y, c, s = to_table(poses[i], frame)
        for j in range(ends.shape[1]):
            u, v = x + c * ends[0, j] - s * ends[1, j], y + s * ends[0, j] + c * ends[1, j]
            # Written so that NaN, from poses beyond all numbers, counts as off the field.
            if 0.0 <= u < cols and 0.0 <= v < rows:
                out[i, j] = _exact_distance(distance[int(v), int(u)] * frame.cells_per_metre) / frame.cells_per_metre
            else:
                out[i, j] = far
