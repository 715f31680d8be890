"""Uniform numbers that are alike for neighbouring beams and scans: wrong readings of real sensors come in bursts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr

from beamfield.arguments import check_fields, require
from beamfield.geometry import FloatArray


@dataclass(frozen=True)
class Dependence:
    """How far the errors of one beam resemble those of its neighbours.

    Parameters
    ----------
    angle
        Bearing difference over which the correlation of the hidden Gaussian numbers falls to 1/e, radians; 0: beams
        are independent.
    time
        The same over time, seconds; 0: scans are independent.

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite.
    """

    angle: float = 0.0
    time: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("angle", "time"):
            value = getattr(self, name)
            require(0.0 <= value < np.inf, "dependence", f"{name} >= 0 and finite", value)

    @property
    def is_none(self) -> bool:
        """Whether all beams are independent."""
        return self.angle == 0.0 and self.time == 0.0


def dependent_uniforms(
    stamps: ArrayLike, bearings: ArrayLike, dependence: Dependence, rng: np.random.Generator
) -> FloatArray:
    """Draw numbers (t, k), each uniform on (0, 1), that are dependent between neighbours (a Gaussian copula).

    A Gaussian number per beam and scan follows a first-order autoregression over bearings and over time; its normal
    distribution function makes it uniform. Whatever is drawn by inverting a distribution function at these numbers has
    exactly that distribution, beam by beam, and comes in bursts.

    The stamps (t,) increase; the bearings (k,) are in any order, but those on either side of +-pi are not treated as
    neighbours.

    >>> bearings = np.linspace(0.0, 1.0, 5)
    >>> u = dependent_uniforms([0.0], bearings, Dependence(angle=100.0), np.random.default_rng(0))
    >>> float(np.ptp(u)) < 0.1
    True
    """
    times, angles = np.asarray(stamps, dtype=np.float64), np.asarray(bearings, dtype=np.float64)
    order = np.argsort(angles, kind="stable")
    latent = rng.standard_normal((len(times), len(angles)))
    _correlate(latent, times, dependence.time)
    _correlate(latent.T, angles[order], dependence.angle)
    uniform: FloatArray = np.empty_like(latent)
    uniform[:, order] = ndtr(latent)
    return np.clip(uniform, np.finfo(float).tiny, np.nextafter(1.0, 0.0))


def _correlate(rows: FloatArray, place: FloatArray, length: float) -> None:
    """Turn independent rows of N(0, 1) into an autoregression over places, in place; each stays N(0, 1)."""
    if length == 0.0:
        return
    keep = np.exp(-np.diff(place) / length)
    for i, share in enumerate(keep, start=1):
        rows[i] = share * rows[i - 1] + np.sqrt(1.0 - share**2) * rows[i]
