"""Which poses of a fitted trajectory can be trusted, and what happened where they cannot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between, compose
from beamfield.kernels import trajectory as kernels
from beamfield.kernels.trajectory import Walls
from beamfield.localization.drive import Drive
from beamfield.localization.hit_noise import off_band
from beamfield.localization.smoother import Smoothed
from beamfield.localization.trajectory_start import Course

# A pose is trusted up to this standard deviation of the position in any direction, metres, and of the heading, radians.
MAX_DEVIATION, MAX_HEADING_DEVIATION = 0.1, float(np.radians(4.0))
# Smallest share of the readings that agree with the map, relative to that of the whole log.
LEAST_AGREEMENT = 0.5
# By its odometry a robot stands if it moves so little from one scan that is held to the map to the next, metres.
STANDS = 0.02
# Readings agree within so many sigma, or metres if that is more; their share is taken over so much of the way.
AGREES_SIGMAS, AGREES, AGREEMENT_WAY = 3.0, 0.1, 2.0
# What is named as a slip: odometry and the rest differ by so much within a second, metres and radians, and sigmas.
SLIP, SLIP_TURN, SLIP_SIGMAS, SLIP_TIME = 0.15, np.radians(8.0), 4.0, 1.0
# A gap in time, seconds and multiples of the usual step.
GAP, GAP_STEPS = 5.0, 20.0
# Wheels are seldom this far off; maps and units more often.
SCALE = 0.05
# So much further off sideways than ahead they slip. Both show in steps between scans that turn less than STRAIGHT
# (radians) if the robot moves so many metres, and this share of its way, along either axis.
APART, STRAIGHT, LEAST_WAY, LEAST_SHARE = 0.03, 0.1, 5.0, 0.1
MOST_NAMED = 5
# Scanners and wheels seldom start and end together: so small a share of scans without odometry is no reason to worry.
FEW_UNKNOWN = 0.01
# From this share of the scans of a kind on, what they have in common explains them.
MOSTLY = 0.5
# Seconds from the nearest odometry after which a robot may be anywhere.
BRIDGED = 2.0


class DrivenWays(NamedTuple):
    """Relative errors of the odometry's distances: what they have to be multiplied by, less one."""

    ahead: float
    sideways: float


def judge_trajectory(
    drive: Drive,
    walls: Walls,
    fitted: Smoothed,
    cut: NDArray[np.bool_],
    beyond: NDArray[np.bool_],
    max_deviation: float,
) -> tuple[NDArray[np.bool_], list[Finding]]:
    """Return which scans (t,) are trusted, and a finding for each reason why not; some are from beyond the map."""
    position = np.sqrt(np.linalg.eigvalsh(fitted.covariances[:, :2, :2])[:, 1])
    heading = np.sqrt(fitted.covariances[:, 2, 2])
    own, agreement = _agreement(drive, walls, fitted)
    usual = float(np.median(agreement))
    weak = (position > max_deviation) | (heading > MAX_HEADING_DEVIATION)
    poor = agreement < LEAST_AGREEMENT * usual
    carried, lost = _around(drive, cut, own < LEAST_AGREEMENT * usual), _far_from_odometry(drive)
    worst = float(position.max())
    unfit = poor & ~weak & ~beyond
    # Where poses are interpolated between odometry far apart, it is these that do not fit.
    is_guessed = bool(drive.unknown[unfit].mean() > MOSTLY) if unfit.any() else False
    findings = [
        *_stretches(
            "odometry-gap", lost, drive, {}, f"there is no odometry within {BRIDGED:g} s",
            "it begins late, ends early, or has another clock than the scans", "Record the odometry throughout",
        ),
        *_stretches(
            "weak-stretch", weak, drive, {"worst_m": worst},
            f"too little holds the position there: its standard deviation is up to {worst:.2f} m",
            "a corridor without ends in sight, or no walls", "Drive where more walls are in sight",
        ),
        *_stretches(
            "beyond-map-stretch", poor & ~weak & beyond, drive, {},
            "the robot is where the map is unknown, or beyond its edges", "it drove on where nobody had mapped",
            "Map that part, too",
        ),
        *_stretches(
            "poor-fit-stretch", unfit, drive, {"usual_share": usual},
            f"the scans do not fit the map there: less than {LEAST_AGREEMENT * usual:.0%} of the readings "
            f"agree, elsewhere {usual:.0%}",
            "most of them have no odometry, and interpolated poses are wrong" if is_guessed else
            "the world differs from the map, or the robot is elsewhere",
            "Record the odometry throughout" if is_guessed else "Look at these scans with beamfield check",
        ),
    ]  # fmt: skip
    return ~(weak | poor | carried | lost), findings


def odometry_findings(drive: Drive, course: Course, fitted: Smoothed) -> Iterator[Finding]:
    """Name the times at which the odometry was wrong: resets, slips, being carried away, gaps."""
    since = drive.stamps - drive.stamps[0]
    yield from _carried(drive, course, since)
    yield from _resets(drive, since)
    yield from _slips(fitted, since, drive.unknown)
    yield from time_gaps(drive.stamps)
    if n_unknown := int(np.count_nonzero(drive.unknown)):
        which = "1 scan has" if n_unknown == 1 else f"{n_unknown} scans have"
        few = n_unknown <= FEW_UNKNOWN * len(drive.unknown)
        yield Finding(
            "odometry-missing", "info" if few else "warning", f"{which} no odometry; it was interpolated.",
            {"scans": float(n_unknown)},
            why="Slips in between are not seen.", do="Record the odometry for as long as the scans.",
        )  # fmt: skip


def scale_finding(scale: float, ways: DrivenWays | None = None) -> Iterator[Finding]:
    """Name a relative error of the odometry's distances, if it is large; of a robot that also moves sideways, of each.

    Its wheels slip sideways more than ahead, whatever the scale of map and ranges.
    """
    if ways is not None and abs(ways.sideways - ways.ahead) > APART and max(map(abs, ways)) > SCALE:
        yield Finding(
            "odometry-scale", "warning",
            f"The odometry's distances are off by {-ways.ahead:+.1%} ahead and by {-ways.sideways:+.1%} sideways.",
            {"scale": scale, "ahead": ways.ahead, "sideways": ways.sideways},
            why="Mecanum and omni wheels slip sideways; map and ranges are not to blame, which would be wrong by the "
            "same both ways.",
            do="Multiply what the base's driver computes of the wheels by "
            f"{1.0 + ways.ahead:.3f} along x and by {1.0 + ways.sideways:.3f} along y.",
        )  # fmt: skip
    elif abs(scale) > SCALE:
        yield Finding(
            "odometry-scale", "warning",
            f"Distances of the odometry and of scans in the map differ by {abs(scale):.1%}.", {"scale": scale},
            why="The wheels' scale, the map's or that of the ranges is wrong; with one of the last two, so are the "
            "poses.",
            do="Measure a long wall, and compare it with the map and with a reading.",
        )  # fmt: skip


def driven_ways(drive: Drive, poses: FloatArray, cut: NDArray[np.bool_]) -> DrivenWays | None:
    """Return the relative errors of the odometry's distances along each axis of a robot that moved along both.

    Poses (t, 3) are fitted; steps that are cut (t - 1,) say nothing. None if the robot moved along one axis only.
    """
    told, true = drive.steps_between_scans, between(poses[drive.scans[:-1]], poses[drive.scans[1:]])
    jumps = np.concatenate([[0], np.cumsum(cut)])[drive.scans]
    # While it turns, the chord of an arc is not along the way of a robot without such wheels.
    straight = (np.diff(jumps) == 0) & (np.abs(told[:, 2]) < STRAIGHT)
    told, true = told[straight, :2], true[straight, :2]
    way = np.abs(told).sum(axis=0)
    if not len(told) or way.min() < max(LEAST_WAY, LEAST_SHARE * way.sum()):
        return None
    return DrivenWays(*((true * told).sum(axis=0) / (told**2).sum(axis=0) - 1.0).tolist())


def _agreement(drive: Drive, walls: Walls, fitted: Smoothed) -> tuple[FloatArray, FloatArray]:
    """Return the share of readings that agree with the map, of each scan held to it (n,), and around each scan (t,)."""
    noise, signed = fitted.noise.hits, np.empty(len(drive.points))
    kernels.fill_residuals(drive.points, drive.first, fitted.poses[drive.scans], walls, noise.low == noise.high, signed)
    limit = max(AGREES_SIGMAS * noise.sigma, AGREES)
    good = np.nan_to_num(np.abs(off_band(signed, noise)), nan=np.inf) <= limit
    n, sums = len(drive.scans), np.concatenate([[0], np.cumsum(good)])
    hits = np.concatenate([[0], sums[drive.first[1:]]])
    own = np.diff(hits) / np.maximum(np.diff(drive.first), 1)
    way = drive.way[drive.scans]
    low = np.searchsorted(way, way - 0.5 * AGREEMENT_WAY, side="left")
    high = np.searchsorted(way, way + 0.5 * AGREEMENT_WAY, side="right")
    share = (hits[high] - hits[low]) / np.maximum(drive.first[high] - drive.first[low], 1)
    nearest = np.clip(np.searchsorted(drive.scans, np.arange(len(drive.stamps)), side="right") - 1, 0, n - 1)
    return own, np.asarray(share[nearest])


def _around(drive: Drive, cut: NDArray[np.bool_], poor: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the scans (t,) between the last one that was held to the map before a jump and the first one after.

    To carry a robot takes time, in which it stands by its odometry. Where scans of that time fit the map poorly (n,),
    all of it is returned: others may fit by chance.
    """
    around, last = np.zeros(len(drive.stamps), bool), len(drive.scans) - 1
    moves = np.concatenate([[0], np.flatnonzero(np.diff(drive.way[drive.scans]) > STANDS) + 1, [last + 1]])
    for step in np.flatnonzero(cut):
        after = min(int(np.searchsorted(drive.scans, step + 1)), last)
        before = max(after - 1, 0)
        begin, end = int(moves[moves <= before][-1]), int(moves[moves > after][0])
        if poor[begin:end].any():
            before, after = begin, min(end, last)
        around[drive.scans[before] : drive.scans[after] + 1] = True
    return around


def _far_from_odometry(drive: Drive) -> NDArray[np.bool_]:
    """Return the scans (t,) that are far in time from all odometry."""
    known = drive.stamps[~drive.unknown]
    after = np.searchsorted(known, drive.stamps).clip(max=len(known) - 1)
    before = (np.searchsorted(known, drive.stamps, side="right") - 1).clip(min=0)
    away = np.minimum(np.abs(drive.stamps - known[before]), np.abs(known[after] - drive.stamps))
    return np.asarray(away > BRIDGED)


def _carried(drive: Drive, course: Course, since: FloatArray) -> Iterator[Finding]:
    steps = drive.steps_between_scans
    for jump in course.jumps:
        off = between(compose(course.poses[jump - 1], steps[jump - 1]), course.poses[jump])
        distance, turn = float(np.hypot(off[0], off[1])), abs(float(off[2]))
        when = float(since[drive.scans[jump]])
        yield Finding(
            "kidnapped", "warning",
            f"{when:.1f} s after the first scan the robot is {distance:.1f} m and {np.degrees(turn):.0f} degrees from "
            "where its odometry (or what stands for it, aligned scans) takes it to: it was carried, the odometry "
            "jumped, or the start that was given is wrong.",
            {"time_s": when, "distance_m": distance, "turn_rad": turn},
            why="Nothing but the scans says where it went on; they are right only if the map is distinct there.",
            do="Split the log there if that was no accident.",
        )  # fmt: skip


def _resets(drive: Drive, since: FloatArray) -> Iterator[Finding]:
    times = since[1:][drive.broken]
    if len(times):
        yield Finding(
            "odometry-reset", "warning",
            f"The odometry jumps {_at(times)}, as after a reset; these steps were not used.",
            {"count": float(len(times)), "time_s": float(times[0])},
            why="There only scans hold the trajectory.", do="Look for a restart of the base at these times.",
        )  # fmt: skip


def _slips(fitted: Smoothed, since: FloatArray, unknown: NDArray[np.bool_]) -> list[Finding]:
    """Find stretches of a second in which odometry, where it is known, and the fitted motion differ too much."""
    error, variance = fitted.step_errors, fitted.step_variances
    end = np.searchsorted(since, since[:-1] + SLIP_TIME, side="right").clip(max=len(since) - 1)
    begin = np.arange(len(end))
    sums, variances = (np.concatenate([np.zeros((1, 3)), np.cumsum(a, axis=0)]) for a in (error, variance))
    total, expected = sums[end] - sums[begin], variances[end] - variances[begin]
    distance, turn = np.hypot(total[:, 0], total[:, 1]), np.abs(total[:, 2])
    surprise = np.sqrt(np.max(total**2 / np.maximum(expected, 1e-12), axis=1))
    slips = ((distance > SLIP) | (turn > SLIP_TURN)) & (surprise > SLIP_SIGMAS)
    guessed = np.concatenate([[0], np.cumsum(unknown[:-1] | unknown[1:])])
    slips &= guessed[end] == guessed[begin]
    found = []
    for first, last in _runs(slips):
        part = slice(first, last + 1)
        when = float(since[first])
        found.append(Finding(
            "wheel-slip", "info",
            f"Odometry and scans differ by {distance[part].max():.2f} m and {np.degrees(turn[part].max()):.0f} degrees "
            f"within a second, {when:.1f} s after the first scan: wheels that slipped, a push, or late stamps.",
            {"time_s": when, "distance_m": float(distance[part].max()), "turn_rad": float(turn[part].max())},
        ))  # fmt: skip
    return sorted(found, key=lambda one: -one.values["distance_m"])[:MOST_NAMED]


def time_gaps(stamps: FloatArray) -> Iterator[Finding]:
    """Name the times at which scans are missing for long."""
    steps, since = np.diff(stamps), stamps - stamps[:1]
    gaps = steps > max(GAP, GAP_STEPS * float(np.median(steps))) if len(steps) else np.zeros(0, bool)
    if gaps.any():
        text = f"There is no scan for up to {steps.max():.1f} s, {_at(since[:-1][gaps])}; odometry bridges it."
        yield Finding("time-gap", "info", text, {"longest_s": float(steps.max())})


def _at(times: FloatArray) -> str:
    named = ", ".join(f"{time:.1f}" for time in times[:MOST_NAMED]) + (", ..." if len(times) > MOST_NAMED else "")
    return f"{named} s after the first scan"


def _stretches(name: str, where: NDArray[np.bool_], drive: Drive, values: dict[str, float], text: str, why: str,
               do: str) -> Iterator[Finding]:  # fmt: skip
    runs = _runs(where)
    if not runs:
        return
    since = drive.stamps - drive.stamps[0]
    longest = sorted(runs, key=lambda run: run[0] - run[1])[:MOST_NAMED]
    times = ", ".join(f"{since[a]:.1f} to {since[b]:.1f} s" for a, b in sorted(longest))
    share = float(where.mean())
    yield Finding(
        name, "warning", f"{share:.1%} of the scans are not trusted ({times} after the first): {text}.",
        {"share": share, "stretches": float(len(runs)), **values}, why=f"The reason may be: {why}.", do=f"{do}.",
    )  # fmt: skip


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first and last index of each run of True."""
    edges = np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8))
    return list(zip(np.flatnonzero(edges == 1).tolist(), (np.flatnonzero(edges == -1) - 1).tolist(), strict=True))
