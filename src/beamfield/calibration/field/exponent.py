"""Learn how much a likelihood field's beams may count, by the posterior that they make (6.3.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from beamfield.calibration.field.posterior_judge import PosteriorScores, judge_weights
from beamfield.calibration.pose_windows import Rivals, Window, WindowOptions
from beamfield.geometry import FloatArray
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import SensorLog

# Six to a decade; the score is smooth between them. 1 takes beams for independent, which they never are.
EXPONENTS: FloatArray = np.geomspace(1e-4, 1.0, 25)


def window_log_likelihoods(model: LikelihoodFieldModel, log: SensorLog, windows: Sequence[Window]) -> FloatArray:
    """Return log q of whole windows at the poses that compete in them.

    Parameters
    ----------
    model
        The field, with exponent 1.
    log, windows
        The log, and w windows of it with n poses each.

    Returns
    -------
    (w, n) nats: sums over a window's scans, near poses before far ones.
    """
    return np.array(
        [
            np.sum(
                [
                    model.log_likelihood(log.scan(int(i)), np.concatenate([near, far]))
                    for i, near, far in zip(window.scans, window.near, window.far, strict=True)
                ],
                axis=0,
            )
            for window in windows
        ]
    )


def score_exponents(
    log_likelihoods: FloatArray, exponents: FloatArray, rivals: Rivals, options: WindowOptions
) -> list[PosteriorScores]:
    """Return the scores of the windows' posteriors under each exponent.

    Parameters
    ----------
    log_likelihoods
        (w, n) from `window_log_likelihoods`.
    exponents
        (c,) each > 0.
    rivals, options
        As the windows were cut with.
    """
    scores = []
    for exponent in exponents:
        log_score, covered = judge_weights((exponent * log_likelihoods)[:, None], len(rivals.offsets), rivals, options)
        scores.append(PosteriorScores(log_score[:, 0], covered[:, 0]))
    return scores


def best_exponent(mean_scores: FloatArray) -> float:
    """Return where a parabola through the best of the mean scores (c,) under `EXPONENTS` and its neighbours is highest.

    Examples
    --------
    >>> round(best_exponent(-np.square(np.log(EXPONENTS / 0.03))), 6)
    0.03
    """
    i = int(np.argmax(mean_scores))
    if i in (0, len(EXPONENTS) - 1):
        return float(EXPONENTS[i])
    left, middle, right = mean_scores[i - 1 : i + 2]
    bend = left - 2.0 * middle + right
    shift = 0.5 * (left - right) / bend if bend < 0.0 else 0.0
    return float(EXPONENTS[i] * (EXPONENTS[i + 1] / EXPONENTS[i]) ** shift)
