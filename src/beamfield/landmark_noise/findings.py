"""What a user of learned landmark noise should know: biases, tails, places and landmarks that differ, cuts."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.time_split import FEWEST_TRUSTED_BLOCKS
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.landmark_noise.em import (
    LEAST_SIGMA_BEARING,
    LEAST_SIGMA_RANGE,
    NoiseClimb,
    NoiseLikelihood,
    NoiseTheta,
)
from beamfield.landmark_noise.forms import NoiseForm
from beamfield.landmark_noise.intervals import NoiseIntervals
from beamfield.landmark_noise.residuals import ResidualGroup
from beamfield.landmark_noise.sighting_table import SightingTable

# A bias of less than this share of sigma hardly moves a likelihood.
NOTABLE_BIAS = 0.25
# Sigmas of the nearest and farthest quarter that differ by more than this factor.
NOTABLE_RATIO = 1.5
# A normal has 0.27 % beyond three deviations.
NORMAL_TAIL = 0.0027
NOTABLE_TAIL, FEWEST_IN_TAIL = 4.0 * NORMAL_TAIL, 5
# From the median of absolute values to the deviation of a normal.
NORMAL_FROM_MIDDLE = 1.4826
# Residuals in the outermost fiftieth of their span, where a tail that was not cut has next to none.
EDGE, FEWEST_AT_EDGE = 0.02, 20
# Mean residuals of neighbouring blocks that agree so much belong to one stretch.
NOTABLE_CORRELATION = 0.5
UNITS = {"range": "m", "bearing": "rad"}


def noise_findings(
    table: SightingTable,
    likelihood: NoiseLikelihood,
    climb: NoiseClimb,
    intervals: NoiseIntervals,
    forms: Sequence[NoiseForm],
    residuals: tuple[FloatArray, FloatArray, FloatArray],
    groups: tuple[Sequence[ResidualGroup], Sequence[ResidualGroup]],
) -> tuple[Finding, ...]:
    """Name what the parameters alone do not say.

    The names: ``not-converged``, ``no-intervals``, ``few-blocks``, ``features-left-out``, ``range-blocks-depend``,
    ``bearing-blocks-depend``, ``range-bias``, ``bearing-bias``, ``range-scale``, ``no-spurious``,
    ``spurious-of-kept``, ``range-exact``, ``bearing-exact``, ``range-heavy-tails``, ``bearing-heavy-tails``,
    ``range-sigma-by-distance``, ``bearing-sigma-by-distance``, ``range-bias-by-landmark``,
    ``bearing-bias-by-landmark``, ``range-looks-cut``, ``bearing-looks-cut``.

    Parameters
    ----------
    table, likelihood, climb, intervals, forms
        What was learned from what.
    residuals
        Range and bearing residuals, bias and scale taken out, and how probably each sighting is of its landmark; each
        (n,).
    groups
        Residuals per landmark and by distance.

    Returns
    -------
    Findings; none if there is nothing to say.
    """
    theta, problem = climb.theta, likelihood.problem
    values = {"range": residuals[0], "bearing": residuals[1]}
    sigmas = {"range": theta.sigma_range, "bearing": theta.sigma_bearing}
    floors = {"range": LEAST_SIGMA_RANGE, "bearing": LEAST_SIGMA_BEARING}
    cuts = dict(zip(values, problem.truncated_at, strict=True))
    raw = {"range": table.range_residuals, "bearing": table.bearing_residuals}
    found = [*_climb_findings(climb), *_block_findings(intervals), *_left_out(table)]
    found += _scale_finding(theta, intervals, forms)
    for what in values:
        if not np.isfinite(values[what]).any():
            continue
        found += _bias_finding(what, theta, intervals, scaled=problem.fit_scale)
        if sigmas[what] <= floors[what]:
            found.append(_exact(what, sigmas[what]))
            continue
        found += _dependence(what, values[what], residuals[2], table.blocks)
        found += _tails(what, values[what], residuals[2])
        found += _by_distance(what, groups[1])
        found += _by_landmark(what, groups[0], sigmas[what])
        if cuts[what] is None:
            found += _looks_cut(what, raw[what])
    return (*found, *_spurious_findings(theta, likelihood, residuals[2]))


def _climb_findings(climb: NoiseClimb) -> list[Finding]:
    if climb.converged:
        return []
    n = len(climb.trace) - 1
    text = f"Learning stopped after {n} iterations before it converged; raise max_iterations."
    return [Finding("not-converged", "warning", text, {"iterations": float(n)})]


def _block_findings(intervals: NoiseIntervals) -> list[Finding]:
    n = intervals.n_blocks
    if n == 1:
        text = "All sightings lie in one stretch of time, so there are no intervals: a longer log is needed."
        return [Finding("no-intervals", "warning", text, {"n_blocks": 1.0})]
    if n < FEWEST_TRUSTED_BLOCKS:
        text = f"The intervals rest on {n} stretches of time, fewer than {FEWEST_TRUSTED_BLOCKS}, and are rough."
        return [Finding("few-blocks", "warning", text, {"n_blocks": float(n)})]
    return []


def _left_out(table: SightingTable) -> list[Finding]:
    if not table.n_unknown and not table.n_without_pose:
        return []
    text = (
        f"{table.n_unknown} features of unknown landmark and {table.n_without_pose} without a pose were left out: "
        "the spurious rate is that of the features whose landmark is named."
    )
    numbers = {"n_unknown": float(table.n_unknown), "n_without_pose": float(table.n_without_pose)}
    return [Finding("features-left-out", "info", text, numbers)]


def _bias_finding(what: str, theta: NoiseTheta, intervals: NoiseIntervals, *, scaled: bool) -> list[Finding]:
    name = f"{what}_bias"
    low, high = intervals.intervals.get(name, (math.nan, math.nan))
    if not (low > 0.0 or high < 0.0):
        return []
    bias, sigma = getattr(theta, name), getattr(theta, f"sigma_{what}")
    beside = " at distance 0" if what == "range" and scaled else ""
    notable = abs(bias) > NOTABLE_BIAS * sigma
    text = (
        f"{what.capitalize()} bias{beside} {_signed(what, bias)} [{low:.3g}, {high:.3g}]: "
        f"remove it at the sensor or keep {name}. Left out, sigma_{what} would be "
        f"{math.hypot(sigma, bias):.3g} {UNITS[what]} instead of {sigma:.3g}."
    )
    return [Finding(f"{what}-bias", "warning" if notable else "info", text, {"bias": bias, "low": low, "high": high})]


def _scale_finding(theta: NoiseTheta, intervals: NoiseIntervals, forms: Sequence[NoiseForm]) -> list[Finding]:
    scale = next((form for form in forms if form.name == "bias and scale"), None)
    if theta.range_scale != 1.0:
        low, high = intervals.intervals.get("range_scale", (math.nan, math.nan))
        gain = (
            ""
            if scale is None
            else f" It gains {scale.gain_over_simpler:+.3f} nats per held-out sighting over a bias alone."
        )
        text = (
            f"Measured ranges are {theta.range_scale:.4f} [{low:.4f}, {high:.4f}] times the true ones: correct the "
            f"sensor's scale (speed of light or sound, clock, focal length) or keep range_scale.{gain}"
        )
        values = {"range_scale": theta.range_scale, "low": low, "high": high}
        return [Finding("range-scale", "warning", text, values)]
    if scale is None or not scale.is_worth_it:
        return []
    text = (
        f"A range scale of {scale.theta.range_scale:.4f} would gain {scale.gain_over_simpler:.3f} nats per held-out "
        f"sighting and bring sigma_range from {theta.sigma_range:.3g} to {scale.theta.sigma_range:.3g} m; "
        "it was not asked for."
    )
    values = {"range_scale": scale.theta.range_scale, "gain": scale.gain_over_simpler}
    return [Finding("range-scale", "warning", text, values)]


def _spurious_findings(theta: NoiseTheta, likelihood: NoiseLikelihood, of_landmark: FloatArray) -> list[Finding]:
    problem, n = likelihood.problem, len(likelihood)
    if not problem.fit_spurious:
        return []
    expected = float((1.0 - of_landmark).sum())
    if expected < 1.0:
        text = (
            f"No sighting looks spurious: the rate is below {3.0 / n:.2g} (95 %, were the {n} sightings independent), "
            "not 0."
        )
        return [Finding("no-spurious", "info", text, {"expected": expected, "upper": 3.0 / n})]
    if problem.truncated_at == (None, None):
        return []
    text = (
        "Features beyond the cut were taken away before: spurious_rate is the share among those that were kept, spread "
        "evenly within the cut. How many were taken away is not known."
    )
    return [Finding("spurious-of-kept", "info", text, {"spurious_rate": theta.spurious_rate})]


def _exact(what: str, sigma: float) -> Finding:
    text = f"The {what} residuals have no noise: sigma_{what} stops at {sigma:g} {UNITS[what]}. Is the log simulated?"
    return Finding(f"{what}-exact", "warning", text, {f"sigma_{what}": sigma})


def _dependence(what: str, e: FloatArray, w: FloatArray, blocks: NDArray[np.int64]) -> list[Finding]:
    used = ~np.isnan(e) & (w > 0.0)
    _, number = np.unique(blocks[used], return_inverse=True)
    counts = np.bincount(number, w[used])
    means = np.bincount(number, w[used] * e[used])[counts > 0] / counts[counts > 0]
    if len(means) < FEWEST_TRUSTED_BLOCKS or not np.ptp(means) > 0.0:
        return []
    off = means - means.mean()
    correlation = float(off[1:] @ off[:-1] / (off @ off))
    if correlation < NOTABLE_CORRELATION:
        return []
    text = (
        f"Mean {what} residuals of neighbouring blocks go together (correlation {correlation:.2f}): the errors last "
        "longer than a block, and the intervals are too narrow. Give a longer block_s, or record more places."
    )
    return [Finding(f"{what}-blocks-depend", "warning", text, {"correlation": correlation})]


def _tails(what: str, e: FloatArray, w: FloatArray) -> list[Finding]:
    # Judged by the deviation of the middle half: tails widen sigma itself until they hide behind it.
    used = ~np.isnan(e) & (w > 0.5)
    middle = NORMAL_FROM_MIDDLE * float(np.median(np.abs(e[used]))) if used.any() else 0.0
    count = float(w[used & (np.abs(e) > 3.0 * middle)].sum())
    beyond = count / max(float(w[used].sum()), 1e-300)
    if beyond <= NOTABLE_TAIL or count < FEWEST_IN_TAIL:
        return []
    text = (
        f"{beyond:.1%} of the {what}s of landmarks lie beyond three times the deviation of the middle half, "
        f"{middle:.3g} {UNITS[what]}, where a normal has 0.3 %: the tails are heavier. sigma_{what} is a compromise; "
        "a filter should give such sightings a larger spurious_rate."
    )
    return [Finding(f"{what}-heavy-tails", "warning", text, {"beyond": beyond, "middle_deviation": middle})]


def _by_distance(what: str, groups: Sequence[ResidualGroup]) -> list[Finding]:
    if len(groups) < 2:
        return []
    near, far = (float(getattr(groups[i], f"{what}_std")) for i in (0, -1))
    if not (near > 0.0 and far > 0.0) or 1.0 / NOTABLE_RATIO <= far / near <= NOTABLE_RATIO:
        return []
    text = (
        f"The {what} noise changes with distance: {near:.3g} {UNITS[what]} at {groups[0].name} m, {far:.3g} at "
        f"{groups[-1].name} m. One sigma is too wide for some and too narrow for others."
    )
    return [Finding(f"{what}-sigma-by-distance", "info", text, {"near": near, "far": far})]


def _by_landmark(what: str, groups: Sequence[ResidualGroup], sigma: float) -> list[Finding]:
    off = [
        (group, getattr(group, f"{what}_mean"))
        for group in groups
        if abs(getattr(group, f"{what}_mean")) > 3.0 * getattr(group, f"{what}_mean_se")
        and abs(getattr(group, f"{what}_mean")) > NOTABLE_BIAS * sigma
    ]
    if not off or len(groups) < 2:
        return []
    worst, mean = max(off, key=lambda item: abs(item[1]))
    text = (
        f"{len(off)} of {len(groups)} landmarks have a {what} bias of their own, most of all {worst.name} with "
        f"{_signed(what, mean)} beside the others: check where they are in the map, or how they look from where "
        "they are seen."
    )
    return [
        Finding(
            f"{what}-bias-by-landmark", "warning", text, {"n": float(len(off)), "worst": mean, "id": float(worst.name)}
        )
    ]


def _looks_cut(what: str, e: FloatArray) -> list[Finding]:
    sizes = np.abs(e[~np.isnan(e)])
    span = float(sizes.max(initial=0.0))
    at_edge = int((sizes > (1.0 - EDGE) * span).sum())
    # Bearings end at a half turn by themselves, and a flat distribution has a fiftieth at its end.
    ends_itself = what == "bearing" and span > 0.9 * math.pi
    if at_edge < FEWEST_AT_EDGE or ends_itself:
        return []
    text = (
        f"{at_edge} {what} residuals lie just below {span:.3g} {UNITS[what]} and none beyond: outliers seem "
        "to have been removed from this log. Give truncated_at, or sigma and tails come out too small."
    )
    return [Finding(f"{what}-looks-cut", "warning", text, {"cut": span, "n_at_edge": float(at_edge)})]


def _signed(what: str, value: float) -> str:
    return f"{value:+.3g} {UNITS[what]}"
