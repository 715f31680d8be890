"""How much of the end points' information counts: walls to the left and to the right tell whether they agree."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.kernels import trajectory as kernels
from beamfield.kernels.trajectory import HitNoise, Walls
from beamfield.localization.drive import Drive

# Scans of so much of the way (metres) are compared together: errors of a map's walls stay the same for a while.
STRETCH = 1.0
# The two sides differ by at most about so much (metres, radians); directions that one does not determine do not count.
MOST_APART = np.array([0.5, 0.5, 0.2])
# What is taken to be known beforehand: so many disagreements, each so much larger than those of independent readings.
KNOWN, USUAL = 10.0, 5.0


def information_share(drive: Drive, walls: Walls, poses: FloatArray, hits: HitNoise) -> float:
    """Return the share of the end points' information that counts, because their errors depend on each other.

    The end points to the left and those to the right each ask for a correction of the fitted poses (t, 3) of a stretch.
    If errors were independent, these would differ by as much as the covariances of both say; the share, in (0, 1], is
    by how much more the squares of the differences are.
    """
    bearing = np.arctan2(drive.points[:, 1], drive.points[:, 0])
    left = bearing > np.median(bearing)
    stretch = np.unique(np.floor(drive.way[drive.scans] / STRETCH), return_inverse=True)[1]
    corrections, covariances, priors = [], [], []
    for side in (left, ~left):
        gradients, infos = _side_sums(drive, walls, poses, hits, side)
        gradient, information = np.zeros((stretch.max() + 1, 3)), np.zeros((stretch.max() + 1, 3, 3))
        np.add.at(gradient, stretch, gradients)
        np.add.at(information, stretch, infos)
        prior = np.linalg.inv(information + np.diag(MOST_APART**-2))
        corrections.append(np.einsum("nij,nj->ni", prior, gradient))
        covariances.append(prior @ information @ prior)
        priors.append(prior)
    apart, precision = corrections[0] - corrections[1], np.linalg.inv(priors[0] + priors[1])
    squares = float(np.einsum("ni,nij,nj->", apart, precision, apart))
    expected = float(np.einsum("nij,nji->", precision, covariances[0] + covariances[1]))
    return 1.0 / max(1.0, (squares + KNOWN * USUAL) / (expected + KNOWN))


def _side_sums(drive: Drive, walls: Walls, poses: FloatArray, hits: HitNoise, side: NDArray[np.bool_]
               ) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Return gradients (n, 3) and information (n, 3, 3) of the end points on one side."""
    first = np.concatenate([[0], np.cumsum(side)])[drive.first]
    n = len(drive.scans)
    gradients, infos = np.empty((n, 6)), np.empty((n, 3, 3))
    kernels.sum_scans(drive.points[side], first, poses[drive.scans], walls, hits, gradients, infos, np.empty(n))
    return gradients[:, :3], infos
