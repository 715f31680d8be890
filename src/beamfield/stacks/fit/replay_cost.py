"""What runs of a setting cost, and whether others cost less for sure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.localization.replay import ReplayErrors
from beamfield.localization.replay_comparison import ReplayComparison, ReplayTrials, compare_trials
from beamfield.stacks.fit.replay_runs import Key

# A run that is farther off counts as so far, metres: lost runs count, but not how far they went.
FARTHEST = 1.0
# No reference is better than this, metres.
NEAREST = 0.001
# An error counts this many times more than it is, per share of the updates that the particles' 95% ellipse lacks of
# holding the reference in 90%: 0.1 m with 70% as 0.14 m. That much is missing by chance in a few dozen updates.
COVERAGE_PRICE = 2.0
COVERAGE = 0.9


def clipped(trials: ReplayTrials) -> ReplayTrials:
    """Return runs whose mean error is no more than 1 m."""
    return _counted(trials, lambda one: min(one.mean, FARTHEST))


def costs(trials: ReplayTrials) -> ReplayTrials:
    """Return runs with the logarithm of their error, no more than 1 m and raised for missing coverage, as the mean."""

    def cost(one: ReplayErrors) -> float:
        missing = max(0.0, COVERAGE - one.inside_noisy)
        return float(np.log(max(min(one.mean, FARTHEST), NEAREST) * (1.0 + COVERAGE_PRICE * missing)))

    return _counted(trials, cost)


def _counted(trials: ReplayTrials, count: Callable[[ReplayErrors], float]) -> ReplayTrials:
    return replace(trials, errors=tuple(replace(one, mean=count(one)) for one in trials.errors))


def costs_by_stretch(trials: Mapping[Key, Sequence[ReplayTrials]]) -> FloatArray:
    """Return the mean cost (n, s) of n settings on s stretches."""
    return np.array([[costs(one).mean("mean") for one in runs] for runs in trials.values()])


def is_surely_better(before: Sequence[ReplayTrials], after: Sequence[ReplayTrials]) -> bool:
    """Return whether the cost is surely lower, and neither the error nor the share of lost runs surely higher."""
    error, cost = compared(before, after, clipped), compared(before, after, costs)
    coverage, lost = (compare_trials(before, after, measure) for measure in ("inside_noisy", "lost"))
    # A few per cent less where errors are small lower the cost, though the error elsewhere may well have grown by more.
    return cost.is_lower and (error.is_lower or coverage.is_higher) and not (error.is_higher or lost.is_higher)


def compared(
    before: Sequence[ReplayTrials], after: Sequence[ReplayTrials], counted: Callable[[ReplayTrials], ReplayTrials]
) -> ReplayComparison:
    """Compare what is counted of runs, stretch by stretch and paired by seeds."""
    return compare_trials([counted(one) for one in before], [counted(one) for one in after])
