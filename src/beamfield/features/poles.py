"""Round objects that stand free: tree trunks, poles, pillars (6.6.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, ndtr, ndtri

from beamfield.arguments import checked, require
from beamfield.errors import InvalidInputError
from beamfield.features.feature import Feature, polar_jacobian
from beamfield.features.straight_line import fit_line
from beamfield.features.sweep import RangeNoise, Sweep, split_at_gaps, sweeps
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.sensors import Scan

# Places of each side of a pole that the posterior is summed over, in a first pass and around what that leaves.
SIDE_PLACES = 40
# The second pass leaves out places this much chi-square worse than the best.
FAR_WORSE = 30.0
# With noisy bearings, a side may be this many deviations inside the last beam that hit, or beyond the next one. What a
# beam that hits measures is averaged over so many directions.
SIDE_DEVIATIONS = 3.0
BEARING_PLACES = 6
SMALLEST_SHARE = 1e-12
# The least cosine of incidence that is told from touching.
LEAST_COSINE = 1e-3
# A fit this bad happens to a round thing once in a thousand times.
BAD_FIT = 1e-3
# A flat board explains the points as well unless the circle is better by this much chi-square.
ROUNDER = 6.0
# The last beam on a board is often mixed with what is behind, which makes it look round: for this much chi-square the
# board may do without it. It is what a chance of 1 in 5 costs, anywhere in a metre, at a noise of 1.5 cm. On Intel,
# Belgioioso and the TurtleBot, most of what was taken for poles were such boards.
MIXED_BEAM = 9.0


@dataclass(frozen=True, eq=False)
class Pole(Feature):
    """A round object: the measurement is (range, bearing) of its centre and its diameter in metres.

    Parameters
    ----------
    chi_square
        Least one of the ranges over the circles that the silhouette allows; about n - 1 degrees of freedom with n
        beams.
    """

    chi_square: float

    @property
    def diameter(self) -> float:
        """Metres."""
        return float(self.measurement[2])


@checked
def find_poles(
    scan: Scan,
    noise: RangeNoise,
    *,
    min_points: int = 4,
    max_diameter: float = 0.6,
    clearance: float = 0.2,
    max_gap: float = 0.2,
) -> list[Pole]:
    """Return the round objects that stand free before what is behind them.

    The posterior of a circle under a uniform prior of centre and radius, given the ranges (with noise along the
    beams) and the silhouette: the trunk ends between the last beam that hits it and the next. The silhouette is what
    fixes the diameter of thin poles. The measurement is the posterior's mean, the covariance its second moments, by
    sums over where the sides may be: a circle is too far from linear for the normal equations of a fit, whose
    ellipses are too small from a noise of a tenth of the diameter on. A thing that a flat board explains as well, its
    last beams mixed with what is behind or not, is not a pole.

    Parameters
    ----------
    scan
        Ranges of any finder.
    noise
        Of single readings.
    min_points
        Fewest beams on a pole, at least 3.
    max_diameter
        Largest diameter, metres.
    clearance
        How much farther the beams on both sides must reach, metres; no return is far enough.
    max_gap
        As for `split_at_gaps`, metres.

    Raises
    ------
    InvalidInputError
        If a limit makes no sense.
    """
    if min_points < 3:
        raise InvalidInputError(f"min_points: expected at least 3, got {min_points}")
    require(max_diameter > 0.0, "max_diameter", "a positive number of metres", max_diameter)
    require(clearance > 0.0, "clearance", "a positive number of metres", clearance)
    poles = []
    for sweep in sweeps(scan):
        for run in split_at_gaps(sweep, noise, max_gap=max_gap):
            wide = np.hypot(*(sweep.points[run[-1]] - sweep.points[run[0]])) > max_diameter
            sides = None if wide or len(run) < min_points else silhouette(sweep, run, clearance)
            pole = None if sides is None else fit_pole(sweep, run, sides, noise)
            if pole is not None and pole.diameter <= max_diameter:
                poles.append(pole)
    return poles


def silhouette(sweep: Sweep, run: NDArray[np.int64], clearance: float) -> FloatArray | None:
    """Return (2,) angles from the last beams that hit to the next ones, right and left, or None if a side is hidden."""
    if run[0] == run[-1] or len(sweep) < len(run) + 2:
        return None
    gaps = []
    for edge, step in ((int(run[0]), -1), (int(run[-1]), 1)):
        beyond = edge + step
        if not 0 <= beyond < len(sweep) and not sweep.closed:
            return None
        beyond %= len(sweep)
        if sweep.returned[beyond] and sweep.ranges[beyond] < sweep.ranges[edge] + clearance:
            return None
        gaps.append(np.mod(step * (sweep.angles[beyond] - sweep.angles[edge]), 2.0 * np.pi))
    return np.array(gaps)


def fit_pole(sweep: Sweep, run: NDArray[np.int64], gaps: FloatArray, noise: RangeNoise) -> Pole | None:
    """Return the circle through a run, or None if it is none or a board does as well."""
    origin = sweep.origins[run].mean(axis=0)
    away = sweep.points[run] - origin
    ranges = np.hypot(*away.T)
    middle = np.arctan2(*away.mean(axis=0)[::-1])
    angles = wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - middle)
    if angles[-1] - angles[0] + gaps.sum() >= np.pi:
        return None
    sides = Sides(angles, gaps, noise.sigma_bearing)
    # Places of the right and of the left side, as shares of what is possible.
    limits = np.array([[0.0, 1.0], [0.0, 1.0]])
    for _ in range(2):
        right, left = (low + (np.arange(SIDE_PLACES) + 0.5) / SIDE_PLACES * (high - low) for low, high in limits)
        circles = given_sides(sides, right, left, ranges, noise)
        limits = np.array([shrink(right, circles.chi_square.min(axis=1)), shrink(left, circles.chi_square.min(axis=0))])
    cost = float(circles.chi_square.min())
    if cost > float(chdtri(len(run) - 1, BAD_FIT)) or board_cost(sweep, run, noise) - cost < ROUNDER:
        return None
    return describe(*circles.moments(origin, middle), sweep.beams[run], cost)


def board_cost(sweep: Sweep, run: NDArray[np.int64], noise: RangeNoise) -> float:
    """Return the chi-square of a flat board, whose last beams may be mixed with what is behind it."""
    costs = []
    for first, last in ((0, 0), (1, 0), (0, 1), (1, 1)):
        rest = run[first : len(run) - last]
        # Any two points lie on a board.
        straight = fit_line(sweep, rest, noise).chi_square if len(rest) > 2 else 0.0
        costs.append(straight + MIXED_BEAM * (first + last))
    return min(costs)


@dataclass(frozen=True, eq=False)
class Sides:
    """Where the sides of a pole may be: `angles` (n,) of the beams that hit it, and the gaps (2,) beyond them."""

    angles: FloatArray
    gaps: FloatArray
    sigma_bearing: float

    def place(self, shares: FloatArray, side: int) -> tuple[FloatArray, FloatArray]:
        """Return the angles at shares in [0, 1] of the possible ones, and the logarithms of their prior.

        The range of the last beam that hits grows with the root of its distance from the side: in equal steps of the
        share, which is that root, it grows evenly.
        """
        slack = SIDE_DEVIATIONS * self.sigma_bearing
        beyond = (self.gaps[side] + 2.0 * slack) * shares**2 - slack
        return self.angles[-side] + (1.0 if side else -1.0) * beyond, np.log(shares)

    def true_angles(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where the beams that hit may point, (right, left, n, q), and the log of the chance to hit and miss so.

        The q directions of a beam have equal probability given that it hits between the sides `first` and `last`.
        """
        if self.sigma_bearing == 0.0:
            shape = (len(first), len(last))
            return np.broadcast_to(self.angles[:, None], (*shape, len(self.angles), 1)), np.zeros(shape)
        right, left = (self._normal_share(side[:, None]) for side in (first, last))
        hit = np.maximum(left[None] - right[:, None], SMALLEST_SHARE)
        quantiles = (np.arange(BEARING_PLACES) + 0.5) / BEARING_PLACES
        turned = ndtri(np.clip(right[:, None, :, None] + hit[..., None] * quantiles, SMALLEST_SHARE, 1.0 - 1e-12))
        beside = np.array([self.angles[0] - self.gaps[0], self.angles[-1] + self.gaps[1]])
        missed = 1.0 - (
            ndtr((last[None, :, None] - beside) / self.sigma_bearing)
            - ndtr((first[:, None, None] - beside) / self.sigma_bearing)
        )
        log_seen = np.log(hit).sum(axis=-1) + np.log(np.maximum(missed, SMALLEST_SHARE)).sum(axis=-1)
        return self.angles[:, None] + self.sigma_bearing * turned, log_seen

    def _normal_share(self, side: FloatArray) -> FloatArray:
        return np.asarray(ndtr((side - self.angles) / self.sigma_bearing))


@dataclass(frozen=True, eq=False)
class Circles:
    """The best circle for each pair of sides: everything (right, left) but the distances' least chi-squares."""

    bearing: FloatArray
    half_angle: FloatArray
    distance: FloatArray
    variance: FloatArray
    chi_square: FloatArray
    log_weight: FloatArray

    def moments(self, origin: FloatArray, middle: float) -> tuple[FloatArray, FloatArray]:
        """Return mean (3,) and covariance (3, 3) of (x, y, radius) over all circles."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        weight /= weight.sum()
        turn = self.bearing + middle
        scale = np.stack([np.cos(turn), np.sin(turn), np.sin(self.half_angle)], axis=-1)
        mean = np.einsum("rl,rlk->k", weight * self.distance, scale)
        offset = self.distance[..., None] * scale - mean
        covariance = np.einsum("rl,rli,rlj->ij", weight, offset, offset)
        covariance += np.einsum("rl,rli,rlj->ij", weight * self.variance, scale, scale)
        return mean + np.array([*origin, 0.0]), covariance


def given_sides(sides: Sides, right: FloatArray, left: FloatArray, ranges: FloatArray, noise: RangeNoise) -> Circles:
    """Return the circles whose sides are at given shares.

    A circle between two sides is fixed but for its distance d, and all ranges are proportional to d: a weighted mean.
    """
    (first, log_first), (last, log_last) = sides.place(right, 0), sides.place(left, 1)
    bearing, half_angle = (last[None, :] + first[:, None]) / 2.0, (last[None, :] - first[:, None]) / 2.0
    angles, log_seen = sides.true_angles(first, last)
    off = angles - bearing[..., None, None]
    sine = np.sin(half_angle)[..., None, None]
    depth = np.sqrt(np.maximum(sine**2 - np.sin(off) ** 2, (LEAST_COSINE * sine) ** 2))
    each = np.cos(off) - depth
    per_metre = each.mean(axis=-1)
    variance = noise.along(ranges) ** 2 + (ranges / per_metre) ** 2 * each.var(axis=-1)
    information = np.sum(per_metre**2 / variance, axis=-1)
    distance = np.sum(per_metre * ranges / variance, axis=-1) / information
    chi_square = np.sum((ranges - distance[..., None] * per_metre) ** 2 / variance, axis=-1)
    # d^2 cos(half angle) is the volume of (x, y, radius) per distance and sides.
    log_weight = (
        log_first[:, None] + log_last[None, :] + log_seen + 2.0 * np.log(distance) + np.log(np.cos(half_angle))
        - 0.5 * (chi_square + np.log(information) + np.sum(np.log(variance), axis=-1))
    )  # fmt: skip
    return Circles(bearing, half_angle, distance, 1.0 / information, chi_square, log_weight)


def shrink(shares: FloatArray, chi_square: FloatArray) -> FloatArray:
    """Return the limits (2,) of the shares that are not hopeless."""
    hopeful = np.flatnonzero(chi_square < chi_square.min() + FAR_WORSE)
    half_step = (shares[1] - shares[0]) / 2.0
    return np.array([shares[hopeful[0]] - half_step, shares[hopeful[-1]] + half_step])


def describe(circle: FloatArray, covariance: FloatArray, beams: NDArray[np.int64], chi_square: float) -> Pole:
    """Put a circle (x, y, radius) into (range, bearing, diameter)."""
    jacobian = np.zeros((3, 3))
    jacobian[:2, :2] = polar_jacobian(circle[:2])
    jacobian[2, 2] = 2.0
    measurement = np.array([np.hypot(circle[0], circle[1]), np.arctan2(circle[1], circle[0]), 2.0 * circle[2]])
    return Pole(measurement, jacobian @ covariance @ jacobian.T, beams, chi_square)
