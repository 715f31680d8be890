"""Sums over many beams of the beam model's formulas (`beam`), looked up: for one scan at very many poses.

The reading of a beam is fixed, so its log density is a function of the expected range z* alone. A table holds it in
pieces; those that would not be close enough hold NaN, which sends a beam to the formulas.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.beam import BeamView, log_mixture
from beamfield.kernels.jit import fused_kernel, kernel

Floats = NDArray[np.float64]

# [0, max_range] is cut at the reading z, where p_short ends, some sigma on either side of it, and once more beyond, as
# p_short falls like 1 / z*. Each of these five parts has so many pieces of equal length; in the first, where only
# random readings are left, one will do.
PIECES = (1, 16, 16, 8, 8)
DEGREE = 5
N_PIECES = sum(PIECES)
FIRST_0, FIRST_1, FIRST_2, FIRST_3, FIRST_4 = (float(sum(PIECES[:part])) for part in range(5))
# Poses that take turns with a beam: its table and their expected ranges stay in the nearest cache.
POSES = 256
# Beams whose expected ranges are read together, as they share lines of the cache.
BEAMS = 8


class MixtureTable(NamedTuple):
    """Log densities of k readings over z*."""

    starts: Floats  # (k, 5) metres, of the parts
    pieces_per_metre: Floats  # (k, 5), 0 for empty parts
    coefficients: Floats  # (k * N_PIECES * (DEGREE + 1),), of rising powers of the share of a piece


@kernel
def fill_looked_up(ranges: Floats, expected: Floats, view: BeamView, table: MixtureTable, out: Floats) -> None:
    """Fill out (n,) as `many_beams.fill_scan_log_likelihood` does, from the table of `ranges` (k,)."""
    z_star, share, sums = np.zeros((BEAMS, POSES)), np.zeros(POSES), np.zeros(POSES)
    piece = np.zeros(POSES, np.int32)
    for start in range(0, out.size, POSES):
        n = min(POSES, out.size - start)
        for i in range(POSES):
            sums[i] = 0.0
        for beam in range(0, ranges.size, BEAMS):
            together = min(BEAMS, ranges.size - beam)
            for i in range(n):
                row = expected[start + i]
                for b in range(together):
                    z_star[b, i] = row[beam + b]
            for b in range(together):
                _find_pieces(z_star[b], view.max_range, table, beam + b, piece, share)
                # As unsigned numbers, which are never negative: LLVM then leaves out a test for each coefficient.
                _add_values(piece.view(np.uint32), share, table.coefficients, ranges[beam + b], z_star[b], view, sums)
        for i in range(n):
            out[start + i] = sums[i]


@kernel
def _find_pieces(
    z_star: Floats, max_range: float, table: MixtureTable, beam: int, piece: NDArray[np.int32], share: Floats
) -> None:
    """Fill in which piece of a beam's table each z* is in, and which share of it; NaN for what is no expected range."""
    first = np.int32(beam * N_PIECES)
    near, z, far, farther = table.starts[beam, 1], table.starts[beam, 2], table.starts[beam, 3], table.starts[beam, 4]
    per = table.pieces_per_metre
    per_0, per_1, per_2, per_3, per_4 = per[beam, 0], per[beam, 1], per[beam, 2], per[beam, 3], per[beam, 4]
    for i in range(POSES):
        x = max_range if z_star[i] > max_range else z_star[i]
        known, before, inside, within, beyond = x >= 0.0, x < z, x >= near, x < far, x >= farther
        start = (near if inside else 0.0) if before else z if within else farther if beyond else far
        scale = (per_1 if inside else per_0) if before else per_2 if within else per_4 if beyond else per_3
        part = (FIRST_1 if inside else FIRST_0) if before else FIRST_2 if within else FIRST_4 if beyond else FIRST_3
        pieces = (x - start) * scale
        whole = np.floor(pieces)
        share[i] = pieces - whole if known else math.nan
        piece[i] = np.int32(part + whole if known else 0.0) + first


@fused_kernel
def _add_values(
    piece: NDArray[np.uint32], share: Floats, c: Floats, z: float, z_star: Floats, view: BeamView, sums: Floats
) -> None:
    """Add the log density of the reading z at each z* to sums."""
    for i in range(POSES):
        j, t = np.int64(piece[i]) * (DEGREE + 1), share[i]
        t2 = t * t
        value = (c[j] + t * c[j + 1]) + t2 * ((c[j + 2] + t * c[j + 3]) + t2 * (c[j + 4] + t * c[j + 5]))
        if math.isnan(value):
            value = log_mixture(z, min(z_star[i], view.max_range), view)
        sums[i] += value
