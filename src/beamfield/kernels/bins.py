"""Particles in the bins of a histogram, by open addressing: how many bins are met, and which of them touch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel, shared

Integers = NDArray[np.int64]

# Bins farther than this from the base are one: none is so far out while poses are sane.
FARTHEST_BIN = 1 << 19
# What a step of one bin in x, y and heading adds to a bin's code.
STEPS = (1 << 42, 1 << 21, 1)
_ODD = np.uint64(0x9E3779B97F4A7C15)


@kernel
def fill_codes(
    poses: NDArray[np.float64], sizes: NDArray[np.float64], base: NDArray[np.float64], codes: Integers
) -> None:
    """Number the bins of poses (n, 3), with sides (3,), by codes (n,): equal for poses of one bin only.

    The bin of the pose `base` (3,) is the one in the middle: maps may lie far from their frame's origin.
    """
    for i in range(len(poses)):
        code = 0
        for axis in range(3):
            place = np.floor(poses[i, axis] / sizes[axis]) - np.floor(base[axis] / sizes[axis])
            place = min(max(place, -FARTHEST_BIN), FARTHEST_BIN)
            code += (int(place) + FARTHEST_BIN + 1) * STEPS[axis]
        codes[i] = code


@kernel
def number_bins(
    codes: Integers, limits: NDArray[np.float64], slots: Integers, bins: Integers, bin_of: Integers
) -> tuple[int, int, bool]:
    """Number the bins as they are met, until there are more particles than the bins so far ask for.

    Parameters
    ----------
    codes
        (n,) of each particle, equal in one bin only.
    limits
        (m,) how many particles are asked for with 1, 2, ... bins; no limit with more.
    slots
        (s,) all -1; s is a power of two and greater than n. Overwritten with the table of bins.
    bins
        (n,) overwritten: the codes of the bins.
    bin_of
        (n,) overwritten: the bin of each particle.

    Returns
    -------
    How many particles were looked at, how many bins they are in, and whether they are more than asked for.
    """
    n_bins = 0
    for i in range(len(codes)):
        slot = slot_of(codes[i], slots, bins)
        if slots[slot] < 0:
            slots[slot] = n_bins
            bins[n_bins] = codes[i]
            n_bins += 1
        bin_of[i] = slots[slot]
        if n_bins <= len(limits) and i + 1 > limits[n_bins - 1]:
            return i + 1, n_bins, True
    return len(codes), n_bins, False


@kernel
def join_bins(slots: Integers, bins: Integers, offsets: Integers, stack: Integers, labels: Integers) -> int:
    """Give bins that touch one label.

    Parameters
    ----------
    slots
        From `number_bins`.
    bins
        (b,) codes of the bins.
    offsets
        What is added to a bin's code to get its neighbours'.
    stack
        (b,) room to work.
    labels
        (b,) overwritten: from 0 on.

    Returns
    -------
    How many labels there are.
    """
    labels[:] = -1
    n_labels = 0
    for first in range(len(bins)):
        if labels[first] >= 0:
            continue
        labels[first] = n_labels
        stack[0] = first
        depth = 1
        while depth > 0:
            depth -= 1
            code = bins[stack[depth]]
            for j in range(len(offsets)):
                other = slots[slot_of(code + offsets[j], slots, bins)]
                if other >= 0 and labels[other] < 0:
                    labels[other] = n_labels
                    stack[depth] = other
                    depth += 1
        n_labels += 1
    return n_labels


@shared
def slot_of(code: int, slots: NDArray[np.int32] | Integers, bins: Integers) -> int:
    """Return the slot that holds a bin, or the empty one where it would be."""
    mask = np.uint64(len(slots) - 1)
    # Upper bits of a product: those of neighbours' codes, which differ in a few bits, are far from one another.
    slot = (np.uint64(code) * _ODD >> np.uint64(40)) & mask
    while slots[slot] >= 0 and bins[slots[slot]] != code:
        slot = (slot + np.uint64(1)) & mask
    return int(slot)
