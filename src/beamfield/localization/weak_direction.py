"""Other optima along the direction that a scan determines worst: how far an alignment may have slid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.kernels import scan_field as kernels
from beamfield.maps.scan_field import MARGIN_SIGMAS, ScanField

# Optima are looked for this far to both sides of the initial pose, metres of end points.
REACH = 0.5
# The scores along the line are those of a field this many times as wide, one per that sigma, with at most so many
# end points. The best few peaks are climbed.
WIDENING, PROFILE_POINTS, CLIMBED_PEAKS = 2.0, 180, 3
# Surfaces count up to this many sigma away; an ascent ends with steps shorter than this, in sigma.
REACH_SIGMAS, TOLERANCE, STEPS = 4.0, 0.01, 10
# Poses this close, in sigma, are one optimum.
SAME_OPTIMUM = 2.0
# How far off the initial pose is taken to be (standard deviation, metres) when optima are weighed against each other.
START_DEVIATION = 0.2


@dataclass(frozen=True, eq=False)
class Optima:
    """What was found along a line.

    Parameters
    ----------
    pose
        (3,) the best optimum.
    spread
        (3, 3) mean square distance of all optima from it, weighted by their posterior probabilities.
    share
        Probability of the optima other than the best, in [0, 1).
    """

    pose: FloatArray
    spread: FloatArray
    share: float


def weigh_optima(points: FloatArray, field: ScanField, pose: FloatArray, direction: FloatArray, start: FloatArray, *,
                 lever: float, threshold: float, dependence: float, window: float) -> Optima:  # fmt: skip
    """Look for optima along a line through an optimum, and weigh all by their scores.

    Along a corridor, the score has many peaks: a door frame that fits another, random readings that meet. The climb
    ends on one of them; the curvature there knows nothing of the rest.

    Parameters
    ----------
    points
        (n, 2) the scan's end points.
    field
        What they are aligned with.
    pose
        (3,) the optimum that the climb has found.
    direction
        (3,) which way to look; one unit moves end points by one metre.
    start
        (3,) initial pose of the alignment.
    lever, threshold
        As in `kernels.scan_field.ascend`.
    dependence
        Number of beams that are worth one independent beam: scores are divided by it.
    window
        Half-width of the window that the caller searches, metres: how far off `start` may be.

    Returns
    -------
    Optima
        `pose` itself, no spread and no share if there is no other.
    """
    scale = np.array([1.0, 1.0, 1.0 / lever])
    centre = float(direction / scale @ ((start - pose) / scale))
    poses, scores = [pose], [_score(points, pose, field)]
    for peak in _peaks(points, field, pose, direction, centre):
        kernels.ascend(
            points, peak, 1, field.sigma_hit, lever, threshold, TOLERANCE * field.sigma_hit, STEPS, field.view
        )
        apart = np.abs((np.array(poses) - peak) / scale).max(axis=1)
        if apart.min() > SAME_OPTIMUM * field.sigma_hit:
            poses.append(peak)
            scores.append(_score(points, peak, field))
    offsets = np.array(poses)[:, :2] - start[:2]
    deviation = max(START_DEVIATION, window)
    log_weight = np.array(scores) / dependence - 0.5 * np.sum(offsets**2, axis=1) / deviation**2
    weight = np.exp(log_weight - log_weight.max())
    weight /= weight.sum()
    best = int(np.argmax(weight))
    difference = np.array(poses) - poses[best]
    return Optima(poses[best], np.einsum("n,ni,nj->ij", weight, difference, difference), 1.0 - float(weight[best]))


def _score(points: FloatArray, pose: FloatArray, field: ScanField) -> float:
    """Return the score of a pose as in the climb."""
    sigma = field.sigma_hit
    return kernels.linearise(
        points, pose, 1, sigma, REACH_SIGMAS * sigma, field.view, np.empty(3), np.empty((3, 3))
    )[0]  # fmt: skip


def _peaks(points: FloatArray, field: ScanField, pose: FloatArray, direction: FloatArray,
           centre: float) -> list[FloatArray]:  # fmt: skip
    """Return the highest peaks of the score along the line, best first."""
    sigma = WIDENING * field.sigma_hit
    steps = max(1, round(REACH / sigma))
    poses = pose + (centre + sigma * np.arange(-steps, steps + 1))[:, None] * direction
    some = np.ascontiguousarray(points[:: max(1, len(points) // PROFILE_POINTS)])
    scores = np.empty(len(poses))
    kernels.fill_scores(some, poses, REACH_SIGMAS * sigma, MARGIN_SIGMAS * sigma, sigma, field.view, scores)
    padded = np.concatenate([[-np.inf], scores, [-np.inf]])
    peaks = np.flatnonzero((scores >= padded[:-2]) & (scores >= padded[2:]))
    return [poses[i].copy() for i in peaks[np.argsort(-scores[peaks], kind="stable")][:CLIMBED_PEAKS]]
