"""Poses for a log that has none: fitted to a map, and judged on beams that they were not fitted to."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import checked
from beamfield.errors import TrajectoryNotFoundError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.localization.trajectory import Progress, TrajectoryFit, find_course, fit_course, fit_trajectory
from beamfield.localization.trajectory_trust import MAX_DEVIATION
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.short_repr import short_repr

# With fewer beams the poses are fitted to all: half of them holds a pose too loosely.
FEWEST_BEAMS = 40
# With less of the log trusted, the result is to be used with care, or not at all.
MOST, HALF = 0.9, 0.5


@dataclass(frozen=True, eq=False)
class FittedPoses:
    """A log with the poses that were fitted to a map.

    Parameters
    ----------
    fit
        The trajectory.
    log
        The log with the poses that are trusted; the others are NaN.
    deviation
        How wrong they are by the fit, standard deviation per axis, metres; the median over the trusted scans. The
        difference between poses from two halves of the beams, where there are such, counts if it is more.
    reference_error
        How wrong they should be taken to be when posteriors are compared with them, metres: the deviation, but at least
        half a cell. Nobody knows better where in its cells a wall stands, and the beams of a scan do not say: all of
        them follow the map.
    instead_of
        How the log's own poses, in whose place they are, compare with them; None if it has none.
    """

    fit: TrajectoryFit
    log: SensorLog
    deviation: float
    reference_error: float
    instead_of: Finding | None = field(default=None, kw_only=True)

    __repr__ = short_repr

    @property
    def n_trusted(self) -> int:
        """Number of scans with a pose."""
        return int(np.isfinite(self.log.poses).all(axis=1).sum())

    @property
    def sentence(self) -> str:
        """Where the poses come from, for people."""
        why = (
            "The log's own poses do not go with the map or the odometry: others"
            if self.instead_of is not None
            else "The log has no reference poses: they"
        )
        return (
            f"{why} were fitted to this map from its odometry and scans. "
            f"{self.n_trusted} of {len(self.log)} scans are trusted, to {self.deviation:.3f} m (standard deviation per "
            "axis, median)."
        )

    def findings(self, measured: str = "") -> tuple[Finding, ...]:
        """Return where the poses come from and what that hides, and what was found on the way.

        `measured` says in sentences what was measured about it.
        """
        share = self.n_trusted / len(self.log)
        values = {"n_scans": float(len(self.log)), "n_trusted": float(self.n_trusted), "share_trusted": share,
                  "deviation_m": self.deviation}  # fmt: skip
        said = Finding(
            "few-poses-trusted" if share < HALF else "poses-fitted",
            "info" if share >= MOST and self.fit.converged else "warning",
            " ".join(filter(None, (self.sentence, measured))),
            values,
            why="Errors of the map, such as a wall drawn 5 cm off, move the poses with them and do not show.",
            do="Look at the path over the map (beamfield trajectory draws it); poses from elsewhere, such as motion "
            "capture's, are better.",
        )
        # What is wrong with the robot comes before what its filter made of it.
        return (said, *self.fit.findings, *([] if self.instead_of is None else [self.instead_of]))


@dataclass(frozen=True, eq=False)
class CrossFittedPoses(FittedPoses):
    """A log whose poses come from every other beam, so that the beams between can be judged at them.

    Parameters
    ----------
    judged
        The beams that `log`'s poses were not fitted to, at those poses; `log` if it has too few beams to halve.
    swapped
        The other beams, at poses from those judged; None without halves.
    same
        The other beams, at the poses that were fitted to them: what shows how much that hides; None without halves.
    """

    judged: SensorLog
    swapped: SensorLog | None
    same: SensorLog | None


@checked
def fit_poses(log: SensorLog, grid: OccupancyGrid, *, start: ArrayLike | None = None, progress: Progress | None = None
              ) -> FittedPoses:  # fmt: skip
    """Fit the poses of a log to a map, by all of its beams, and keep those that are trusted; see `fit_trajectory`.

    TrajectoryNotFoundError if none is, too.
    """
    fit = fit_trajectory(log, grid, start=start, progress=progress)
    posed, deviation = _posed(log, fit, fit.trusted), _deviation(fit, fit.trusted)
    return FittedPoses(fit, posed, deviation, max(deviation, 0.5 * grid.resolution))


@checked
def cross_fit_poses(log: SensorLog, grid: OccupancyGrid, *, start: ArrayLike | None = None,
                    progress: Progress | None = None) -> CrossFittedPoses:  # fmt: skip
    """Fit the poses of a log to a map by every other beam, twice, so that no beam is judged at a pose that it made.

    A pose follows the noise of the beams that it is fitted to, and the map's errors. At poses from the beams between,
    the first does not flatter the sensor; the second still does, and is the larger part (docs/evidence/calibrate.md).
    Roughly where the robot drove, within tenths of a metre, is found once by all beams, as is what stands in for
    odometry that is missing.

    Parameters
    ----------
    log, grid, start, progress
        As for `fit_trajectory`.

    Returns
    -------
    The log, and its halves with each other's poses. A scan is trusted if it is in both fits and they agree to 0.1 m.
    Its odometry is that of the fit, in a frame of its own: where the findings say that signs were put right or steps
    were not used, that is done, so that nothing is learned from the fault.

    Raises
    ------
    TrajectoryNotFoundError
        If no pose is trusted, and as `fit_trajectory`.
    InvalidInputError, TooLittleDataError
        As `fit_trajectory`.

    Examples
    --------
    >>> import beamfield as bf
    >>> grid = bf.draw_floor_plan()
    >>> finder = bf.RangeFinder.from_bearings(np.linspace(-2, 2, 60), max_range=12.0)
    >>> truth = bf.BeamParameters(0.85, 0.08, 0.02, 0.05, sigma_hit=0.03, lambda_short=0.5)
    >>> log = bf.simulate_log(grid, finder, truth, duration=10.0, scan_rate=4.0).only_sensor()
    >>> fitted = cross_fit_poses(log, grid, start=log.poses[0])
    >>> fitted.judged.finder.n_beams, bool(np.nanmax(np.abs(fitted.judged.poses - log.poses)[:, :2]) < 0.1)
    (30, True)
    """
    if log.finder.n_beams < FEWEST_BEAMS:
        plain = fit_poses(log, grid, start=start, progress=progress)
        return CrossFittedPoses(plain.fit, plain.log, plain.deviation, plain.reference_error, plain.log, None, None)
    report = progress or (lambda _stage, _done, _total: None)
    # Half of the beams may be too few to tell one place from another.
    course = find_course(log, grid, start=start, progress=report)
    if log.has_odometry:
        log = replace(log, odometry=np.where(np.isfinite(log.odometry), course.odometry, np.nan))
    even, odd = (_beams(log, first) for first in (0, 1))
    fit = fit_course(odd, grid, course, progress=report)
    again = fit_course(
        even, grid, course, progress=lambda stage, done, total: report(f"{stage}, other beams", done, total)
    )
    apart = (fit.poses - again.poses)[:, :2]
    trusted = fit.trusted & again.trusted & (np.hypot(*apart.T) <= MAX_DEVIATION)
    swapped = _posed(odd, again, trusted)
    # Each half has half of the variance of their difference; the median of a normal's absolute value is 0.674 sd.
    between = float(np.median(np.abs(apart[trusted]))) / 0.674 / np.sqrt(2.0)
    deviation = max(_deviation(fit, trusted), between)
    return CrossFittedPoses(
        fit, _posed(log, fit, trusted), deviation, max(deviation, 0.5 * grid.resolution),
        judged=_posed(even, fit, trusted), swapped=swapped, same=_posed(odd, fit, trusted),
    )  # fmt: skip


def _beams(log: SensorLog, first: int) -> SensorLog:
    """Return the log with every other beam."""
    beams = np.arange(first, log.finder.n_beams, 2)
    return SensorLog(log.finder.subset(beams), log.stamps, log.ranges[:, beams], log.poses, log.odometry, log.no_return)


def _posed(log: SensorLog, fit: TrajectoryFit, trusted: NDArray[np.bool_]) -> SensorLog:
    if not trusted.any():
        reasons = " ".join(finding.text for finding in fit.findings) or "poses from two halves of the beams disagree"
        raise TrajectoryNotFoundError(f"no pose of the fitted trajectory can be trusted: {reasons}")
    return log.with_poses(np.where(trusted[:, None], fit.poses, np.nan))


def _deviation(fit: TrajectoryFit, trusted: NDArray[np.bool_]) -> float:
    variances: FloatArray = fit.covariances[trusted, :2, :2].trace(axis1=1, axis2=2) / 2.0
    return float(np.sqrt(np.median(variances)))
