"""Learn the intrinsic parameters where the cause of every beam is known (6.14) to (6.23)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import checked
from beamfield.calibration.intrinsic.learning_problem import LearningProblem, learning_problem
from beamfield.calibration.intrinsic.likelihood import (
    RATE,
    VARIANCE,
    W_HIT,
    W_MAX,
    W_SHORT,
    ExpectedStatistics,
    parameters_of,
)
from beamfield.calibration.intrinsic.m_steps import m_step
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray
from beamfield.kernels.beam import SHORTEST_SUPPORT
from beamfield.models.beam_density import CAUSES
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.blind_zone import check_limits, counted_from, expected_from


@checked
def learn_from_known_causes(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    causes: ArrayLike,
    max_range: float,
    *,
    min_range: float = 0.0,
    closed_form: bool = False,
) -> BeamParameters:
    """Return the maximum-likelihood parameters of beams whose causes are known.

    The weights are the shares of the causes (6.14). By default sigma_hit and lambda_short maximise the likelihood of
    the densities as they are, cut to [min_range, max_range] and [min_range, z*]; with `closed_form` they are the
    chapter's (6.19) and (6.23), which do so only for densities that are not cut.

    Parameters
    ----------
    ranges, expected_ranges
        Metres, shape (n,); `max_range` or more is no return.
    causes
        Shape (n,): names or positions in `beamfield.models.beam_density.CAUSES` (hit, short, max, rand).
    max_range
        Limit of the sensor, metres.
    min_range
        Nearer readings were dropped, metres; what is learned describes the others.
    closed_form
        Whether to use (6.19) and (6.23), with ranges counted from min_range in (6.23).

    Returns
    -------
    Weights and shapes of the chapter: range_offset and sigma_slope are 0.

    Raises
    ------
    InvalidInputError
        If shapes differ, a value is out of range, or a cause cannot have led to its range: max and only max for no
        return, a short not beyond z* (or a micrometre beyond min_range, if z* is less).
    TooLittleDataError
        If there is no hit.

    Notes
    -----
    Without shorts every lambda_short is as likely; it is then 0.

    References
    ----------
    Probabilistic Robotics, section 6.3.3: (6.14), (6.19) and (6.23).

    Examples
    --------
    >>> learn_from_known_causes([0.9, 1.1, 0.5, 8.0], [1.0] * 4, ["hit", "hit", "short", "max"], 8.0, closed_form=True)
    BeamParameters(z_hit=0.5, z_short=0.25, z_max=0.25, z_rand=0.0, sigma_hit=0.1..., lambda_short=2.0, ...)
    """
    check_limits(max_range, min_range)
    z = np.asarray(ranges, dtype=np.float64)
    expected = np.asarray(expected_ranges, dtype=np.float64)
    numbers = _numbers(causes)
    for name, column in (("ranges", z), ("expected_ranges", expected), ("causes", numbers)):
        if column.ndim != 1 or column.shape != z.shape:
            raise InvalidInputError(f"{name}: expected one dimension as long as ranges, got shape {column.shape}")
    _check_consistency(z, expected, numbers, max_range, min_range)
    counts = np.bincount(numbers, minlength=4).astype(np.float64)
    if counts[W_HIT] == 0.0:
        raise TooLittleDataError(f"0 hits among {z.size} beams: sigma_hit is not defined")

    problem = learning_problem(max_range, min_range=min_range)
    z, expected = counted_from(min_range, z, max_range), expected_from(min_range, expected)
    theta = _closed_form(z, expected, numbers, counts, problem)
    if not closed_form:
        theta = m_step(_known_statistics(z, expected, numbers, counts), theta, problem)
    return parameters_of(theta)


def _numbers(causes: ArrayLike) -> NDArray[np.int64]:
    column = np.asarray(causes)
    if column.dtype.kind in "US":
        unknown = sorted(set(column.tolist()) - set(CAUSES))
        if unknown:
            raise InvalidInputError(f"causes: expected names among {', '.join(CAUSES)}, got {unknown[0]!r}")
        return np.array([CAUSES.index(name) for name in column.tolist()], dtype=np.int64)
    if column.size and (column.dtype.kind not in "iu" or not 0 <= column.min() <= column.max() < len(CAUSES)):
        raise InvalidInputError("causes: expected names or positions 0 to 3 (hit, short, max, rand)")
    return column.astype(np.int64)


def _check_consistency(
    z: FloatArray, expected: FloatArray, causes: NDArray[np.int64], max_range: float, min_range: float
) -> None:
    wrong = ~((z >= min_range) & (expected >= 0.0) & (expected <= max_range))
    wrong |= (z >= max_range) != (causes == W_MAX)
    wrong |= (causes == W_SHORT) & (z > np.maximum(expected, min_range + SHORTEST_SUPPORT))
    if wrong.any():
        i = int(np.flatnonzero(wrong)[0])
        raise InvalidInputError(
            f"beam {i}: range {z[i]} with expected range {expected[i]} cannot be caused by {CAUSES[causes[i]]!r}"
        )


def _closed_form(
    z: FloatArray, expected: FloatArray, causes: NDArray[np.int64], counts: FloatArray, problem: LearningProblem
) -> FloatArray:
    """(6.14), (6.19) and (6.23)."""
    hit, short = causes == W_HIT, causes == W_SHORT
    theta = np.zeros(8)
    theta[:4] = counts / z.size
    theta[VARIANCE] = np.mean((z[hit] - expected[hit]) ** 2)
    total = float(z[short].sum())
    theta[RATE] = counts[W_SHORT] / total if total > 0.0 else (problem.upper[RATE] if short.any() else 0.0)
    return problem.apply(theta)


def _known_statistics(
    z: FloatArray, expected: FloatArray, causes: NDArray[np.int64], counts: FloatArray
) -> ExpectedStatistics:
    """Statistics of certain causes: every beam is a node of weight 0 or 1."""
    hit, short = (causes == W_HIT).astype(np.float64), (causes == W_SHORT).astype(np.float64)
    error = np.where(hit > 0.0, z - expected, 0.0)
    return ExpectedStatistics(
        log_likelihood=np.nan,
        counts=counts,
        node_ranges=expected,
        node_hit=np.stack([hit, error, error**2]),
        node_short=short,
        sum_short_range=float(z[causes == W_SHORT].sum()),
        cut_matters=True,
    )
