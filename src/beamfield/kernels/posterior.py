"""Sums over beams of values that are looked up: what fitting a likelihood field spends its time on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

# Sets of parameters that are summed in one pass.
LANES = 8
_ODD = np.uint64(0x9E3779B97F4A7C15)


@kernel
def number_distances(distances: NDArray[np.uint64], places: NDArray[np.int8], slots: NDArray[np.int32],
                     known: NDArray[np.uint64], known_places: NDArray[np.int8], n_known: int, codes: NDArray[np.int32]
                     ) -> int:  # fmt: skip
    """Number end points by what lies there: equal distance and place, equal number, in the order of appearance.

    Parameters
    ----------
    distances
        (e,) metres: the bits of float64.
    places
        (e,) known, unknown or off the map.
    slots
        Hash table, a power of two long: numbers, -1 where empty; updated.
    known, known_places
        Distance and place of each number so far; as long as half of `slots`, updated.
    n_known
        How many there are.
    codes
        (e,) overwritten.

    Returns
    -------
    How many there are now; -1 if the table is too small.
    """
    mask = np.uint64(len(slots) - 1)
    for i in range(len(distances)):
        bits, place = distances[i], places[i]
        # Distances of single precision have zeros below, so that only the product's upper bits differ.
        mixed = (bits ^ np.uint64(place)) * _ODD
        slot = ((mixed >> np.uint64(40)) ^ (mixed >> np.uint64(24))) & mask
        while True:
            code = slots[slot]
            if code < 0:
                if n_known == len(known):
                    return -1
                known[n_known], known_places[n_known] = bits, place
                slots[slot] = code = n_known
                n_known += 1
                break
            if known[code] == bits and known_places[code] == place:
                break
            slot = (slot + np.uint64(1)) & mask
        codes[i] = code
    return n_known


@kernel
def sum_values(
    codes: NDArray[np.int32], starts: NDArray[np.int64], table: NDArray[np.float64], sums: NDArray[np.float64]
) -> None:
    """Sum the table's rows over the beams of each pose.

    Parameters
    ----------
    codes
        Rows of the table, the beams of one pose after those of the other.
    starts
        (n + 1,) where each pose's beams start.
    table
        (v, 8) values for eight sets of parameters, or (v, 1) for one.
    sums
        (n, 8) or (n, 1) overwritten.
    """
    if table.shape[1] == 1:
        # A quarter of the time of eight: one by one is how an optimiser asks.
        column = table.reshape(-1)
        for i in range(len(starts) - 1):
            a = 0.0
            for j in range(starts[i], starts[i + 1]):
                a += column[codes[j]]
            sums[i, 0] = a
        return
    for i in range(len(starts) - 1):
        a = b = c = d = e = f = g = h = 0.0
        for j in range(starts[i], starts[i + 1]):
            row = table[codes[j]]
            a += row[0]
            b += row[1]
            c += row[2]
            d += row[3]
            e += row[4]
            f += row[5]
            g += row[6]
            h += row[7]
        sums[i, 0], sums[i, 1], sums[i, 2], sums[i, 3] = a, b, c, d
        sums[i, 4], sums[i, 5], sums[i, 6], sums[i, 7] = e, f, g, h


@kernel
def judge_posteriors(near: NDArray[np.float64], far: NDArray[np.float64], mass: NDArray[np.float64],
                     density: NDArray[np.float64], far_mass: float, far_density: float, ratios: NDArray[np.float64],
                     denser: NDArray[np.float64]) -> None:  # fmt: skip
    """Fill the posterior density at the truth over the prior's, and how much of the posterior is denser.

    There are c guesses at what is not known, each with a truth, which is the pose of that number, and a prior.

    Parameters
    ----------
    near
        (r, n) weights of poses around the reference, the c truths first.
    far
        (r, m) weights of poses elsewhere.
    mass, density
        (c, n) each near pose's share of the prior and the prior's density there.
    far_mass, far_density
        The same of each far pose.
    ratios
        (r, c) overwritten: weight of the truth over the mean weight under the prior; 0 if it has none.
    denser
        (r, c) overwritten: posterior probability of the poses that are denser than the truth; 1 if none has a weight.
    """
    for r in range(len(near)):
        for c in range(len(mass)):
            here = near[r, c] * density[c, c]
            total = above = 0.0
            for i in range(near.shape[1]):
                part = near[r, i] * mass[c, i]
                total += part
                above += part if near[r, i] * density[c, i] > here else 0.0
            for i in range(far.shape[1]):
                part = far[r, i] * far_mass
                total += part
                above += part if far[r, i] * far_density > here else 0.0
            ratios[r, c] = near[r, c] / total if total > 0.0 else 0.0
            denser[r, c] = above / total if total > 0.0 else 1.0
