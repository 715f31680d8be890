"""The normal of angles: mean 0, cut off at a half turn to either side, and normalised."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr, ndtri

from beamfield.geometry import FloatArray


def sample_wrapped(sigma: float, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Draw angles in [-pi, pi], of this shape, of a normal with mean 0, cut off at -pi and pi.

    sigma is the standard deviation before it is cut.
    """
    below = float(ndtr(-np.pi / sigma))
    # The lower half alone, with a random sign: ndtri is exact there.
    lower = below + rng.random(shape) * (0.5 - below)
    sign = np.where(rng.random(shape) < 0.5, 1.0, -1.0)
    with np.errstate(divide="ignore"):
        return np.asarray(sign * np.minimum(-sigma * ndtri(lower), np.pi))


def log_share_on_circle(sigma: float) -> float:
    """Return the log of the share of a normal of mean 0 and standard deviation sigma, radians, that lies in (-pi, pi].

    Examples
    --------
    >>> round(math.exp(log_share_on_circle(math.pi / 2)), 3)
    0.954
    """
    return math.log(math.erf(math.pi / (sigma * math.sqrt(2.0))))
