"""Draw readings from the beam model."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr, ndtri_exp

from beamfield.arguments import checked
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels.beam import SHORTEST_SUPPORT, BeamView
from beamfield.models.beam_density import as_expected_ranges, as_view
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.blind_zone import expected_from

# Draws of one go: keeps the temporary arrays in the cache and memory small.
CHUNK = 1 << 16


@checked
def sample_beams(
    expected_ranges: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
    rng: np.random.Generator,
    *,
    min_range: float = 0.0,
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
    min_range
        Nearer readings are not seen, metres; see `beam_log_density`.

    Returns
    -------
    Metres, of the same shape: in [min_range, max_range), or exactly max_range for "no return".

    Raises
    ------
    InvalidInputError
        If an expected range is negative or the limits are not 0 <= min_range < max_range.

    References
    ----------
    Probabilistic Robotics, section 6.3.1: the generative reading of (6.12).

    Examples
    --------
    >>> parameters = BeamParameters(z_hit=0.0, z_short=0.0, z_max=1.0, z_rand=0.0, sigma_hit=0.1, lambda_short=0.5)
    >>> sample_beams([1.0, 2.0], 8.0, parameters, np.random.default_rng(0)).tolist()
    [8.0, 8.0]
    """
    view = as_view(parameters, max_range, min_range)
    expected = np.minimum(expected_from(min_range, as_expected_ranges(expected_ranges)), view.max_range)
    flat = expected.reshape(-1)
    out: FloatArray = np.empty(flat.size)
    for start in range(0, flat.size, CHUNK):
        part = slice(start, min(start + CHUNK, flat.size))
        n = part.stop - part.start
        out[part] = _invert(rng.random(n), rng.random(n), flat[part], view)
    return _counted_from_zero(out, view, max_range).reshape(expected.shape)


def beams_from_uniforms(
    cause_uniforms: ArrayLike,
    range_uniforms: ArrayLike,
    expected_ranges: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
    *,
    min_range: float = 0.0,
) -> FloatArray:
    """Return the reading that two numbers in [0, 1) stand for, per beam: what `sample_beams` does with its draws.

    If both numbers, that which chooses the cause and that which chooses the range given the cause, are uniform and
    independent of each other, a reading has exactly the distribution of the mixture, whatever the dependence between
    beams; so dependent beams can be drawn from dependent numbers. All arrays have one shape, or InvalidInputError says
    so.
    """
    view = as_view(parameters, max_range, min_range)
    expected = np.minimum(expected_from(min_range, as_expected_ranges(expected_ranges)), view.max_range)
    u, v = np.asarray(cause_uniforms, dtype=np.float64), np.asarray(range_uniforms, dtype=np.float64)
    if not u.shape == v.shape == expected.shape:
        raise InvalidInputError(f"uniforms: expected shape {expected.shape}, got {u.shape} and {v.shape}")
    drawn = _invert(u.ravel(), v.ravel(), expected.ravel(), view)
    return _counted_from_zero(drawn, view, max_range).reshape(expected.shape)


def _counted_from_zero(ranges: FloatArray, view: BeamView, max_range: float) -> FloatArray:
    """Return drawn ranges, which are counted from min_range, as the sensor would say them."""
    if view.min_range == 0.0:
        return ranges
    farthest = np.nextafter(float(max_range), 0.0)
    return np.where(ranges >= view.max_range, float(max_range), np.minimum(view.min_range + ranges, farthest))


def _invert(u: FloatArray, v: FloatArray, z_star: FloatArray, view: BeamView) -> FloatArray:
    cause = np.searchsorted(np.cumsum([view.z_hit, view.z_short, view.z_max]), u, side="right")
    hit, short = cause == 0, cause == 1
    z = v * view.max_range
    z[hit] = _hit_quantile(v[hit], z_star[hit], view)
    z[short] = _short_quantile(v[short], z_star[short], view.lambda_short)
    # A rounding must not turn a range into "no return", which has its own probability.
    z = np.clip(z, 0.0, np.nextafter(view.max_range, 0.0))
    z[cause == 2] = view.max_range
    z[np.isnan(z_star)] = np.nan
    return z


def _hit_quantile(v: FloatArray, z_star: FloatArray, view: BeamView) -> FloatArray:
    """Invert the distribution function of (6.4), in log space so that any tail works."""
    mean = z_star + view.range_offset
    sigma = np.hypot(view.sigma_hit, view.sigma_slope * (view.min_range + z_star))
    low, high = -mean / sigma, (view.max_range - mean) / sigma
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
