"""Learn the beam model's parameters of a fleet, of its sites or of its robots, from a catalogue of beams."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from beamfield.arguments import as_count, checked
from beamfield.calibration.intrinsic.block_intervals import IntervalResult, intervals_of_blocks
from beamfield.calibration.intrinsic.climb import climb
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic.learning_problem import LearningProblem, learning_problem
from beamfield.calibration.intrinsic.likelihood import parameters_of, theta_of
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.fleet.catalogue import Catalogue
from beamfield.fleet.engine import Engine
from beamfield.fleet.shard_passes import Part, SensorLimits, ShardedLikelihood, metres, shard_parts
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr

By = Literal["fleet", "site", "robot"]
LEVELS: tuple[By, ...] = ("fleet", "site", "robot")

# The first answer rests on about so many beams of so many shards, at most twice as many of either.
SAMPLE_BEAMS, SAMPLE_SHARDS = 100_000, 256
# No weight of the first answer is 0 for the full data: a cause may be too rare for the sample.
LEAST_FIRST_WEIGHT = 1e-6
TOLERANCE = 1e-10
MOST_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class GroupFit:
    """What was learned from the beams of one group: the fleet, a site or a robot, with sensors of equal limits.

    Parameters
    ----------
    site, robot
        Whose beams; None for those of all.
    limits
        Limits of the sensors.
    parameters
        The maximum-likelihood parameters.
    first
        The first answer, from a thinned sample.
    intervals
        95% intervals and standard errors by blocks of time; without entries where there is one block only.
    covariance
        Of the working vector (z_hit, z_short, z_max, z_rand, sigma_hit^2, sigma_slope^2, range_offset, lambda_short),
        by blocks of time, shape (8, 8); 0 for what is held or sits on a bound, NaN where
        there is one block only.
    log_likelihood
        At the parameters, nats per beam.
    n_beams
        What was learned from.
    passes
        How often all these beams were read; not counting the sample.
    converged
        Whether one more step promises less than 1e-10 nats per beam.
    """

    site: str | None
    robot: str | None
    limits: SensorLimits
    parameters: BeamParameters
    first: BeamParameters
    intervals: IntervalResult
    covariance: FloatArray
    log_likelihood: float
    n_beams: int
    passes: int
    converged: bool

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class FleetFit:
    """What `learn` found.

    Parameters
    ----------
    by
        "fleet", "site" or "robot": one fit for each, and for each set of sensor limits within.
    fits
        Sorted by site, robot and limits.
    left_out
        (site, robot, reason) of groups with too few beams.
    """

    by: By
    fits: tuple[GroupFit, ...]
    left_out: tuple[tuple[str | None, str | None, str], ...] = ()

    __repr__ = short_repr

    def robots_by_limits(self) -> list[tuple[GroupFit, ...]]:
        """Return the robots' fits, those of one kind of sensor together; an error if the fit is not by robot."""
        if self.by != "robot":
            raise InvalidInputError(f"fit: expected one by robot, got one by {self.by}")
        limits = sorted({one.limits for one in self.fits})
        return [tuple(one for one in self.fits if one.limits == each) for each in limits]


@checked
def learn(catalogue: Catalogue, engine: Engine, *, by: By = "fleet", thin: int = 1) -> FleetFit:
    """Learn the parameters of a fleet, of each site or of each robot, from the beams that are not held out.

    Sensors whose limits differ are learned apart: a weight of random readings up to 12 m means something else than one
    up to 30 m.

    Parameters
    ----------
    catalogue
        With the beams.
    engine
        Where the work is done. Shards are spread over its workers; with `by` "robot", robots are.
    by
        What shares one set of parameters.
    thin
        Learn from one beam in this many: an answer soon, with wider intervals.

    Returns
    -------
    The fits; the same bits for any number of workers.

    Raises
    ------
    InvalidInputError
        If an argument is impossible.
    TooLittleDataError
        If no group has 20 beams.
    FormatError
        If a shard is damaged.

    Notes
    -----
    The likelihood is that of `learn_intrinsic_parameters`, and so is its maximum: tests hold the two together to 1e-12.
    A thinned sample in memory finds the maximum's basin; Newton steps on all beams, each one pass over the shards,
    finish there (EM steps, should a Newton step fail). Beams stream through in batches of half a million.

    Intervals are those of the block jackknife, `block_intervals`, with blocks of 20 s; a longer day has 64 longer ones.

    References
    ----------
    Probabilistic Robotics, sections 6.3.2 and 6.3.3.
    """
    if by not in LEVELS:
        raise InvalidInputError(f"by: expected one of {', '.join(LEVELS)}, got {by!r}")
    as_count(thin, "thin", least=1)
    groups = _groups(catalogue, by, thin)
    outcomes = engine.map(_fit_here, groups) if by == "robot" else [_fit(group, engine) for group in groups]
    fits = tuple(item for item in outcomes if isinstance(item, GroupFit))
    left_out = tuple(
        (group.site, group.robot, item)
        for group, item in zip(groups, outcomes, strict=True)
        if not isinstance(item, GroupFit)
    )
    if not fits:
        raise TooLittleDataError(f"nothing to learn from: {left_out[0][2] if left_out else _unused(catalogue)}")
    return FleetFit(by, fits, left_out)


def _unused(catalogue: Catalogue) -> str:
    """Say why no run is used: the first reason, and where to find the others."""
    runs = catalogue.runs
    if not runs:
        return "the catalogue has no run"
    others = f"; beamfield fleet scan lists the reasons for all {len(runs)} runs" if runs[1:] else ""
    return f"no run of the catalogue is used: {runs[0].reason}{others}"


@dataclass(frozen=True)
class _Group:
    site: str | None
    robot: str | None
    limits: SensorLimits
    parts: tuple[Part, ...]


def _groups(catalogue: Catalogue, by: By, thin: int) -> list[_Group]:
    parts: dict[tuple[str, str, SensorLimits], list[Part]] = {}
    for part in shard_parts(catalogue, thin):
        key = (part.shard.site if by != "fleet" else "", part.shard.robot if by == "robot" else "", part.limits)
        parts.setdefault(key, []).append(part)
    return [
        _Group(site if by != "fleet" else None, robot if by == "robot" else None, limits, tuple(members))
        for (site, robot, limits), members in sorted(parts.items(), key=lambda item: item[0])
    ]


def _fit_here(group: _Group) -> GroupFit | str:
    with Engine("serial") as engine:
        return _fit(group, engine)


def _fit(group: _Group, engine: Engine) -> GroupFit | str:
    """Return the fit of a group, or why there is none."""
    limits = group.limits
    problem = learning_problem(limits.max_range, min_range=limits.min_range, fit_offset=True)
    try:
        first = _from_sample(group, engine)
    except TooLittleDataError as error:
        return str(error)
    start = theta_of(first)
    start[:4] = np.maximum(start[:4], LEAST_FIRST_WEIGHT)
    start = problem.apply(start)
    likelihood = ShardedLikelihood(group.parts, engine, start)
    end = climb(
        likelihood,
        problem,
        start,
        tolerance=TOLERANCE,
        max_iterations=MOST_ITERATIONS,
        em_steps_first=0,
        known=likelihood.at_start,
    )
    intervals, covariance = _intervals(group, likelihood, problem, end.theta)
    return GroupFit(
        group.site,
        group.robot,
        limits,
        parameters=parameters_of(end.theta),
        first=first,
        intervals=intervals,
        covariance=covariance,
        log_likelihood=end.objective,
        n_beams=int(likelihood.n_beams),
        passes=likelihood.passes,
        converged=end.converged,
    )


def _from_sample(group: _Group, engine: Engine) -> BeamParameters:
    some = group.parts[:: max(1, len(group.parts) // SAMPLE_SHARDS)]
    rows = sum(part.shard.rows for part in some) // some[0].thin
    fewer = max(1, rows // SAMPLE_BEAMS)
    samples = engine.map(_sample, [replace(part, thin=part.thin * fewer) for part in some])
    ranges, expected = (np.concatenate([sample[i] for sample in samples]) for i in range(2))
    limits = group.limits
    return learn_intrinsic_parameters(
        ranges, expected, limits.max_range, min_range=limits.min_range, fit_offset=True
    ).parameters


def _sample(part: Part) -> tuple[FloatArray, FloatArray]:
    batch = part.shard.read(("range", "expected_range"), fit_only=True, thin=part.thin)
    ranges, expected, hits = metres(batch["range"], batch["expected_range"], part.limits)
    return ranges[hits], expected[hits]


def _intervals(
    group: _Group, likelihood: ShardedLikelihood, problem: LearningProblem, theta: FloatArray
) -> tuple[IntervalResult, FloatArray]:
    sizes, gradients, hessian = likelihood.blocks(theta)
    length = float(np.mean([part.block_s for part in group.parts]))
    return intervals_of_blocks(problem, theta, gradients, hessian, sizes, length)
