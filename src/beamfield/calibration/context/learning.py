"""Learn a model's parameters for the posteriors that they make, by gradient (6.3.4; Thrun 1998)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from beamfield.arguments import checked, require
from beamfield.calibration.context.evidence import BeamEvidence, Evidence, FieldEvidence
from beamfield.calibration.context.exponent import EXPONENTS, LEVEL, score_exponents, suited_exponent
from beamfield.calibration.context.posterior_judge import LOWEST, PosteriorScores, relative_weights
from beamfield.calibration.pose_windows import FAR_SHARE, Rivals, Window, WindowOptions, cut_windows, draw_rivals
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.range_mixture import RangeMixtureModel
from beamfield.sensors import SensorLog

# Steps of the quasi-Newton method; it stops before if the windows that stop it have not gained in so many.
MOST_STEPS = 30
PATIENCE = 5
# How far a coordinate may go, mostly a logarithm: a factor of 150.
REACH = 5.0


@dataclass(frozen=True)
class ContextScore:
    """How the posteriors of one set of parameters, with how much beams count, do on the held-out windows."""

    name: str
    parameters: BeamParameters | LikelihoodFieldParameters
    exponent: float
    scores: PosteriorScores


@dataclass(frozen=True, eq=False)
class ContextLearning:
    """Result of `learn_in_context`.

    Parameters
    ----------
    parameters, exponent
        What was learned; the exponent is for drives, as in a filter.
    steps
        Number of the gradient's step that is best on the windows that stop it; 0: the start is.
    fitted, stopping
        Mean score after each step, the start's first, nats: of the windows whose gradient is followed, which never
        falls, and of those that stop it.
    held_out
        Scores on windows that had no part in it: of the start with exponent 1, of the start with an exponent, and of
        what was learned.
    """

    parameters: BeamParameters | LikelihoodFieldParameters
    exponent: float
    steps: int
    fitted: tuple[float, ...]
    stopping: tuple[float, ...]
    held_out: tuple[ContextScore, ...]


@checked
def learn_in_context(
    model: RangeMixtureModel | LikelihoodFieldModel,
    log: SensorLog,
    grid: OccupancyGrid,
    *,
    options: WindowOptions | None = None,
) -> ContextLearning:
    """Return the parameters and the exponent whose posteriors over drives of a few scans are best.

    The objective is the mean log of the posterior's density at the truth, over drives of a few updates of a filter. Its
    gradient is exact: the derivative of log p(z | x, m) at the truth, less its mean under the posterior. It is followed
    on one part of the log's blocks of time, from the model's parameters (learned by EM, say) and their exponent, until
    another part no longer gains; a third judges.

    docs/evidence/in_context.md has what this gains on real logs over an exponent alone: nothing that is sure. Use
    `learn_exponent` unless you know better.

    Parameters
    ----------
    model
        The model to start from, with its number of beams. Its exponent does not matter.
    log
        Scans with reference poses in the map frame.
    grid
        The map.
    options
        How drives are cut from the log, see `cut_windows`.

    Raises
    ------
    InvalidInputError
        If the log has no reference poses on the map, or the field treats unknown space by itself.
    TooLittleDataError
        If the log is too short.

    References
    ----------
    Probabilistic Robotics, section 6.3.4: intrinsic parameters in the context of the application.
    """
    options = options or WindowOptions()
    rivals = draw_rivals(options, grid)
    windows = cut_windows(log, grid, rivals, options)
    parts = [[window for window in windows if window.fold == fold] for fold in range(3)]
    followed, stopping, held_out = (_evidence(model, log, part) for part in parts)
    both = [followed.log_likelihood(followed.start), stopping.log_likelihood(stopping.start)]
    start = np.append(followed.start, np.log(_exponent(both, rivals)))
    climb = _climb(followed, stopping, start, rivals)
    point = climb.points[climb.best]
    both = [followed.log_likelihood(point[:-1]), stopping.log_likelihood(point[:-1])]
    exponent = _exponent(both, rivals)

    def judged(name: str, at: FloatArray, power: float) -> ContextScore:
        (scores,) = score_exponents(held_out.log_likelihood(at), np.array([power]), rivals)
        return ContextScore(name, held_out.parameters(at), power, scores)

    return ContextLearning(
        followed.parameters(point[:-1]), exponent, climb.best, tuple(climb.fitted), tuple(climb.stopping),
        (
            judged("start, exponent 1", held_out.start, 1.0),
            judged("start", held_out.start, float(np.exp(start[-1]))),
            judged("in context", point[:-1], exponent),
        ),
    )  # fmt: skip


def score_and_weights(values: FloatArray, rivals: Rivals) -> tuple[FloatArray, FloatArray]:
    """Return log scores (w,) of posteriors, and weights (w, n) of log-likelihoods whose sum has the score's derivative.

    The values (w, n) are log-likelihoods of windows, near poses before far ones, times the exponent. Scores are as
    `PosteriorScores.log_score`; weights are 1 at the truth less the posterior, mean over guesses at both.
    """
    n_truths, n_near = rivals.mass.shape
    n_far = values.shape[1] - n_near
    share = FAR_SHARE if n_far else 0.0
    elsewhere = np.full((n_truths, n_far), share / max(1, n_far))
    prior = np.concatenate([(1.0 - share) * rivals.mass, elsewhere], axis=1)
    weights = relative_weights(values)
    total = weights @ prior.T
    ratios = np.divide(weights[:, :n_truths], total, out=np.zeros_like(total), where=total > 0.0)
    # A window that no pose can explain says nothing, and no step of the parameters makes it.
    alive = (ratios > np.exp(LOWEST)) & (values.max(axis=1, keepdims=True) > -np.inf)
    shares = np.divide(alive, total, out=np.zeros_like(total), where=alive) / n_truths
    slopes = -weights * (shares @ prior)
    slopes[:, :n_truths] += alive / n_truths
    return np.log(np.maximum(ratios, np.exp(LOWEST))).mean(axis=1), slopes


@dataclass(eq=False)
class _Climb:
    """Points of a climb, with their mean scores."""

    points: list[FloatArray]
    fitted: list[float]
    stopping: list[float]

    @property
    def best(self) -> int:
        return int(np.argmax(self.stopping))


def _climb(followed: Evidence, stopping: Evidence, start: FloatArray, rivals: Rivals) -> _Climb:
    """Follow the gradient on some windows until others no longer gain."""
    climb = _Climb([], [], [])

    def mean_score(evidence: Evidence, point: FloatArray) -> float:
        values = np.exp(point[-1]) * evidence.log_likelihood(point[:-1])
        return float(score_and_weights(values, rivals)[0].mean())

    def loss(point: FloatArray) -> tuple[float, FloatArray]:
        power, values = np.exp(point[-1]), followed.log_likelihood(point[:-1])
        scores, weights = score_and_weights(power * values, rivals)
        by_power = float((weights * np.where(weights == 0.0, 0.0, values)).sum())
        slope = power * np.append(followed.gradient(point[:-1], weights), by_power) / len(values)
        return -float(scores.mean()), -slope

    def note(point: FloatArray) -> None:
        climb.points.append(point.copy())
        climb.fitted.append(mean_score(followed, point))
        climb.stopping.append(mean_score(stopping, point))
        if len(climb.points) - 1 - climb.best >= PATIENCE:
            raise StopIteration

    note(start)
    bounds = [*((x - REACH, x + REACH) for x in start[:-1]), (np.log(EXPONENTS[0]), 0.0)]
    minimize(
        loss, start, jac=True, method="L-BFGS-B", bounds=bounds, callback=note, options={"maxiter": MOST_STEPS}
    )  # fmt: skip
    return climb


def _exponent(values: Sequence[FloatArray], rivals: Rivals) -> float:
    """Return the exponent whose 90% regions hold the truth in 90% of the windows."""
    scores = score_exponents(np.concatenate(values), EXPONENTS, rivals)
    return suited_exponent(np.array([each.coverage_at(LEVEL) for each in scores]))


def _evidence(model: RangeMixtureModel | LikelihoodFieldModel, log: SensorLog, windows: Sequence[Window]) -> Evidence:
    if isinstance(model, LikelihoodFieldModel):
        require(model.unknown == "free", "unknown", "a field with 'free'", model.unknown)
        return FieldEvidence(model, log, windows)
    return BeamEvidence(model, log, windows)
