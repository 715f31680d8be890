"""Learn the noise, the biases and the spurious rate of a landmark sensor from sightings with true poses (6.6.2)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import checked
from beamfield.calibration.evaluation import is_worth_it
from beamfield.calibration.time_split import of_held_out
from beamfield.detection_log import DetectionLog
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.landmark_noise.em import NoiseLikelihood, NoiseProblem, NoiseTheta, fit_noise
from beamfield.landmark_noise.findings import noise_findings
from beamfield.landmark_noise.intervals import noise_intervals
from beamfield.landmark_noise.sighting_table import SightingTable, sighting_table
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.short_repr import short_repr

# Six parameters from fewer sightings than this are noise.
FEWEST_SIGHTINGS = 20
# EM approaches a spurious rate of 0 without end; below this many expected sightings it is there.
NO_SIGHTING = 1e-3


@dataclass(frozen=True, eq=False)
class LandmarkLearningResult:
    """What was learned, how well it is known, and what it leaves out.

    Parameters
    ----------
    parameters
        The maximum-likelihood parameters, ready for `LandmarkModel`.
    intervals, standard_errors
        95% intervals and standard errors by block bootstrap, per learned parameter by its name; empty where all
        sightings lie in one block.
    log_likelihood
        At the parameters, nats per sighting.
    converged
        Whether further iterations promise less than the tolerance.
    n_sightings, n_blocks
        Features that were used, and the stretches of time or place they fall into.
    table
        The sightings.
    findings
        What to know before trusting the parameters, by name.
    """

    parameters: LandmarkParameters
    intervals: Mapping[str, tuple[float, float]]
    standard_errors: Mapping[str, float]
    log_likelihood: float
    converged: bool
    n_sightings: int
    n_blocks: int
    table: SightingTable
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
    fit_scale: bool | None = None,
    fit_spurious: bool = True,
    max_range: float | None = None,
    block_s: float | None = None,
    n_replicates: int = 200,
    seed: int = 0,
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
    fit_scale
        Whether to learn range_scale; None learns it where it gains more than 0.005 nats per held-out sighting and more
        than twice the gain's standard error.
    fit_spurious
        Whether to learn spurious_rate; else it is 0, and features known to be spurious are left out.
    max_range
        Limit of the sensor, metres; None takes the largest range in the log.
    block_s
        Length of the blocks of time for held-out sightings and intervals, seconds; None takes the log's places, or a
        24th of its duration.
    n_replicates, seed
        Of the bootstrap.
    max_iterations
        Of EM, at most.
    progress
        Called with the number of finished replicates and their total.

    Returns
    -------
    The parameters with intervals and findings. Where `converged` is False they are the best that was found.

    Raises
    ------
    InvalidInputError
        If an id is not in the map, an option is impossible, a range is beyond `max_range`, or a feature known to be
        spurious has one below 0.
    TooLittleDataError
        If fewer than 20 features remain, or ranges do not grow with the distance although a scale was asked for.

    Notes
    -----
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
    if max_iterations < 1:
        raise InvalidInputError(f"max_iterations: expected at least 1, got {max_iterations}")
    if max_range is not None and not 0.0 < max_range < math.inf:
        raise InvalidInputError(f"max_range: expected a positive, finite number of metres, got {max_range}")
    table = _enough(sighting_table(landmark_map, log, mount=mount, block_s=block_s), fit_spurious)
    if max_range is not None:
        _check_reach(table, max_range)
    limit = None
    if fit_spurious and not np.isnan(table.ranges).all():
        limit = max_range if max_range is not None else max(float(np.nanmax(table.ranges)), 1e-9)
        _check_spurious(table, limit)
    problem = NoiseProblem(limit, fit_spurious=fit_spurious)
    scaled = replace(problem, fit_scale=True)
    if fit_scale and not _distances_vary(table):
        raise InvalidInputError("fit_scale: expected ranges at several distances")
    if fit_scale or (fit_scale is None and _distances_vary(table) and _is_worth_it(table, problem, scaled)):
        problem = scaled
    likelihood = NoiseLikelihood(table, problem)
    climb = fit_noise(likelihood, max_iterations=max_iterations)
    if climb.theta.range_scale <= 0.0:
        raise TooLittleDataError(
            f"measured ranges do not grow with the distance (scale {climb.theta.range_scale:.3g}): "
            "no scale can be learned"
        )
    if climb.theta.spurious_rate * len(table) < NO_SIGHTING:
        climb = replace(climb, theta=climb.theta._replace(spurious_rate=0.0))
    intervals = noise_intervals(
        likelihood, table.blocks, climb.theta, n_replicates=n_replicates, seed=seed, progress=progress
    )
    of_landmark = likelihood.e_step(climb.theta)[1]
    residuals = _remaining(table, climb.theta)
    return LandmarkLearningResult(
        parameters=_as_parameters(climb.theta, limit if limit is not None else max_range),
        intervals=intervals.intervals,
        standard_errors=intervals.standard_errors,
        log_likelihood=climb.trace[-1],
        converged=climb.converged,
        n_sightings=len(table),
        n_blocks=intervals.n_blocks,
        table=table,
        findings=tuple(noise_findings(table, climb, intervals, landmark_map.ids, residuals, of_landmark)),
    )


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


def _check_reach(table: SightingTable, limit: float) -> None:
    """Refuse ranges of landmarks beyond the limit: they would count as certain, whatever sigma that takes."""
    beyond = (table.landmarks >= 0) & (table.ranges > limit)
    if beyond.any():
        i = int(beyond.argmax())
        raise InvalidInputError(
            f"a range of {table.ranges[i]:g} m at stamp {table.stamps[i]:.10g} is beyond the sensor's limit of "
            f"{limit:g} m: leave it out, or give max_range at least as large"
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
    return bool(used.any() and np.ptp(table.expected_ranges[used]) > 0.0)


def _is_worth_it(table: SightingTable, plain: NoiseProblem, scaled: NoiseProblem) -> bool:
    """Return whether held-out blocks are enough more likely with a scale; no where there are too few blocks."""
    _, number = np.unique(table.blocks, return_inverse=True)
    held_out, real = of_held_out(number), table.landmarks >= 0
    if not (real & held_out).any() or not (real & ~held_out).any():
        return False
    fitted_on, scored_on = table.subset(~held_out), table.subset(held_out)
    simple, rich = (fit_noise(NoiseLikelihood(fitted_on, problem)).theta for problem in (plain, scaled))
    judge = NoiseLikelihood(scored_on, scaled)
    without, gains = judge.e_step(simple)[0], judge.e_step(rich)[0]
    if rich.range_scale <= 0.0 or np.isneginf(gains).any():
        return False
    return is_worth_it(gains - without, scored_on.blocks)


def _remaining(table: SightingTable, theta: NoiseTheta) -> tuple[FloatArray, FloatArray]:
    ranges = table.ranges - (theta.range_scale * table.expected_ranges + theta.range_bias)
    return ranges, wrap_angle(table.bearings - table.expected_bearings - theta.bearing_bias)


def _as_parameters(theta: NoiseTheta, max_range: float | None) -> LandmarkParameters:
    return LandmarkParameters(
        None if math.isnan(theta.sigma_range) else theta.sigma_range,
        None if math.isnan(theta.sigma_bearing) else theta.sigma_bearing,
        spurious_rate=theta.spurious_rate,
        max_range=max_range,
        range_bias=theta.range_bias,
        bearing_bias=theta.bearing_bias,
        range_scale=theta.range_scale,
    )
