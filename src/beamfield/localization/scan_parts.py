"""Parts of a scan that do not fit the map together: lasers merged by a wrong transform, or bearings that are wrong."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between, compose, transform_points, wrap_angle
from beamfield.kernels.trajectory import Walls
from beamfield.maps.end_points import points_along
from beamfield.sensors import SensorLog, usable_ranges

# Equal sectors of a turn, beams of each, and scans that are held to the map, turned by so many radians.
PARTS, BEAMS, SCANS = 8, 25, 150
TURNS = np.radians(np.arange(-12.0, 12.5))
# Of hits about the walls, metres, and how likely other readings are, relative to one on a wall.
SIGMA, CLUTTER = 0.1, 0.0025
# Fewer scans or readings say nothing.
FEWEST_SCANS, FEWEST_READINGS = 20, 500
# What two turns gain over one, nats per reading, and their difference: at most 0.021 and 2 degrees on six real logs and
# 0.018 and 2 degrees on 30 good simulated drives, two of three in maps that are out of date; at least 0.07 and 4
# degrees on all 36 of which half of the beams, or a third, were turned by 6 or 8 degrees.
LEAST_GAIN, LEAST_TURN = 0.06, math.radians(3.5)


def parts_that_disagree(log: SensorLog, walls: Walls, poses: FloatArray, trusted: NDArray[np.bool_]) -> list[Finding]:
    """Return a finding, "scan-parts-disagree", if two sectors of the scans fit the map best by different headings.

    The poses (t, 3) were fitted to whole scans; those that are not trusted (t,) do not count.
    """
    scans = np.flatnonzero(trusted)
    scans = scans[np.unique(np.linspace(0, len(scans) - 1, min(SCANS, len(scans))).round().astype(np.int64))]
    if len(scans) < FEWEST_SCANS:
        return []
    scores, readings = _scores(log, walls, poses, scans)
    total, together = readings.sum(), scores.sum(axis=0).max()
    best, found = LEAST_GAIN * total, None
    # The narrowest first: parts without beams change nothing.
    for n in range(1, PARTS // 2 + 1):
        for first in range(PARTS):
            inside = np.isin(np.arange(PARTS), (first + np.arange(n)) % PARTS)
            if min(readings[inside].sum(), readings[~inside].sum()) < FEWEST_READINGS:
                continue
            ours, others = scores[inside].sum(axis=0), scores[~inside].sum(axis=0)
            turn = float(TURNS[ours.argmax()] - TURNS[others.argmax()])
            gain = ours.max() + others.max() - together
            if gain > best and abs(turn) > LEAST_TURN:
                best, found = gain, (first, n, turn)
    return [] if found is None else [_finding(*found)]


def _scores(log: SensorLog, walls: Walls, poses: FloatArray, scans: NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
    """Return the log-likelihoods of each part at each turn, nats, and how many readings each part has."""
    placed = between((walls.x, walls.y, walls.yaw), poses[scans])
    headings = np.column_stack([np.zeros((len(TURNS), 2)), TURNS])
    sector = np.floor((wrap_angle(log.finder.mounts[:, 2]) / (2.0 * np.pi) + 0.5) * PARTS).astype(np.int64) % PARTS
    scores, readings = np.zeros((PARTS, len(TURNS))), np.zeros(PARTS)
    for k in np.unique(sector):
        beams = np.flatnonzero(sector == k)
        beams = beams[:: -(-len(beams) // BEAMS)]
        ranges = usable_ranges(log.ranges[np.ix_(scans, beams)], log.finder)
        returned = ranges < log.finder.max_range
        points = points_along(log.finder.mounts[beams], ranges)
        readings[k] = returned.sum()
        for turn, heading in enumerate(headings):
            at = transform_points(compose(placed, heading)[:, None], points)[returned]
            # Within obstacles it is 0: walls that are painted too thick would tell parts apart.
            off = np.maximum(_nearest(walls, at), 0.0) / SIGMA
            scores[k, turn] = np.log(np.exp(-0.5 * off * off) + CLUTTER).sum()
    return scores, readings


def _nearest(walls: Walls, points: FloatArray) -> FloatArray:
    """Return the signed distances to the walls at points (n, 2) in the table's frame; inf off the table."""
    col, row = np.floor(points.T / walls.resolution).astype(np.int64)
    on = (row >= 0) & (row < walls.distance.shape[0]) & (col >= 0) & (col < walls.distance.shape[1])
    return np.where(on, walls.distance[np.where(on, row, 0), np.where(on, col, 0)], np.inf)


def _finding(first: int, n: int, turn: float) -> Finding:
    begin, end = (math.degrees(wrap_angle(2.0 * math.pi * (k / PARTS - 0.5))) for k in (first, first + n))
    return Finding(
        "scan-parts-disagree", "warning",
        f"The beams from {begin:.0f} to {end:.0f} degrees fit the map best turned by {abs(math.degrees(turn)):.0f} "
        f"degrees to the {'left' if turn > 0.0 else 'right'} of the others.",
        {"from_rad": math.radians(begin), "to_rad": math.radians(end), "turn_rad": turn},
        why="Poses then lie between the parts, and no parameters make all beams fit.",
        do="If the scans are merged of several lasers, record each laser's own: --sensor chooses one, whose wrong "
        "transform is then named. Of one laser, compare angle_min, angle_max and angle_increment with its data sheet.",
    )  # fmt: skip
