"""Parameters on scales where a normal distribution describes how far estimates are off, and how robots differ."""

from __future__ import annotations

import math

import numpy as np

from beamfield.calibration.intrinsic.learning_problem import LearningProblem
from beamfield.calibration.intrinsic.likelihood import OFFSET, W_HIT
from beamfield.fleet.learning import GroupFit
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters

# Log odds of the weights against z_hit, log sigma_hit, log lambda_short, and range_offset as it is.
WEIGHTS = ("z_short", "z_max", "z_rand")
NAMES = (*WEIGHTS, "sigma_hit", "lambda_short", "range_offset")
# An estimate on its bound, 0, leaves an exponential distribution: its mean is the upper end of the 95% interval over
# ln 20; its logarithm has Euler's constant less, and this variance.
_EULER = 0.5772156649015329
_VARIANCE_OF_LOG = math.pi**2 / 6.0
# What no beam tells.
UNKNOWN = 1e12
_LEAST = 1e-12


def transformed(fit: GroupFit) -> tuple[FloatArray, FloatArray]:
    """Return the parameters of a fit in the order of `NAMES`, (6,), and their variances, (6,).

    Where the beams do not determine a parameter its variance is `UNKNOWN`.
    """
    values, variances = np.zeros(len(NAMES)), np.full(len(NAMES), UNKNOWN)
    if not fit.intervals.intervals:
        return values, variances
    for i, name in enumerate(NAMES):
        known = _offset(fit) if name == "range_offset" else _log_ratio(fit, name)
        if known is not None:
            values[i], variances[i] = known
    return values, variances


def parameters_from(values: FloatArray) -> BeamParameters:
    """Return the parameters of transformed values (6,)."""
    short, largest, rand = (float(v) for v in values[:3])
    top = max(short, largest, rand, 0.0)
    hit, short, largest, rand = np.exp(np.array([0.0, short, largest, rand]) - top).tolist()
    total = hit + short + largest + rand
    return BeamParameters(
        z_hit=hit / total,
        z_short=short / total,
        z_max=largest / total,
        z_rand=rand / total,
        sigma_hit=math.exp(values[3]),
        lambda_short=math.exp(values[4]),
        range_offset=float(values[5]),
    )


def intervals_from(values: FloatArray, variances: FloatArray, reach: float) -> dict[str, tuple[float, float]]:
    """Return (low, high) by the names of `BeamParameters`, `reach` standard errors of the transformed values wide.

    A weight's interval is that of its log odds against all the others.
    """
    weights = parameters_from(values).weights
    found = {}
    for k, name in enumerate(("z_hit", *WEIGHTS)):
        w = float(weights[k])
        pull = np.where(np.arange(4) == k, 1.0, -np.asarray(weights) / max(1.0 - w, _LEAST))[1:]
        error = reach * math.sqrt(float(np.sum(pull**2 * variances[:3])))
        odds = math.log(max(w, _LEAST) / max(1.0 - w, _LEAST))
        found[name] = (_share(odds - error), _share(odds + error))
    for i, name in ((3, "sigma_hit"), (4, "lambda_short")):
        error = reach * math.sqrt(float(variances[i]))
        found[name] = (math.exp(max(values[i] - error, -700.0)), math.exp(min(values[i] + error, 700.0)))
    error = reach * math.sqrt(float(variances[5]))
    found["range_offset"] = (float(values[5]) - error, float(values[5]) + error)
    return found


def _share(log_odds: float) -> float:
    return 1.0 / (1.0 + math.exp(min(max(-log_odds, -700.0), 700.0)))


def _offset(fit: GroupFit) -> tuple[float, float] | None:
    variance = float(fit.covariance[OFFSET, OFFSET])
    return (fit.parameters.range_offset, variance) if variance > 0.0 else None


def _log_ratio(fit: GroupFit, name: str) -> tuple[float, float] | None:
    """Return log sigma_hit, log lambda_short or a weight's log odds against z_hit, and its variance."""
    own, hit = _log(fit, name), _log(fit, "z_hit") if name in WEIGHTS else (0.0, 0.0)
    if own is None or hit is None:
        return None
    i = LearningProblem.position(name)
    if name in WEIGHTS:
        covariance = float(fit.covariance[i, W_HIT]) / (getattr(fit.parameters, name) * fit.parameters.z_hit or 1.0)
    else:
        covariance = 0.0
    return own[0] - hit[0], max(own[1] + hit[1] - 2.0 * covariance, _LEAST)


def _log(fit: GroupFit, name: str) -> tuple[float, float] | None:
    value, error = getattr(fit.parameters, name), fit.intervals.standard_errors[name]
    if math.isnan(error):  # on its bound
        high = fit.intervals.intervals[name][1]
        if value > 0.0 or not 0.0 < high < math.inf:  # sigma_hit at its floor, or no interval
            return None
        return math.log(high / math.log(20.0)) - _EULER, _VARIANCE_OF_LOG
    if not (math.isfinite(error) and value > 0.0):
        return None
    return math.log(value), (error / value) ** 2
