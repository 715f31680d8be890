"""Learn the intrinsic parameters of the beam model by maximum likelihood (6.3.2, 6.3.3, Table 6.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import as_floats, checked, require
from beamfield.calibration.intrinsic.climb import Climb, climb
from beamfield.calibration.intrinsic.identifiability import Mode, identifiability_findings
from beamfield.calibration.intrinsic.learning_problem import LearningProblem, learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, parameters_of, theta_of
from beamfield.calibration.intrinsic.priors import IntrinsicPriors
from beamfield.calibration.intrinsic.starts import MOST_STARTS, data_driven_starts
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.blind_zone import check_limits
from beamfield.short_repr import short_repr

Progress = Callable[[str, int], None]

# Six parameters from fewer beams than this are noise.
FEWEST_BEAMS = 20
# All starts are climbed on about this many beams; only what is best there is climbed on all.
SCREENING_BEAMS = 20_000
_SCREENING_ITERATIONS = 200
# A mode within this of the best of the screening, nats per beam, may still be the best of all beams.
_SCREENING_SLACK = 0.01
_MOST_FINALISTS = 3


@dataclass(frozen=True)
class LearningResult:
    """What was learned, and how.

    Parameters
    ----------
    parameters
        The maximum-likelihood (with priors: maximum a posteriori) parameters.
    log_likelihood
        At these parameters, nats per beam that was used; priors not counted.
    trace
        What was climbed on all beams, at the best start and after each iteration, nats per beam: the log-likelihood,
        plus the log prior if there is one. It never falls. Where starts are tried on a sample of the beams (40,000 and
        more), the best start is what was reached there.
    iterations, em_steps, newton_steps
        Iterations of that climb, and how many of each kind.
    converged
        Whether one more step promises less than the tolerance.
    n_beams
        Beams that were used.
    n_excluded
        Beams left out because their ray hits nothing: with z* = max_range the model's readings pile up on two places at
        once, which ruins z_max.
    n_no_measurement
        Readings that are NaN, which say nothing and were left out.
    modes
        The distinct maxima that the starts led to, best first, as parameters with their log-likelihood per beam.
    findings
        What the data cannot tell, by name.
    """

    parameters: BeamParameters
    log_likelihood: float
    trace: tuple[float, ...]
    iterations: int
    em_steps: int
    newton_steps: int
    converged: bool
    n_beams: int
    n_excluded: int
    n_no_measurement: int
    modes: tuple[Mode, ...]
    findings: tuple[Finding, ...]

    __repr__ = short_repr


@checked
def learn_intrinsic_parameters(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    max_range: float,
    *,
    min_range: float = 0.0,
    initial: BeamParameters | None = None,
    hold: Mapping[str, float] | None = None,
    priors: IntrinsicPriors | None = None,
    fit_offset: bool = False,
    fit_sigma_slope: bool = False,
    n_starts: int = MOST_STARTS,
    tolerance: float = 1e-10,
    max_iterations: int = 500,
    accelerate: bool = True,
    weights: ArrayLike | None = None,
    device: Literal["cpu", "cuda"] = "cpu",
    progress: Progress | None = None,
) -> LearningResult:
    """Return the parameters that make the ranges most likely, given what the map lets expect.

    Expectation maximisation with the responsibilities of the mixture (6.12) and exact M-steps for the truncated
    densities, finished by Newton steps on the likelihood itself. The likelihood never falls on the way.

    Parameters
    ----------
    ranges
        Measured ranges, metres, shape (n,); `max_range` or more (also +inf) is no return, NaN no measurement: such a
        beam contributes nothing.
    expected_ranges
        Ranges z* that the map lets expect, metres, shape (n,); `max_range` or more means that the ray hits nothing.
    max_range
        Limit of the sensor, metres.
    min_range
        Nearer readings were dropped, metres: what is learned describes the others (`RangeFinder.min_range`).
    initial
        One more start, tried first; usually not needed.
    hold
        Parameters to keep at a value, by the names of `BeamParameters`. The free weights share what held ones leave.
    priors
        Priors on weights, sigma_hit and lambda_short; None for maximum likelihood.
    fit_offset
        Learn `range_offset` too: the map's wall surface need not be the cell's edge.
    fit_sigma_slope
        Learn `sigma_slope` too: noise that grows with the expected range.
    n_starts
        How many of the data-driven starts to try, 1 to 6.
    tolerance
        Nats per beam that one more step may promise when this counts as converged.
    max_iterations
        Most iterations on all beams, from each start.
    accelerate
        False for plain EM, which crawls where components trade places.
    weights
        How often each beam counts, shape (n,), >= 0; None for once.
    device
        Where passes over all beams run: "cpu", or "cuda", a GPU (docs/gpu.md).
    progress
        Called with the stage (``"screening"``, ``"climbing"``) and a count.

    Returns
    -------
    The parameters, the trace of the climb, and findings that say what the beams leave open. Where `converged` is False
    they are the best that was found.

    Raises
    ------
    InvalidInputError
        If shapes differ, a range is negative or below min_range, an expected range negative or NaN (the message names
        its index), an option is impossible, or device is "cuda" and there is no GPU, or one with too little free
        memory.
    TooLittleDataError
        If fewer than 20 beams remain.
    MissingDependencyError
        If device is "cuda" and numba-cuda is not installed.

    Notes
    -----
    Table 6.2 taken literally does not maximise (6.13): its E-step (6.27) leaves out the mixture weights, and (6.30) and
    (6.31) are maximisers for untruncated densities only. Here the weights are in, and the shapes maximise the expected
    log-likelihood of a hit cut to [0, z_max] and a short cut to [0, z*]. See docs/evidence/learning.md.

    A parameter at the edge of its range is a result: ``lambda_short`` = 0 (shorts uniform on [0, z*]) and a weight of 0
    are frequent on real data. At z = z_max only the point mass counts, so the learned ``z_max`` is exactly the share of
    such readings. Where hits are exact the likelihood has no maximum; sigma_hit stops at 1e-5 max_range and a finding
    says so.

    References
    ----------
    Probabilistic Robotics, sections 6.3.2 and 6.3.3, Table 6.2, equations (6.13) and (6.24) to (6.31).

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> expected = rng.uniform(1.0, 9.0, 5000)
    >>> ranges = np.clip(rng.normal(expected, 0.05), 0.0, 10.0)
    >>> ranges[:500] = 10.0
    >>> result = learn_intrinsic_parameters(ranges, expected, 10.0)
    >>> round(result.parameters.z_max, 3), round(result.parameters.sigma_hit, 2), result.converged
    (0.1, 0.05, True)
    """
    z, expected, counts = checked_beams(ranges, expected_ranges, max_range, min_range, weights)
    measured, hits = ~np.isnan(z), expected < max_range
    n_no_measurement = int(z.size - np.count_nonzero(measured))
    used = hits if n_no_measurement == 0 else hits & measured
    n_unused = int(used.size - np.count_nonzero(used))
    n_excluded = n_unused - n_no_measurement  # of the beams with a measurement
    if n_unused:
        z, expected = z[used], expected[used]
        counts = None if counts is None else counts[used]
    n_counted = z.size if counts is None else int(np.count_nonzero(counts))
    if n_counted < FEWEST_BEAMS:
        raise TooLittleDataError(
            f"{n_counted} beams to learn from, need {FEWEST_BEAMS}: of {used.size} beams {n_no_measurement} carry no "
            f"measurement, the rays of {n_excluded} hit nothing in the map, and {z.size - n_counted} have weight 0"
        )
    _check_options(n_starts, tolerance, max_iterations)
    problem = learning_problem(
        max_range, min_range=min_range, hold=hold, priors=priors, fit_offset=fit_offset, fit_sigma_slope=fit_sigma_slope
    )
    likelihood = IntrinsicLikelihood(z, expected, float(max_range), min_range=min_range, weights=counts, device=device)
    if likelihood.n_max > 0.0 and not problem.free[2] and problem.held[2] == 0.0:
        raise InvalidInputError(
            f"hold z_max: expected more than 0 because {likelihood.n_max:g} readings are at max_range, got 0"
        )

    report = progress or (lambda _stage, _count: None)
    sample = likelihood.thinned(SCREENING_BEAMS)
    starts = data_driven_starts(sample, problem, n_starts)
    if initial is not None:
        starts.insert(0, problem.apply(theta_of(initial)))
    most = _SCREENING_ITERATIONS if sample is not likelihood else min(_SCREENING_ITERATIONS, max_iterations)
    climbs = []
    for so_far in _screen(sample, problem, starts, most, accelerate, report):
        # Of few beams the sample is all: what was climbed there is part of the climb.
        steps = so_far.em_steps + so_far.newton_steps if sample is likelihood else 0
        rest = climb(
            likelihood,
            problem,
            so_far.theta,
            tolerance=tolerance,
            max_iterations=max_iterations - steps,
            accelerate=accelerate,
            report=lambda iteration: report("climbing", iteration),
        )
        climbs.append(_joined(so_far, rest) if sample is likelihood else rest)
    climbs.sort(key=lambda item: -item.objective)
    if not climbs or climbs[0].objective == -np.inf:
        held = ", ".join(f"{name} = {value:g}" for name, value in (hold or {}).items())
        raise InvalidInputError(
            f"hold: with {held} some reading has no cause; expected z_rand above 0, and z_max too if readings are at "
            f"max_range ({likelihood.n_max:g} are)"
        )
    return _result(likelihood, problem, climbs, n_counted, n_excluded, n_no_measurement)


def checked_beams(
    ranges: ArrayLike, expected_ranges: ArrayLike, max_range: float, min_range: float, weights: ArrayLike | None = None
) -> tuple[FloatArray, FloatArray, FloatArray | None]:
    """Return beams and their weights as float64 columns of one length, or say what is wrong with them."""
    check_limits(max_range, min_range)
    z = _column("ranges", ranges, min_range, may_be_nan=True)
    expected = _column("expected_ranges", expected_ranges)
    counts = None if weights is None else _column("weights", weights)
    for name, column in (("expected_ranges", expected), ("weights", counts)):
        if column is not None and column.shape != z.shape:
            raise InvalidInputError(f"{name}: expected the shape of ranges {z.shape}, got {column.shape}")
    if counts is not None and not np.isfinite(counts).all():
        raise InvalidInputError("weights: expected finite numbers")
    return z, expected, counts


def _column(name: str, values: ArrayLike, least: float = 0.0, *, may_be_nan: bool = False) -> FloatArray:
    column = as_floats(values, name)
    if column.ndim != 1:
        raise InvalidInputError(f"{name}: expected one dimension, got shape {column.shape}; .ravel() makes one")
    # NaN fails the comparison too. One pass without a mask for the usual case: 10^7 beams are not rare.
    if column.size and not column.min() >= least:
        wrong = column < least if may_be_nan else ~(column >= least)
        if wrong.any():
            index = int(np.flatnonzero(wrong)[0])
            raise InvalidInputError(f"{name}[{index}]: expected a number >= {least:g}, got {column[index]}")
    return column


def _check_options(n_starts: int, tolerance: float, max_iterations: int) -> None:
    require(1 <= n_starts <= MOST_STARTS, "n_starts", f"1 to {MOST_STARTS}", n_starts)
    require(0.0 < tolerance < np.inf, "tolerance", "a positive number of nats per beam", tolerance)
    require(max_iterations >= 1, "max_iterations", "at least 1", max_iterations)


def _screen(
    sample: IntrinsicLikelihood,
    problem: LearningProblem,
    starts: list[FloatArray],
    max_iterations: int,
    accelerate: bool,
    report: Progress,
) -> list[Climb]:
    """Climb from every start on a sample of the beams; return distinct climbs that may be best on all, best first."""
    ends: list[Climb] = []
    for number, start in enumerate(starts):
        report("screening", number)
        ends.append(climb(sample, problem, start, tolerance=1e-8, max_iterations=max_iterations, accelerate=accelerate))
    ends.sort(key=lambda item: -item.objective)
    finalists: list[Climb] = []
    for end in ends:
        near_best = end.objective > ends[0].objective - _SCREENING_SLACK
        is_new = all(_differ(end.theta, other.theta) for other in finalists)
        if near_best and is_new and len(finalists) < _MOST_FINALISTS:
            finalists.append(end)
    return finalists


def _joined(first: Climb, rest: Climb) -> Climb:
    """Return one climb from the start of `first` to the end of `rest`, which began where `first` ended."""
    return replace(
        rest,
        trace=(*first.trace, *rest.trace[1:]),
        em_steps=first.em_steps + rest.em_steps,
        newton_steps=first.newton_steps + rest.newton_steps,
    )


def _differ(theta: FloatArray, other: FloatArray) -> bool:
    """Whether two ends are different maxima rather than one approached from two sides."""
    spread = np.abs(np.log(theta[4] / other[4]))
    return bool(np.abs(theta[:4] - other[:4]).max() > 0.01 or spread > 0.1 or abs(theta[6] - other[6]) > 0.01)


def _result(
    likelihood: IntrinsicLikelihood,
    problem: LearningProblem,
    climbs: list[Climb],
    n_used: int,
    n_excluded: int,
    n_no_measurement: int,
) -> LearningResult:
    best = climbs[0]
    distinct: list[Climb] = []
    for item in climbs:
        if all(_differ(item.theta, other.theta) for other in distinct):
            distinct.append(item)
    n = likelihood.n_beams
    modes = tuple(
        Mode(parameters_of(item.theta), item.objective - problem.priors.log_density(item.theta)[0] / n)
        for item in distinct
    )
    return LearningResult(
        parameters=modes[0].parameters,
        log_likelihood=modes[0].log_likelihood,
        trace=best.trace,
        iterations=best.em_steps + best.newton_steps,
        em_steps=best.em_steps,
        newton_steps=best.newton_steps,
        converged=best.converged,
        n_beams=n_used,
        n_excluded=n_excluded,
        n_no_measurement=n_no_measurement,
        modes=modes,
        findings=(*_convergence_findings(best), *identifiability_findings(likelihood, problem, best.theta, modes)),
    )


def _convergence_findings(best: Climb) -> Iterator[Finding]:
    if not best.converged:
        steps = best.em_steps + best.newton_steps
        yield Finding(
            "not-converged",
            "warning",
            f"Learning stopped after {steps} iterations before it converged.",
            {"iterations": float(steps)},
            why="Other values may explain the beams better.",
            do="Raise max_iterations.",
        )
