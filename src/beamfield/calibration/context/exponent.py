"""Learn how much the beams of a model may count, by the posteriors that scans make (6.3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import checked
from beamfield.calibration.block_errors import block_interval, jackknife_error
from beamfield.calibration.context.posterior_judge import PosteriorScores, judge_weights
from beamfield.calibration.evaluation import block_standard_error
from beamfield.calibration.pose_windows import (
    HELD_OUT,
    Rivals,
    Window,
    WindowOptions,
    cut_windows,
    draw_rivals_of_each,
    reference_deviations,
    window_block_s,
)
from beamfield.calibration.selection import SelectionOptions
from beamfield.calibration.time_split import time_blocks
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.range_mixture import RangeMixtureModel
from beamfield.sensors import SensorLog

# Six to a decade; coverage and score are smooth between them. 1 takes beams for independent.
EXPONENTS: FloatArray = np.geomspace(1e-4, 1.0, 25)
# Posteriors are to hold the truth in so large a share of cases, in regions of this probability.
LEVEL = 0.90
# Guesses at the truth that stand for a reference without error.
N_NEAREST = 2


@dataclass(frozen=True)
class LearnedExponent:
    """An exponent, and how the posteriors that it makes do on held-out blocks of time.

    Parameters
    ----------
    value
        The power of each beam's value, in (0, 1].
    interval
        95% interval, from blocks of time; (0, inf) if there are not two of them.
    if_reference_exact
        The exponent, or less, if the reference poses had no error: well above `value` where their stated error sets the
        limit.
    coverage
        Share of the held-out posteriors whose 90% region holds the truth.
    score, score_se
        Mean log of the held-out posteriors' density at the truth over the prior's, and its standard error, nats; 0 for
        beams that say nothing.
    score_independent
        The score with exponent 1.
    """

    value: float
    interval: tuple[float, float]
    if_reference_exact: float
    coverage: float
    score: float
    score_se: float
    score_independent: float


@dataclass(frozen=True)
class ExponentLearning:
    """How much the beams of a scan may count.

    Parameters
    ----------
    drive
        For a filter, which multiplies what scan after scan says: learned from drives of `n_scans` updates, whose errors
        go together.
    single
        For one scan on its own.
    n_beams
        Beams of a scan that are used: what the exponents belong to.
    beams_of_scan
        Beams that the sensor has.
    n_scans
        Scans of a drive.
    reference_error
        How wrong the reference poses may be, metres: no posterior is taken to be surer than they are.
    single_in_filter
        Whether a filter is to take that of single scans, too: with it, ours errs less on the log.
    """

    drive: LearnedExponent
    single: LearnedExponent
    n_beams: int
    beams_of_scan: int
    n_scans: int
    reference_error: float
    single_in_filter: bool = False

    @property
    def in_filter(self) -> LearnedExponent:
        """The one that files hold for a filter."""
        return self.single if self.single_in_filter else self.drive

    @property
    def independent_beams(self) -> float:
        """How many independent beams a scan on its own is worth."""
        return self.single.value * self.n_beams

    @property
    def independent_beams_in_drive(self) -> float:
        """How many each scan of a drive is worth."""
        return self.drive.value * self.n_beams


@checked
def learn_exponent(
    model: RangeMixtureModel | LikelihoodFieldModel,
    log: SensorLog,
    grid: OccupancyGrid,
    *,
    reference_error: float = 0.04,
    selection: SelectionOptions | None = None,
    block_s: float | None = None,
    seed: int = 0,
) -> ExponentLearning:
    """Return how much the beams of a model may count: the alpha of 6.3.4.

    Errors of neighbouring beams and scans go together, because the map, the pose and the people before the sensor are
    the same: multiplied as if they were independent, their values make posteriors that are certain and wrong. Each
    value to the power of the exponent makes posteriors around the reference poses whose 90% regions hold the truth in
    90% of the cases. docs/evidence/in_context.md has what this gives on real logs.

    Parameters
    ----------
    model
        Any model of range scans, with the number of beams that it will be used with. Its own exponent does not matter.
    log
        Scans of one sensor with reference poses in the map frame.
    grid
        The map.
    reference_error
        How wrong the reference poses may be, standard deviation per axis, metres, and a quarter of it in radians.
    selection
        Which scans are used.
    block_s
        Length of the blocks of time that are fitted or held out whole, seconds; None: 20, or more if drives need it.
    seed
        Of the poses that compete with the reference.

    Raises
    ------
    InvalidInputError
        If the log has no reference poses on the map, or an option is out of range.
    TooLittleDataError
        If the log is too short.

    References
    ----------
    Probabilistic Robotics, section 6.3.4.
    """
    options = WindowOptions(reference_error=reference_error, seed=seed)
    length = window_block_s(log, grid, options, selection) if block_s is None else block_s
    windows = cut_windows(log, grid, draw_rivals_of_each(options, grid), options, selection, length)
    values = scan_log_likelihoods(model, log, windows)
    return exponents_of(values, windows, time_blocks(log.stamps, length), options, model.n_beams, log)


def exponents_of(
    values: FloatArray,
    windows: Sequence[Window],
    blocks: NDArray[np.int64],
    options: WindowOptions,
    n_beams: int | None,
    log: SensorLog,
) -> ExponentLearning:
    """Return the exponents of windows whose log-likelihoods (w, s, n) are known, from `scan_log_likelihoods`.

    Blocks (t,) are those of time of each scan of the log; n_beams are the model's.
    """
    held_out = np.array([window.fold == HELD_OUT for window in windows])
    block = np.array([blocks[window.scans[0]] for window in windows])
    of_scan = log.finder.n_beams
    rivals = [window.rivals for window in windows]
    return ExponentLearning(
        _learn(values.sum(axis=1), held_out, block, rivals, options),
        # The first scan of each window alone: around its own reference are the poses that compete.
        _learn(values[:, 0], held_out, block, rivals, options),
        of_scan if n_beams is None else min(n_beams, of_scan), of_scan, options.scans, options.reference_error,
    )  # fmt: skip


def scan_log_likelihoods(
    model: RangeMixtureModel | LikelihoodFieldModel, log: SensorLog, windows: Sequence[Window]
) -> FloatArray:
    """Return log p (w, s, n) of the s scans of w windows at the n poses that compete in them, with exponent 1.

    Near poses come before far ones.
    """
    return np.array(
        [
            [
                model.log_likelihood(log.scan(int(i)), np.concatenate([near, far])) / model.exponent
                for i, near, far in zip(window.scans, window.near, window.far, strict=True)
            ]
            for window in windows
        ]
    )


def score_exponents(
    log_likelihoods: FloatArray, exponents: FloatArray, rivals: Rivals | Sequence[Rivals]
) -> list[PosteriorScores]:
    """Return the scores of posteriors under each exponent > 0 (c,), of w drives or scans at n poses.

    The rivals are those that the windows were cut with, for all of them or for each.
    """
    if isinstance(rivals, Rivals):
        n_near = len(rivals.offsets)
        return [judge_weights((power * log_likelihoods)[:, None], n_near, rivals)[0] for power in exponents]
    each = [
        judge_weights((exponents[:, None] * values)[None], len(own.offsets), own)
        for values, own in zip(log_likelihoods, rivals, strict=True)
    ]
    return [
        PosteriorScores(np.concatenate([s.log_score for s in of_power]), np.concatenate([s.denser for s in of_power]))
        for of_power in zip(*each, strict=True)
    ]


def suited_exponent(coverages: FloatArray) -> float:
    """Return the largest exponent whose coverage at `LEVEL` is as large as that, given (c,) those of `EXPONENTS`.

    Examples
    --------
    >>> round(suited_exponent(np.interp(np.log(EXPONENTS), np.log([1e-3, 1e-1]), [1.0, 0.8])), 6)
    0.01
    """
    enough = np.flatnonzero(coverages >= LEVEL)
    if not len(enough):
        return float(EXPONENTS[0])
    i = int(enough[-1])
    if i == len(EXPONENTS) - 1:
        return float(EXPONENTS[-1])
    share = (coverages[i] - LEVEL) / (coverages[i] - coverages[i + 1])
    return float(EXPONENTS[i] * (EXPONENTS[i + 1] / EXPONENTS[i]) ** share)


def _learn(
    values: FloatArray, held_out: NDArray[np.bool_], blocks: NDArray[np.int64], rivals: Sequence[Rivals],
    options: WindowOptions,
) -> LearnedExponent:  # fmt: skip
    """Return the exponent for log-likelihoods (w, n), judged on what is held out."""
    of_fitted = [own for own, out in zip(rivals, held_out, strict=True) if not out]
    of_judged = [own for own, out in zip(rivals, held_out, strict=True) if out]
    fitted = score_exponents(values[~held_out], EXPONENTS, of_fitted)
    each = np.array([scores.denser < LEVEL for scores in fitted])
    covered = each.mean(axis=2)
    power = suited_exponent(covered.mean(axis=1))
    # The guesses at the truth that lie next to the reference.
    error = reference_deviations(options.reference_error)
    truths = np.array([np.square(own.offsets[: each.shape[2]] / error).sum(axis=1) for own in of_fitted])
    nearest = np.argsort(truths, axis=1)[:, :N_NEAREST]
    exact = suited_exponent(np.take_along_axis(each, nearest[None], axis=2).mean(axis=(1, 2)))
    interval = _interval(power, covered, blocks[~held_out])
    judged, independent = score_exponents(values[held_out], np.array([power, 1.0]), of_judged)
    score_se = block_standard_error(judged.log_score, blocks[held_out])
    return LearnedExponent(power, interval, exact, judged.coverage_at(LEVEL), judged.mean, score_se, independent.mean)


def _interval(power: float, covered: FloatArray, blocks: NDArray[np.int64]) -> tuple[float, float]:
    """Return the 95% interval of an exponent, from what each block of time adds to it."""
    _, block = np.unique(blocks, return_inverse=True)
    n_blocks = int(block.max()) + 1
    if n_blocks < 2:
        return 0.0, np.inf
    without = [[np.log(suited_exponent(covered[:, block != b].mean(axis=1)))] for b in range(n_blocks)]
    low, high = block_interval(power, power * float(jackknife_error(np.array(without))[0]), n_blocks)
    return low, min(high, 1.0)
