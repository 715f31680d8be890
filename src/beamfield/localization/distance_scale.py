"""Distances of odometry that are all off by the same share: each particle has one, and those that fit survive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from beamfield.arguments import check_fields, require
from beamfield.geometry import FloatArray
from beamfield.models.motion import check_not_negative


class ScaleEstimate(NamedTuple):
    """The relative error of the odometry's distances, by the particles: the robot drove 1 + mean times as far."""

    mean: float
    deviation: float
    """Standard deviation."""


@dataclass(frozen=True)
class DistanceScale:
    """How far off all of an odometry's distances may be alike: worn wheels, carpet, scan matching that slides.

    Noise, drawn anew at each step, makes no particle drive 5% less all the way: a filter with noise alone lags behind
    such odometry (docs/evidence/localization.md). Each particle therefore has a relative error that stays with it.
    Most robots' odometry is right to half a percent, and some are off by much more: normal, with two deviations.

    Parameters
    ----------
    usual
        Standard deviation of the relative error of most particles.
    worn
        That of the others.
    worn_share
        How many those are, from 0 to 1.
    redrawn
        Share of the particles whose error is drawn anew in a metre: floors differ, and particles that all come from
        the few that fitted at first must find other errors again.

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite, or a share above 1.

    References
    ----------
    Not in the book. Parameters in a particle filter's state: Liu and West, Combined parameter and state estimation in
    simulation-based filtering, 2001.
    """

    usual: float = 0.005
    worn: float = 0.04
    worn_share: float = 0.1
    redrawn: float = 0.01

    def __post_init__(self) -> None:
        check_fields(self)
        check_not_negative(self, "usual", "worn")
        for name in ("worn_share", "redrawn"):
            require(0.0 <= getattr(self, name) <= 1.0, name, "a share from 0 to 1", getattr(self, name))

    def times(self, factor: float) -> DistanceScale:
        """Return one for odometry that errs so many times as much."""
        return replace(self, usual=factor * self.usual, worn=factor * self.worn)

    def draw(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Return (n,) relative errors."""
        deviations = np.where(rng.random(n) < self.worn_share, self.worn, self.usual)
        return np.asarray(deviations * rng.standard_normal(n))

    def move(
        self, before: FloatArray, after: FloatArray, scales: FloatArray, distance: float, rng: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Return poses (n, 3) after a step that was sampled without such errors, and the errors (n,) after it."""
        moved, scales = after.copy(), scales.copy()
        moved[:, :2] += scales[:, np.newaxis] * (after - before)[:, :2]
        n_redrawn = rng.binomial(len(scales), min(1.0, self.redrawn * distance))
        scales[rng.integers(0, len(scales), n_redrawn)] = self.draw(n_redrawn, rng)
        return moved, scales
