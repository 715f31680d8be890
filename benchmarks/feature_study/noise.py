"""The noise of features of a scan against those of a map: corners with clutter, heavy tails and a limited view."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.special import gammaln

from beamfield.arguments import check_fields
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.models.line import LineParameters

HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
# What the clutter's corners open to: rooms and edges of things.
CONCAVE, CONVEX = 0.5 * math.pi, 1.5 * math.pi


@dataclass(frozen=True)
class CornerNoise:
    """How corners of a scan differ from those of a map, which ones are seen, and what else is seen.

    A corner f = (r, phi, opening) seen from a pose x is one of the map's corners j, or clutter::

        p(f | x) = (clutter p_0(f) + sum_j d_j(x) p(f | x, j)) / (clutter + sum_j d_j(x))

    d_j is exp(-r_j^2 / (2 reach^2)) for a corner in view, plus a share of `hidden` for any of them. p(f | x, j) is
    normal with the variances of the extraction plus those of the deviations below; a share `tail_share` is
    `tail_factor` times as wide. p_0 has a gamma density of the range, any bearing in view, and openings around a half
    and one and a half pi.

    `learn_feature_noise` learns the values. `TYPICAL_CORNERS` is near what five buildings give together, with maps
    drawn from other scans of the same logs (``python -m benchmarks.feature_study.coverage``); its exponent is cautious.

    Parameters
    ----------
    sigma_place, sigma_heading, sigma_opening
        Beyond what the noise of readings makes: errors of map and reference poses, walls that are not straight. Metres
        and radians, > 0.
    tail_share, tail_factor
        Share of matches, in [0, 1), that err by more, and how much more, >= 1.
    clutter
        Corners that are none of the map's, for each near corner of the map in view, > 0.
    clutter_shape, clutter_scale
        Gamma density of their ranges, > 0; scale in metres.
    convex_share, clutter_opening
        Share of them that open to more than a half turn, in (0, 1), and the spread about it, radians.
    reach
        Distance at which corners of the map become hard to see, metres, > 0.
    hidden
        Weight of all corners of the map together that should be out of view, > 0.
    exponent
        Of the likelihood of all corners of a scan: errors that they share make it too sharp. In (0, 1].

    Raises
    ------
    InvalidInputError
        If a value is out of its range.
    """

    sigma_place: float
    sigma_heading: float
    sigma_opening: float
    tail_share: float
    tail_factor: float
    clutter: float
    clutter_shape: float
    clutter_scale: float
    convex_share: float
    clutter_opening: float
    reach: float
    hidden: float
    exponent: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self)
        for name, value in vars(self).items():
            if not 0.0 <= value < np.inf or (value == 0.0 and name != "tail_share"):
                raise InvalidInputError(f"{name}: expected a positive, finite number, got {value}")
        for name in ("tail_share", "convex_share"):
            if not getattr(self, name) < 1.0:
                raise InvalidInputError(f"{name}: expected a share below 1, got {getattr(self, name)}")
        if self.tail_factor < 1.0:
            raise InvalidInputError(f"tail_factor: expected at least 1, got {self.tail_factor}")
        if self.exponent > 1.0:
            raise InvalidInputError(f"exponent: expected a number in (0, 1], got {self.exponent}")

    def deviations(self, measured: FloatArray, variances: FloatArray, cell: tuple[float, float]) -> FloatArray:
        """Return the deviations (k, 3) of range, bearing and opening of corners that are of the map.

        Parameters
        ----------
        measured, variances
            (k, 3) the corners and the variances of their extraction.
        cell
            Side (metres) and heading step (radians) of the lattice that poses are rounded to; zeros for exact poses.
        """
        place = self.sigma_place**2 + cell[0] ** 2 / 12.0
        turn = self.sigma_heading**2 + cell[1] ** 2 / 12.0
        distance = np.maximum(measured[:, 0], 1e-6)
        added = [
            np.full(len(measured), place),
            place / distance**2 + turn,
            np.full(len(measured), self.sigma_opening**2),
        ]
        return np.asarray(np.sqrt(variances + np.column_stack(added)))

    def log_match(self, residuals: FloatArray, deviations: FloatArray) -> FloatArray:
        """Return log p(f | x, j) of residuals (..., 3) with their deviations, (...)."""
        square = ((residuals / deviations) ** 2).sum(axis=-1)
        constant = -np.log(deviations).sum(axis=-1) - 3.0 * HALF_LOG_2PI
        core = math.log1p(-self.tail_share) - 0.5 * square
        if self.tail_share == 0.0:
            return np.asarray(core + constant)
        tail = math.log(self.tail_share) - 3.0 * math.log(self.tail_factor) - 0.5 * square / self.tail_factor**2
        return np.asarray(np.logaddexp(core, tail) + constant)

    def log_clutter(self, measured: FloatArray, view: float) -> FloatArray:
        """Return log p_0 (k,) of corners (k, 3) that are none of the map's, for a view of so many radians."""
        shape, scale = self.clutter_shape, self.clutter_scale
        distance, opening = np.maximum(measured[:, 0], 1e-6), measured[:, 2]
        ranges = (shape - 1.0) * np.log(distance) - distance / scale - gammaln(shape) - shape * math.log(scale)
        shares = ((1.0 - self.convex_share, CONCAVE), (self.convex_share, CONVEX))
        openings = [math.log(q) - 0.5 * ((opening - middle) / self.clutter_opening) ** 2 for q, middle in shares]
        constant = -math.log(view) - math.log(self.clutter_opening) - HALF_LOG_2PI
        return np.asarray(ranges + np.logaddexp(*openings) + constant)

    def visibility(self, distances: FloatArray) -> FloatArray:
        """Return d_j of corners in view at distances in metres, same shape."""
        return np.asarray(np.exp(-0.5 * (distances / self.reach) ** 2))


@dataclass(frozen=True)
class LineNoise:
    """How walls of a scan differ from those of a map.

    Parameters
    ----------
    parameters
        Added deviations, share of walls that the map does not show, and the largest distance of such.
    exponent
        As for `CornerNoise`.

    Raises
    ------
    InvalidInputError
        If the exponent is out of its range.
    """

    parameters: LineParameters
    exponent: float = 1.0

    def __post_init__(self) -> None:
        check_fields(self)
        if not 0.0 < self.exponent <= 1.0:
            raise InvalidInputError(f"exponent: expected a number in (0, 1], got {self.exponent}")


TYPICAL_CORNERS = CornerNoise(0.02, 0.007, 0.012, 0.3, 3.4, 3.3, 3.2, 0.9, 0.53, 0.44, 6.5, 0.08, 0.8)
TYPICAL_LINES = LineNoise(LineParameters(0.03, 0.01, 0.4, 15.0), 0.5)


@dataclass(frozen=True)
class FeatureNoise:
    """The noise of walls and of corners, for `posteriors_of_scan`."""

    lines: LineNoise = field(default=TYPICAL_LINES)
    corners: CornerNoise = field(default=TYPICAL_CORNERS)


TYPICAL_NOISE = FeatureNoise()
