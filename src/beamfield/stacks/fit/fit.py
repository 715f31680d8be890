"""Fit a stack's parameters in its own formula, to what its weights are for: a posterior that holds the truth."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from beamfield.calibration.context.posterior_judge import PosteriorScores
from beamfield.calibration.pose_windows import HELD_OUT, Rivals, Window, WindowOptions, cut_windows, draw_rivals
from beamfield.calibration.selection import SelectionOptions
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import SensorLog
from beamfield.stacks.coordinates import FitSpace
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.fit.fit_space import fit_space
from beamfield.stacks.fit.particle_update import ParticleUpdate, update_particles
from beamfield.stacks.fit.window_evidence import WindowEvidence, gather_evidence, score_windows
from beamfield.stacks.registry import build_model

Progress = Callable[[str, int, int], None]

# Of the held-out windows so many must have the reference in their 95% region. With a few dozen windows a calibrated
# model falls below by chance once in twenty.
LEAST_COVERAGE = 0.85
# Nats per window that missing coverage costs: a share of 0.1 too few costs 0.3 nats.
COVERAGE_PRICE = 3.0
# A choice of more beams must gain so many nats per window over fewer.
LEAST_GAIN = 0.02
# The optimiser stops where its coordinates (logarithms and log odds) move less.
TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class Trial:
    """One setting of what cannot be fitted continuously, with the best continuous parameters.

    Parameters
    ----------
    setting
        Parameters that were set: the number of beams, for example.
    parameters
        The stack's parameters.
    crossed
        Scores on the windows fitted to, each half judged by what the other was fitted to. Settings are chosen by them.
    held_out
        Scores on the windows that have no part in the fit and the choice.
    """

    setting: Mapping[str, Any]
    parameters: Any
    crossed: PosteriorScores
    held_out: PosteriorScores


@dataclass(frozen=True, eq=False)
class StackFit:
    """Result of `fit_stack`.

    Parameters
    ----------
    model
        The stack's model with the fitted parameters.
    start
        The parameters it started from: the stack's defaults or the user's.
    chosen, before
        The trial that was chosen, and the start's scores.
    trials
        All trials.
    update, update_before
        One update of a particle set on held-out scans, fitted and before.
    how
        "maximum likelihood" or "posterior": where the continuous parameters come from.
    options
        How windows were cut.
    at_edge
        What ended at a bound of the search: the log might ask for more.
    """

    model: StackModel[Any, Any]
    start: Any
    chosen: Trial
    before: Trial
    trials: tuple[Trial, ...]
    update: ParticleUpdate
    update_before: ParticleUpdate
    how: str
    options: WindowOptions = field(default_factory=WindowOptions)
    at_edge: tuple[str, ...] = ()

    @property
    def parameters(self) -> Any:
        """The fitted parameters."""
        return self.chosen.parameters

    @property
    def covers(self) -> bool:
        """Whether enough held-out windows have the reference in their 95% region."""
        return self.chosen.held_out.coverage >= LEAST_COVERAGE


def fit_stack(
    stack: str,
    model: str,
    log: SensorLog,
    grid: OccupancyGrid,
    *,
    start: Any,
    beam_parameters: BeamParameters | None = None,
    options: WindowOptions | None = None,
    selection: SelectionOptions | None = None,
    block_s: float | None = None,
    progress: Progress | None = None,
) -> StackFit:
    """Fit a stack's parameters to a log with reference poses and a map.

    For each setting of what is discrete (beams) the continuous parameters are fitted to windows of the log: drives of a
    few scans, in which the reference trajectory competes with others around it and elsewhere on the map. The objective
    is the mean log of the posterior's density at the reference, a proper score: weights that are too flat lose, and so
    do weights that are certain and wrong. Of the settings the one is taken that scores best on windows it was not
    fitted to, less a price for 95% regions that miss the reference. The start is kept if none does better.

    Parameters
    ----------
    stack, model
        For example "nav2", "likelihood_field_prob".
    log
        Scans with reference poses.
    grid
        The map.
    start
        The stack's parameters to start from; what is not fitted stays as it is.
    beam_parameters
        The chapter's beam model as learned from the same log by maximum likelihood. Beam models take their continuous
        parameters from it instead of the windows; None fits them to the windows.
    options, selection, block_s
        How windows are cut, see `cut_windows`.
    progress
        Called with what is done, steps done and steps in all.

    Raises
    ------
    InvalidInputError
        If there is no such stack or model, or no scan has a pose on the map.
    TooLittleDataError
        If the log is too short.
    """
    options = options or WindowOptions()
    rivals = draw_rivals(options, grid)
    windows = cut_windows(log, grid, rivals, options, selection, block_s)
    space = fit_space(stack, model, start, log.finder, grid, beam_parameters)
    before_model = build_model(stack, model, grid, space.usable_start)
    stage, n_steps = f"fitting {stack} {model}", len(space.settings) + 3
    _tell(progress, stage, 0, n_steps)
    as_it_was = {name: getattr(space.usable_start, name) for name in space.settings[0]}
    before = _judge(before_model, as_it_was, log, windows, rivals)
    trials = []
    for done, setting in enumerate(space.settings):
        _tell(progress, stage, done + 1, n_steps)
        made = before_model.with_parameters(replace(space.first_guess, **setting))
        trials.append(_try(made, setting, log, windows, space, rivals))
    best = _best(trials)
    _tell(progress, stage, n_steps - 2, n_steps)
    final = before_model.with_parameters(best.parameters)
    if space.coordinates:
        fitted_to = gather_evidence(final, log, [window for window in windows if window.fold != HELD_OUT])
        final = final.with_parameters(_polish(final, fitted_to, space, rivals))
    chosen = replace(_judge(final, best.setting, log, windows, rivals), crossed=best.crossed)
    if net_score(before.crossed) > net_score(best.crossed):
        chosen = before
    _tell(progress, stage, n_steps - 1, n_steps)
    judged = [int(window.scans[0]) for window in windows if window.fold == HELD_OUT]
    final = build_model(stack, model, grid, chosen.parameters)
    return StackFit(
        final, start, chosen, before, tuple(trials),
        update_particles(final, log, judged), update_particles(before_model, log, judged),
        "maximum likelihood" if space.from_likelihood else "posterior", options,
        () if chosen is before else _at_edge(space, chosen.parameters),
    )  # fmt: skip


def net_score(scores: PosteriorScores) -> float:
    """Return what a setting is chosen by: the mean log score less the price of missing coverage, nats per window."""
    return scores.mean - COVERAGE_PRICE * max(0.0, 0.95 - scores.coverage)


def _best(trials: Sequence[Trial]) -> Trial:
    """Return the trial with the best net score; of nearly equal ones the first, which has the fewest beams."""
    best = trials[0]
    for trial in trials[1:]:
        if net_score(trial.crossed) > net_score(best.crossed) + LEAST_GAIN:
            best = trial
    return best


def _judge(
    model: StackModel[Any, Any], setting: Mapping[str, Any], log: SensorLog, windows: Sequence[Window], rivals: Rivals
) -> Trial:
    """Return the scores of a model as it is."""
    (scores,) = score_windows(model, gather_evidence(model, log, windows), [model.parameters], rivals)
    held_out = np.array([window.fold == HELD_OUT for window in windows])
    return Trial(dict(setting), model.parameters, scores[~held_out], scores[held_out])


def _try(
    model: StackModel[Any, Any], setting: Mapping[str, Any], log: SensorLog, windows: Sequence[Window], space: FitSpace,
    rivals: Rivals,
) -> Trial:  # fmt: skip
    """Return the best point of the search grid for one setting, judged crosswise.

    Each half of the windows judges the point that is best for the other: settings are not chosen by what they were
    fitted to, and the held-out windows have no part in it.
    """
    evidence = gather_evidence(model, log, windows)
    candidates = [space.parameters(model.parameters, point) for point in space.grid(model.parameters)]
    scores = score_windows(model, evidence, candidates, rivals)
    folds = [np.array([window.fold == fold for window in windows]) for fold in range(3)]

    def best(chosen: NDArray[np.bool_]) -> int:
        return int(np.argmax([net_score(score[chosen]) for score in scores]))

    crossed = scores[best(folds[0])][folds[1]] + scores[best(folds[1])][folds[0]]
    overall = best(~folds[HELD_OUT])
    return Trial(setting, candidates[overall], crossed, scores[overall][folds[HELD_OUT]])


def _polish(model: StackModel[Any, Any], evidence: WindowEvidence, space: FitSpace, rivals: Rivals) -> Any:
    """Return better parameters near the model's own, by the windows fitted to."""

    def loss(point: FloatArray) -> float:
        (scores,) = score_windows(model, evidence, [space.parameters(model.parameters, point)], rivals)
        return -net_score(scores)

    first = space.point(model.parameters)
    result = minimize(
        loss, first, method="Nelder-Mead",
        options={
            "maxfev": 30 * len(first), "xatol": TOLERANCE, "fatol": 0.002, "initial_simplex": space.simplex(first)
        },
    )  # fmt: skip
    return space.parameters(model.parameters, np.asarray(result.x))


def _at_edge(space: FitSpace, parameters: Any) -> tuple[str, ...]:
    """Return the names of coordinates at a bound, as near as the optimiser comes."""
    point = space.point(parameters).tolist()
    places = zip(space.coordinates, point, strict=True)
    return tuple(item.name for item, value in places if min(value - item.low, item.high - value) < 2.0 * TOLERANCE)


def _tell(progress: Progress | None, stage: str, done: int, total: int) -> None:
    if progress is not None:
        progress(stage, done, total)
