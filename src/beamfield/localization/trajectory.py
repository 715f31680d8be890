"""The poses of a whole log, fitted to its odometry and to a map at once."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import checked, require
from beamfield.errors import InvalidInputError, TooLittleDataError, TrajectoryNotFoundError
from beamfield.finding import Finding, worst_first
from beamfield.geometry import FloatArray, as_pose, chained
from beamfield.localization.course_choice import FoundCourse, MirroredError, StartHypothesis, choose_course
from beamfield.localization.drive import Drive, prepare, with_points, without_points
from beamfield.localization.laser_mount import mount_of_fit, mount_of_scans
from beamfield.localization.mapped_area import MappedArea
from beamfield.localization.moving_objects import without_crowd
from beamfield.localization.robot_faults import OF_THE_ROBOT
from beamfield.localization.scan_delay import scan_delay
from beamfield.localization.scan_odometry import odometry_from_scans
from beamfield.localization.scan_parts import parts_that_disagree
from beamfield.localization.smoother import Smoothed, smooth
from beamfield.localization.trajectory_start import Course
from beamfield.localization.trajectory_trust import (
    MAX_DEVIATION,
    driven_ways,
    judge_trajectory,
    odometry_findings,
    scale_finding,
)
from beamfield.localization.turn_errors import TurnErrors, drift_at_rest, turn_errors, turn_findings, turns_of_scans
from beamfield.localization.wall_distance import walls_of
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.outdated_map import find_outdated_map
from beamfield.maps.range_scale import require_metres
from beamfield.sensors import SensorLog
from beamfield.sensors.robot_in_sight import robot_in_sight
from beamfield.short_repr import short_repr

Progress = Callable[[str, int, int], None]

FEWEST_SCANS, FEWEST_POINTS = 3, 100
# Metres, a radian of turning counting as a tenth of one: a robot that stands sees one place, of which maps have many.
LEAST_WAY = 0.3
# A robot that drives or turns less, metres along an axis and radians, does not tell how wrong its odometry is in that.
LEAST_DRIVE, LEAST_TURN = 0.5, 0.5
# Without odometry it is an alignment that slipped, not a wheel.
OF_WHEELS = ("wheel-slip", "odometry-turn-scale", "odometry-drift", "odometry-drift-at-rest")
NO_ODOMETRY = "no-odometry"
# With this share of trusted poses a course is right even if most readings disagree with the map.
NEARLY_ALL = 0.9


@dataclass(frozen=True, eq=False)
class TrajectoryFit:
    """A trajectory with its uncertainty, and what is wrong with it.

    Parameters
    ----------
    stamps
        (t,) seconds, of the scans.
    poses
        (t, 3) of the robot in the map, metres and radians.
    covariances
        (t, 3, 3) of x, y, theta, in the map's frame.
    trusted
        (t,) whether a pose can be relied on; see the findings for why not.
    findings
        What a user should know, worst first.
    hypotheses
        Where the log may have begun: the start that was chosen, and the next best that is elsewhere.
    sigma
        Standard deviation of the hits about the map's walls, metres.
    distance_scale, turn_scale, turn_per_metre
        What was found about the odometry: relative errors of its distances and turns, and radians that the robot turned
        per metre without its noticing.
    converged
        Whether the fit ended by itself.

    Notes
    -----
    The poses were fitted to the map: errors of the map that the scans can follow are in them, and do not show.
    """

    stamps: FloatArray
    poses: FloatArray
    covariances: FloatArray
    trusted: NDArray[np.bool_]
    findings: tuple[Finding, ...]
    hypotheses: tuple[StartHypothesis, ...]
    sigma: float
    distance_scale: float
    turn_scale: float
    turn_per_metre: float
    converged: bool

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def is_beyond_doubt(self) -> bool:
        """Whether the poses are right, whatever the map shows: nearly all trusted, and the robot was not carried."""
        carried = any(finding.name == "kidnapped" for finding in self.findings)
        return not carried and float(self.trusted.mean()) >= NEARLY_ALL

    def summary(self) -> str:
        """Return what was found in a few lines."""
        deviation = position_deviations(self.covariances)[self.trusted if self.trusted.any() else slice(None)]
        steps = np.hypot(*np.diff(self.poses[:, :2], axis=0).T)
        carried = [one.values["time_s"] for one in self.findings if one.name == "kidnapped"]
        steps[np.searchsorted(self.stamps - self.stamps[0], carried) - 1] = 0.0  # not driven
        x, y, theta = self.poses[0]
        drove = np.ptp(self.poses[:, :2], axis=0).max() >= LEAST_DRIVE
        turned = np.ptp(np.unwrap(self.poses[:, 2])) >= LEAST_TURN
        turns = ", turns" if drove else "; turns off"
        aligned = "none; those of aligned scans: " if any(one.name == NO_ODOMETRY for one in self.findings) else ""
        return (
            f"start      {x:.3f} m, {y:.3f} m, {np.degrees(theta):.1f} deg; "
            f"{self.hypotheses[0].agrees:.0%} of the beams agree with the map\n"
            f"path       {len(self)} scans, {steps.sum():.1f} m, {self.stamps[-1] - self.stamps[0]:.1f} s\n"
            f"trusted    {self.trusted.mean():.1%} of the scans\n"
            f"position   {np.median(deviation):.3f} m standard deviation (median), {deviation.max():.3f} m at worst\n"
            f"odometry   {aligned}"
            + (f"distances off by {-self.distance_scale:+.2%}" if drove else "the robot hardly drove")
            + (f"{turns} by {-self.turn_scale:+.2%}" if turned else "; the robot hardly turned")
        )


def position_deviations(covariances: FloatArray) -> FloatArray:
    """Return the standard deviation of each position in its worst direction, (t,) metres."""
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, 1]))


@checked
def fit_trajectory(
    log: SensorLog,
    grid: OccupancyGrid,
    *,
    start: ArrayLike | None = None,
    max_deviation: float = MAX_DEVIATION,
    progress: Progress | None = None,
) -> TrajectoryFit:
    """Find where a robot drove, from its odometry, its scans and a map; offline, over the whole log at once.

    1. The map is searched for the surroundings of eight places of the log. What is found at each is followed forwards
       and backwards through the log, also as if its odometry were wrong throughout; the cheapest way through these
       hypotheses is taken, with jumps from one to another where the robot was carried away.
    2. All poses are then fitted together: odometry from scan to scan, with errors that have long tails; end points of
       the scans to the nearest walls. How wrong both are is estimated from the log itself, as are scale errors of the
       odometry. Corridors are held by the odometry on both sides of them.
    3. Poses are not trusted where too little holds them, where the scans do not fit, and where the robot was carried.

    Parameters
    ----------
    log
        Scans with odometry. Without odometry, neighbouring scans are aligned in its place. Reference poses are not
        used.
    grid
        The map.
    start
        (3,) pose of the first scan, to about two metres and 45 degrees; None searches the whole map.
    max_deviation
        Poses are trusted up to this standard deviation of the position in any direction, metres.
    progress
        Called with (stage, done, total).

    Returns
    -------
    Poses, covariances, and what is wrong with them. All numbers are finite.

    Raises
    ------
    InvalidInputError
        If the map has no free or no occupied cell, the start is not a pose on the map, stamps run backwards,
        readings are longer than the map, or `max_deviation` is not positive.
    TooLittleDataError
        If the log has fewer than 3 scans or next to no readings.
    TrajectoryNotFoundError
        If no course fits, or two fit equally well; the best two starts are named.

    Notes
    -----
    Covariances are the marginals of the whole fit. End points on one patch of wall share its errors, so they count less
    than if they were independent; see docs/evidence/trajectory.md for the measured coverage.

    References
    ----------
    Probabilistic Robotics, (6.32) and section 6.4 for the end points. Lu and Milios, "Globally consistent range scan
    alignment for environment mapping" (1997), for fitting all poses at once.

    Examples
    --------
    >>> import beamfield as bf
    >>> grid = bf.draw_floor_plan()
    >>> finder = bf.RangeFinder.from_bearings(np.linspace(-2, 2, 60), max_range=12.0)
    >>> truth = bf.BeamParameters(0.85, 0.08, 0.02, 0.05, sigma_hit=0.03, lambda_short=0.5)
    >>> log = bf.simulate_log(grid, finder, truth, duration=20.0, scan_rate=4.0).only_sensor()
    >>> fit = fit_trajectory(log, grid)
    >>> bool(np.abs(fit.poses - log.poses)[:, :2].max() < 0.1)
    True
    """
    require(0.0 < max_deviation < np.inf, "max_deviation", "a number > 0", max_deviation)
    found = find_course(log, grid, start=start, progress=progress)
    return fit_course(log, grid, found, max_deviation=max_deviation, progress=progress)


def find_course(
    log: SensorLog, grid: OccupancyGrid, *, start: ArrayLike | None = None, progress: Progress | None = None
) -> FoundCourse:
    """Find roughly where a robot drove: the first step of `fit_trajectory`, with its parameters and errors."""
    report = progress or (lambda _stage, _done, _total: None)
    initial = _checked(log, grid, start)
    odometry = log.odometry
    if not log.has_odometry:
        odometry = odometry_from_scans(log, lambda done, total: report("aligning scans", done, total))
    drive = prepare(log, odometry)
    _check_points(drive)
    _check_moves(drive, log)
    try:
        found = choose_course(log, grid, drive, walls_of(grid), initial, report)
    except MirroredError:
        raise
    except TrajectoryNotFoundError as error:
        wrong = (mount_of_scans(log) or scan_delay(log) or turns_of_scans(log)) if log.has_odometry else None
        # Beams that see the robot hide the map, and look alike wherever it turns.
        named = [*robot_in_sight(log), *([] if wrong is None else [wrong])]
        if not named or named[0].severity == "info":
            raise
        raise TrajectoryNotFoundError(f"{error}. {named[0].text} {named[0].do}") from error
    return found if log.has_odometry else found._replace(findings=(_no_odometry(log), *found.findings))


def fit_course(
    log: SensorLog,
    grid: OccupancyGrid,
    found: FoundCourse,
    *,
    max_deviation: float = MAX_DEVIATION,
    progress: Progress | None = None,
) -> TrajectoryFit:
    """Fit all poses of a log whose course is known: the other steps of `fit_trajectory`.

    The log may have only some beams of that which the course was found for. TooLittleDataError if it has next to no
    readings.
    """
    report = progress or (lambda _stage, _done, _total: None)
    walls = walls_of(grid)
    still, crowd = without_crowd(log, found.drive, found.course.poses)
    drive = with_points(found.drive, still)
    _check_points(drive)
    poses, cut = _spread_out(drive, found.course)
    report("fitting all poses", 0, 1)
    report_fit, area = partial(report, "fitting all poses"), MappedArea(grid)
    fitted = smooth(drive, walls, poses, cut, report_fit)
    beyond = area.is_beyond(fitted.poses)
    trusted, more = judge_trajectory(drive, walls, fitted, cut, beyond, max_deviation)
    if (beyond & ~trusted).any():
        # Walls that the map does not show pull a robot to those that it does; there only odometry holds it.
        within = without_points(drive, ~trusted[drive.scans])
        fitted = smooth(within, walls, fitted.poses, cut, report_fit)
        beyond = area.is_beyond(fitted.poses)
        trusted, more = judge_trajectory(drive, walls, fitted, cut, beyond, max_deviation)
    of_wheels = () if log.has_odometry else OF_WHEELS
    turns = turn_errors(drive, fitted.poses, cut)
    seen = [*turn_findings(turns), *drift_at_rest(drive, fitted.poses), *odometry_findings(drive, found.course, fitted)]
    seen = [one for one in seen if one.name not in of_wheels]
    # Where poses seem to slip they may show no delay, as after a jump of a clock; the scans themselves do.
    slips = any(one.name == "wheel-slip" for one in seen)
    late = scan_delay(log, None if slips else fitted.poses) if log.has_odometry else None
    if late is not None and late.severity == "info":
        more, late = [*more, late], None
    wrong = late or (mount_of_fit(log, fitted.poses) if log.has_odometry else None)
    before = list(found.findings)
    if wrong is not None:
        # A laser turned around fits odometry whose direction is reversed.
        before = [wrong, *(one for one in before if wrong.name != "laser-mount" or one.name != "odometry-sign")]
    if any(one.name in OF_THE_ROBOT for one in before):
        seen = [one for one in seen if one.name != "wheel-slip"]
    distance = _distance_scale(fitted, wrong)
    ways = driven_ways(drive, fitted.poses, cut) if wrong is None else None
    seen = [*(scale_finding(distance, ways) if log.has_odometry else ()), *seen]
    held = drive.scans
    parts = parts_that_disagree(still[held], walls, fitted.poses[held], trusted[held])
    # Of parts that disagree the mount is not one.
    findings = [*parts, *before, *seen, *more, *crowd, *robot_in_sight(log)]
    fit = _result(log, fitted, distance, turns, trusted, findings, found.hypotheses)
    outdated = find_outdated_map(still[held], grid, fit.poses[held], are_right=fit.is_beyond_doubt)
    return fit if outdated is None else replace(fit, findings=worst_first([*findings, outdated]))


def _check_points(drive: Drive) -> None:
    if len(drive.points) < FEWEST_POINTS:
        raise TooLittleDataError(
            f"the scans have {len(drive.points)} readings with an end point; expected {FEWEST_POINTS}: beamfield "
            "inspect shows what became of the others"
        )


def _check_moves(drive: Drive, log: SensorLog) -> None:
    if drive.way[-1] < LEAST_WAY:
        source = "odometry" if log.has_odometry else "scans (the log has no odometry)"
        dead = turns_of_scans(log) if log.has_odometry else None
        raise TooLittleDataError(
            f"by its {source}, the robot moves {np.hypot(*drive.steps[:, :2].T).sum():.2f} m and turns "
            f"{np.degrees(np.abs(drive.steps[:, 2]).sum()):.0f} degrees in all; a trajectory needs a drive"
            + ("" if dead is None else f". {dead.text} {dead.do}")
            + ("" if log.has_odometry else _blind_scans(log))
        )


def _blind_scans(log: SensorLog) -> str:
    said = "; if its poses are the odometry, read it with lone_poses='odometry'" if log.has_poses else ""
    return f". Scans of few beams or of cones do not tell how it moves: such a log needs odometry{said}"


def _checked(log: SensorLog, grid: OccupancyGrid, start: ArrayLike | None) -> FloatArray | None:
    if not grid.occupied.any():
        raise InvalidInputError("grid: the map has no occupied cell, so no pose can be told from another")
    if not grid.free.any():
        raise InvalidInputError("grid: the map has no free cell, so the robot can be nowhere")
    if len(log) < FEWEST_SCANS:
        raise TooLittleDataError(f"too few scans: {len(log)}; a trajectory needs at least {FEWEST_SCANS}")
    if not np.isfinite(log.stamps).all():
        where = int(np.argmin(np.isfinite(log.stamps)))
        raise InvalidInputError(f"log: expected finite stamps, got {log.stamps[where]} at scan {where}")
    if (np.diff(log.stamps) < 0.0).any():
        where = int(np.argmin(np.diff(log.stamps))) + 1
        raise InvalidInputError(f"log: the stamps run backwards at scan {where}; cut the log there")
    require_metres(log, grid)
    if start is None:
        return None
    pose = as_pose(start, "start")
    col, row = grid.to_cells(pose[:2])
    if not (0.0 <= col < grid.shape[1] and 0.0 <= row < grid.shape[0]):
        raise InvalidInputError(f"start: ({pose[0]:g} m, {pose[1]:g} m) lies off the map")
    return pose


def _spread_out(drive: Drive, course: Course) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return poses of all scans, and the steps over which the robot was carried or the odometry is broken."""
    ends = [*drive.scans[1:], len(drive.stamps)]
    parts = [chained(pose, drive.steps[a : b - 1]) for pose, a, b in zip(course.poses, drive.scans, ends, strict=True)]
    cut = drive.broken.copy()
    for jump in course.jumps:
        cut[drive.scans[jump] - 1] = True
    return np.concatenate(parts), cut


def _distance_scale(fitted: Smoothed, wrong: Finding | None) -> float:
    """Return the relative error of the odometry's distances.

    At the heading of a laser whose mount is wrong by an angle, the robot seems to go ahead by its cosine of the way.
    """
    scale = float(fitted.systematic[0])
    if wrong is None or wrong.name != "laser-mount":
        return scale
    return (1.0 + scale) / abs(math.cos(wrong.values["turn_rad"])) - 1.0


def _result(log: SensorLog, fitted: Smoothed, distance: float, turns: TurnErrors | None, trusted: NDArray[np.bool_],
            findings: list[Finding], hypotheses: tuple[StartHypothesis, ...]) -> TrajectoryFit:  # fmt: skip
    first = hypotheses[0]._replace(pose=fitted.poses[0])
    _, turn, per_metre = (float(value) for value in fitted.systematic)
    if turns is not None:
        turn, per_metre = -turns.scale, -turns.drift
    return TrajectoryFit(
        log.stamps, fitted.poses, fitted.covariances, trusted, worst_first(findings), (first, *hypotheses[1:]),
        fitted.noise.hits.sigma, distance, turn, per_metre, fitted.converged,
    )  # fmt: skip


def _no_odometry(log: SensorLog) -> Finding:
    own = " If its own poses are the odometry, read them as such (--lone-poses odometry)." if log.has_poses else ""
    return Finding(
        NO_ODOMETRY, "warning",
        "The log has no odometry at the times of its scans: each was aligned with the one before in its place.",
        why="Along corridors, scans alone slide.",
        do="Record the odometry (docs/recording.md); if you did, beamfield inspect says whether two clocks differ."
        + own,
    )  # fmt: skip
