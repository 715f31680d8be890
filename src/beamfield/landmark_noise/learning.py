"""Learn the noise, the biases and the spurious rate of a landmark sensor from sightings with true poses (6.6.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import checked
from beamfield.detection_log import DetectionLog
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.landmark_noise.em import NoiseLikelihood, NoiseProblem, NoiseTheta
from beamfield.landmark_noise.findings import noise_findings
from beamfield.landmark_noise.forms import NoiseForm, fit_noise, score_forms
from beamfield.landmark_noise.intervals import noise_intervals
from beamfield.landmark_noise.residuals import ResidualGroup, groups_by_distance, groups_by_landmark
from beamfield.landmark_noise.sighting_table import SightingTable, sighting_table
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.short_repr import short_repr

# Six parameters from fewer sightings than this are noise.
FEWEST_SIGHTINGS = 20
# EM approaches a spurious rate of 0 without end; below this many expected sightings it is there.
NO_SIGHTING = 1e-3
Truncation = tuple[float | None, float | None]


@dataclass(frozen=True, eq=False)
class LandmarkLearningResult:
    """What was learned, how well it is known, and what it leaves out.

    Parameters
    ----------
    parameters
        The maximum-likelihood parameters, ready for `LandmarkModel`.
    intervals, standard_errors
        By block bootstrap, per learned parameter by its name; empty where all sightings lie in one block.
    level
        The share of such intervals that are to hold the truth.
    log_likelihood
        At the parameters, nats per sighting.
    trace
        Log-likelihood per sighting after each iteration, nats; it never falls.
    converged
        Whether further iterations promise less than the tolerance.
    forms
        What bias and scale are worth on held-out sightings, from the simplest form on; empty with too few blocks.
    by_landmark, by_distance
        Residuals in groups, bias and scale taken out.
    n_sightings, n_blocks
        Features that were used, and the stretches of time or place they fall into.
    table
        The sightings.
    of_landmark
        (n,) how probably each is of its landmark and not spurious.
    findings
        What to know before trusting the parameters, by name.
    """

    parameters: LandmarkParameters
    intervals: Mapping[str, tuple[float, float]]
    standard_errors: Mapping[str, float]
    level: float
    log_likelihood: float
    trace: tuple[float, ...]
    converged: bool
    forms: tuple[NoiseForm, ...]
    by_landmark: tuple[ResidualGroup, ...]
    by_distance: tuple[ResidualGroup, ...]
    n_sightings: int
    n_blocks: int
    table: SightingTable
    of_landmark: FloatArray
    findings: tuple[Finding, ...]

    __repr__ = short_repr

    def summary(self) -> str:
        """Return the parameters with intervals and warnings, as text to print."""
        from beamfield.report.results import landmark_summary

        return landmark_summary(self)

    def save(self, path: str | Path) -> None:
        """Write a landmark_model.yaml, which `read_landmark_model` reads.

        Parameters
        ----------
        path
            The file; one that is there is replaced.
        """
        from beamfield.report.results import save_landmarks

        save_landmarks(self, path)


@checked
def learn_landmark_parameters(
    landmark_map: LandmarkMap,
    log: DetectionLog,
    *,
    mount: ArrayLike = (0.0, 0.0, 0.0),
    fit_bias: bool = True,
    fit_scale: bool | None = None,
    fit_spurious: bool = True,
    truncated_at: Truncation | None = None,
    max_range: float | None = None,
    keep: LandmarkParameters | None = None,
    block_s: float | None = None,
    n_replicates: int = 200,
    level: float = 0.95,
    seed: int = 0,
    tolerance: float = 1e-9,
    max_iterations: int = 1000,
    progress: Callable[[int, int], None] | None = None,
) -> LandmarkLearningResult:
    """Return the noise that makes the sightings most likely, given true poses and known landmarks.

    A sighting of landmark j is of j with probability ``1 - spurious_rate``, with the normal noise of (6.40) around
    ``range_scale * range + range_bias`` and ``bearing + bearing_bias`` (wrapped); else it is anything, with the density
    that `LandmarkModel` gives to a feature of no landmark. EM learns all of it at once; what is not measured
    (range-only, bearing-only) is left out. Biases are parameters of their own, so that they do not end up in sigmas.

    Parameters
    ----------
    landmark_map
        Where the landmarks are.
    log
        True poses and features with ids. Features of unknown id or pose are left out and counted; a feature known to
        be `SPURIOUS` counts as such.
    mount
        (3,) pose of the sensor on the robot, metres and radians. A wrong heading of the mount is a bearing bias.
    fit_bias
        Whether to learn range_bias and bearing_bias.
    fit_scale
        Whether to learn range_scale; None learns it where it gains more than 0.005 nats per held-out sighting and more
        than twice the gain's standard error.
    fit_spurious
        Whether to learn spurious_rate; else it is 0, and features known to be spurious are left out.
    truncated_at
        (metres, radians), each or None: features whose residual is larger were taken out of the log before, and the
        densities are cut there. None if nothing was taken out.
    max_range
        Limit of the sensor, metres; None takes the largest range in the log.
    keep
        Signature noise to carry over into the result.
    block_s
        Length of the blocks of time for held-out sightings and intervals, seconds; None takes the log's places, or a
        24th of its duration.
    n_replicates, level, seed
        Of the bootstrap.
    tolerance, max_iterations
        Of EM: nats per sighting that further iterations may promise, and the most iterations.
    progress
        Called with the number of finished replicates and their total.

    Returns
    -------
    The parameters with intervals, residuals and findings. Where `converged` is False they are the best that was found.

    Raises
    ------
    InvalidInputError
        If an id is not in the map, an option is impossible, a residual lies beyond `truncated_at`, or a feature known
        to be spurious has a range outside [0, max_range].
    TooLittleDataError
        If fewer than 20 features remain, or ranges do not grow with the distance although a scale was asked for.

    Notes
    -----
    Where `truncated_at` is given, spurious_rate is the share of spurious features among those that were kept, and a
    finding says so: how many were taken out cannot be learned.

    Sightings of neighbouring times err together (the same landmark from the same place): intervals come from resampled
    blocks. Errors of the reference poses end up in the sigmas; motion capture and surveys have little of them.

    References
    ----------
    Probabilistic Robotics, 6.6.2 and 6.6.3: (6.39), (6.40). Kuensch, "The jackknife and the bootstrap for general
    stationary observations", Annals of Statistics 17, 1989.

    Examples
    --------
    >>> from beamfield.detections import Detections
    >>> from beamfield.models.landmark import LandmarkModel
    >>> rng = np.random.default_rng(2)
    >>> landmarks = LandmarkMap([[0.0, 0.0], [6.0, 0.0], [3.0, 5.0]])
    >>> noise = LandmarkParameters(0.1, 0.02, range_bias=0.3)
    >>> poses = rng.uniform([1.0, 1.0, -3.0], [5.0, 4.0, 3.0], (200, 3))
    >>> seen = LandmarkModel(landmarks, noise, correspondence="known").sample(poses, rng)
    >>> log = DetectionLog(poses, [Detections(z.ranges, z.bearings, ids=z.ids, stamp=i) for i, z in enumerate(seen)])
    >>> result = learn_landmark_parameters(landmarks, log, n_replicates=50)
    >>> round(result.parameters.range_bias, 1), round(result.parameters.sigma_range, 1)
    (0.3, 0.1)
    >>> [finding.name for finding in result.findings]
    ['range-bias', 'no-spurious']
    """
    cuts = _checked_cuts(truncated_at)
    _check_options(tolerance, max_iterations, max_range)
    table = _enough(sighting_table(landmark_map, log, mount=mount, block_s=block_s), fit_spurious)
    _check_within(table, cuts)
    has_range, has_bearing = (bool(np.isfinite(e).any()) for e in (table.range_residuals, table.bearing_residuals))
    if fit_scale and not (has_range and fit_bias and _distances_vary(table)):
        raise InvalidInputError("fit_scale: expected ranges at several distances and fit_bias=True")
    limit = None
    if has_range and fit_spurious:
        limit = max_range if max_range is not None else max(float(np.nanmax(table.ranges)), 1e-9)
        _check_spurious(table, limit)
    problem = NoiseProblem(limit, cuts, fit_bias and has_range, fit_bias and has_bearing, False, fit_spurious)
    options = {"tolerance": tolerance, "max_iterations": max_iterations}
    may_scale = fit_scale is not False and has_range and fit_bias and _distances_vary(table)
    problem, forms = _chosen_form(table, problem, fit_scale, may_scale, options)
    likelihood = NoiseLikelihood(table, problem)
    climb = fit_noise(likelihood, **options)
    if climb.theta.range_scale <= 0.0:
        raise TooLittleDataError(
            f"measured ranges do not grow with the distance (scale {climb.theta.range_scale:.3g}): "
            "no scale can be learned"
        )
    if climb.theta.spurious_rate * len(table) < NO_SIGHTING:
        climb = replace(climb, theta=climb.theta._replace(spurious_rate=0.0))
    intervals = noise_intervals(
        likelihood,
        table.blocks,
        climb.theta,
        n_replicates=n_replicates,
        level=level,
        seed=seed,
        progress=progress,
    )
    of_landmark = likelihood.e_step(climb.theta)[1]
    ranges, bearings = _remaining(table, climb.theta)
    groups = (
        groups_by_landmark(table, landmark_map.ids, ranges, bearings, of_landmark),
        groups_by_distance(table, ranges, bearings, of_landmark),
    )
    return LandmarkLearningResult(
        parameters=_as_parameters(climb.theta, limit if limit is not None else max_range, keep),
        intervals=intervals.intervals,
        standard_errors=intervals.standard_errors,
        level=level,
        log_likelihood=climb.trace[-1],
        trace=climb.trace,
        converged=climb.converged,
        forms=forms,
        by_landmark=groups[0],
        by_distance=groups[1],
        n_sightings=len(table),
        n_blocks=intervals.n_blocks,
        table=table,
        of_landmark=of_landmark,
        findings=noise_findings(table, likelihood, climb, intervals, forms, (ranges, bearings, of_landmark), groups),
    )


def _checked_cuts(truncated_at: Truncation | None) -> Truncation:
    if truncated_at is None:
        return (None, None)
    if len(truncated_at) != 2:
        raise InvalidInputError(f"truncated_at: expected (metres, radians), got {truncated_at!r}")
    for value in truncated_at:
        if value is not None and not 0.0 < value < math.inf:
            raise InvalidInputError(f"truncated_at: expected positive numbers or None, got {truncated_at!r}")
    cut_range, cut_bearing = truncated_at
    # A bearing is never off by more than half a turn.
    return (cut_range, cut_bearing if cut_bearing is not None and cut_bearing < math.pi else None)


def _check_options(tolerance: float, max_iterations: int, max_range: float | None) -> None:
    if not 0.0 < tolerance < math.inf:
        raise InvalidInputError(f"tolerance: expected a positive number of nats per sighting, got {tolerance}")
    if max_iterations < 1:
        raise InvalidInputError(f"max_iterations: expected at least 1, got {max_iterations}")
    if max_range is not None and not 0.0 < max_range < math.inf:
        raise InvalidInputError(f"max_range: expected a positive, finite number of metres, got {max_range}")


def _enough(table: SightingTable, fit_spurious: bool) -> SightingTable:
    if not fit_spurious:
        table = table.subset(table.landmarks >= 0)
    n = int((table.landmarks >= 0).sum())
    if n < FEWEST_SIGHTINGS:
        raise TooLittleDataError(
            f"{n} sightings of known landmarks at known poses, need {FEWEST_SIGHTINGS}: {table.n_unknown} more are of "
            f"unknown landmarks, {table.n_without_pose} have no pose"
        )
    return table


def _check_within(table: SightingTable, cuts: Truncation) -> None:
    for name, residuals, cut in zip(
        ("range", "bearing"), (table.range_residuals, table.bearing_residuals), cuts, strict=True
    ):
        if cut is None:
            continue
        beyond = np.abs(np.nan_to_num(residuals)) > cut
        if beyond.any():
            i = int(np.nanargmax(np.abs(residuals)))
            raise InvalidInputError(
                f"truncated_at: expected all {name} residuals within {cut:g}, got {residuals[i]:.6g} at stamp "
                f"{table.stamps[i]:.10g} ({int(beyond.sum())} lie beyond)"
            )


def _check_spurious(table: SightingTable, limit: float) -> None:
    impossible = (table.landmarks < 0) & ((table.ranges < 0.0) | (table.ranges > limit))
    if impossible.any():
        i = int(impossible.argmax())
        raise InvalidInputError(
            f"max_range: expected ranges of features of no landmark in [0, {limit:g}], got {table.ranges[i]:g} at "
            f"stamp {table.stamps[i]:.10g}"
        )


def _distances_vary(table: SightingTable) -> bool:
    used = np.isfinite(table.range_residuals)
    return bool(np.ptp(table.expected_ranges[used]) > 0.0)


def _chosen_form(
    table: SightingTable, problem: NoiseProblem, fit_scale: bool | None, may_scale: bool, options: dict[str, Any]
) -> tuple[NoiseProblem, tuple[NoiseForm, ...]]:
    """Score the forms on held-out blocks; return the problem to solve, and the forms with the chosen one marked."""
    plain = replace(problem, fit_range_bias=False, fit_bearing_bias=False)
    scaled = replace(problem, fit_scale=True)
    candidates = [("no bias", plain)]
    if problem.fit_range_bias or problem.fit_bearing_bias:
        candidates.append(("bias", problem))
    if may_scale or (fit_scale is False and problem.fit_range_bias and _distances_vary(table)):
        candidates.append(("bias and scale", scaled))
    forms = score_forms(table, candidates, **options)
    use_scale = bool(fit_scale) and may_scale
    if fit_scale is None and may_scale and forms:
        use_scale = forms[-1].is_worth_it and forms[-1].theta.range_scale > 0.0
    chosen = "bias and scale" if use_scale else ("bias" if len(candidates) > 1 else "no bias")
    marked = tuple(replace(form, chosen=form.name == chosen) for form in forms)
    return dict(candidates)[chosen], marked


def _remaining(table: SightingTable, theta: NoiseTheta) -> tuple[FloatArray, FloatArray]:
    ranges = table.ranges - (theta.range_scale * table.expected_ranges + theta.range_bias)
    return ranges, wrap_angle(table.bearings - table.expected_bearings - theta.bearing_bias)


def _as_parameters(theta: NoiseTheta, max_range: float | None, keep: LandmarkParameters | None) -> LandmarkParameters:
    return LandmarkParameters(
        None if math.isnan(theta.sigma_range) else theta.sigma_range,
        None if math.isnan(theta.sigma_bearing) else theta.sigma_bearing,
        None if keep is None else keep.sigma_signature,
        None if keep is None else keep.signature_covariance,
        None if keep is None else keep.confusion,
        spurious_rate=theta.spurious_rate,
        max_range=max_range,
        range_bias=theta.range_bias,
        bearing_bias=theta.bearing_bias,
        range_scale=theta.range_scale,
    )
