"""How far learned parameters move when one block of time is left out, and the intervals that follow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import betaincinv, ndtri, stdtrit

from beamfield.calibration.block_errors import share_interval
from beamfield.calibration.intrinsic.curvature import free_directions, inverse_root
from beamfield.calibration.intrinsic.identifiability import FEWEST_BEAMS_OF_A_CAUSE
from beamfield.calibration.intrinsic.learning_problem import LearningProblem
from beamfield.calibration.intrinsic.likelihood import N_PARAMETERS, OFFSET, RATE, SLOPE, VARIANCE, W_HIT, W_SHORT
from beamfield.geometry import FloatArray

# The share of intervals that are to hold the truth.
LEVEL = 0.95
_TAIL = 0.5 * (1.0 - LEVEL)
# The design effect of a cause is known from this many of its beams on.
_BEAMS_OF_A_DESIGN_EFFECT = 10.0


class Jackknife:
    """How far the parameters move when one block of time is left out, and the intervals that follow."""

    def __init__(
        self,
        problem: LearningProblem,
        theta: FloatArray,
        gradients: FloatArray,
        hessian: FloatArray,
        sizes: NDArray[np.int64],
    ) -> None:
        _, prior_gradient, prior_hessian = problem.priors.log_density(theta)
        self.problem = problem
        self.theta = theta
        self.n_beams = int(sizes.sum())
        # At a bound they do not add up to 0: what counts is how blocks differ beside their numbers of beams.
        share = (sizes / self.n_beams)[:, None]
        self.scores = (gradients - share * gradients.sum(axis=0)) / (1.0 - share)
        self.gradient = gradients.sum(axis=0) + prior_gradient
        self.hessian = hessian + prior_hessian
        # Expected beams per cause: weight times the sum of density over mixture.
        self.counts = theta[:4] * gradients[:, :4].sum(axis=0)
        self.t = float(stdtrit(len(gradients) - 1, 1.0 - _TAIL))
        self.gaussian = float(ndtri(1.0 - _TAIL))
        self.wider = self.t / self.gaussian
        self.most_nats = -math.log(1.0 - LEVEL) * self.wider**2
        # A weight of 1 is not a bound of its own: the others' are at 0.
        self.inside = problem.free & (theta > problem.lower) & ((theta < problem.upper) | (np.arange(N_PARAMETERS) < 4))

    def interval(self, i: int) -> tuple[float, float]:
        """Return (low, high) of entry i of the working vector, in the units of `BeamParameters`."""
        if self._is_undetermined(i):
            return (-math.inf if i == OFFSET else 0.0), math.inf
        low, high = self._weight_interval(i) if i <= 3 else self._shape_interval(i)
        return (math.sqrt(low), math.sqrt(high)) if i in (VARIANCE, SLOPE) else (low, high)

    def standard_error(self, i: int) -> float:
        """Return the standard error of entry i of the working vector, in the units of `BeamParameters`."""
        if self._is_undetermined(i):
            return math.inf
        if not self.inside[i]:
            return math.nan
        error = math.sqrt(self.errors.robust[i, i])
        return error / (2.0 * math.sqrt(self.theta[i])) if i in (VARIANCE, SLOPE) else error

    @cached_property
    def errors(self) -> _Errors:
        """Covariances of what may move."""
        return self._errors(self.inside)

    def _errors(self, moving: NDArray[np.bool_]) -> _Errors:
        basis = free_directions(moving, self.theta)
        if basis.shape[1] == 0:
            nothing = np.zeros((N_PARAMETERS, N_PARAMETERS))
            return _Errors(nothing, nothing, np.zeros_like(self.scores))
        root = inverse_root(-basis.T @ self.hessian @ basis)
        inverse = basis @ root @ root.T @ basis.T
        moves = self.scores @ inverse
        n_blocks = len(moves)
        return _Errors((n_blocks - 1) / n_blocks * moves.T @ moves, inverse, moves)

    def _reaches(self, i: int, known_skewness: float = 0.0) -> tuple[float, float]:
        """Return how many standard errors an interval reaches down and up."""
        a = self.errors.skewness(i) / math.sqrt(len(self.scores)) - known_skewness
        if not 1e-6 < abs(a) < 1e6:  # beyond either end the formula gives t, but for rounding
            return self.t, self.t
        low, high = (3.0 / a * (math.cbrt(1.0 + a * x - a**2 / 6.0) - 1.0) for x in (self.t, -self.t))
        return max(low, self.t), max(-high, self.t)

    def _weight_interval(self, i: int) -> tuple[float, float]:
        w, variance = float(self.theta[i]), float(self.errors.robust[i, i])
        if self.problem.free[:4].sum() == 1:  # what the held ones leave
            return w, w
        most = 1.0 - float(self.theta[:4][~self.problem.free[:4]].sum())
        if w <= self.problem.lower[i]:
            return 0.0, min(self._rise_from_bound(i, self._largest_design_effect), most)
        if not (variance > 0.0 and w < 1.0):
            # All of the weight there is, unless a cause that this log does not show has some.
            absent = [k for k in range(4) if self.problem.free[k] and self.theta[k] <= self.problem.lower[k]]
            rise = max((self._rise_from_bound(k, self._largest_design_effect) for k in absent), default=0.0)
            return max(w - rise, 0.0), w
        error = math.sqrt(variance)
        down, up = self._reaches(i, (1.0 - 2.0 * w) * error / (w * (1.0 - w)))
        low, _ = share_interval(w, variance * (down / self.gaussian) ** 2, 2.0 * _TAIL)
        _, high = share_interval(w, variance * (up / self.gaussian) ** 2, 2.0 * _TAIL)
        # Less than one reading in all is not a share: what moves such a weight are readings of other causes.
        of_one_reading = float(betaincinv(2.0, (1.0 - w) / w, 1.0 - _TAIL))
        high = min(high, max(w + up * error, of_one_reading))  # in this order: the second may be NaN
        return low, min(high, most)

    def _shape_interval(self, i: int) -> tuple[float, float]:
        value, lower, upper = (float(a[i]) for a in (self.theta, self.problem.lower, self.problem.upper))
        if value <= lower and i != OFFSET:
            # The floor of sigma_hit is that of the search: the noise itself may be anything below.
            return 0.0, min(lower + self._rise_from_bound(i, 1.0), upper)
        if not self.inside[i]:  # at a limit of the search that no data set
            return (-math.inf if i == OFFSET else 0.0), math.inf
        error = math.sqrt(self.errors.robust[i, i])
        below, above = (reach * error for reach in self._reaches(i))
        low = value - below if value - below > lower else (0.0 if i == VARIANCE else lower)
        return low, min(value + above, upper)

    def _rise_from_bound(self, i: int, least_design_effect: float) -> float:
        """Return how far above its lower bound entry i may be before the likelihood has fallen by too many nats."""
        moving = self.inside.copy()
        moving[i] = True
        basis, errors = free_directions(moving, self.theta), self._errors(moving)
        inwards = basis[:, np.argmax(basis[i])]
        slope = max(-float(inwards @ self.gradient), 0.0)
        if not inwards @ self.hessian @ inwards < 0.0:  # no maximum nearby: the slope alone tells
            nats = self.most_nats * least_design_effect
            return nats / slope if slope > 0.0 else math.inf
        nats = self.most_nats * max(errors.design_effect(i), least_design_effect)
        curvature = 1.0 / float(errors.naive[i, i])
        return 2.0 * nats / (slope + math.sqrt(slope**2 + 2.0 * curvature * nats))

    @cached_property
    def _largest_design_effect(self) -> float:
        known = [
            i
            for i in range(4)
            if self.inside[i] and min(self.counts[i], self.n_beams - self.counts[i]) >= _BEAMS_OF_A_DESIGN_EFFECT
        ]
        known += [VARIANCE] if self.inside[VARIANCE] and self.counts[W_HIT] >= _BEAMS_OF_A_DESIGN_EFFECT else []
        return max([1.0, *(self.errors.design_effect(i) for i in known if self.errors.naive[i, i] > 0.0)])

    def _is_undetermined(self, i: int) -> bool:
        """Return whether the log does not show a shape, for want of readings of its cause."""
        if i == RATE:
            return self._rate_is_undetermined
        return i in (VARIANCE, SLOPE, OFFSET) and bool(self.counts[W_HIT] < FEWEST_BEAMS_OF_A_CAUSE)

    @cached_property
    def _rate_is_undetermined(self) -> bool:
        ceiling = self.problem.upper[RATE]
        if self.counts[W_SHORT] < FEWEST_BEAMS_OF_A_CAUSE or self.theta[RATE] >= ceiling:
            return True
        return bool(self._shape_interval(RATE)[1] >= ceiling)


@dataclass(frozen=True, eq=False)
class _Errors:
    """Covariances of the working vector (8, 8), 0 for what may not move: of the jackknife, and of independent beams.

    `moves` (b, 8) is by how much each block pulls the working vector.
    """

    robust: FloatArray
    naive: FloatArray
    moves: FloatArray

    def design_effect(self, i: int) -> float:
        return float(self.robust[i, i] / self.naive[i, i])

    def skewness(self, i: int) -> float:
        """Return the skewness of the blocks' moves; 0 where none moves."""
        centred = self.moves[:, i] - self.moves[:, i].mean()
        variance = float(np.mean(centred**2))
        return float(np.mean(centred**3)) / variance**1.5 if variance > 0.0 else 0.0
