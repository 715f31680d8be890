"""How far an alignment errs, estimated from the two scans themselves: a sandwich of curvature and scatter."""

from __future__ import annotations

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.kernels.pull_scatter import SUMS, sum_patches
from beamfield.kernels.scan_alignment import linearise
from beamfield.maps.scan_field import ScanField

# The gradient is differenced this many sigma to both sides: about as far as alignments err.
DIFFERENCE = 2.0 / 3.0
# The measured curvature is taken to be at least this share of the Gauss-Newton information.
LEAST_CURVATURE = 0.1
# End points on one patch of surface, metres long, have residuals that depend on each other.
PATCH = 0.5
# No reading is better than this, metres.
RESOLUTION = 0.001


def sandwich_covariance(points: FloatArray, pose: FloatArray, field: ScanField, *, directions: FloatArray,
                        information: FloatArray, lever: float, reach: float) -> FloatArray:  # fmt: skip
    """Return the covariance (3, 3) of a pose at which the end points' pulls balance, of the rank of the directions.

    The pose solves g(pose) = sum of w r J = 0 with residuals r, weights w and the residuals' derivatives J by the pose.
    To first order its error is A^-1 g(true pose), with A the fall of g per move, so that its covariance is A^-1 B A^-1
    with B the covariance of g (the "sandwich" of an M-estimator).

    - **A** is measured: differences of g, two thirds of sigma to both sides. It is less than the Gauss-Newton
      information where end points change from element to element, normals are noisy and robust weights fall.
    - **B** is at least what independent errors give: the sum of the squared pulls, and for each patch of surface the
      noise of the field's own end points, which shifts all pulls of the patch: how far they scatter about the lines
      fitted to them. Where the pulls of whole patches, half a metre long, scatter more than that, B is their sum of
      squares: rough surfaces, other heights, people.

    `directions` (d, 3) are the determined ones, moves whose information is diagonal: `information` (d,), in end points.
    End points move `lever` metres per radian, and surfaces pull on them up to `reach` metres away.

    References: P. J. Huber, *The behavior of maximum likelihood estimates under nonstandard conditions*, 1967; for
    clusters: K.-Y. Liang, S. L. Zeger, *Longitudinal data analysis using generalized linear models*, 1986.
    """
    pulls, noise, sums = np.empty((3, 3)), np.empty((3, 3)), np.empty((field.n_elements, SUMS))
    sum_patches(points, pose, field.sigma_hit, reach, PATCH, field.view, sums, pulls, noise)
    # In these moves the Gauss-Newton information is the identity.
    moves = directions / np.sqrt(information)[:, None]
    curvature = moves @ _curvature(points, pose, field, lever, reach) @ moves.T
    bread = np.linalg.inv(_clipped(curvature, LEAST_CURVATURE, 1.0))
    root = np.linalg.cholesky(moves @ noise @ moves.T + RESOLUTION**2 * np.eye(len(moves)))
    unit = np.linalg.solve(root, moves)
    scatter = root @ _clipped(unit @ pulls @ unit.T, 1.0, np.inf) @ root.T
    return np.asarray(moves.T @ bread @ scatter @ bread @ moves)


def _curvature(points: FloatArray, pose: FloatArray, field: ScanField, lever: float, reach: float) -> FloatArray:
    """Return by how much the gradient falls per move, (3, 3)."""
    step = DIFFERENCE * field.sigma_hit * np.array([1.0, 1.0, 1.0 / lever])
    gradients = np.empty((2, 3, 3))
    for side, sign in enumerate((1.0, -1.0)):
        for axis in range(3):
            moved = pose.copy()
            moved[axis] += sign * step[axis]
            linearise(points, moved, 1, field.sigma_hit, reach, field.view, gradients[side, axis], np.empty((3, 3)))
    fall = (gradients[1] - gradients[0]) / (2.0 * step[:, None])
    return np.asarray(0.5 * (fall + fall.T))


def _clipped(matrix: FloatArray, low: float, high: float) -> FloatArray:
    """Return a symmetric matrix with its eigenvalues clipped."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.clip(values, low, high)) @ vectors.T)
