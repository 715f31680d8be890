"""Calibrate odometry against a trajectory: systematic errors, and the noise for a filter's motion model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import checked
from beamfield.calibration.odometry.findings import odometry_findings
from beamfield.calibration.odometry.held_out import (
    HeldOut,
    blocks_of,
    jackknife_covariance,
    jackknife_intervals,
    judged,
)
from beamfield.calibration.odometry.noise_family import DIFFERENTIAL, GAUSSIAN, ONE_ALPHA, NoiseFamily
from beamfield.calibration.odometry.noise_fit import (
    LEAST_LEVEL,
    fit_levels,
    log_densities,
    not_faults,
    squared_distances,
)
from beamfield.calibration.odometry.result import (
    Estimate,
    NoiseCandidate,
    OdometryCalibration,
    OdometryOptions,
    SystematicErrors,
)
from beamfield.calibration.odometry.systematic import systematic_errors
from beamfield.calibration.odometry.windows import SYSTEMATIC, OdometryWindows, cut_odometry_windows, update_scans
from beamfield.calibration.pose_error import as_pose_covariances
from beamfield.calibration.pose_windows import reference_deviations
from beamfield.errors import TooLittleDataError
from beamfield.geometry import FloatArray
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.motion import OdometryMotion
from beamfield.sensors import SensorLog

# Update steps over which odometry and reference are compared. Single steps mislead: errors that last, and the
# reference's own, look like no noise at all.
WINDOW = 8
# Windows of these lengths show whether noise adds up as white noise does.
LENGTHS = (1, 2, 4, 8, 16)
# A systematic error of which the drive leaves more than this share of the prior spread is not identifiable.
LEAST_KNOWN = 0.5
# Where odometry and reference share less than this of the variance of their turns, the robot drove straight: noise is
# most of what the odometry turned, which looks like a scale of -1.
LEAST_SHARED = 0.9
# How often systematic errors and noise are fitted in turn.
ROUNDS = 3
# Levels below this are 0: the reference's error hides them.
NO_LEVEL = 10.0 * LEAST_LEVEL
# No pose is more exact than this, metres and radians.
EXACT = 1e-4
# 95% of a chi-square of 3 degrees of freedom lie below.
NINETY_FIVE = 7.815
DEFAULT = DifferentialMotion()


@checked
def calibrate_odometry(
    log: SensorLog, options: OdometryOptions | None = None, *, covariances: ArrayLike | None = None
) -> OdometryCalibration:
    """Learn the systematic errors and the noise of a log's odometry from reference poses.

    Parameters
    ----------
    log
        Scans with odometry and poses; poses may be NaN where they cannot be trusted.
    options
        How; None for the defaults.
    covariances
        (t, 3, 3) of the poses, in the map frame, as `fit_trajectory` gives them; None: `reference_error` for all. A
        tenth of a millimetre and of a milliradian are added, so that no pose is exact.

    Returns
    -------
    Errors and noise with intervals, held-out scores beside the stacks' default, and findings.

    Raises
    ------
    InvalidInputError
        If the covariances have another shape, are not finite where there is a pose, or not positive semi-definite.
    TooLittleDataError
        If there is no odometry or no pose, the robot never moves, or there are fewer than 12 windows between poses.

    Notes
    -----
    Windows of 8 update steps are compared; their covariance is that of the steps' noise, carried to the window's end to
    first order, plus the reference's at both ends. Windows less likely than one in a million count as faults, not as
    noise, and are reported. One, two and four alphas are compared on held-out blocks of steps; the simplest within one
    standard error of the best is taken. Intervals are those of the block jackknife, of logarithms for noise. The alphas
    are those of the robot as it drove: what systematic errors do to it is in them, as no stack corrects those.

    Examples
    --------
    Odometry that errs as AMCL's model says, with all alphas 0.01:

    >>> from beamfield.geometry import compose
    >>> from beamfield.sensors import RangeFinder, SensorLog
    >>> rng, n = np.random.default_rng(0), 400
    >>> odometry, poses = [np.zeros(3)], [np.zeros(3)]
    >>> for turn in rng.normal(0.0, 0.2, n):
    ...     odometry.append(compose(odometry[-1], [0.3, 0.0, turn]))
    ...     poses.append(DifferentialMotion(0.01, 0.01, 0.01, 0.01).sample(poses[-1][None], odometry[-2:], rng)[0])
    >>> laser = RangeFinder.from_bearings([0.0], max_range=8.0)
    >>> log = SensorLog(laser, np.arange(n + 1.0), np.ones((n + 1, 1)), poses, odometry)
    >>> exact = OdometryOptions(update_min_d=0.0, update_min_a=0.0, reference_error=1e-4)
    >>> result = calibrate_odometry(log, exact)
    >>> alpha = result.candidates[1].levels[0]
    >>> alpha.low < 0.01 < alpha.high, result.alphas.alpha3  # advised is the floor
    (True, 0.02)
    """
    options = options or OdometryOptions()
    fit, n_steps, cut = _cut(log, options, covariances)
    windows, is_noise = fit.windows, fit.kept
    systematic, corrected = fit.systematic_errors()
    default = fit.judge_given(DEFAULT)
    ours = [fit.judge(family, default) for family in DIFFERENTIAL]
    other = fit.judge(GAUSSIAN, default)
    chosen = _simplest_of_the_best(ours)
    covariance = windows.reference + windows.covariance(chosen.model)
    inside = squared_distances(windows.residuals, covariance)[is_noise] <= NINETY_FIVE
    floored = {f"alpha{i}": max(getattr(chosen.model, f"alpha{i}"), options.floor) for i in range(1, 5)}
    result = OdometryCalibration(
        systematic=systematic.errors,
        alphas=DifferentialMotion(**floored),
        chosen=chosen,
        candidates=(
            NoiseCandidate("nav2's default, 0.2", DEFAULT, (), default.mean, 0.0, 0.0, tuple(default.by_block)),
            *ours,
            other,
        ),
        corrected_alpha=corrected,
        by_length=_by_length(cut),
        coverage=float(inside.mean()),
        fault_stamps=log.stamps[windows.scans[windows.first[~is_noise]]],
        n_windows=len(windows),
        n_steps=n_steps,
        n_blocks=fit.blocks.n,
        options=options,
        findings=(),
        windows=windows,
        is_noise=is_noise,
    )
    return replace(result, findings=odometry_findings(result, log))


@checked
def learn_systematic_errors(log: SensorLog, *, covariances: ArrayLike | None) -> SystematicErrors:
    """Learn only the systematic errors that `calibrate_odometry` does, with their covariance; much faster than all."""
    fit, _, _ = _cut(log, OdometryOptions(), covariances)
    return fit.systematic_errors()[0]


def _cut(
    log: SensorLog, options: OdometryOptions, covariances: ArrayLike | None
) -> tuple[_WindowFit, int, Callable[[int], OdometryWindows]]:
    """Return the windows without faults, the number of update steps, and what cuts windows of other lengths."""
    if not log.has_odometry or not log.has_poses:
        raise TooLittleDataError(f"the log has no {'reference poses' if log.has_odometry else 'odometry'}")
    poses_covariance = _pose_covariances(log, covariances, options)
    scans = update_scans(log.odometry, options.update_min_d, options.update_min_a)

    def cut(length: int) -> OdometryWindows:
        return cut_odometry_windows(log.odometry, log.poses, poses_covariance, scans, length)

    windows = cut(WINDOW)
    unit = windows.covariance(ONE_ALPHA.units[0])
    if not unit.any():
        raise TooLittleDataError("the odometry never moves")
    is_noise = not_faults(windows.residuals, windows.reference, unit[None])
    return _WindowFit(windows, is_noise), len(scans) - 1, cut


class _WindowFit:
    """The windows that are no faults, and what is learned from them with and without each block."""

    def __init__(self, windows: OdometryWindows, is_noise: NDArray[np.bool_]) -> None:
        self.windows, self.kept = windows, is_noise
        self.residuals, self.reference = windows.residuals[is_noise], windows.reference[is_noise]
        self.blocks = blocks_of(windows.first[is_noise], windows.length)

    def units(self, family: NoiseFamily) -> FloatArray:
        """Return what each level of a family adds to the windows' covariance: (k, w, 3, 3)."""
        return np.array([self.windows.covariance(unit)[self.kept] for unit in family.units])

    def judge(self, family: NoiseFamily, default: HeldOut) -> NoiseCandidate:
        """Learn a family's levels with intervals, and judge it on held-out blocks beside the default."""
        units = self.units(family)
        levels = fit_levels(self.residuals, self.reference, units)
        without, density = [], np.full(len(self.residuals), np.nan)
        for block, rest in self._rests():
            left = fit_levels(self.residuals[rest], self.reference[rest], units[:, rest], levels)
            inside = self.blocks.inside(block)
            covariance = self.reference[inside] + np.tensordot(left, units[:, inside], 1)
            density[inside] = log_densities(self.residuals[inside], covariance)
            without.append(np.log(left))
        intervals = np.exp(jackknife_intervals(np.log(levels), np.array(without)))
        levels[~units.any(axis=(1, 2, 3))] = 0.0  # no window shows it: nothing turns, for example
        score = judged(density, self.blocks)
        estimates = tuple(_estimate(*map(float, row)) for row in np.column_stack([levels, intervals]))
        return NoiseCandidate(
            family.name, family.build(levels), estimates, score.mean, *score.gain_over(default), tuple(score.by_block)
        )

    def judge_given(self, model: OdometryMotion) -> HeldOut:
        """Judge a model whose parameters are given."""
        covariance = self.reference + self.windows.covariance(model)[self.kept]
        return judged(log_densities(self.residuals, covariance), self.blocks)

    def systematic_errors(self) -> tuple[SystematicErrors, float]:
        """Return the systematic errors that the drive shows, and the common alpha without them."""
        design, unit = self.windows.design()[self.kept], self.units(ONE_ALPHA)
        design[:, :, SYSTEMATIC.index("turn_scale")] *= self._turns_are_shared()
        short = self.windows.shortening(ONE_ALPHA.units[0])[self.kept]
        everything = np.ones(len(self.residuals), dtype=np.bool_)
        errors, left, alpha = self._in_turn(design, unit, short, everything, None)
        without = np.array([
            self._in_turn(design, unit, short, rest, np.array([alpha]))[0] for _, rest in self._rests()
        ])  # fmt: skip
        intervals = jackknife_intervals(errors, without)
        shown = np.flatnonzero(left < LEAST_KNOWN)
        found = {SYSTEMATIC[i]: Estimate(float(errors[i]), *map(float, intervals[i])) for i in shown}
        covariance = jackknife_covariance(without, len(errors))[np.ix_(shown, shown)]
        return SystematicErrors(found, covariance), alpha

    def _turns_are_shared(self) -> bool:
        said = self.windows.motion[self.kept, 2]
        shown = said + self.residuals[:, 2]
        return bool((said @ shown) ** 2 > LEAST_SHARED * (said @ said) * (shown @ shown))

    def _in_turn(
        self, design: FloatArray, unit: FloatArray, short: FloatArray, used: NDArray[np.bool_],
        start: FloatArray | None,
    ) -> tuple[FloatArray, FloatArray, float]:  # fmt: skip
        """Fit systematic errors and the common alpha in turn; return both, and what share of the priors is left."""
        residuals, reference, unit = self.residuals[used], self.reference[used], unit[:, used]
        corrected = residuals
        for _ in range(ROUNDS):
            start = fit_levels(corrected, reference, unit, start)
            errors, left = systematic_errors(residuals, design[used], reference + start[0] * unit[0])
            corrected = residuals - design[used] @ errors
        alpha = float(fit_levels(corrected, reference, unit, start)[0])
        # Last, and once: a shortening that the noise is fitted to in turn may grow without limit.
        errors, left = systematic_errors(residuals - alpha * short[used], design[used], reference + alpha * unit[0])
        return errors, left, alpha

    def _rests(self) -> list[tuple[int, NDArray[np.bool_]]]:
        """Return each block with the windows (w,) that touch nothing of it."""
        rests = [(block, self.blocks.without(block)) for block in range(self.blocks.n)]
        return [(block, rest) for block, rest in rests if rest.sum() >= 2]


def _estimate(level: float, low: float, high: float) -> Estimate:
    """Return a level; one that does not show, or is at the search's lower bound, is 0 and may be anything."""
    return Estimate(0.0, 0.0, np.inf) if level < NO_LEVEL else Estimate(level, low, high)


def _simplest_of_the_best(candidates: list[NoiseCandidate]) -> NoiseCandidate:
    """Return the first candidate that is no more than a standard error behind the best on held-out blocks."""
    best = max(candidates, key=lambda one: one.score if np.isfinite(one.score) else -np.inf)

    def is_as_good(one: NoiseCandidate) -> bool:
        behind, error = HeldOut(np.array(best.score_by_block)).gain_over(HeldOut(np.array(one.score_by_block)))
        return not behind > error  # also where there are too few blocks to tell

    return next(one for one in candidates if is_as_good(one))


def _by_length(cut: Callable[[int], OdometryWindows]) -> tuple[tuple[int, float], ...]:
    """Return the common alpha learned with windows of several lengths; without those too long for the log."""
    found = []
    for steps in LENGTHS:
        try:
            windows = cut(steps)
        except TooLittleDataError:
            continue
        unit = windows.covariance(ONE_ALPHA.units[0])[None]
        kept = not_faults(windows.residuals, windows.reference, unit)
        level = float(fit_levels(windows.residuals[kept], windows.reference[kept], unit[:, kept])[0])
        found.append((steps, _estimate(level, 0.0, np.inf).value))
    return tuple(found)


def _pose_covariances(log: SensorLog, covariances: ArrayLike | None, options: OdometryOptions) -> FloatArray:
    """Return the covariance of each pose (t, 3, 3): as given, or the same for all."""
    if covariances is None:
        deviations = reference_deviations(options.reference_error)
        return np.broadcast_to(np.diag(deviations**2), (len(log), 3, 3))
    return as_pose_covariances(log, covariances) + EXACT**2 * np.eye(3)
