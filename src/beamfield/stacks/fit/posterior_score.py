"""Judge a stack's weights by the posterior they make."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from beamfield.calibration.context.posterior_judge import PosteriorScores, judge_weights
from beamfield.calibration.pose_windows import Rivals
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.fit.window_evidence import LANES, WindowEvidence


def score_windows(
    model: StackModel[Any, Any], evidence: WindowEvidence, candidates: Sequence[Any], rivals: Rivals
) -> list[PosteriorScores]:
    """Return how well parameters, one set after the other, do on windows.

    A filter knows where the robot is up to a prior, which is off the truth as far as its spread says, or that it may be
    anywhere. The posterior is that prior times the stack's weights. It is judged where the truth may be: around the
    reference.

    The evidence is from `gather_evidence`; the rivals are those that the windows were cut with.
    """
    scores: list[PosteriorScores] = []
    for first in range(0, len(candidates), LANES):
        chunk = candidates[first : first + LANES]
        log_weights = evidence.log_weights(model, chunk)
        scores += judge_weights(log_weights, evidence.n_near, rivals)
    return scores
