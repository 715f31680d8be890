"""What the error of the poses does to parameters that were learned at them: simulation and extrapolation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import as_floats, require
from beamfield.calibration.intrinsic.block_intervals import IntervalResult
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import WEIGHTS, BeamParameters
from beamfield.sensors import SensorLog


def as_pose_covariances(log: SensorLog, covariances: ArrayLike) -> FloatArray:
    """Return the covariances of a log's poses as (t, 3, 3); raise unless each pose has one."""
    given = as_floats(covariances, "covariances")
    require(given.shape == (len(log), 3, 3), "covariances", f"shape ({len(log)}, 3, 3)", given.shape)
    posed = np.isfinite(log.poses).all(axis=1)
    if not np.isfinite(given[posed]).all():
        raise InvalidInputError("covariances: expected finite numbers wherever there is a pose")
    if len(given[posed]) and np.linalg.eigvalsh(given[posed])[:, 0].min() < -1e-9:
        raise InvalidInputError("covariances: expected positive semi-definite matrices")
    return given


def with_error_again(log: SensorLog, covariances: FloatArray, seed: int) -> SensorLog:
    """Return the log at poses with twice the variance of their errors: one more error is drawn for each."""
    poses = log.poses.copy()
    posed = np.isfinite(poses).all(axis=1)
    variances, axes = np.linalg.eigh(covariances[posed])
    drawn = np.random.default_rng(seed).standard_normal((len(variances), 3))
    poses[posed] += np.einsum("tij,tj->ti", axes, np.sqrt(np.maximum(variances, 0.0)) * drawn)
    return log.with_poses(poses)


def with_pose_error(intervals: IntervalResult, fit: BeamParameters, again: BeamParameters) -> IntervalResult:
    """Widen intervals by what the error of the poses does to the parameters.

    Parameters
    ----------
    intervals
        Those of `fit`, for exact poses.
    fit
        What was learned at the poses.
    again
        What was learned where their error has twice the variance: to first order in the variance, the error has changed
        `fit` by as much as a second one changes it.

    Returns
    -------
    Each interval as it was, joined with itself moved back by that change.

    References
    ----------
    Cook and Stefanski 1994, simulation and extrapolation, linear in the variance.
    """
    ends = {}
    for name, (low, high) in intervals.intervals.items():
        before, after = getattr(fit, name), getattr(again, name)
        # Variances add up, deviations do not.
        power = 2.0 if name in ("sigma_hit", "sigma_slope") else 1.0
        least, most = -np.inf if name == "range_offset" else 0.0, 1.0 if name in WEIGHTS else np.inf
        back = np.clip(np.array([low, high]) ** power - (after**power - before**power), least, most) ** (1.0 / power)
        ends[name] = min(low, float(back[0])), max(high, float(back[1]))
    return replace(intervals, intervals=ends)
