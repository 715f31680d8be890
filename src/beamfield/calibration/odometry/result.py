"""Options and result of the calibration of odometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_fields, check_magnitude, require
from beamfield.calibration.odometry.noise_family import NoiseFamily
from beamfield.calibration.odometry.noise_fit import fit_levels, matched_levels
from beamfield.calibration.odometry.windows import OdometryWindows
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.gaussian_motion import USUAL_MOTION, GaussianMotion
from beamfield.models.motion import OdometryMotion
from beamfield.short_repr import short_repr


@dataclass(frozen=True)
class OdometryOptions:
    """How odometry is calibrated.

    Parameters
    ----------
    update_min_d, update_min_a
        Motion between a filter's updates, metres and radians: AMCL's alphas belong to it.
    reference_error
        Standard deviation of the reference poses, per axis in metres and by `REFERENCE_LEVER` in radians, where no
        covariances are given.
    floor
        No alpha is advised below this: it survives a fault of the odometry. An alpha 5 times too small loses the robot,
        one 4 times too large costs little.

    Raises
    ------
    InvalidInputError
        If a number is not finite and in its range: distances, angles and floor >= 0, errors > 0.
    """

    update_min_d: float = 0.25
    update_min_a: float = 0.2
    reference_error: float = 0.04
    floor: float = 0.02

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("update_min_d", "update_min_a", "floor"):
            require(0.0 <= getattr(self, name) < np.inf, name, "a finite number >= 0", getattr(self, name))
        check_magnitude("reference_error", self.reference_error)


@dataclass(frozen=True)
class Estimate:
    """A value and its interval.

    Parameters
    ----------
    value, low, high
        The ends are infinite, or 0 and infinite for noise, where there are too few blocks for an interval, or where
        noise does not show: behind the reference's error, or in a drive without turns. Its level is 0 then.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class SystematicErrors:
    """Systematic errors of odometry.

    Parameters
    ----------
    errors
        Those that the drive shows, by the names of `OdometryCalibration.systematic`.
    covariance
        (e, e) of their values, by the jackknife over blocks of the drive; infinite variances if there are too few.
    """

    errors: Mapping[str, Estimate]
    covariance: FloatArray


@dataclass(frozen=True, eq=False)
class NoiseCandidate:
    """One way to have noise, judged on held-out blocks.

    Parameters
    ----------
    name
        For tables.
    model
        With the levels learned from all windows.
    levels
        An estimate for each level of the family.
    score
        Nats per held-out window; NaN if there are too few blocks.
    gain, gain_se
        Over the stacks' default, and its standard error over blocks.
    score_by_block
        Nats per window of each block.
    """

    name: str
    model: OdometryMotion
    levels: tuple[Estimate, ...]
    score: float
    gain: float
    gain_se: float
    score_by_block: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class OdometryCalibration:
    """What a log says about its odometry.

    Parameters
    ----------
    systematic
        Relative errors of distances and turns ("distance_scale", "turn_scale": truth over odometry, minus 1), heading
        gained per metre ("drift", rad/m), and the angle from odometry's direction of motion to the reference's ("yaw",
        rad); without what the drive does not show.
    alphas
        Advised for a `DifferentialMotion`: those of the chosen candidate, or the floor.
    chosen
        The simplest candidate of nav2's formula that is as good as the best on held-out blocks.
    candidates
        All that were compared: the stacks' default, one, two and four alphas, and `GaussianMotion`.
    corrected_alpha
        One common alpha, if systematic errors were put right.
    by_length
        Steps of a window, and the common alpha learned with such windows.
    coverage
        Share of the windows, faults aside, whose 95% region under the chosen candidate holds the reference.
    fault_stamps
        Stamps of the windows that no noise explains: slips, missed turns, lost signs.
    n_windows, n_steps, n_blocks
        Windows compared, update steps and blocks.
    options
        As given.
    findings
        What to know before trusting it.
    windows, is_noise
        What was compared, and which windows (w,) are no faults.
    """

    systematic: Mapping[str, Estimate]
    alphas: DifferentialMotion
    chosen: NoiseCandidate
    candidates: tuple[NoiseCandidate, ...]
    corrected_alpha: float
    by_length: tuple[tuple[int, float], ...]
    coverage: float
    fault_stamps: FloatArray
    n_windows: int
    n_steps: int
    n_blocks: int
    options: OdometryOptions
    findings: tuple[Finding, ...]
    windows: OdometryWindows = field(repr=False)
    is_noise: NDArray[np.bool_] = field(repr=False)

    __repr__ = short_repr

    def summary(self) -> str:
        """Return tables of the errors and the noise, and warnings."""
        from beamfield.report.odometry_section import odometry_tables

        return odometry_tables(self)

    @property
    def filter_motion(self) -> GaussianMotion:
        """Motion for our own `ParticleFilter`: the learned `GaussianMotion`, with no less noise than usual.

        Errors that last, as a wrong scale or a drift of the heading, are in the learned noise. The usual one is a
        reserve, for what the log did not show and for errors of the map.
        """
        learned = next(each.model for each in self.candidates if isinstance(each.model, GaussianMotion))
        usual = asdict(USUAL_MOTION)
        return GaussianMotion(**{name: max(float(getattr(learned, name)), least) for name, least in usual.items()})

    def fit(self, family: NoiseFamily) -> OdometryMotion:
        """Return the likeliest model of another family, with no less noise than the floor has.

        The floor of another formula is where it fits a `DifferentialMotion` with all alphas at the floor best.
        """
        windows, kept = self.windows, self.is_noise
        reference = windows.reference[kept]
        units = np.array([windows.covariance(unit)[kept] for unit in family.units])
        levels = fit_levels(windows.residuals[kept], reference, units)
        floor = self.options.floor
        least = windows.covariance(DifferentialMotion(floor, floor, floor, floor))[kept]
        return family.build(np.maximum(levels, matched_levels(least, units)))
