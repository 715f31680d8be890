"""Judge a stack's weights by the posterior they make: whether the reference is in it, and with how much weight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.sensors import SensorLog
from beamfield.stacks.emulator import StackModel
from beamfield.stacks.windows import Rivals, Window, WindowOptions

LEVEL = 0.95


class WindowEvidence(NamedTuple):
    """What one window says before the fitted parameters come in: one evidence per scan, near poses before far ones."""

    scans: tuple[Any, ...]
    fold: int


@dataclass(frozen=True, eq=False)
class PosteriorScores:
    """Scores of windows, one each.

    Parameters
    ----------
    log_score
        (w,) nats: log of the posterior density at the reference over the prior's there. 0 for weights that say nothing;
        wrong and certain is punished without bound, so that it is largest in the mean for a calibrated posterior.
    covered
        (w,) probability that the posterior's 95 % region holds the truth, which is somewhere around the reference.
    """

    log_score: FloatArray
    covered: FloatArray

    @property
    def mean(self) -> float:
        """Mean log score, nats per window."""
        return float(self.log_score.mean())

    @property
    def coverage(self) -> float:
        """Share of the windows whose 95 % region holds the truth."""
        return float(self.covered.mean())

    def __getitem__(self, chosen: NDArray[np.bool_]) -> PosteriorScores:
        """Return the scores of some of the windows."""
        return PosteriorScores(self.log_score[chosen], self.covered[chosen])

    def __add__(self, other: PosteriorScores) -> PosteriorScores:
        """Return the scores of both sets of windows."""
        return PosteriorScores(np.append(self.log_score, other.log_score), np.append(self.covered, other.covered))


def gather_evidence(
    model: StackModel[Any, Any],
    log: SensorLog,
    windows: Sequence[Window],
    progress: Callable[[int, int], None] | None = None,
) -> list[WindowEvidence]:
    """Return the evidence of all windows, for many evaluations with other parameters."""
    gathered = []
    for done, window in enumerate(windows):
        scans = tuple(
            model.evidence(log.scan(int(i)), np.concatenate([near, far]))
            for i, near, far in zip(window.scans, window.near, window.far, strict=True)
        )
        gathered.append(WindowEvidence(scans, window.fold))
        if progress is not None:
            progress(done + 1, len(windows))
    return gathered


def score_windows(
    model: StackModel[Any, Any], evidence: Sequence[WindowEvidence], parameters: Any, rivals: Rivals,
    options: WindowOptions,
) -> PosteriorScores:  # fmt: skip
    """Return how well parameters do on windows.

    Parameters
    ----------
    model
        Makes weights from evidence.
    evidence
        From `gather_evidence`.
    parameters
        The stack's.
    rivals, options
        As the windows were cut with.
    """
    scores, covered = np.empty(len(evidence)), np.empty(len(evidence))
    for i, window in enumerate(evidence):
        total = np.sum([model.log_weights(scan, parameters) for scan in window.scans], axis=0)
        scores[i], covered[i] = _judge(total, rivals, options)
    return PosteriorScores(scores, covered)


def _judge(log_weights: FloatArray, rivals: Rivals, options: WindowOptions) -> tuple[float, float]:
    """Return log score and coverage of one window, given log weights of near and far poses."""
    n = len(rivals.prior)
    top = float(log_weights.max())
    if top == -np.inf:
        # No pose has any weight: the filter learns nothing (nav2 then makes all weights equal).
        return 0.0, 1.0
    weights = np.exp(log_weights - top)
    near, far = weights[:n], weights[n:]
    at_reference = float((near * rivals.reference).sum() / rivals.reference.sum())
    around = float((near * rivals.prior).sum() / rivals.prior.sum())
    elsewhere = float(far.mean()) if far.size else 0.0
    share = options.far_share if far.size else 0.0
    evidence = (1.0 - share) * around + share * elsewhere
    # A weight that underflows next to the best pose is a loss that no fit should follow for ever.
    score = max(np.log(max(at_reference, 1e-300)) - np.log(evidence), -50.0)
    return score, _coverage(near, elsewhere * share, rivals, 1.0 - share)


def _coverage(near: FloatArray, elsewhere: float, rivals: Rivals, share: float) -> float:
    """Return the probability that the region of highest density with 95 % of the posterior holds the truth.

    A rival lies in it if what is denser has less than 95 %. Poses elsewhere count as denser if their mean weight is
    larger.
    """
    mass = near * rivals.prior * (share / rivals.prior.sum())
    density = near * rivals.prior_density
    order: NDArray[np.int64] = np.argsort(-density, kind="stable")
    above = np.empty(len(near))
    above[order] = np.cumsum(mass[order]) - mass[order]
    above += np.where(elsewhere > near * share, elsewhere, 0.0)
    inside = above < LEVEL * (mass.sum() + elsewhere)
    return float((inside * rivals.reference).sum() / rivals.reference.sum())
