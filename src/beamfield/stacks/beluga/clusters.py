"""Which particles Beluga takes for one cluster, and the mean of the heaviest cluster."""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, compose, wrap_angle
from beamfield.stacks.filters.histogram import BinSizes, bin_codes
from beamfield.stacks.filters.particles import EVERY, particle_moments

SIDE, TURN = 0.2, 0.524
# Cells weigh at most what this share of them weighs.
CAP = 0.9
# To the neighbours of a cell, seen from one of its particles.
_STEPS = np.array([(SIDE, 0, 0), (-SIDE, 0, 0), (0, SIDE, 0), (0, -SIDE, 0), (0, 0, TURN), (0, 0, -TURN)], dtype=float)


def heaviest_cluster(poses: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the mean (3,) of the cluster whose particles weigh most; clusters of one particle do not count.

    Poses are (n, 3), weights (n,) sum to 1.
    """
    labels = cluster_labels(poses, weights)
    heavy = np.bincount(labels, weights)
    heavy[np.bincount(labels) < 2] = -1.0
    groups = labels if heavy.max() >= 0.0 else EVERY
    return particle_moments(poses, weights, groups, int(np.argmax(heavy)))[0]


def cluster_labels(poses: FloatArray, weights: FloatArray) -> NDArray[np.int64]:
    """Return the cluster of each particle, (n,) from 0 on.

    Particles are counted in cells of 0.2 m, 0.2 m and 0.524 rad. Going from the cells with the highest mean weight
    downwards, each takes in those of its six neighbours that weigh no more and belong to none, and these theirs, before
    another peak begins a cluster. Neighbours lie along the axes of the robot at the first particle of a cell. Mean
    weights are cut off where a tenth of the cells weighs more. Of equal cells the program takes the one first that its
    hash table happens to hold first; here they come in their order on the map.
    """
    wrapped = np.column_stack([poses[:, :2], wrap_angle(poses[:, 2])])
    sizes = BinSizes(SIDE, SIDE, TURN)
    codes, first, cell_of = np.unique(bin_codes(wrapped, sizes, wrapped[0]), return_index=True, return_inverse=True)
    # Of equal particles all means are to be the same, in which those of 1/n would differ by their rounding.
    mean = np.bincount(cell_of, weights / weights.max()) / np.bincount(cell_of)
    mean = np.minimum(mean, np.sort(mean)[int(len(mean) * CAP)])
    around = compose(wrapped[first][:, None], _STEPS)
    neighbours = bin_codes(around.reshape(-1, 3), sizes, wrapped[0]).reshape(len(codes), len(_STEPS)).tolist()
    place = {code: i for i, code in enumerate(codes.tolist())}
    weight = mean.tolist()
    labels = [-1] * len(codes)
    queue = [(-value, i) for i, value in enumerate(weight)]
    heapq.heapify(queue)
    top, n_clusters = max(weight), 0
    while queue:
        _, i = heapq.heappop(queue)
        if labels[i] < 0:
            labels[i] = n_clusters
            n_clusters += 1
        for code in neighbours[i]:
            j = place.get(code, -1)
            if j >= 0 and labels[j] < 0 and weight[j] <= weight[i]:
                labels[j] = labels[i]
                heapq.heappush(queue, (-(top + weight[j]), j))
    return np.array(labels, np.int64)[cell_of]
