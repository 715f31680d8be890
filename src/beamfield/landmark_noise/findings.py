"""What a user of learned landmark noise should know: biases, a scale, tails, landmarks that differ, blocks."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.time_split import FEWEST_TRUSTED_BLOCKS
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.landmark_noise.em import LEAST_SIGMA_BEARING, LEAST_SIGMA_RANGE, NoiseClimb, NoiseTheta
from beamfield.landmark_noise.intervals import LEVEL, NoiseIntervals
from beamfield.landmark_noise.sighting_table import SightingTable

# A bias of less than this share of sigma hardly moves a likelihood.
NOTABLE_BIAS = 0.25
# Deviations of the nearest and the farthest quarter that differ by more than this factor.
NOTABLE_RATIO = 1.5
# A normal has 0.27% beyond three deviations.
NOTABLE_TAIL, FEWEST_IN_TAIL = 4.0 * 0.0027, 5
# From the median of absolute values to the deviation of a normal.
NORMAL_FROM_MIDDLE = 1.4826
# Mean residuals of neighbouring blocks that agree so much belong to one stretch.
NOTABLE_CORRELATION = 0.5
# A landmark's own bias is judged from at least so many blocks and sightings.
FEWEST_BLOCKS, FEWEST_SIGHTINGS = 4, 10
UNITS = {"range": "m", "bearing": "rad"}
# A direction known to a radian tells next to nothing. Headings in degrees and swapped axes made 1.7 rad and more of the
# 0.02 rad of MRCLAM's cameras. Of a camera that sees 60 degrees, turned the wrong way round, they made 0.6: more than
# the bearings themselves spread, of which a sensor's noise is but a part.
UNRELATED_BEARING, NOTABLE_BEARING, NOTABLE_SPREAD = 1.0, 0.2, 1.2
# Up to 1% of the sightings of MRCLAM, Roh and Plaza are spurious, with swapped axes or poses in millimetres 30 to 100%.
NOTABLE_SPURIOUS, MOSTLY_SPURIOUS = 0.2, 0.5
# No sensor is off by such a factor: one of the two lengths is not in metres, or the ranges are of something else.
WRONG_SCALE = 2.0


def noise_findings(
    table: SightingTable,
    climb: NoiseClimb,
    intervals: NoiseIntervals,
    ids: NDArray[np.int64],
    residuals: tuple[FloatArray, FloatArray],
    of_landmark: FloatArray,
) -> Iterator[Finding]:
    """Name what the parameters alone do not say.

    The names: ``not-converged``, ``no-intervals``, ``few-blocks``, ``features-left-out``, ``range-scale``,
    ``no-spurious``, ``many-spurious``, ``landmark-misplaced``, ``bearing-unrelated``, and for ranges and bearings
    ``range-bias``, ``range-exact``, ``range-blocks-depend``, ``range-heavy-tails``, ``range-sigma-by-distance``,
    ``range-bias-by-landmark``.

    The ids (N,) are of the map's landmarks; residuals (n,) are of range and bearing, bias and scale taken out;
    `of_landmark` (n,) is how probably each sighting is of its landmark.
    """
    theta = climb.theta
    yield from (
        *_climb_finding(climb),
        *_block_finding(intervals),
        *_left_out(table),
        *_scale_finding(theta, intervals),
    )
    for what, e, sigma, least in (
        ("range", residuals[0], theta.sigma_range, LEAST_SIGMA_RANGE),
        ("bearing", residuals[1], theta.sigma_bearing, LEAST_SIGMA_BEARING),
    ):
        used = ~np.isnan(e) & (of_landmark > 0.0)
        if not used.any():
            continue
        if what == "bearing" and _is_unrelated(sigma, table.bearings[used], of_landmark[used]):
            yield Finding(
                "bearing-unrelated",
                "error",
                f"Measured bearings have hardly to do with where the landmarks are: sigma_bearing {sigma:.3g} rad.",
                {"sigma_bearing": sigma},
                why="The parameters say nothing about the sensor.",
                do="Check that headings and bearings are in radians and counter-clockwise, that x and y are not "
                "swapped, that the landmarks are those of this log, and the mount.",
            )
            continue
        yield from _bias_finding(what, theta, intervals)
        if sigma <= least:
            yield Finding(
                f"{what}-exact",
                "warning",
                f"The {what} residuals have no noise: sigma_{what} stops at {sigma:g} {UNITS[what]}.",
                {f"sigma_{what}": sigma},
                why="No real sensor is exact: a filter with this sigma would trust it too much.",
                do="Learn from measured, not from simulated or rounded sightings.",
            )
            continue
        yield from _dependence(what, e[used], of_landmark[used], table.blocks[used])
        yield from _tails(what, e[used], of_landmark[used])
        yield from _by_distance(what, table.expected_ranges[used], e[used], of_landmark[used])
        yield from _by_landmark(what, table.subset(used), ids, e[used], of_landmark[used], sigma)
    yield from _spurious_finding(intervals, of_landmark)
    yield from _many_spurious(of_landmark[table.landmarks >= 0])
    yield from _misplaced(table, ids, of_landmark)


def _is_unrelated(sigma: float, bearings: FloatArray, w: FloatArray) -> bool:
    """Whether bearings lie farther from the landmarks' directions than from their own mean direction."""
    if sigma <= NOTABLE_BEARING or sigma > UNRELATED_BEARING:
        return sigma > UNRELATED_BEARING
    length = math.hypot(float(w @ np.cos(bearings)), float(w @ np.sin(bearings))) / float(w.sum())
    return length > 0.0 and sigma > NOTABLE_SPREAD * math.sqrt(-2.0 * math.log(min(length, 1.0)))


def _climb_finding(climb: NoiseClimb) -> Iterator[Finding]:
    if not climb.converged:
        n = len(climb.trace) - 1
        yield Finding(
            "not-converged",
            "warning",
            f"Learning stopped after {n} iterations before it converged.",
            {"iterations": float(n)},
            why="The parameters are not yet the most likely ones.",
            do="Raise max_iterations.",
        )


def _block_finding(intervals: NoiseIntervals) -> Iterator[Finding]:
    n = intervals.n_blocks
    if n == 1:
        text = "All sightings lie in one stretch of time, so there are no intervals."
        name, why = "no-intervals", "How far off the parameters may be is not known."
    elif n < FEWEST_TRUSTED_BLOCKS:
        text = f"The intervals rest on {n} stretches of time, fewer than {FEWEST_TRUSTED_BLOCKS}."
        name, why = "few-blocks", "They are rough, those of the sigmas too narrow if errors last as long as a stretch."
    else:
        return
    do = "Record a longer log, from more places."
    yield Finding(name, "warning", text, {"n_blocks": float(n)}, why=why, do=do)


def _left_out(table: SightingTable) -> Iterator[Finding]:
    if table.n_unknown or table.n_without_pose:
        yield Finding(
            "features-left-out",
            "info",
            f"{table.n_unknown} features of unknown landmark and {table.n_without_pose} without a pose were left out: "
            "the spurious rate is that of the features whose landmark is named.",
            {"n_unknown": float(table.n_unknown), "n_without_pose": float(table.n_without_pose)},
        )


def _bias_finding(what: str, theta: NoiseTheta, intervals: NoiseIntervals) -> Iterator[Finding]:
    name = f"{what}_bias"
    low, high = intervals.intervals.get(name, (math.nan, math.nan))
    if not (low > 0.0 or high < 0.0):
        return
    bias, sigma = getattr(theta, name), getattr(theta, f"sigma_{what}")
    beside = " at distance 0" if what == "range" and theta.range_scale != 1.0 else ""
    notable = abs(bias) > NOTABLE_BIAS * sigma
    without = f"{math.hypot(sigma, bias):.3g} {UNITS[what]} instead of {sigma:.3g}"
    yield Finding(
        f"{what}-bias",
        "warning" if notable else "info",
        f"{what.capitalize()} bias{beside} {bias:+.3g} {UNITS[what]} [{low:.3g}, {high:.3g}].",
        {"bias": bias, "low": low, "high": high},
        why=f"Left out, sigma_{what} would be {without}.",
        do=f"Remove it at the sensor (mount, clock) or keep {name}.",
    )


def _scale_finding(theta: NoiseTheta, intervals: NoiseIntervals) -> Iterator[Finding]:
    low, high = intervals.intervals.get("range_scale", (math.nan, math.nan))
    if not (low > 1.0 or high < 1.0):
        return
    wrong = not 1.0 / WRONG_SCALE <= theta.range_scale <= WRONG_SCALE
    correct = "Correct the sensor's scale (speed of light or sound, clock, focal length) or keep range_scale."
    yield Finding(
        "range-scale",
        "error" if wrong else "warning",
        f"Measured ranges are {theta.range_scale:.4f} [{low:.4f}, {high:.4f}] times the true ones.",
        {"range_scale": theta.range_scale, "low": low, "high": high},
        why="The error grows with the distance, which no sigma or bias makes up for.",
        do="Check that ranges, poses and landmarks are all in metres and of one frame." if wrong else correct,
    )


def _spurious_finding(intervals: NoiseIntervals, of_landmark: FloatArray) -> Iterator[Finding]:
    expected = float((1.0 - of_landmark).sum())
    if "spurious_rate" not in intervals.intervals or expected >= 1.0:
        return
    upper = intervals.intervals["spurious_rate"][1]
    text = f"No sighting looks spurious: the rate is below {upper:.2g} ({LEVEL:.0%}), not 0."
    yield Finding("no-spurious", "info", text, {"expected": expected, "upper": upper})


def _many_spurious(of_landmark: FloatArray) -> Iterator[Finding]:
    rate = float(1.0 - of_landmark.mean()) if len(of_landmark) else 0.0
    if rate <= NOTABLE_SPURIOUS:
        return
    yield Finding(
        "many-spurious",
        "error" if rate > MOSTLY_SPURIOUS else "warning",
        f"{rate:.0%} of the sightings do not fit the landmark that they name.",
        {"rate": rate},
        why="The noise is that of the others alone, which may fit by chance.",
        do="Check the ids and the mount, that x and y are not swapped, and that all is in metres and of one frame.",
    )


def _misplaced(table: SightingTable, ids: NDArray[np.int64], of_landmark: FloatArray) -> Iterator[Finding]:
    """Name landmarks that most of their own sightings do not fit, unless that holds of most sightings of all."""
    real = table.landmarks >= 0
    if 1.0 - of_landmark[real].mean() > MOSTLY_SPURIOUS:
        return
    share: dict[int, float] = {}
    for j in np.unique(table.landmarks[real]):
        mine = of_landmark[table.landmarks == j]
        if len(mine) >= FEWEST_SIGHTINGS and 1.0 - mine.mean() > MOSTLY_SPURIOUS:
            share[int(ids[j])] = float(1.0 - mine.mean())
    if not share:
        return
    worst = max(share, key=lambda name: share[name])
    others = sorted(share.keys() - {worst})
    beside = f", nor do most of {', '.join(map(str, others))}" if others else ""
    yield Finding(
        "landmark-misplaced",
        "warning",
        f"{share[worst]:.0%} of the sightings of landmark {worst} do not fit it{beside}.",
        {"n": float(len(share)), "worst": share[worst], "id": float(worst)},
        why="They count as spurious, which makes the spurious rate too high for the other landmarks.",
        do="Check its id and where it is in the map.",
    )


def _dependence(what: str, e: FloatArray, w: FloatArray, blocks: NDArray[np.int64]) -> Iterator[Finding]:
    means, _ = _block_means(e, w, blocks)
    if len(means) < FEWEST_TRUSTED_BLOCKS or not np.ptp(means) > 0.0:
        return
    off = means - means.mean()
    correlation = float(off[1:] @ off[:-1] / (off @ off))
    if correlation < NOTABLE_CORRELATION:
        return
    yield Finding(
        f"{what}-blocks-depend",
        "warning",
        f"Mean {what} residuals of neighbouring blocks go together (correlation {correlation:.2f}).",
        {"correlation": correlation},
        why="The errors last longer than a block, and the intervals are too narrow.",
        do="Give a longer block_s, or record more places.",
    )


def _tails(what: str, e: FloatArray, w: FloatArray) -> Iterator[Finding]:
    # Judged by the deviation of the middle half: tails widen sigma itself until they hide behind it.
    of_landmark = w > 0.5
    if not of_landmark.any():
        return
    middle = NORMAL_FROM_MIDDLE * float(np.median(np.abs(e[of_landmark])))
    count = float(w[of_landmark & (np.abs(e) > 3.0 * middle)].sum())
    beyond = count / float(w[of_landmark].sum())
    if beyond <= NOTABLE_TAIL or count < FEWEST_IN_TAIL:
        return
    yield Finding(
        f"{what}-heavy-tails",
        "warning",
        f"{beyond:.1%} of the {what}s of landmarks lie beyond three times the deviation of the middle half, "
        f"{middle:.3g} {UNITS[what]}, where a normal has 0.3%: the tails are heavier.",
        {"beyond": beyond, "middle_deviation": middle},
        why=f"sigma_{what} is a compromise between most sightings and the few that are far off.",
        do="Give a filter a larger spurious_rate, and features without ids: it believes the ids that they carry.",
    )


def _by_distance(what: str, distances: FloatArray, e: FloatArray, w: FloatArray) -> Iterator[Finding]:
    low, high = np.quantile(distances, [0.25, 0.75])
    near, far = (
        float(np.sqrt(np.cov(e[quarter], aweights=w[quarter]))) if w[quarter].sum() >= FEWEST_SIGHTINGS else 0.0
        for quarter in (distances <= low, distances >= high)
    )
    if not (near > 0.0 and far > 0.0 and low < high) or 1.0 / NOTABLE_RATIO <= far / near <= NOTABLE_RATIO:
        return
    text = (
        f"The {what} noise changes with distance: {near:.3g} {UNITS[what]} up to {low:.3g} m, {far:.3g} from "
        f"{high:.3g} m on. One sigma is too wide for some and too narrow for others."
    )
    yield Finding(f"{what}-sigma-by-distance", "info", text, {"near": near, "far": far})


def _by_landmark(
    what: str, table: SightingTable, ids: NDArray[np.int64], e: FloatArray, w: FloatArray, sigma: float
) -> Iterator[Finding]:
    """Name landmarks whose mean residual is more than three standard errors, taken from block to block, from 0."""
    off: dict[int, float] = {}
    seen = np.unique(table.landmarks)
    for j in seen:
        mine = table.landmarks == j
        means, weights = _block_means(e[mine], w[mine], table.blocks[mine])
        mean, b = float((weights * means).sum() / weights.sum()), len(means)
        if b < FEWEST_BLOCKS or weights.sum() < FEWEST_SIGHTINGS or abs(mean) <= NOTABLE_BIAS * sigma:
            continue
        error = math.sqrt(float(np.square(weights * (means - mean)).sum()) * b / (b - 1.0)) / float(weights.sum())
        if abs(mean) > 3.0 * error:
            off[int(ids[j])] = mean
    if not off or len(seen) < 2:
        return
    worst = max(off, key=lambda name: abs(off[name]))
    yield Finding(
        f"{what}-bias-by-landmark",
        "warning",
        f"{len(off)} of {len(seen)} landmarks have a {what} bias of their own, most of all {worst} with "
        f"{off[worst]:+.3g} {UNITS[what]} beside the others.",
        {"n": float(len(off)), "worst": off[worst], "id": float(worst)},
        why="They pull the pose the same way whenever they are seen.",
        do="Check where they are in the map, and how they look from where they are seen.",
    )


def _block_means(e: FloatArray, w: FloatArray, blocks: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean of each block that has any weight, and its weight."""
    _, number = np.unique(blocks, return_inverse=True)
    weights: FloatArray = np.bincount(number, w).astype(np.float64)
    return np.bincount(number, w * e) / weights, weights
