"""Draw readings from the beam model."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtri_exp

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels.beam import SHORTEST_SUPPORT
from beamfield.models.beam_density import as_expected_ranges, as_view
from beamfield.models.beam_parameters import BeamParameters

# Draws of one go: keeps the temporary arrays in the cache and memory small.
CHUNK = 1 << 16


def sample_beams(
    expected_ranges: ArrayLike, max_range: float, parameters: BeamParameters, rng: np.random.Generator
) -> FloatArray:
    """Draw one reading per beam from the mixture (6.12).

    Each beam draws its cause by the weights and its range by the cause's distribution, from the inverse of the
    distribution function.

    Parameters
    ----------
    expected_ranges
        Expected ranges z* in metres, any shape; values above `max_range` count as `max_range`, NaN gives NaN.
    max_range
        The sensor's limit in metres.
    parameters
        Weights and shapes of the four densities.
    rng
        Source of randomness; the same state gives the same readings.

    Returns
    -------
    Metres, of the same shape: in [0, max_range), or exactly max_range for "no return".

    Raises
    ------
    InvalidInputError
        If an expected range is negative or max_range is not positive and finite.

    References
    ----------
    Probabilistic Robotics, section 6.3.1: the generative reading of (6.12).
    """
    limit = as_view(parameters, max_range).max_range
    expected = np.minimum(as_expected_ranges(expected_ranges), limit)
    flat = expected.reshape(-1)
    out: FloatArray = np.empty(flat.size)
    for start in range(0, flat.size, CHUNK):
        part = slice(start, min(start + CHUNK, flat.size))
        n = part.stop - part.start
        out[part] = _invert(rng.random(n), rng.random(n), flat[part], limit, parameters)
    return out.reshape(expected.shape)


def beams_from_uniforms(
    cause_uniforms: ArrayLike,
    range_uniforms: ArrayLike,
    expected_ranges: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
) -> FloatArray:
    """Return the reading that two numbers in [0, 1) stand for, per beam: what `sample_beams` does with its draws.

    If both numbers are uniform and independent of each other, a reading has exactly the distribution of the mixture,
    whatever the dependence between beams; so dependent beams can be drawn from dependent numbers.

    Parameters
    ----------
    cause_uniforms, range_uniforms
        Numbers in [0, 1) that choose the cause, and the range given the cause; of one shape with the expected ranges.
    expected_ranges, max_range, parameters
        As for `sample_beams`.
    """
    limit = as_view(parameters, max_range).max_range
    expected = np.minimum(as_expected_ranges(expected_ranges), limit)
    u, v = np.asarray(cause_uniforms, dtype=np.float64), np.asarray(range_uniforms, dtype=np.float64)
    if not u.shape == v.shape == expected.shape:
        raise InvalidInputError(f"uniforms: expected shape {expected.shape}, got {u.shape} and {v.shape}")
    return _invert(u.ravel(), v.ravel(), expected.ravel(), limit, parameters).reshape(expected.shape)


def _invert(
    u: FloatArray, v: FloatArray, z_star: FloatArray, max_range: float, parameters: BeamParameters
) -> FloatArray:
    cause = np.searchsorted(np.cumsum(parameters.weights)[:3], u, side="right")
    hit, short = cause == 0, cause == 1
    z = v * max_range
    z[hit] = _hit_quantile(v[hit], z_star[hit], max_range, parameters)
    z[short] = _short_quantile(v[short], z_star[short], parameters.lambda_short)
    # A rounding must not turn a range into "no return", which has its own probability.
    z = np.clip(z, 0.0, np.nextafter(max_range, 0.0))
    z[cause == 2] = max_range
    z[np.isnan(z_star)] = np.nan
    return z


def _hit_quantile(v: FloatArray, z_star: FloatArray, max_range: float, parameters: BeamParameters) -> FloatArray:
    """Invert the distribution function of (6.4), in log space so that any tail works."""
    mean = z_star + parameters.range_offset
    sigma = np.hypot(parameters.sigma_hit, parameters.sigma_slope * z_star)
    low, high = -mean / sigma, (max_range - mean) / sigma
    # Mirror where needed so that most of the interval lies above the mean, where log P(t > x) is exact.
    mirror = low + high < 0.0
    near, far = np.where(mirror, -high, low), np.where(mirror, -low, high)
    above_near, above_far = log_ndtr(-near), log_ndtr(-far)
    log_above = above_near + np.log1p(v * np.expm1(above_far - above_near))
    t = -ndtri_exp(log_above)
    return np.asarray(mean + sigma * np.where(mirror, -t, t))


def _short_quantile(v: FloatArray, z_star: FloatArray, lambda_short: float) -> FloatArray:
    """Invert the distribution function of (6.7)."""
    support = np.maximum(z_star, SHORTEST_SUPPORT)
    if lambda_short == 0.0:
        return np.asarray(v * support)
    return np.asarray(np.minimum(-np.log1p(v * np.expm1(-lambda_short * support)) / lambda_short, support))
