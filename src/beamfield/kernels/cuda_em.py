"""The passes of `intrinsics` on a GPU: a block of threads for each bin, a thread for each share of its beams.

The beams stay in the GPU's memory: a pass sends up parameters and bins, and the sums of each bin come down. Threads add
up their shares, then one thread each sum of the shares, both in order: results do not depend on scheduling.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import cuda, float64
from numpy.typing import NDArray

from beamfield.kernels import intrinsics as cpu
from beamfield.kernels.cuda_target import allocate, launch_blocks, on_device, upload
from beamfield.kernels.intrinsics import N_DERIVATIVES, Beams, Scratch
from beamfield.kernels.narrow_bins import BIN_BEAMS, TERMS, Bins, Mixture

Floats = NDArray[np.float64]
normalisers, slopes_of = on_device(cpu._normalisers), on_device(cpu._slopes)
fill_densities, shift_sum = on_device(cpu._fill_densities), on_device(cpu._shift_sum)
responsibilities, chebyshev_moments = on_device(cpu._responsibilities), on_device(cpu._chebyshev_moments)
derivatives, outer_products = on_device(cpu._derivatives), on_device(cpu._outer_products)

# Threads of a block, as many as run in step: to wait for each other costs them nothing.
SHARES = 32
MOST_BEAMS = BIN_BEAMS // SHARES
# What a pass sums: as the columns of `sums` and `moments` of `em_pass`, and of `out` of `newton_pass`.
EM_SUMS = 5 + 4 * TERMS
NEWTON_SUMS = 1 + N_DERIVATIVES + N_DERIVATIVES * (N_DERIVATIVES + 1) // 2


def em_pass(beams: Beams, mixture: Mixture, bins: Bins, sums: Floats, moments: Floats) -> None:
    """Do what `intrinsics.em_pass` does for all bins, with all moments; `beams` are on the device."""
    out = _over_bins(_em, EM_SUMS, beams, mixture, bins)
    sums[:], moments[:] = out[:, :5], out[:, 5:].reshape(moments.shape)


def newton_pass(beams: Beams, mixture: Mixture, bins: Bins, out: Floats) -> None:
    """Do what `intrinsics.newton_pass` does for all bins; `beams` are on the device."""
    out[:] = _over_bins(_newton, NEWTON_SUMS, beams, mixture, bins)


def launch_over_bins(kernel: Any, beams: Beams, mixture: Mixture, bins: Bins, out: Any) -> None:
    """Run a kernel in a block for each bin; all but `mixture` is on the device, `out` has a row for each bin."""
    # Kernels ask for no size of the memory that a block shares: in the simulator threads would race to create it.
    n_bins, n_sums = out.shape
    launch_blocks(kernel, n_bins, SHARES, SHARES * n_sums * 8, beams, mixture, bins, out)


def _over_bins(kernel: Any, n_sums: int, beams: Beams, mixture: Mixture, bins: Bins) -> Floats:
    out = np.empty((bins.starts.size, n_sums))
    if len(out):
        sums = allocate(*out.shape)
        launch_over_bins(kernel, beams, mixture, Bins(*map(upload, bins)), sums)
        sums.copy_to_host(out)
    return out


@cuda.jit
def _em(beams, mixture, bins, out):  # type: ignore[no-untyped-def]
    """Fill out (n, 37) with the sums of the E-step over n bins."""
    polynomials = cuda.local.array((3, TERMS), float64)
    columns = cuda.local.array((7, MOST_BEAMS), float64)
    shares = cuda.shared.array(0, float64)
    j, share, n_sums = cuda.blockIdx.x, cuda.threadIdx.x, out.shape[1]
    if j >= out.shape[0]:
        return
    part, scratch = _share_of(beams, bins, j, share), _scratch(columns)
    sums = shares[share * n_sums : (share + 1) * n_sums]
    normalisers(bins, j, mixture, polynomials)
    n = fill_densities(part, mixture, bins, j, polynomials, scratch)
    responsibilities(n, mixture, part.ranges, scratch, sums)
    sums[0] += shift_sum(n, scratch)
    for kind in range(3):
        chebyshev_moments(n, scratch.t, scratch.hit, sums[5 + kind * TERMS :])
        for i in range(n):
            scratch.hit[i] *= scratch.r[i]
    chebyshev_moments(n, scratch.t, scratch.short, sums[5 + 3 * TERMS :])
    _add_up(shares, share, out[j])


@cuda.jit
def _newton(beams, mixture, bins, out):  # type: ignore[no-untyped-def]
    """Fill out (n, 36) with the log-likelihood, gradient and Hessian of n bins."""
    polynomials = cuda.local.array((3, TERMS), float64)
    slopes = cuda.local.array((7, TERMS), float64)
    columns = cuda.local.array((7, MOST_BEAMS), float64)
    scores = cuda.local.array((N_DERIVATIVES, MOST_BEAMS), float64)
    shares = cuda.shared.array(0, float64)
    j, share, n_sums = cuda.blockIdx.x, cuda.threadIdx.x, out.shape[1]
    if j >= out.shape[0]:
        return
    part, scratch = _share_of(beams, bins, j, share), _scratch(columns)
    sums = shares[share * n_sums : (share + 1) * n_sums]
    normalisers(bins, j, mixture, polynomials)
    slopes_of(bins, j, mixture, slopes)
    n = fill_densities(part, mixture, bins, j, polynomials, scratch)
    derivatives(n, part.ranges, part.expected, mixture, scratch, polynomials[1], slopes, scores, sums)
    sums[0] += shift_sum(n, scratch)
    outer_products(n, scratch.repeats, scores, sums)
    _add_up(shares, share, out[j])


@cuda.jit(device=True)
def _share_of(beams, bins, j, share):  # type: ignore[no-untyped-def]
    """Return every 32nd beam of bin j: threads that run in step read neighbours."""
    start, stop = bins.starts[j] + share, bins.stops[j]
    return Beams(beams.ranges[start:stop:SHARES], beams.expected[start:stop:SHARES], beams.counts[start:stop:SHARES])


@cuda.jit(device=True)
def _scratch(columns):  # type: ignore[no-untyped-def]
    """Return the columns (7, n) by name; each beam counts once until counts are filled in."""
    for i in range(columns.shape[1]):
        columns[2, i] = 1.0
    return Scratch(columns[0], columns[1], columns[2], columns[3], columns[4], columns[5], columns[6])


@cuda.jit(device=True)
def _add_up(shares, share, out):  # type: ignore[no-untyped-def]
    """Fill out (n,) with the sums over the 32 rows of shares (32 n,), each in order."""
    cuda.syncthreads()
    n = out.size
    for v in range(share, n, SHARES):
        total = 0.0
        for k in range(SHARES):
            total += shares[k * n + v]
        out[v] = total
