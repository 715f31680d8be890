"""What the data cannot tell about the intrinsic parameters, by name.

A finding rests on two numbers. *Rarity*: how many beams a cause has by its responsibilities. *Share of information*:
the variance that a parameter would have if the cause of every beam were known, over the variance that it has; EM's rate
of convergence is 1 minus its smallest value. Two causes are confounded if that share is small and the error is large
against the weights, not if one of them is merely rare.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from beamfield.calibration.intrinsic.curvature import naive_covariance
from beamfield.calibration.intrinsic.learning_problem import LearningProblem
from beamfield.calibration.intrinsic.likelihood import (
    OFFSET,
    RATE,
    SLOPE,
    VARIANCE,
    W_HIT,
    W_MAX,
    W_RAND,
    W_SHORT,
    IntrinsicLikelihood,
)
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters

# Fewer expected beams than this are not evidence of a cause.
FEWEST_BEAMS_OF_A_CAUSE = 3.0
# Standard errors from curvature are at least this many times too small on real logs.
DEPENDENCE = 4.0
# Less of the information than this is left: the causes are hard to tell apart.
SMALL_SHARE = 0.1
# Modes within this many nats per beam are nearly equal; dependence makes a log worth a sixteenth of its beams or less.
NEARLY_EQUAL = 1e-3
_EFFECTIVE_NATS = 3.0
# Readings exactly at the near limit move lambda_short by a standard error if they are more than 0.2 to 0.4% of all in
# a log of 2 minutes, 0.05 to 0.2% in one of 10 minutes (docs/evidence/learning.md).
NOTABLE_SHARE_AT_LIMIT = 0.001
# They are the same number but for rounding: of the maximum range.
_SAME_RANGE = 1e-6


@dataclass(frozen=True)
class Mode:
    """A maximum of the likelihood.

    Parameters
    ----------
    parameters
        Where it is.
    log_likelihood
        Nats per beam.
    """

    parameters: BeamParameters
    log_likelihood: float


def identifiability_findings(
    likelihood: IntrinsicLikelihood, problem: LearningProblem, theta: FloatArray, modes: tuple[Mode, ...]
) -> tuple[Finding, ...]:
    """Name what these beams leave open at the maximum `theta` (8,), the first of the maxima that were found."""
    if likelihood.n_returned == 0.0:
        return (
            Finding(
                "no-returns",
                "warning",
                "All readings are at the maximum range.",
                {"n_beams": likelihood.n_beams},
                why="Nothing but z_max can be learned.",
                do="Check how the log reports a missing return (no_return) and the sensor's max_range.",
            ),
        )
    counts = likelihood.expected_statistics(theta).counts
    covariance = naive_covariance(likelihood, problem, theta)
    return (
        *_absent_causes(counts, problem),
        *_near_limit_findings(likelihood, problem),
        *_rate_findings(likelihood, problem, theta, counts, covariance),
        *_sigma_findings(problem, theta, counts, covariance),
        *_offset_findings(problem, theta),
        *_confounded_causes(likelihood, problem, theta, counts, covariance),
        *_mode_findings(likelihood, modes),
    )


def _absent_causes(counts: FloatArray, problem: LearningProblem) -> Iterator[Finding]:
    absent = (
        (W_SHORT, "no-shorts", "No reading looks like an unexpected object: z_short is (nearly) 0."),
        (W_MAX, "no-max-readings", "No reading is at the maximum range: z_max is 0 in this log."),
        (W_RAND, "no-random", "No reading is unexplained: z_rand is (nearly) 0."),
    )
    few = (counts < FEWEST_BEAMS_OF_A_CAUSE) & problem.free[: len(counts)]
    if few[W_HIT]:
        yield Finding(
            "no-hits",
            "warning",
            "No reading looks like a hit.",
            {"expected_beams": float(counts[W_HIT])},
            why="The readings do not follow the map, so sigma_hit is meaningless.",
            do="Check the map, the poses and the sensor's mount.",
        )
    for cause, name, text in absent:
        if few[cause]:
            yield Finding(name, "info", text, {"expected_beams": float(counts[cause])})


def _near_limit_findings(likelihood: IntrinsicLikelihood, problem: LearningProblem) -> Iterator[Finding]:
    at_limit = likelihood.ranges <= _SAME_RANGE * likelihood.max_range
    n = float(likelihood.weights[at_limit].sum()) if likelihood.weights.size else float(np.count_nonzero(at_limit))
    share = n / likelihood.n_beams
    if not problem.free[W_SHORT] or n < FEWEST_BEAMS_OF_A_CAUSE or share < NOTABLE_SHARE_AT_LIMIT:
        return
    yield Finding(
        "readings-at-near-limit",
        "warning",
        f"{100.0 * share:.2g}% of the readings are exactly {likelihood.min_range:g} m, which some sensors report for "
        "an invalid reading.",
        {"n": n, "share": share},
        why="They look like unexpected objects and raise z_short and lambda_short.",
        do="Set a min_range above that value to drop them, or pass it as no_return if it means that there "
        "was no return.",
    )


def _rate_findings(
    likelihood: IntrinsicLikelihood,
    problem: LearningProblem,
    theta: FloatArray,
    counts: FloatArray,
    covariance: FloatArray,
) -> Iterator[Finding]:
    if not problem.free[RATE]:
        return
    rate = float(theta[RATE])
    error, reach = DEPENDENCE * float(np.sqrt(covariance[RATE, RATE])), float(likelihood.expected.mean())
    if counts[W_SHORT] < FEWEST_BEAMS_OF_A_CAUSE:
        text = "lambda_short cannot be learned because there are (nearly) no shorts."
        yield _undetermined_rate(text, {"lambda_short": rate})
    elif rate == 0.0:
        text = "lambda_short is 0: unexpected objects are as frequent at any range up to the map's (uniform)."
        yield Finding("shorts-uniform", "info", text, {"lambda_short": 0.0})
    elif rate >= problem.upper[RATE]:
        yield Finding(
            "lambda-at-ceiling",
            "warning",
            "lambda_short is at its ceiling.",
            {"lambda_short": rate},
            why="Readings very near 0 look like shorts; the sensor may report 'invalid' that way.",
            do="Set a min_range above them, or pass them as no_return.",
        )
    elif error * reach > 1.0 and error > 0.5 * rate:
        text = f"lambda_short = {rate:.3g}/m is hardly determined: its error is about {error:.2g}/m."
        yield _undetermined_rate(text, {"lambda_short": rate, "standard_error": error})


def _undetermined_rate(text: str, values: dict[str, float]) -> Finding:
    return Finding(
        "lambda-undetermined",
        "warning",
        text,
        values,
        why="Its value means little; with few shorts it matters little, too.",
        do="Hold it (lambda_short = 0 is uniform), or record a log with people.",
    )


def _sigma_findings(
    problem: LearningProblem, theta: FloatArray, counts: FloatArray, covariance: FloatArray
) -> Iterator[Finding]:
    if not problem.free[VARIANCE] or counts[W_HIT] < FEWEST_BEAMS_OF_A_CAUSE:
        return
    variance, slope = float(theta[VARIANCE]), float(np.sqrt(max(theta[SLOPE], 0.0)))
    sigma = float(np.sqrt(variance))
    if variance <= problem.lower[VARIANCE] and slope > 0.0:
        text = (
            f"sigma_hit is at its floor of {sigma:.3g} m: all noise of hits grows with the expected range "
            f"({slope:.3g} m per metre), as if near walls were measured without any."
        )
        yield Finding("noise-all-slope", "info", text, {"sigma_hit": sigma, "sigma_slope": slope})
        return
    if variance <= problem.lower[VARIANCE]:
        yield Finding(
            "sigma-at-floor",
            "warning",
            f"sigma_hit is at its floor of {sigma:.3g} m: many readings equal the expected range exactly, as in a "
            "simulation without noise.",
            {"sigma_hit": sigma},
            why="The likelihood grows without bound as sigma_hit shrinks.",
            do="Hold sigma_hit at the sensor's noise, or use readings with noise.",
        )
        return
    relative_variance = float(covariance[VARIANCE, VARIANCE]) / (4.0 * variance**2)
    share = 1.0 / (2.0 * counts[W_HIT] * max(relative_variance, 1e-300))
    error = DEPENDENCE * float(np.sqrt(relative_variance))
    if share < SMALL_SHARE and error > 0.25:
        yield Finding(
            "sigma-confounded",
            "warning",
            f"sigma_hit = {sigma:.3g} m is {100 * error:.0f}% uncertain: hits are confused with shorts or random "
            "readings.",
            {"sigma_hit": sigma, "relative_error": error, "share_of_information": float(share)},
            why="A quite different sigma_hit explains the log nearly as well.",
            do="Record a longer log, or hold what you know (sigma_hit from the data sheet).",
        )


def _offset_findings(problem: LearningProblem, theta: FloatArray) -> Iterator[Finding]:
    offset = float(theta[OFFSET])
    if not problem.free[OFFSET] or problem.lower[OFFSET] < offset < problem.upper[OFFSET]:
        return
    yield Finding(
        "offset-at-limit",
        "warning",
        f"range_offset is at its limit of {offset:.3g} m.",
        {"range_offset": offset},
        why="Hits are not near the map's walls.",
        do="Check the map, the poses and the sensor's mount.",
    )


def _confounded_causes(
    likelihood: IntrinsicLikelihood,
    problem: LearningProblem,
    theta: FloatArray,
    counts: FloatArray,
    covariance: FloatArray,
) -> Iterator[Finding]:
    pairs = (
        (W_HIT, W_SHORT, "hits-and-shorts-confounded", "hits and shorts"),
        (W_HIT, W_RAND, "hits-and-random-confounded", "hits and random readings"),
        (W_SHORT, W_RAND, "shorts-and-random-confounded", "shorts and random readings"),
    )
    flat = bool(theta[VARIANCE] > (0.25 * likelihood.max_range) ** 2)
    for a, b, name, label in pairs:
        if not (problem.free[a] and problem.free[b]) or min(counts[a], counts[b]) < FEWEST_BEAMS_OF_A_CAUSE:
            continue
        known = theta[a] + theta[b] - (theta[a] - theta[b]) ** 2
        variance = max(float(covariance[a, a] + covariance[b, b] - 2.0 * covariance[a, b]), 1e-300)
        share = float(known / likelihood.n_beams / variance)
        error = DEPENDENCE * 0.5 * float(np.sqrt(variance))
        if (share < SMALL_SHARE and error > 0.5 * min(theta[a], theta[b])) or (flat and b == W_RAND and a == W_HIT):
            yield Finding(
                name,
                "warning",
                f"The data hardly separate {label}: weight may move between them by about {error:.2g}.",
                {"standard_error": error, "share_of_information": share},
                why="Either weight alone is uncertain; their sum is not.",
                do="Record a longer log, or hold one of the two.",
            )


def _mode_findings(likelihood: IntrinsicLikelihood, modes: tuple[Mode, ...]) -> Iterator[Finding]:
    if len(modes) < 2:
        return
    gap = modes[0].log_likelihood - modes[1].log_likelihood
    if gap > max(NEARLY_EQUAL, DEPENDENCE**2 * _EFFECTIVE_NATS / likelihood.n_beams):
        return
    other = modes[1].parameters
    yield Finding(
        "several-modes",
        "warning",
        f"Another set of parameters explains the beams nearly as well ({gap:.2g} nats per beam less): sigma_hit "
        f"{other.sigma_hit:.3g} m, z_hit {other.z_hit:.3g}, z_short {other.z_short:.3g}, z_rand {other.z_rand:.3g}.",
        {"gap": gap, "sigma_hit": other.sigma_hit, "z_hit": other.z_hit, "z_short": other.z_short},
        why="The log does not tell which of the two is right.",
        do="Use the set that fits what you know of the sensor, hold sigma_hit, or record a longer log.",
    )
