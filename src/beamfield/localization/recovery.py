"""Finding a lost robot again: when poses are drawn anew, and from where (augmented filter, sensor resetting)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

import numpy as np

from beamfield.arguments import as_count, check_fields, check_magnitude, require
from beamfield.detections import SPURIOUS, Detections
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray
from beamfield.kernels import particles as kernels
from beamfield.localization.particles import free_poses, require_free
from beamfield.localization.resampling import systematic_indices
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.models.base import MeasurementModel, checked_log_likelihood
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_poses import sample_poses
from beamfield.sensors import Scan
from beamfield.short_repr import short_repr

Z_contra = TypeVar("Z_contra", contravariant=True)
# Effective number of candidates that poses are drawn from by a scan, at least.
LEAST_EFFECTIVE = 20
# Candidates where there are several landmarks: of 20, most fit one landmark alone.
LANDMARK_CANDIDATES = 5000


@dataclass(frozen=True)
class Recovery:
    """When the filter draws poses anew: the averages w_slow and w_fast of the augmented filter.

    At each measurement the two averages of the likelihood move towards its value by the shares alpha_slow and
    alpha_fast; when particles are drawn, each is replaced with probability max(0, 1 - w_fast / w_slow), at most `most`.

    Parameters
    ----------
    alpha_slow, alpha_fast
        Shares, 0 < alpha_slow < alpha_fast <= 1.
    readings
        The likelihood averaged is that of one reading, w^(1/readings): the likelihood of a whole scan varies over so
        many powers of ten that an average says only which scan was the best. 1 is the table to the letter. Sensible is
        the exponent of the model times its number of beams.
    most
        No particle is replaced with a higher probability. A stretch that the map does not know fits badly at the right
        place, too, and a cloud replaced as a whole has lost it; 1 is the table to the letter.

    Raises
    ------
    InvalidInputError
        If a number is out of range.

    References
    ----------
    Probabilistic Robotics, Table 8.3 (Augmented_MCL).
    """

    alpha_slow: float = 0.005
    alpha_fast: float = 0.1
    readings: float = 1.0
    most: float = 0.1

    def __post_init__(self) -> None:
        check_fields(self)
        if not 0.0 < self.alpha_slow < self.alpha_fast <= 1.0:
            raise InvalidInputError(
                f"alpha_slow, alpha_fast: expected 0 < alpha_slow < alpha_fast <= 1, got {self.alpha_slow} and "
                f"{self.alpha_fast}"
            )
        check_magnitude("readings", self.readings)
        require(0.0 < self.most <= 1.0, "most", "a probability above 0", self.most)


class LikelihoodAverages:
    """The two averages of `Recovery`, as they run along.

    Parameters
    ----------
    recovery
        Their shares.
    """

    def __init__(self, recovery: Recovery) -> None:
        self._recovery = recovery
        # Logarithms: a power of a density may be beyond what a float holds.
        self._slow = self._fast = math.nan

    def add(self, log_likelihood: float) -> None:
        """Take in the logarithm of a measurement's mean likelihood; -inf for an impossible one."""
        value = log_likelihood / self._recovery.readings
        if math.isnan(self._slow):
            if value > -math.inf:
                self._slow = self._fast = value
            return
        self._slow = _log_mix(self._slow, value, self._recovery.alpha_slow)
        self._fast = _log_mix(self._fast, value, self._recovery.alpha_fast)

    @property
    def share(self) -> float:
        """Probability that a particle is replaced, in [0, 1]."""
        if math.isnan(self._slow):
            return 0.0
        return min(self._recovery.most, -math.expm1(min(0.0, self._fast - self._slow)))


def _log_mix(old: float, new: float, share: float) -> float:
    """Return log((1 - share) e^old + share e^new)."""
    top = max(old, new)
    if top == -math.inf:
        return top
    total = (1.0 - share) * math.exp(old - top) + share * math.exp(new - top)
    return top + math.log(total) if total > 0.0 else -math.inf


class PoseSource(Protocol[Z_contra]):
    """Where poses come from that take no account of the belief."""

    def draw(self, z: Z_contra, n: int, rng: np.random.Generator) -> FloatArray:
        """Draw n poses (n, 3), at least 1; a source need not look at the measurement at hand."""
        ...


@dataclass(frozen=True, eq=False)
class FreePoses:
    """Poses uniform over the free cells of a map.

    Parameters
    ----------
    grid
        The map.

    Raises
    ------
    InvalidInputError
        If it has no free cell.
    """

    grid: OccupancyGrid

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        require_free(self.grid)

    def draw(self, z: object, n: int, rng: np.random.Generator) -> FloatArray:  # noqa: ARG002
        """Draw n poses (n, 3), metres and radians; the measurement does not matter."""
        return free_poses(self.grid, n, rng)


@dataclass(frozen=True, eq=False)
class PosesFromScan:
    """Poses that fit a scan: candidates over all free cells, drawn by their likelihood (sensor resetting).

    The posterior of the scan alone under a uniform prior, p(x | z, m), by importance resampling. The likelihood is
    flattened until 20 of the candidates count, as they are too far apart for a sharp peak to hold one.

    Parameters
    ----------
    grid
        The map.
    model
        Weighs the candidates.
    n_candidates
        How many are weighed at each call.

    Raises
    ------
    InvalidInputError
        If the map has no free cell or there are fewer than 20 candidates.

    References
    ----------
    Lenser and Veloso, "Sensor resetting localization for poorly modelled mobile robots" (2000). Probabilistic Robotics,
    section 6.6.4, for the same with landmarks.
    """

    grid: OccupancyGrid
    model: MeasurementModel[Scan]
    n_candidates: int = field(default=20_000, kw_only=True)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        require_free(self.grid)
        as_count(self.n_candidates, "n_candidates", least=LEAST_EFFECTIVE, most=100_000_000)

    def draw(self, z: Scan, n: int, rng: np.random.Generator) -> FloatArray:
        """Draw n poses (n, 3) that fit the scan; where it is impossible at all candidates, any free poses."""
        candidates = free_poses(self.grid, self.n_candidates, rng)
        log_likelihood = checked_log_likelihood(self.model, z, candidates)
        weights: FloatArray = np.full(len(candidates), 1.0 / len(candidates))
        weights, *_ = reweigh(weights, log_likelihood, LEAST_EFFECTIVE / len(candidates))
        return np.asarray(candidates[systematic_indices(weights, n, rng)])


@dataclass(frozen=True, eq=False)
class PosesFromLandmarks:
    """Poses that fit detected landmarks: (6.41), Table 6.5.

    Features that do not say where the robot could be are left out: spurious ones, those with neither range nor bearing,
    and those without range where the model has no max_range. Where several are left, 5000 candidates or more are drawn
    from one feature each, and the poses from these by their weights.

    Parameters
    ----------
    model
        Map, noise and mount.
    grid
        Poses lie in its free cells; None: anywhere.

    References
    ----------
    Probabilistic Robotics, section 6.6.4.
    """

    model: LandmarkModel
    grid: OccupancyGrid | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)

    def draw(self, z: Detections, n: int, rng: np.random.Generator) -> FloatArray:
        """Draw n poses (n, 3); (0, 3) if the detections say nothing of the pose."""
        z = z.subset(np.flatnonzero(self._are_telling(z)))
        if not len(z):
            return np.zeros((0, 3))
        try:
            drawn = sample_poses(self.model, z, n if len(z) == 1 else max(n, LANDMARK_CANDIDATES), rng, grid=self.grid)
        except TooLittleDataError:
            return np.zeros((0, 3))
        weights = np.exp(drawn.log_weights)
        return np.asarray(drawn.poses[systematic_indices(weights / weights.sum(), n, rng)])

    def _are_telling(self, z: Detections) -> BoolArray:
        """Return which features (k,) bound where the robot can be."""
        telling = ~np.isnan(z.ranges)
        if self.model.parameters.max_range is not None:
            telling |= ~np.isnan(z.bearings)
        return np.asarray(telling if z.ids is None else telling & (z.ids != SPURIOUS))


def reweigh(
    weights: FloatArray, log_likelihood: FloatArray, least_share: float
) -> tuple[FloatArray, float, float, float]:
    """Multiply weights (n,) by a likelihood (n,), flattened so far that a share of their effective number is left.

    The likelihood is taken to the largest power, at most 1, that leaves this share of the effective number of those
    weights that are possible by it; 0 takes the first power. The weights sum to 1.

    Return the new weights, or those given where all are impossible; log sum_i w_i p_i before any flattening, -inf where
    all are impossible; the effective number of the new weights; the power.
    """
    trial = np.empty_like(weights)
    log_mean, effective = kernels.fill_weights(weights, log_likelihood, 1.0, trial)
    power = 1.0
    if not -math.inf < log_mean < math.inf:
        return weights, log_mean, effective, power
    if least_share > 0.0:
        possible = weights[log_likelihood > -math.inf]
        possible /= possible.max()  # squares of small weights would be 0
        target = least_share * float(possible.sum()) ** 2 / float(np.square(possible).sum())
        if effective < target:
            power, effective = _flatten(weights, log_likelihood, target, trial)
    return trial, log_mean, effective, power


# The power is looked for among the highest DECADES, then among the next, and found to 0.1% by so many halvings.
DECADES, HALVINGS = 3.0 * math.log(10.0), 12
# Nobody asks for less; it ends the search where rounding alone is in the way.
LOWEST_POWER = 1e-300


def _flatten(weights: FloatArray, log_likelihood: FloatArray, target: float, trial: FloatArray) -> tuple[float, float]:
    """Find the power by halving; `trial` ends with its weights."""
    power, effective = 1.0, 0.0
    while effective < target and power > LOWEST_POWER:
        high = math.log(power)
        low = high - DECADES
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            if kernels.fill_weights(weights, log_likelihood, math.exp(middle), trial)[1] >= target:
                low = middle
            else:
                high = middle
        power = math.exp(low)
        effective = kernels.fill_weights(weights, log_likelihood, power, trial)[1]
    return power, effective
