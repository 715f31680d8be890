"""Judge weights by the posterior they make: whether the reference is in it, and with how much weight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.pose_windows import FAR_SHARE, Rivals
from beamfield.geometry import FloatArray
from beamfield.kernels.posterior import judge_posteriors
from beamfield.short_repr import short_repr

# Nats that a window can lose at most.
LOWEST = -50.0


@dataclass(frozen=True, eq=False)
class PosteriorScores:
    """Scores of windows, one each.

    Parameters
    ----------
    log_score
        (w,) nats: log of the posterior density at the truth over the prior's there, mean over guesses at both. 0 for
        weights that say nothing; wrong and certain is punished, so that it is largest in the mean for a calibrated
        posterior.
    denser
        (w, c) probability of the poses that the posterior has denser than the truth, for each guess: the highest
        density region of more than that holds the truth. Uniform on (0, 1) for a calibrated posterior.
    """

    log_score: FloatArray
    denser: FloatArray

    __repr__ = short_repr

    @property
    def mean(self) -> float:
        """Mean log score, nats per window."""
        return float(self.log_score.mean())

    @property
    def coverage(self) -> float:
        """Share of the guesses at the truth, over all windows, that the 95% region holds."""
        return self.coverage_at(0.95)

    def coverage_at(self, level: float) -> float:
        """Return the share of the guesses at the truth, over all windows, that the region of a probability holds."""
        return float((self.denser < level).mean())

    def __getitem__(self, chosen: NDArray[np.bool_]) -> PosteriorScores:
        """Return the scores of some of the windows."""
        return PosteriorScores(self.log_score[chosen], self.denser[chosen])

    def __add__(self, other: PosteriorScores) -> PosteriorScores:
        """Return the scores of both sets of windows."""
        return PosteriorScores(np.append(self.log_score, other.log_score), np.concatenate([self.denser, other.denser]))


def judge_weights(log_weights: FloatArray, n_near: int, rivals: Rivals) -> list[PosteriorScores]:
    """Return the scores of c sets of log weights (w, c, n), near poses before far ones."""
    shape = log_weights.shape[:2]
    rows = log_weights.reshape(-1, log_weights.shape[2])
    weights = relative_weights(rows)
    near, far = np.ascontiguousarray(weights[:, :n_near]), np.ascontiguousarray(weights[:, n_near:])
    share = FAR_SHARE if far.shape[1] else 0.0
    ratios, denser = np.empty((len(rows), len(rivals.mass))), np.empty((len(rows), len(rivals.mass)))
    judge_posteriors(
        near, far, (1.0 - share) * rivals.mass, (1.0 - share) * rivals.density, share / max(1, far.shape[1]),
        share * rivals.far_density, ratios, denser,
    )  # fmt: skip
    # A weight that underflows next to the best pose is a loss that no fit should follow for ever.
    scores = np.log(np.maximum(ratios, np.exp(LOWEST))).mean(axis=1).reshape(shape)
    denser = denser.reshape(*shape, -1)
    return [PosteriorScores(scores[:, i], denser[:, i]) for i in range(shape[1])]


def relative_weights(log_weights: FloatArray) -> FloatArray:
    """Return the weights (w, n) of logarithms, the largest of each window 1."""
    top = log_weights.max(axis=1, keepdims=True)
    # No pose has any weight: the filter learns nothing (nav2 then makes all weights equal).
    return np.exp(np.where(top > -np.inf, log_weights - np.where(top > -np.inf, top, 0.0), 0.0))
