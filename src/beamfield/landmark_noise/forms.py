"""What a bias and a scale are worth: forms of a landmark sensor's noise, judged on sightings held out by time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamfield.landmark_noise.em import (
    NoiseClimb,
    NoiseLikelihood,
    NoiseProblem,
    NoiseTheta,
    climb_noise,
    noise_starts,
)
from beamfield.landmark_noise.sighting_table import SightingTable

# A further parameter must gain more nats per held-out sighting than this, and more than twice its standard error.
LEAST_GAIN = 0.005
# Every third block is held out, as for beams.
_EVERY = 3


@dataclass(frozen=True)
class NoiseForm:
    """One form of the noise, fitted to two thirds of the blocks and scored on the others.

    Parameters
    ----------
    name
        "no bias", "bias", or "bias and scale".
    theta
        What was learned from the blocks for fitting.
    log_likelihood
        Nats per held-out sighting.
    gain, gain_se
        How much more that is than without bias, and the standard error of this difference, from blocks.
    gain_over_simpler, gain_over_simpler_se
        The same against the form before this one.
    chosen
        Whether it is the form of the result.
    """

    name: str
    theta: NoiseTheta
    log_likelihood: float
    gain: float = 0.0
    gain_se: float = 0.0
    gain_over_simpler: float = 0.0
    gain_over_simpler_se: float = 0.0
    chosen: bool = False

    @property
    def is_worth_it(self) -> bool:
        """Whether it gains enough over the simpler form to be believed."""
        noise = 2.0 * self.gain_over_simpler_se if math.isfinite(self.gain_over_simpler_se) else 0.0
        return self.gain_over_simpler > max(LEAST_GAIN, noise)


def score_forms(
    table: SightingTable, problems: Sequence[tuple[str, NoiseProblem]], **options: float
) -> list[NoiseForm]:
    """Fit each form to two thirds of the blocks, score it on the rest.

    Parameters
    ----------
    table
        The sightings.
    problems
        (name, problem) from the simplest to the richest.
    **options
        As `climb_noise`: tolerance and max_iterations.

    Returns
    -------
    One per form; none where there are not two blocks with sightings of landmarks on both sides.
    """
    _, number = np.unique(table.blocks, return_inverse=True)
    held_out = number % _EVERY == _EVERY // 2
    real = table.landmarks >= 0
    if not (real & held_out).any() or not (real & ~held_out).any():
        return []
    fitted_on, scored_on = table.subset(~held_out), table.subset(held_out)
    forms: list[NoiseForm] = []
    each: list[NDArray[np.float64]] = []
    for name, problem in problems:
        theta = fit_noise(NoiseLikelihood(fitted_on, problem), **options).theta
        values = NoiseLikelihood(scored_on, problem).log_likelihood_each(theta)
        form = NoiseForm(name, theta, float(values.mean()))
        if each:
            gain, gain_se = _gain(values, each[0], scored_on.blocks)
            over, over_se = _gain(values, each[-1], scored_on.blocks)
            form = replace(form, gain=gain, gain_se=gain_se, gain_over_simpler=over, gain_over_simpler_se=over_se)
        forms.append(form)
        each.append(values)
    return forms


def fit_noise(likelihood: NoiseLikelihood, **options: float) -> NoiseClimb:
    """Climb from every start and return the highest end.

    Parameters
    ----------
    likelihood
        What is climbed.
    **options
        As `climb_noise`.

    Returns
    -------
    The end of the highest climb.
    """
    climbs = [climb_noise(likelihood, start, **options) for start in noise_starts(likelihood)]  # type: ignore[arg-type]
    return max(climbs, key=lambda climb: climb.trace[-1])


def _gain(values: NDArray[np.float64], others: NDArray[np.float64], blocks: NDArray[np.int64]) -> tuple[float, float]:
    """Return the mean difference per sighting, and its standard error from block to block."""
    if np.isneginf(values).any() or np.isneginf(others).any():
        return (math.inf if np.isneginf(others).any() and not np.isneginf(values).any() else -math.inf), math.nan
    difference = values - others
    _, number = np.unique(blocks, return_inverse=True)
    sums, counts = np.bincount(number, difference), np.bincount(number)
    mean, b = float(difference.mean()), len(counts)
    if b < 2:
        return mean, math.nan
    spread = float(np.square(sums - mean * counts).sum())
    return mean, math.sqrt(spread * b / (b - 1.0)) / len(values)
