"""Check the reference poses that a calibration rests on: the likelihood does not reveal errors of a path."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between, compose, wrap_angle
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.outdated_map import find_outdated_map
from beamfield.maps.ray_agreement import LEAST_AGREEMENT, scan_agreement
from beamfield.maps.raycast import RayCaster
from beamfield.models.motion import odometry_jumps
from beamfield.sensors import SensorLog

# Windows of odometry that the reference is compared with (seconds), and the least motion that can be judged (metres).
WINDOW_S = 5.0
LEAST_MOTION = 0.5
# From this share of scans that disagree with the map, part of it is wrong: at most 0.13 on 16 real logs (0.26 on a
# campus), 0.23 to 0.56 in offices of the same plan that are divided otherwise.
MANY_SCANS = 0.25
# Scans decide between two poses if the share of their readings that agree with the map differs by more than this. Where
# odometry was wrong it differed by 0.3 and more in 46 of 47 windows of four real logs; along corridors it is the same.
CLEARLY = 0.2
# Where the map is out of date, scans at right poses may agree by less than elsewhere: a pose can be right if its scan
# agrees half as much as the log's scans usually do. In offices of which half or most was moved, with very poor
# odometry, that clears four of five windows of right poses; the three of poses that slid it does not.
LEAST_OF_USUAL = 0.5


def pose_findings(log: SensorLog, grid: OccupancyGrid, *, drawn: bool = False) -> Iterator[Finding]:
    """Check the reference path of a whole log (NaN where there is none) against the map and the odometry.

    If the map was drawn from the log itself, its scans agree with any poses that drew it.
    """
    yield from (*map_findings(log, grid), *_inside_walls(log, grid), *jump_findings(log))
    yield from _against_odometry(log, None if drawn else grid)


def map_findings(log: SensorLog, grid: OccupancyGrid) -> Iterator[Finding]:
    """Find that most readings of a log, or of many of its scans, disagree with the map at its reference poses."""
    if log.finder.opening_angle > 0.0:
        return
    shares = scan_agreement(log, grid, log.poses)
    shares = shares[np.isfinite(shares)]
    if len(shares) == 0:
        return
    median, share = float(np.median(shares)), float(np.mean(shares < LEAST_AGREEMENT))
    if median >= LEAST_AGREEMENT:
        if share >= MANY_SCANS:
            yield Finding(
                "map-disagrees-in-part",
                "warning",
                f"In {share:.0%} of the scans most readings disagree with the map at the reference poses.",
                {"share": share, "median_agreement": median},
                why="Part of the map is out of date, or the poses are wrong for part of the drive: the values tell of "
                "that as much as of the sensor.",
                do="Run beamfield check: it shows the places. Map them anew, or calibrate with a drive where the map "
                "is right.",
            )
        return
    yield find_outdated_map(log, grid, log.poses) or Finding(
        "map-disagrees",
        "warning",
        f"At the reference poses, {int(100.0 * median)}% of a scan's readings agree with the map (median; expected "
        f"{LEAST_AGREEMENT:.0%} or more).",
        {"median_agreement": median},
        why="Log, poses and map most likely do not belong together: the map is mirrored, of another building or in "
        "another frame, headings of the poses are in degrees, the sensor's mount is wrong, or most readings are of "
        "people.",
        do="Run beamfield trajectory on this log and map: it finds the robot in the map, or says that it cannot. If "
        "the poses are odometry (a text log with one pose per scan), read the log with lone_poses='odometry'.",
    )


def jump_findings(log: SensorLog) -> Iterator[Finding]:
    """Find steps of a log's odometry that no robot makes."""
    known = np.isfinite(log.odometry).all(axis=1)
    stamps = log.stamps[known]
    times = stamps[1:][_jumps(log.odometry[known], stamps)] - log.stamps[:1]
    n = len(times)
    if n > 0:
        yield Finding(
            "odometry-jumps",
            "warning",
            f"The odometry jumps {'once' if n == 1 else f'{n} times'} farther than a robot drives or turns, first "
            f"{times[0]:.1f} s after the first scan.",
            {"count": float(n), "first_s": float(times[0])},
            why="It was reset, or is not in metres; a filter that follows it gets lost.",
            do="Look for a restart of the base at these times.",
        )


def _inside_walls(log: SensorLog, grid: OccupancyGrid) -> Iterator[Finding]:
    posed = np.isfinite(log.poses).all(axis=1)
    inside = grid.look_up(grid.occupied, log.poses[posed, :2])
    share = float(inside.mean()) if len(inside) else 0.0
    if share == 0.0:
        return
    first = log.stamps[posed][inside][0] - log.stamps[0]
    yield Finding(
        "pose-in-wall",
        "warning",
        f"{int(inside.sum())} reference poses ({share:.1%}) lie inside occupied cells, first {first:.1f} s after "
        "the start.",
        {"n": float(inside.sum()), "share": share, "first_s": float(first)},
        why="Either the reference is off or the map has obstacles that were not there.",
        do="Look at the path on the map there; correct the poses, or clear those cells in the map.",
    )


def _against_odometry(log: SensorLog, grid: OccupancyGrid | None) -> Iterator[Finding]:
    both = np.isfinite(log.poses).all(axis=1) & np.isfinite(log.odometry).all(axis=1)
    if both.sum() < 3:
        return
    stamps, poses, odometry = log.stamps[both], log.poses[both], log.odometry[both]
    starts, ends = _windows(stamps)
    # What the odometry itself shows to be wrong says nothing about the reference.
    jumps = np.concatenate([[0], np.cumsum(_jumps(odometry, stamps))])
    steady = jumps[starts] == jumps[ends]
    starts, ends = starts[steady], ends[steady]
    if len(starts) == 0:
        return
    reference = between(poses[starts], poses[ends])
    driven = between(odometry[starts], odometry[ends])
    moved = np.hypot(driven[:, 0], driven[:, 1])
    shown = np.hypot(reference[:, 0], reference[:, 1])
    slip = np.hypot(*(reference[:, :2] - driven[:, :2]).T)
    turn_error = np.abs(wrap_angle(reference[:, 2] - driven[:, 2]))
    begin = stamps[starts] - log.stamps[0]
    stands = (moved > LEAST_MOTION) & (shown < 0.25 * moved)
    # Wheels that measure 25% too far are seen; sideways a robot hardly moves without its odometry noticing.
    direction = driven[:, :2] / np.maximum(moved, 1e-9)[:, None]
    sideways = np.abs(reference[:, 1] * direction[:, 0] - reference[:, 0] * direction[:, 1])
    reach = np.maximum(moved, shown)
    slides = (slip > np.maximum(0.3, 0.25 * reach)) | (
        (moved > LEAST_MOTION) & (sideways > np.maximum(0.25, 0.12 * reach))
    )
    wheels = np.zeros(len(starts), dtype=bool)
    asked = np.flatnonzero(stands | slides)
    if grid is not None and len(asked) and log.finder.opening_angle == 0.0:
        driven_to = compose(poses[starts[asked]], driven[asked])
        wheels[asked] = _prefer_reference(log.select(both), grid, starts[asked], ends[asked], driven_to)
    stands, slides = stands & ~wheels, slides & ~stands & ~wheels
    if stands.any():
        yield Finding(
            "reference-stands-still",
            "warning",
            f"The reference stands still while the odometry moves in {int(stands.sum())} of {len(starts)} windows "
            f"of {WINDOW_S:.0f} s, first at {begin[stands][0]:.1f} s.",
            {"n_windows": float(stands.sum()), "first_s": float(begin[stands][0])},
            why="The robot was not at these poses; the likelihood alone does not show it.",
            do="Take the poses that beamfield trajectory fits to a map, or cut this part out of the log.",
        )
    if _are_many(slides):
        yield Finding(
            "reference-slides",
            "warning",
            f"Reference poses and odometry disagree in {int(slides.sum())} of {len(starts)} windows of "
            f"{WINDOW_S:.0f} s (median difference there {np.median(slip[slides]):.2f} m), first at "
            f"{begin[slides][0]:.1f} s.",
            {
                "n_windows": float(slides.sum()),
                "median_difference": float(np.median(slip[slides])),
                "first_s": float(begin[slides][0]),
            },
            why="The reference slides, like a lost localizer's, or the odometry slips or has a wrong sign: the scans "
            "do not tell which.",
            do="Look at the log there. Take the poses that beamfield trajectory fits to a map, or cut this part out of "
            "the log.",
        )
    if _are_many(wheels):
        yield Finding(
            "odometry-disagrees",
            "warning",
            f"The odometry is wrong in {int(wheels.sum())} of {len(starts)} windows of {WINDOW_S:.0f} s (median "
            f"difference from the reference {np.median(slip[wheels]):.2f} m), first at {begin[wheels][0]:.1f} s: there "
            "the scans agree with the reference.",
            {
                "n_windows": float(wheels.sum()),
                "median_difference": float(np.median(slip[wheels])),
                "first_s": float(begin[wheels][0]),
            },
            why="Wheels slip, or a scale or sign is wrong: the robot's filter has to bridge that.",
            do="Run beamfield calibrate --odometry-noise: it measures scales and noise, and finds a wrong sign.",
        )
    turns = turn_error > 0.2
    if turns.mean() > 0.1:
        yield Finding(
            "reference-turns",
            "warning",
            f"The heading of the reference and of the odometry differ by more than 0.2 rad within {WINDOW_S:.0f} s "
            f"in {turns.mean():.0%} of the windows.",
            {"share": float(turns.mean())},
            why="Stamps may be skewed, or the odometry's turns are poor; wrong headings widen sigma_hit.",
            do="Compare the clocks of the laser, the odometry and the localizer, if the poses are from one; with poor "
            "odometry, go on.",
        )


def _are_many(windows: NDArray[np.bool_]) -> bool:
    return bool(windows.mean() > 0.02 or windows.sum() >= 3)


def _prefer_reference(
    log: SensorLog, grid: OccupancyGrid, starts: NDArray[np.int64], ends: NDArray[np.int64], driven_to: FloatArray
) -> NDArray[np.bool_]:
    """Return whether scans agree with the map at both ends of windows, and clearly less where odometry (n, 3) leads."""
    caster = RayCaster(grid)
    usual = scan_agreement(log, grid, log.poses, caster=caster)
    usual = usual[np.isfinite(usual)]
    least = min(LEAST_AGREEMENT, LEAST_OF_USUAL * float(np.median(usual))) if len(usual) else LEAST_AGREEMENT

    def agreement(scans: NDArray[np.int64], poses: FloatArray) -> FloatArray:
        return scan_agreement(log.select(scans), grid, poses, most=len(scans), caster=caster)

    there = agreement(ends, log.poses[ends])
    is_right = np.minimum(there, agreement(starts, log.poses[starts])) >= least
    return np.asarray(is_right & (there - agreement(ends, driven_to) > CLEARLY))


def _jumps(odometry: FloatArray, stamps: FloatArray) -> NDArray[np.bool_]:
    return odometry_jumps(between(odometry[:-1], odometry[1:]), np.maximum(np.diff(stamps), 0.0))


def _windows(stamps: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last index of consecutive windows of `WINDOW_S` seconds; a shorter log, of 2 scans or more, is one."""
    edges = [0]
    for i in range(1, len(stamps)):
        if stamps[i] - stamps[edges[-1]] >= WINDOW_S:
            edges.append(i)
    if len(edges) == 1:
        edges.append(len(stamps) - 1)
    index = np.array(edges, dtype=np.int64)
    return index[:-1], index[1:]
