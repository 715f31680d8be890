"""Other optima along the direction that a scan determines worst: how far an alignment may have slid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.kernels.scan_alignment import ascend, linearise
from beamfield.kernels.scan_field import fill_scores
from beamfield.maps.scan_field import MARGIN_SIGMAS, ScanField

# The line is searched this far to both sides of the initial pose, metres, in steps of one sigma, with at most so many
# end points. The best few peaks are climbed.
REACH, PROFILE_POINTS, CLIMBED_PEAKS = 0.5, 120, 2
# Places this many sigma from the best one belong to its own peak, whose width is known from its curvature.
NEAR = 2.0
# Surfaces count up to this many sigma away; an ascent ends with steps shorter than this, in sigma.
REACH_SIGMAS, TOLERANCE, STEPS = 4.0, 0.01, 10
# Directions with an eigenvalue below this are undetermined: nothing moves along them.
UNDETERMINED = 0.02
# How far off the initial pose is taken to be (standard deviation, metres) when poses are weighed against each other.
START_DEVIATION = 0.2
# Which of two places fits better is told by one independent beam per this angle, however dense the beams are: what
# neighbouring beams share seldom makes another place fit. Chosen on simulated corridors.
INDEPENDENT_ANGLE = math.radians(16.0)


@dataclass(frozen=True, eq=False)
class Slide:
    """The best optimum (3,) along a line, and the mean square distance of all places on the line from it, m^2.

    Places count by their posterior probabilities.
    """

    pose: FloatArray
    variance: float


def weigh_slides(points: FloatArray, field: ScanField, pose: FloatArray, direction: FloatArray, start: FloatArray, *,
                 lever: float, beam_spacing: float, window: float) -> Slide:  # fmt: skip
    """Look for better poses along a line through an optimum (3,), and weigh the whole line by its scores.

    Along a corridor, the score has many peaks: a door frame that fits another, random readings that meet. The climb
    ends on one of them; the curvature there knows nothing of the rest.

    The scan's end points are (n, 2). The direction (3,) is a move of one metre in x and y with the turn that goes with
    it; the lever is as in `kernels.scan_alignment.ascend`. Scores are divided by the number of beams per independent
    one, by the angle between neighbouring beams. The window is how many metres off the start (3,) of the alignment may
    be.

    Return the best pose that was found, and how far the poses that fit about as well are spread along the line.
    """
    deviation, dependence = max(START_DEVIATION, window), max(INDEPENDENT_ANGLE / beam_spacing, 1.0)
    offsets = float(direction[:2] @ (start - pose)[:2]) + _steps(field.sigma_hit)
    line = pose + offsets[:, None] * direction
    scores = _profile(points, line, field)
    best, highest = pose, _log_posterior(_score(points, pose, field), pose, start, dependence, deviation)
    for peak in _peaks(scores):
        climbed = line[peak].copy()
        ascend(points, climbed, 1, field.sigma_hit, lever, UNDETERMINED, TOLERANCE * field.sigma_hit, STEPS, field.view)
        height = _log_posterior(_score(points, climbed, field), climbed, start, dependence, deviation)
        if height > highest:
            best, highest = climbed, height
    log_weight = _log_posterior(scores, line, start, dependence, deviation)
    weight = np.exp(log_weight - log_weight.max())
    along = offsets - float(direction[:2] @ (best - pose)[:2])
    elsewhere = np.abs(along) > NEAR * field.sigma_hit
    return Slide(best, float(weight[elsewhere] @ along[elsewhere] ** 2 / weight.sum()))


def _steps(sigma: float) -> FloatArray:
    """Return where to look, metres from the middle of the line."""
    n = max(1, round(REACH / sigma))
    return np.asarray(sigma * np.arange(-n, n + 1), dtype=np.float64)


def _profile(points: FloatArray, line: FloatArray, field: ScanField) -> FloatArray:
    """Return the scores of poses, as if all end points had been looked at."""
    sigma = field.sigma_hit
    some = np.ascontiguousarray(points[:: max(1, len(points) // PROFILE_POINTS)])
    scores = np.empty(len(line))
    fill_scores(some, line, REACH_SIGMAS * sigma, MARGIN_SIGMAS * sigma, sigma, field.view, scores)
    some_score = scores - len(some) * np.log(field.view.unseen_density)
    return np.asarray(some_score * (len(points) / len(some)))


def _peaks(scores: FloatArray) -> list[int]:
    """Return the highest peaks, best first."""
    padded = np.concatenate([[-np.inf], scores, [-np.inf]])
    peaks = np.flatnonzero((scores >= padded[:-2]) & (scores >= padded[2:]))
    return [int(i) for i in peaks[np.argsort(-scores[peaks], kind="stable")][:CLIMBED_PEAKS]]


def _score(points: FloatArray, pose: FloatArray, field: ScanField) -> float:
    """Return the score of a pose as in the climb."""
    reach = REACH_SIGMAS * field.sigma_hit
    return linearise(points, pose, 1, field.sigma_hit, reach, field.view, np.empty(3), np.empty((3, 3)))[0]


def _log_posterior(score: FloatArray | float, pose: FloatArray, start: FloatArray, dependence: float,
                   deviation: float) -> FloatArray:  # fmt: skip
    """Return log posteriors up to a constant: end points depend on each other, and the start is a guess."""
    offset = pose[..., :2] - start[:2]
    return np.asarray(score / dependence - 0.5 * np.sum(offset**2, axis=-1) / deviation**2)
