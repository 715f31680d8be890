"""Judge a fitted beam model on beams that it was not fitted to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable
from beamfield.geometry import FloatArray
from beamfield.models.beam_density import beam_log_density, beam_pit, beam_responsibilities
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr

# An extra parameter must gain this much per held-out measurement, nats, and twice its standard error.
LEAST_GAIN = 0.005
# Half the width of a 95% interval in standard errors.
Z95 = 1.96


def _normalized(z_hit: float, z_short: float, z_max: float, z_rand: float) -> BeamParameters:
    total = z_hit + z_short + z_max + z_rand
    return BeamParameters(z_hit / total, z_short / total, z_max / total, z_rand / total, 0.2, 0.1)


# Defaults of the stacks' beam models; their weights sum to 1.1 and 1.15, so they are normalised to be densities.
DEFAULTS: Mapping[str, BeamParameters] = {
    "nav2 defaults": _normalized(0.5, 0.05, 0.05, 0.5),
    "ROS 1 defaults": _normalized(0.95, 0.1, 0.05, 0.05),
}


def uniform_parameters(max_share: float) -> BeamParameters:
    """Return the model that knows only how often nothing returns: uniform from min_range to max_range.

    max_share is that of "no return" readings in the data the fit has seen; both weights stay above 0.
    """
    # Half a reading more or less keeps log(z_max) finite if the fit blocks have no "no return" at all.
    share = min(max(max_share, 1e-6), 1.0 - 1e-6)
    return BeamParameters(0.0, 0.0, share, 1.0 - share, 1.0, 0.0)


@dataclass(frozen=True)
class ModelScore:
    """Held-out score of one set of parameters: mean nats per beam, with a standard error from blocks of time.

    `behind_fit` tells how much less than the fit's it is, with the standard error of this difference.
    """

    name: str
    parameters: BeamParameters
    log_likelihood: float
    standard_error: float
    behind_fit: float = 0.0
    behind_fit_se: float = 0.0


def score_models(
    models: Mapping[str, BeamParameters], table: BeamTable, blocks: NDArray[np.int64]
) -> tuple[ModelScore, ...]:
    """Score sets of parameters on held-out beams; the first is the fit that the others are compared with.

    Blocks (n,) are those of time of each beam; beams whose ray hits nothing are left out. A score is -inf where a model
    makes a reading impossible.
    """
    used, block = table.select(~table.hits_nothing), blocks[~table.hits_nothing]
    densities = {name: log_density(used, parameters) for name, parameters in models.items()}
    fit = next(iter(densities.values()))

    def score(name: str, density: FloatArray) -> ModelScore:
        error, behind = block_standard_error(density, block), gains_over(density, fit)
        behind_se = block_standard_error(behind, block)
        return ModelScore(name, models[name], float(density.mean()), error, float(behind.mean()), behind_se)

    return tuple(score(*each) for each in densities.items())


def log_density(table: BeamTable, parameters: BeamParameters) -> FloatArray:
    """Return the log density of each beam's range, (n,) nats."""
    return beam_log_density(table.ranges, table.expected_ranges, table.max_range, parameters, min_range=table.min_range)


def gains_over(simpler: FloatArray, richer: FloatArray) -> FloatArray:
    """Return how much a second log density of each beam is larger, (n,) nats; 0 also where both are -inf.

    >>> gains_over(np.array([-1.0, -np.inf]), np.array([-0.5, -np.inf])).tolist()
    [0.5, 0.0]
    """
    return np.subtract(richer, simpler, out=np.zeros_like(simpler), where=richer != simpler)


def block_standard_error(values: FloatArray, blocks: NDArray[np.int64]) -> float:
    """Return the standard error of a mean whose terms (n,) depend on each other within blocks, whose numbers are (n,).

    NaN for one block, or with terms that are not finite. Four values that are really two, each counted twice:

    >>> values = np.array([1.0, 1.0, 3.0, 3.0])
    >>> block_standard_error(values, np.arange(4)) < block_standard_error(values, np.array([0, 0, 1, 1]))
    True
    """
    _, index = np.unique(blocks, return_inverse=True)
    n_blocks = int(index.max()) + 1 if len(index) else 0
    if n_blocks < 2 or not np.isfinite(values).all():
        return float("nan")
    centred = np.bincount(index, weights=values - values.mean(), minlength=n_blocks)
    return float(np.sqrt(n_blocks / (n_blocks - 1) * (centred**2).sum()) / len(values))


def is_worth_it(gains: FloatArray, blocks: NDArray[np.int64]) -> bool:
    """Return whether held-out gains (n,), nats, justify one parameter more: enough, and more than twice their error."""
    noise = block_standard_error(gains, blocks)
    return bool(gains.mean() > max(LEAST_GAIN, 2.0 * noise if np.isfinite(noise) else 0.0))


def randomized_pit(table: BeamTable, parameters: BeamParameters, rng: np.random.Generator) -> FloatArray:
    """Return the randomised probability integral transform of the beams whose ray hits something, (m,).

    It is uniform on [0, 1] if the model is right. "No return" is a point mass: its value is drawn uniformly from [1 -
    z_max, 1].
    """
    used = table.select(~table.hits_nothing)
    return beam_pit(used.ranges, used.expected_ranges, used.max_range, parameters, rng, min_range=used.min_range)


def pit_deviation(pit: FloatArray) -> float:
    """Return the largest distance between the PIT's distribution and the uniform one (Kolmogorov's statistic), or NaN.

    >>> pit_deviation(np.array([0.25, 0.5, 0.75, 1.0]))
    0.25
    """
    n = len(pit)
    if n == 0:
        return float("nan")
    ordered = np.sort(pit)
    steps = np.arange(1, n + 1) / n
    return float(max((steps - ordered).max(), (ordered - steps + 1.0 / n).max()))


def likely_causes(table: BeamTable, parameters: BeamParameters) -> NDArray[np.int8]:
    """Return the most likely cause of each beam (n,), as its position in `beamfield.models.beam_density.CAUSES`.

    0 (hit) too where the model makes the reading impossible.
    """
    share = beam_responsibilities(
        table.ranges, table.expected_ranges, table.max_range, parameters, min_range=table.min_range
    )
    return np.asarray(share.argmax(axis=-1), dtype=np.int8)


@dataclass(frozen=True, eq=False)
class Timeline:
    """Mean log-likelihood per beam in nats, scan by scan: columns (s,) of scans in the log, some held out."""

    scan: NDArray[np.int64]
    stamps: FloatArray
    log_likelihood: FloatArray
    held_out: NDArray[np.bool_]

    __repr__ = short_repr


def timeline(table: BeamTable, parameters: BeamParameters, held_out: NDArray[np.bool_]) -> Timeline:
    """Return how well each scan with a beam whose ray hits something fits, in the order of the log.

    `held_out` (n,) says whether each beam was held out; those whose ray hits nothing do not count.
    """
    rows = ~table.hits_nothing
    used = table.select(rows)
    scans, first, index = np.unique(used.scan, return_index=True, return_inverse=True)
    total = np.bincount(index, weights=log_density(used, parameters))
    return Timeline(scans.astype(np.int64), used.stamps[first], total / np.bincount(index), held_out[rows][first])
