"""Which course a log took through a map, and in what sense its odometry and scans were meant."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from beamfield.errors import TrajectoryNotFoundError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray, chained, wrap_angle
from beamfield.kernels.trajectory import Walls
from beamfield.localization.drive import Drive, mirrored, with_points
from beamfield.localization.moving_objects import without_crowd
from beamfield.localization.trajectory_start import (
    Course,
    Followed,
    cheapest_course,
    course_through,
    follow_hypotheses,
    is_at,
    other_courses,
)
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import LEAST_AGREEMENT, ray_agreement
from beamfield.sensors import SensorLog

Progress = Callable[[str, int, int], None]

# So many beams pass walls in the right place, too: glass, and walls that are grazed. Nats that more cost, per scan, and
# how much these speak against a map: they tell buildings apart, but not two places in one.
USUAL_THROUGH, MORE_THROUGH, THROUGH = 0.4, 10.0, 6.0
# Nats per scan beyond which a course is none: between those in the right map (at most 4.0) and in the maps of other
# buildings (at least 4.7) of the logs that docs/evidence/trajectory.md lists.
MOST_COST = 4.6
# One that costs more is right all the same if it has no jumps, enough of its beams agree with the map, more than on any
# other course (in maps of other buildings by at most 0.04, in the right one by 0.12 and more where many readings are
# short, random, or of what the map does not show), and it costs less than any other without jumps (by at most 0.7, and
# 1.0 and more), and no more than this beyond any with jumps.
AGREES_MORE, COSTS_LESS, MOST_BEYOND = 0.08, 0.9, 1.0
# That was in logs of two minutes; means over fewer scans held to the map scatter more. Of 720 logs of 12 s in maps of
# other buildings some stand out by 0.44 and 4.7 nats.
MANY_SCANS, FEW_POWER = 560, 0.75
# If it stands out by this much, half of its beams need not agree: the map is out of date. In maps of other buildings
# courses stand out by at most 0.06 and 1.3 nats in logs of two minutes, and 0.44 and 4.7 in those of 12 s; in maps that
# lack much of an office by at least 0.19 and 5.3 (benchmarks/other_maps.py), or, where most of what stood there was
# moved, 0.17 and 3.4. Of shorter logs so many times as much is asked at most.
AGREES_FAR_MORE, COSTS_FAR_LESS, AT_MOST = 0.1, 2.5, 2.0
# With jumps, as of a robot that was carried, a course is right though it costs more if this share of its beams agrees,
# so much more than on any course without, and it costs so much less. In maps of other buildings courses with jumps
# agree to 0.53 at most; of robots that were carried, or whose wheels slipped by a metre, 0.75 and more of the beams
# agree, 0.29 more than on any other, and they cost 6 nats less.
AGREES_WITH_JUMPS, MORE_WITH_JUMPS, LESS_WITH_JUMPS = 0.65, 0.2, 4.0
# Odometry is taken to be wrong throughout if a course that learns how costs so many nats less (at most 16 where it is
# right; where courses that do not learn it are a quarter of a metre off, 18 to 293).
WRONG_THROUGHOUT = 30.0
# A start that is given is believed against a worse fit, without jumps.
MOST_COST_FROM_START = 9.0
# What is mirrored if only mirrored scans fit, or, with odometry that is mirrored too, the map.
MIRRORED_SCANS = (
    "its scans are mirrored (a lidar upside down, or the wrong sign of angle_increment?): put that right in the "
    "sensor's frame or in the scans"
)
MIRRORED_MAP = (
    "the map is mirrored (its picture upside down, or rows in the wrong order?): flip the picture from top to bottom, "
    "and look whether the map's origin still holds"
)
# Two courses whose costs and misfits differ by less, in nats, are equally likely.
SURELY_BETTER = 30.0
# So are two whose misfits differ by less than this, in nats per scan, if the costs of so many metres of way, which err
# alike, differ less than by chance (one standard error): docs/evidence/trajectory.md says how often that is so.
ALIKE, ALIKE_WAY = 0.7, 2.0


class MirroredError(TrajectoryNotFoundError):
    """A log fits a map only if its scans, or the map, are mirrored: that is what is wrong, and all."""


class StartHypothesis(NamedTuple):
    """Where the log may have begun.

    Parameters
    ----------
    pose
        (3,) of the first scan, metres and radians.
    cost
        Nats that scans and corrections of the odometry cost, per scan, and more beams through walls than usual; the
        best start has the least.
    agrees, through
        Shares of the beams: as long as the map says; longer, through its walls.
    """

    pose: FloatArray
    cost: float
    agrees: float
    through: float

    @property
    def misfit(self) -> float:
        """Nats per scan that speak against the map."""
        return self.cost + THROUGH * min(self.through, USUAL_THROUGH)

    def __str__(self) -> str:
        x, y, theta = self.pose
        return f"({x:.2f} m, {y:.2f} m, {np.degrees(theta):.0f} deg): {self.agrees:.0%} of the beams agree"


Judged = tuple[StartHypothesis, Course]


class FoundCourse(NamedTuple):
    """Where a log was recorded, before its poses are fitted.

    Parameters
    ----------
    drive
        The log, with odometry put right where its sign is wrong.
    course
        Rough poses.
    hypotheses
        Where the log may have begun, the best first.
    findings
        What is wrong with the odometry.
    """

    drive: Drive
    course: Course
    hypotheses: tuple[StartHypothesis, ...]
    findings: tuple[Finding, ...]

    @property
    def odometry(self) -> FloatArray:
        """(t, 3) the odometry as it was used: signs put right, and standing over steps that no robot makes."""
        poses = chained(np.zeros(3), self.drive.steps)
        poses[:, 2] = wrap_angle(poses[:, 2])
        return poses


def choose_course(
    log: SensorLog, grid: OccupancyGrid, drive: Drive, walls: Walls, start: FloatArray | None, report: Progress
) -> FoundCourse:
    """Return the course through the log, with odometry put right where its sign is wrong.

    The start (3,) is where the first scan was taken, roughly; None if that is not known. TrajectoryNotFoundError if no
    course fits, two fit equally well, or one fits only scans, or a map, that are mirrored.
    """
    limit = MOST_COST if start is None else MOST_COST_FROM_START
    search = partial(_hypotheses, grid=grid, walls=walls, start=start, report=report)
    plain, turned, reversed_, both = ("", drive), *mirrored(drive)
    first: tuple[StartHypothesis, ...] = ()
    seen, crowd = without_crowd(log, drive)
    still = "", with_points(drive, seen)
    # By odometry that is wrong throughout all seems to move. Scans that turn against the odometry may be what is
    # mirrored; only the map tells.
    for (put_right, steps), unturned, scans in (
        (still, None, seen), *([(plain, None, log)] if crowd else []), (turned, plain, None), (reversed_, None, None),
        (both, reversed_, None),
    ):  # fmt: skip
        judged = search(log if scans is None else scans, steps, put_right, is_still=scans is not None)
        first = first or tuple(one for one, _ in judged[:2])
        if judged[0][0].misfit > (MOST_COST if len(judged[0][1].jumps) else limit):
            judged = (
                standing_out(judged, start, len(drive.scans))
                or standing_out_with_jumps(judged, len(drive.scans))
                or (_steady(judged) if start is not None else [])
            )
        if not judged:
            continue
        hypotheses = tuple(one for one, _ in judged[:2])
        equal, more = SURELY_BETTER / len(drive.scans), "" if start is None else " more exactly"
        way, rivals = drive.way[drive.scans], [one for one in judged[1:] if is_at(one[0].pose, start)]
        alike = [one[0] for one in rivals if are_alike(way, judged[0], one, start)]
        if unturned is not None:
            _refuse_mirrored(log, unturned[1], search, hypotheses[0].misfit + equal)
        elif not put_right and len(judged[0][1].jumps):
            # In the mirrored map of a building whose two sides look alike, the robot seems to be carried between them.
            _refuse_mirrored(log, turned[1], search, hypotheses[0].misfit - equal, MIRRORED_MAP)
        if alike:
            raise TrajectoryNotFoundError(
                f"two trajectories fit the log equally well, give the start of one{more}; "
                f"{_named((hypotheses[0], alike[0]))}"
            )
        findings = (_wrong_sign(put_right),) if put_right else ()
        return FoundCourse(steps, judged[0][1], hypotheses, findings)
    for _, steps in (plain, reversed_):
        _refuse_mirrored(log, steps, search, limit)
    _refuse_mirrored(log, turned[1], search, MOST_COST, MIRRORED_MAP)
    may_be_right = start is None and first[0].agrees >= LEAST_AGREEMENT
    raise TrajectoryNotFoundError(
        "no trajectory through this map fits the log (another building, a map out of date, inverted (negate) or of "
        "wrong resolution, places that look alike, people all around, a drive beyond it, or wrong odometry?); "
        f"{_named(starts_apart(first))}"
        f"{'; if it began at one of these, give that start' if may_be_right else ''}"
    )


def without_false_jumps(
    log: SensorLog, grid: OccupancyGrid, drive: Drive, followed: list[Followed], course: Course,
    start: FloatArray | None,
) -> Course:  # fmt: skip
    """Return the course without the jumps without which no fewer beams agree with the map, or it costs no more.

    Hypotheses are followed by end points, which fit walls behind walls as well. The course is the cheapest way through
    those `followed`.
    """
    bounds = [0, *course.jumps, len(course.which)]
    for i, jump in enumerate(course.jumps, 1):
        # What held before the jump may hold after it, or the other way round.
        for first, end, other in (
            (jump, bounds[i + 1], course.which[jump - 1]),
            (bounds[i - 1], jump, course.which[jump]),
        ):
            part, which = slice(first, end), course.which.copy()
            which[part] = other
            shorter = course_through(drive, followed, which, start)
            if len(shorter.jumps) < len(course.jumps) and is_at(shorter.poses[0], start):
                chosen, instead = (
                    ray_agreement(log, grid, one.poses[part], drive.scans[part]).agrees for one in (course, shorter)
                )
                if instead >= chosen or shorter.cost <= course.cost:
                    return without_false_jumps(log, grid, drive, followed, shorter, start)
    return course


def standing_out(judged: list[Judged], start: FloatArray | None, n_scans: int) -> list[Judged]:
    """Return the courses without jumps if the first is beyond doubt though its readings fit the map poorly, or none.

    The cheapest course comes first; n_scans were held to the map. If a start (3,) is given, there need not be another
    course that begins there.
    """
    best, *others = sorted(judged, key=lambda pair: len(pair[1].jumps) > 0)
    jumping = min((one.cost for one, course in others if len(course.jumps)), default=np.inf)
    steady = min((one.cost for one, course in others if not len(course.jumps)), default=np.inf)
    more = best[0].agrees - max((one.agrees for one, _ in others), default=0.0)
    less, few = steady - best[0].cost, _times_as_much(n_scans)
    far = min(few, AT_MOST)
    undoubted = (
        not len(best[1].jumps)
        and (np.isfinite(steady) or start is not None)
        and best[0].cost <= jumping + MOST_BEYOND
        and (
            (best[0].agrees >= LEAST_AGREEMENT and more >= few * AGREES_MORE and less >= few * COSTS_LESS)
            or (np.isfinite(steady) and more >= far * AGREES_FAR_MORE and less >= far * COSTS_FAR_LESS)
        )
    )
    return [pair for pair in (best, *others) if not len(pair[1].jumps)] if undoubted else []


def standing_out_with_jumps(judged: list[Judged], n_scans: int) -> list[Judged]:
    """Return all courses if the first, which has jumps, is beyond doubt though it fits the map poorly, or none."""
    (best, course), *others = judged
    few = _times_as_much(n_scans)
    undoubted = (
        len(course.jumps) > 0
        and len(others) > 0
        and best.agrees >= AGREES_WITH_JUMPS
        and best.agrees >= max(one.agrees for one, _ in others) + few * MORE_WITH_JUMPS
        and best.cost <= min(one.cost for one, _ in others) - few * LESS_WITH_JUMPS
    )
    return judged if undoubted else []


def _times_as_much(n_scans: int) -> float:
    """Return how many times as much is asked of a log of few scans."""
    return float(max(1.0, MANY_SCANS / n_scans) ** FEW_POWER)


def are_alike(way: FloatArray, best: Judged, other: Judged, start: FloatArray | None) -> bool:
    """Return whether another course is as likely as the best one; way (n,) are the metres driven until each scan.

    From a start that is given, courses that differ by chance slide along a corridor: their covariances say so.
    """
    equal, misfit = SURELY_BETTER / len(way), other[0].misfit - best[0].misfit
    if other[0].cost - best[0].cost < equal > misfit:
        return True
    if start is not None:
        return False
    parts = np.unique(way // ALIKE_WAY, return_inverse=True)[1]
    sums = np.bincount(parts, other[1].costs - best[1].costs)
    return bool(misfit < ALIKE and len(sums) > 1 and sums.sum() < np.sqrt(len(sums) * sums.var(ddof=1)))


def _steady(judged: list[Judged]) -> list[Judged]:
    """Return the courses without jumps that are believed from a start that is given, though others fit better."""
    return [(one, course) for one, course in judged if not len(course.jumps) and one.misfit <= MOST_COST_FROM_START]


def _refuse_mirrored(log: SensorLog, drive: Drive, search: Callable[..., list[Judged]], limit: float,
                     wrong: str = MIRRORED_SCANS) -> None:  # fmt: skip
    """Refuse a log that fits the map, up to a misfit, if its scans are mirrored."""
    finder = replace(log.finder, mounts=log.finder.mounts * [1.0, -1.0, -1.0])
    image = replace(log, finder=finder)
    judged = search(image, with_points(drive, image), "with its scans mirrored")
    if judged[0][0].misfit <= limit:
        starts = _named([one for one, _ in judged[:1]])
        raise MirroredError(f"the log fits the map only if {wrong}; {starts}")


def _hypotheses(
    log: SensorLog, drive: Drive, name: str, *, grid: OccupancyGrid, walls: Walls, start: FloatArray | None,
    report: Progress, is_still: bool = False,
) -> list[Judged]:  # fmt: skip
    """Return courses through the log, the cheapest first; without a crowd, if one is left in what is given."""
    if not is_still:
        log, _ = without_crowd(log, drive)
        drive = with_points(drive, log)
    stage = "searching the map" + (f", {name}" if name else "")
    rigid, learning = follow_hypotheses(drive, grid, walls, start, partial(report, stage))
    best, followed = _cheapest(log, grid, drive, rigid, start)
    learned = _cheapest(log, grid, drive, learning, start)
    if (best[0].cost - learned[0][0].cost) * len(drive.scans) > WRONG_THROUGHOUT:
        best, followed = learned
    others = [_judged(log, grid, drive, one) for one in other_courses(followed, best[1], start)[:3]]
    if start is not None and not others:
        # None else begins there: those that fit worse tell by how much the best one stands out.
        elsewhere = [_judged(log, grid, drive, one) for one in other_courses(followed, best[1], None)[:3]]
        others = elsewhere if all(one.cost > best[0].cost for one, _ in elsewhere) else []
    if start is not None and len(best[1].jumps) and best[0].misfit > MOST_COST:
        # Beyond the map nothing fits as well as some other place in it.
        known = {int(course.which[0]) for _, course in others}
        steady = [one for one in other_courses(followed, None, start)[:1] if int(one.which[0]) not in known]
        others += [_judged(log, grid, drive, one) for one in steady]
    return sorted([best, *others], key=lambda pair: pair[0].cost)


def _cheapest(
    log: SensorLog, grid: OccupancyGrid, drive: Drive, ways: list[list[Followed]], start: FloatArray | None
) -> tuple[Judged, list[Followed]]:
    """Return the cheapest course through hypotheses that were followed in one way or another, and all of these."""
    followed = [one for way in ways for one in way]
    if not followed:
        raise TrajectoryNotFoundError("no place of the map looks like any place of the log")
    cheapest = [
        without_false_jumps(log, grid, drive, some, cheapest_course(drive, some, start), start)
        for some in (followed, *ways)
    ]
    return min((_judged(log, grid, drive, one) for one in cheapest), key=lambda pair: pair[0].cost), followed


def _judged(log: SensorLog, grid: OccupancyGrid, drive: Drive, course: Course) -> Judged:
    agreement = ray_agreement(log, grid, course.poses, drive.scans)
    pose = course.poses[0].copy()
    pose[2] = wrap_angle(pose[2])
    cost = course.cost / len(drive.scans) + MORE_THROUGH * max(agreement.through - USUAL_THROUGH, 0.0)
    return StartHypothesis(pose, cost, *agreement), course


def starts_apart(hypotheses: Sequence[StartHypothesis]) -> list[StartHypothesis]:
    """Return the starts without those of further courses from the same place, between which nobody can choose."""
    apart: list[StartHypothesis] = []
    for one in hypotheses:
        if not any(is_at(one.pose, other.pose) for other in apart):
            apart.append(one)
    return apart


def _named(hypotheses: Sequence[StartHypothesis]) -> str:
    return "best starts: " + "; ".join(map(str, hypotheses))


def _wrong_sign(kind: str) -> Finding:
    return Finding(
        "odometry-sign", "warning", f"The odometry fits only {kind}; that was done.",
        why="A robot that takes its odometry as it is gets lost.",
        do="Correct the sign where the odometry is made; if the direction is reversed, look whether it is the laser's "
        "mount that is wrong by 180 degrees.",
    )  # fmt: skip
