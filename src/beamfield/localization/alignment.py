"""Align a scan with other scans by climbing on their likelihood field (section 6.4.2, Figure 6.11)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.argument_kinds import expect_each
from beamfield.arguments import checked
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_pose, wrap_angle
from beamfield.kernels import scan_alignment as kernels
from beamfield.localization.alignment_covariance import sandwich_covariance
from beamfield.localization.weak_direction import START_DEVIATION, UNDETERMINED, weigh_slides
from beamfield.maps.end_points import hit_points
from beamfield.maps.scan_field import ScanField
from beamfield.sensors import Scan
from beamfield.short_repr import short_repr

Problem = Literal["", "no end points", "no overlap", "outside the search", "undetermined", "ambiguous", "not converged"]

# Coarse to fine, in units of the field's sigma: the widest catches errors of 0.3 m and 15 degrees with sigma 0.03 m.
COARSE_SIGMAS = (12.0, 4.0)
# At the coarse levels this many end points are enough.
COARSE_POINTS = 60
# The ascent of a level ends with steps shorter than this, in sigma.
COARSE_TOLERANCE, FINE_TOLERANCE = 0.06, 0.002
COARSE_STEPS, FINE_STEPS = 10, 30
# Steps after the ascent, which ends where the score has a small step.
SETTLING_STEPS = 6
# Surfaces pull on end points up to this many sigma away.
REACH_SIGMAS = 4.0
# Starts of a search lie this close: within what the widest level catches. The best few are followed further.
START_SPACING, START_TURN, FOLLOWED_STARTS = 0.4, math.radians(12.0), 4
DEFAULT_SEARCH = (0.0, START_TURN)
MAX_STARTS = 20_000
# Another start replaces the initial pose only if its score is better by this share: in a round room all are as good.
BETTER = 0.02
# An optimum so much further (metres, radians) from the initial pose than was searched is another place that looks
# alike: twice what the ascent catches.
FURTHEST_CAUGHT = (0.6, math.radians(30.0))
# Fewer end points on surfaces than this say nothing.
FEWEST_MATCHES = 3.0
# A slide along the surfaces is looked for if it meets less than this share of the end points' resistance, and reported
# if it has this standard deviation in metres.
WEAK, AMBIGUOUS_DEVIATION = 0.35, 0.1
# The end points determine such a direction to this (metres aside per metre): after a slide, or where the initial pose
# is off along it, the rest is wrong by as much. The door frames that hold a slide in a wrong place turn it more than
# the noise turns an undetermined direction. Chosen on simulated corridors.
SLIDE_DIRECTION_DEVIATION, FREE_DIRECTION_DEVIATION = 0.05, 0.01
# Standard deviation along an undetermined direction, metres of end points.
UNDETERMINED_DEVIATION = 100.0


@dataclass(frozen=True, eq=False)
class AlignmentResult:
    """Where a scan fits, how sure that is, and what is wrong with it.

    Parameters
    ----------
    pose
        (3,) pose of the scan's robot in the field's frame, metres and radians; the initial pose where nothing could be
        done.
    covariance
        (3, 3) of x, y, theta in the field's frame; see `align` for the model. Always finite and positive definite; the
        standard deviation along undetermined directions is 100 m (of end points). They are hardly ever along an axis,
        so their 100 m show in all of the diagonal: fuse the whole matrix with what is known along them.
    score
        Sum over end points of log(field / unseen), nats: an end point that the field says nothing about adds nothing.
    overlap
        Share of the scan's end points in [0, 1] that lie in space which the field saw.
    n_matched
        Number of end points on a surface (the sum of their probabilities of being a hit).
    spread
        Root mean square distance of those from the surface, metres.
    converged
        Whether the last ascent ended by itself.
    eigenvalues
        (3,) of the information per matched end point, ascending, in [0, about 1]: the mean square cosine between the
        surfaces' normals and how the end points move, a turn being measured by how far it moves them (times `lever`).
    undetermined
        (u, 3) directions (x, y, theta) that too few end points determine; u is 0 if all is well, 1 in a corridor. A
        move along one slides the end points along the surfaces. Their length is one metre of end points.
    lever
        Metres that end points move per radian.
    problem
        "" or what is wrong: "no end points" (in the scan), "no overlap" (with the field's surfaces), "undetermined",
        "outside the search" (0.6 m or 30 degrees further from the initial pose than the window: likely another place
        that looks alike, which the covariance does not hold), "ambiguous" (places along a slide of more than 0.1 m fit
        about as well; the covariance holds them) or "not converged".
    """

    pose: FloatArray
    covariance: FloatArray
    score: float
    overlap: float
    n_matched: float
    spread: float
    converged: bool
    eigenvalues: FloatArray
    undetermined: FloatArray
    lever: float
    problem: Problem

    __repr__ = short_repr

    def summary(self) -> str:
        """Return the pose with its standard errors, how well it fits, and what is wrong with it, in four lines."""
        x, y, theta = self.pose
        errors = np.sqrt(np.diag(self.covariance))
        held = ", the 100 m along undetermined directions in them" if len(self.undetermined) else ""
        return (
            f"pose      {x:.3f} m, {y:.3f} m, {np.degrees(theta):.2f} deg\n"
            f"errors    {errors[0]:.3f} m, {errors[1]:.3f} m, {np.degrees(errors[2]):.2f} deg (standard{held})\n"
            f"fit       {self.n_matched:.0f} end points on surfaces, {self.spread:.3f} m off, {self.overlap:.0%} seen\n"
            f"problem   {self.problem or 'none'}"
        )


@checked
def align(
    scan: Scan,
    onto: ScanField | Scan | Sequence[Scan],
    initial: ArrayLike,
    *,
    onto_poses: ArrayLike | None = None,
    search: tuple[float, float] = DEFAULT_SEARCH,
) -> AlignmentResult:
    """Find the pose at which a scan fits best onto what other scans saw.

    Maximises the sum over the scan's end points of the field's logarithm. Each step is a damped Gauss-Newton step on
    the distances between end points and the nearest surfaces, every end point weighted by the probability that it is a
    hit at all, so that outliers and occluded end points do not pull; a step is kept only if the score does not fall.
    Three levels go from 12 sigma over 4 sigma to the field's own sigma.

    Parameters
    ----------
    scan
        The scan to align. Readings without return are left out.
    onto
        The field, or the scan or scans to make one from (with `ScanField`'s default parameters).
    initial
        (3,) first guess of the pose of the scan's robot in the field's frame. Errors up to about 0.3 m and 15 degrees
        are caught.
    onto_poses
        Poses of `onto` in the field's frame, (n, 3) for several scans and (3,) for one; identity for one if not given.
    search
        Half-widths (metres, radians) of a window around `initial` that is searched from a grid of starts 0.4 m and 12
        degrees apart; (0, 0) for `initial` alone, which takes half the time and fails more often. For large windows use
        `beamfield.localization.global_search`.

    Returns
    -------
    AlignmentResult
        Never NaN. Scans without end points and without overlap give the initial pose, all directions undetermined.

    Raises
    ------
    InvalidInputError
        If poses are not finite or have other shapes, several scans come without poses, or search makes
        no sense.

    Notes
    -----
    **Undetermined directions** are those along which the end points' information is that of less than 2% of them
    facing it squarely. Nothing moves along them: the pose keeps what `initial` says.

    **Slides.** Along a corridor few end points tell one place from the next, and the score has many small peaks. Where
    a move in the weakest direction meets less than 35% of the end points' resistance, the line along it is looked at
    every sigma, up to 0.5 m from the initial pose. The best peaks are climbed, and all places are weighed by their
    scores (one independent beam per 16 degrees) and by their distance from the initial pose (deviation 0.2 m).

    **Covariance.** Estimated from the two scans alone, without a floor: the sandwich A^-1 B A^-1 of
    `alignment_covariance.sandwich_covariance`. The curvature A is measured by differences. The scatter B of the end
    points' pulls holds both scans' noise, and what whole patches of surface (half a metre) scatter beyond it. Places
    further along a slide than 2 sigma add their mean square distance by their weights. In simulated worlds the mean
    squared error in units of this covariance (NEES) is 2 to 4 for 3 degrees of freedom: docs/evidence/alignment.md.

    It does not know of errors that bend or shift a scan as a whole: a sweep taken in fast motion, a tilted scanner, a
    wrong calibration. Add their covariance where they matter.

    An ascent that ended in a wrong optimum elsewhere has an error that no covariance covers. It is flagged if it is far
    from the initial pose; otherwise look at `overlap` and `score`, and use `search`.

    References
    ----------
    Section 6.4.2 and Figure 6.11 for the field; (6.32) to (6.34).

    Examples
    --------
    >>> from beamfield.sensors import RangeFinder
    >>> bearings = np.radians(np.arange(0.5, 360.0))
    >>> finder = RangeFinder.from_bearings(bearings, max_range=20.0)
    >>> room = np.minimum(2.0 / np.abs(np.cos(bearings)), 3.0 / np.abs(np.sin(bearings)))
    >>> result = align(Scan(room, finder), Scan(room, finder), [0.2, -0.1, 0.1])
    >>> bool(np.abs(result.pose).max() < 1e-3), result.problem
    (True, '')
    """
    start = _checked_start(initial, search)
    field = _as_field(onto, onto_poses)
    points = hit_points(scan.ranges, scan.finder)
    lever = _lever(points)
    if not len(points):
        return _failure(start, 0.0, 0.0, lever, "no end points")
    pose = _climb_coarse(points, field, start, search, lever)
    sigma = field.sigma_hit
    _, converged = kernels.ascend(
        points, pose, 1, sigma, lever, UNDETERMINED, FINE_TOLERANCE * sigma, FINE_STEPS, field.view
    )
    fit = _inspect(points, pose, field, lever)
    if fit.n_matched < FEWEST_MATCHES:
        return _failure(start, fit.score, fit.overlap, lever, "no overlap")
    sliding = 0.0
    if fit.eigenvalues[0] >= UNDETERMINED and fit.slide_information < WEAK:
        slide = weigh_slides(
            points, field, pose, fit.slide, start,
            lever=lever, beam_spacing=_beam_spacing(scan), window=search[0],
        )  # fmt: skip
        pose, sliding = slide.pose, slide.variance
    kernels.settle(points, pose, sigma, lever, UNDETERMINED, FINE_TOLERANCE * sigma, SETTLING_STEPS, field.view)
    fit = _inspect(points, pose, field, lever)
    free = fit.eigenvalues < UNDETERMINED
    covariance = _covariance(points, field, fit, free, lever)
    covariance += sliding * np.outer(fit.slide, fit.slide)
    aside = SLIDE_DIRECTION_DEVIATION**2 * sliding
    aside += (FREE_DIRECTION_DEVIATION * START_DEVIATION) ** 2 if free.any() else 0.0
    covariance += aside * np.diag((1.0, 1.0, lever**-2))
    found = np.array([*fit.pose[:2], wrap_angle(fit.pose[2])])
    problem: Problem = "" if converged else "not converged"
    if _is_outside(found, start, search):
        problem = "outside the search"
    elif free.any():
        problem = "undetermined"
    elif sliding > 0.0 and fit.slide[:2] @ covariance[:2, :2] @ fit.slide[:2] > AMBIGUOUS_DEVIATION**2:
        problem = "ambiguous"
    return AlignmentResult(
        found, 0.5 * (covariance + covariance.T), fit.score, fit.overlap, fit.n_matched, fit.spread, converged,
        np.maximum(fit.eigenvalues, 0.0), fit.directions[free], lever, problem,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Fit:
    """How end points lie at a pose; fields as in `AlignmentResult`, directions (3, 3) one per eigenvalue.

    `slide` is the move (3,) of one metre, with the turn that suits it, which the end points resist least;
    `slide_information` is how much they do, per matched end point.
    """

    pose: FloatArray
    score: float
    overlap: float
    n_matched: float
    spread: float
    eigenvalues: FloatArray
    directions: FloatArray
    slide: FloatArray
    slide_information: float


def _inspect(points: FloatArray, pose: FloatArray, field: ScanField, lever: float) -> _Fit:
    """Return how end points lie at a pose."""
    sigma = field.sigma_hit
    information = np.zeros((3, 3))
    score, matched, squares, seen = kernels.linearise(
        points, pose, 1, sigma, REACH_SIGMAS * sigma, field.view, np.zeros(3), information
    )
    some = max(matched, FEWEST_MATCHES)
    scale = np.array([1.0, 1.0, 1.0 / lever])
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale) / some)
    overlap = min(seen / len(points), 1.0)
    # The information about x and y if theta follows.
    turn = -information[2, :2] / max(information[2, 2], 1e-9)
    resistance, slides = np.linalg.eigh(information[:2, :2] + np.outer(information[:2, 2], turn))
    slide = np.array([*slides[:, 0], turn @ slides[:, 0]])
    return _Fit(
        pose, score, overlap, matched, math.sqrt(squares / some), values, vectors.T * scale, slide,
        float(resistance[0]) / some,
    )  # fmt: skip


def _covariance(points: FloatArray, field: ScanField, fit: _Fit, free: NDArray[np.bool_], lever: float) -> FloatArray:
    """Return the covariance at one optimum, free directions included."""
    unknown = UNDETERMINED_DEVIATION * fit.directions[free]
    covariance = np.asarray(unknown.T @ unknown)
    if free.all():
        return covariance
    information = max(fit.n_matched, FEWEST_MATCHES) * fit.eigenvalues[~free]
    return covariance + sandwich_covariance(
        points, fit.pose, field, directions=fit.directions[~free], information=information, lever=lever,
        reach=REACH_SIGMAS * field.sigma_hit,
    )  # fmt: skip


def _checked_start(initial: ArrayLike, search: tuple[float, float]) -> FloatArray:
    """Return the initial pose, a copy."""
    start = as_pose(initial, "initial")
    if len(search) != 2 or not all(0.0 <= half < np.inf for half in search):
        raise InvalidInputError(f"search: expected half-widths >= 0 in metres and radians, got {search!r}")
    return start


def _is_outside(found: FloatArray, start: FloatArray, search: tuple[float, float]) -> bool:
    """Return whether a pose lies further from the initial one than any start of the search can be off."""
    dx, dy, turn = (found - start).tolist()
    too_far = max(abs(dx), abs(dy)) > search[0] + FURTHEST_CAUGHT[0]
    return too_far or bool(abs(wrap_angle(turn)) > search[1] + FURTHEST_CAUGHT[1])


def _as_field(onto: ScanField | Scan | Sequence[Scan], poses: ArrayLike | None) -> ScanField:
    """Return the field to align with."""
    if isinstance(onto, ScanField):
        if poses is not None:
            raise InvalidInputError("onto_poses: a field has its frame already; expected None")
        return onto
    if isinstance(onto, Scan):
        return ScanField.from_scan(onto, pose=(0.0, 0.0, 0.0) if poses is None else poses)
    expect_each("onto", onto, Sequence[Scan])
    if poses is None:
        raise InvalidInputError("onto_poses: expected the poses of the scans in one frame, got None")
    return ScanField.from_scans(onto, poses)


def _lever(points: FloatArray) -> float:
    """Return how far end points move when the robot turns: the root mean square of their distances, at least 0.1 m."""
    return max(math.sqrt(float(np.mean(np.sum(points**2, axis=1)))), 0.1) if len(points) else 1.0


def _failure(start: FloatArray, score: float, overlap: float, lever: float, problem: Problem) -> AlignmentResult:
    """Return the result that says nothing but why."""
    scale = np.array([1.0, 1.0, 1.0 / lever])
    start[2] = wrap_angle(start[2])
    return AlignmentResult(
        start, np.diag((UNDETERMINED_DEVIATION * scale) ** 2), score, overlap, 0.0, 0.0, False, np.zeros(3),
        np.diag(scale), lever, problem,
    )  # fmt: skip


def _climb_coarse(points: FloatArray, field: ScanField, start: FloatArray, search: tuple[float, float], lever: float
                  ) -> FloatArray:  # fmt: skip
    """Return the best pose after the coarse levels, from all starts."""
    stride = max(1, len(points) // COARSE_POINTS)
    climbers = _starts(start, search)
    scores = np.zeros(len(climbers))
    for factor in COARSE_SIGMAS:
        sigma = factor * field.sigma_hit
        for i, pose in enumerate(climbers):
            scores[i], _ = kernels.ascend(
                points, pose, stride, sigma, lever, UNDETERMINED, COARSE_TOLERANCE * sigma, COARSE_STEPS, field.view
            )
        # The initial pose stays in the race as the first.
        kept = [0, *(1 + np.argsort(-scores[1:])[:FOLLOWED_STARTS])]
        climbers, scores = [climbers[i] for i in kept], scores[kept]
    best = int(np.argmax(scores))
    return climbers[best] if scores[best] > scores[0] + BETTER * abs(scores[0]) else climbers[0]


def _starts(start: FloatArray, search: tuple[float, float]) -> list[FloatArray]:
    """Return the starts of a search: the initial pose first, then a grid around it."""
    moves = math.ceil(search[0] / START_SPACING)
    turns = math.ceil(search[1] / START_TURN)
    if (2 * moves + 1) ** 2 * (2 * turns + 1) > MAX_STARTS:
        raise InvalidInputError(f"search: expected a window of at most {MAX_STARTS} starts, got {search!r}")
    along = np.linspace(-search[0], search[0], 2 * moves + 1) if moves else np.zeros(1)
    about = np.linspace(-search[1], search[1], 2 * turns + 1) if turns else np.zeros(1)
    offsets = sorted(product(along, along, about), key=lambda offset: offset != (0.0, 0.0, 0.0))
    return [start + np.array(offset) for offset in offsets]


def _beam_spacing(scan: Scan) -> float:
    """Return the mean angle between neighbouring beams, whatever their origins; pi for one beam."""
    bearings = np.sort(scan.finder.bearings)
    if len(bearings) < 2:
        return math.pi
    return max(float(bearings[-1] - bearings[0]) / (len(bearings) - 1), 1e-5)
