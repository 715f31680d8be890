"""Choose the scans of a log that a sensor model can be learned from, and say why the others were dropped."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_fields, require
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray, between, compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_scale import require_metres
from beamfield.models.motion import odometry_jumps
from beamfield.sensors import SensorLog, usable_ranges
from beamfield.short_repr import short_repr

# In the order in which they are looked for; a scan is dropped for the first that holds.
REASONS = (
    "no reference pose",
    "no usable range",
    "off the map",
    "sensor inside a wall",
    "reference pose jumps",
    "turning too fast",
    "standing still",
    "not needed",
)
# More beams only take memory and time: of so many, chance is the smallest error.
MOST_BEAMS = 5_000_000


@dataclass(frozen=True)
class SelectionOptions:
    """Which scans are used.

    Parameters
    ----------
    min_travel, min_turn
        A scan counts as moving if the robot moved this far (metres) or turned this much (radians) since the last scan
        that was used; scans of a standing robot repeat one measurement and would count as many.
    max_turn_rate
        Scans taken while the robot turns faster (rad/s) are dropped: the beams of one sweep then belong to different
        headings.
    max_jump, max_jump_turn
        A step of the reference between neighbouring scans may differ from the odometry's by this much (metres,
        radians); without odometry, or where it jumps farther than a robot drives, nothing is tested.
    min_scans
        Fewer scans than this are too little data.

    Raises
    ------
    InvalidInputError
        If a number is negative or NaN.
    """

    min_travel: float = 0.02
    min_turn: float = 0.02
    max_turn_rate: float = 1.5
    max_jump: float = 0.5
    max_jump_turn: float = 0.35
    min_scans: int = 10

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("min_travel", "min_turn", "max_turn_rate", "max_jump", "max_jump_turn", "min_scans"):
            value = getattr(self, name)
            require(value >= 0, name, "a number >= 0", value)


@dataclass(frozen=True, eq=False)
class Selection:
    """Which scans of a log are used.

    Parameters
    ----------
    used
        (t,) mask.
    reason
        (t,) index into `REASONS` of why a scan was dropped; -1 for used ones.
    """

    used: NDArray[np.bool_]
    reason: NDArray[np.int8]

    __repr__ = short_repr

    @property
    def dropped(self) -> Mapping[str, int]:
        """How many scans were dropped for each reason; only reasons that occurred."""
        counts = np.bincount(self.reason[self.reason >= 0], minlength=len(REASONS))
        return {name: int(n) for name, n in zip(REASONS, counts, strict=True) if n}

    def describe(self) -> str:
        """Return one line for people, for example "80 of 100 scans used; dropped: 20 standing still"."""
        why = ", ".join(f"{n} {name}" for name, n in self.dropped.items())
        return f"{int(self.used.sum())} of {len(self.used)} scans used" + (f"; dropped: {why}" if why else "")


def select_scans(log: SensorLog, grid: OccupancyGrid, options: SelectionOptions | None = None) -> Selection:
    """Select the scans whose reference pose and readings a model can be learned from, and say why others are dropped.

    InvalidInputError if the log has no reference poses at all, all of it lies off the map, or readings are longer than
    the map; TooLittleDataError if fewer than `options.min_scans` scans remain.
    """
    options = options or SelectionOptions()
    if not log.has_poses:
        raise InvalidInputError(
            f"{log.finder.name or 'log'}: no scan has a reference pose; give some with attach_poses, or fit them to "
            "the map with localization.cross_fit_poses"
        )
    require_metres(log, grid)
    reason = np.full(len(log), -1, dtype=np.int8)

    def drop(mask: NDArray[np.bool_], name: str) -> None:
        reason[mask & (reason < 0)] = REASONS.index(name)

    posed = np.asarray(np.isfinite(log.poses).all(axis=1))
    drop(~posed, "no reference pose")
    drop(np.asarray(~np.isfinite(usable_ranges(log.ranges, log.finder)).any(axis=1)), "no usable range")
    origins = _sensor_origins(log)
    outside = posed & grid.look_up(np.zeros(grid.shape, bool), origins, outside=True)
    _require_overlap(log, grid, outside, posed)
    drop(outside, "off the map")
    drop(posed & grid.look_up(grid.occupied, origins), "sensor inside a wall")
    drop(_jumps(log, options), "reference pose jumps")
    drop(_turns_fast(log, options.max_turn_rate), "turning too fast")
    drop(_stands(log, reason < 0, options), "standing still")
    selection = Selection(reason < 0, reason)
    if selection.used.sum() < options.min_scans:
        raise TooLittleDataError(f"{log.finder.name or 'log'}: {selection.describe()}; need {options.min_scans}")
    return selection


def thinned(selection: Selection, n_beams: int) -> Selection:
    """Return every second, third, ... scan of those selected, of n_beams each, so that MOST_BEAMS remain."""
    scans = np.flatnonzero(selection.used)
    every = max(1, -(-len(scans) * n_beams // MOST_BEAMS))
    reason = selection.reason.copy()
    reason[scans] = REASONS.index("not needed")
    reason[scans[::every]] = -1
    return Selection(reason < 0, reason)


def _sensor_origins(log: SensorLog) -> FloatArray:
    """(t, 2) where the first beam starts; poses that are NaN are put at the origin (they are dropped anyway)."""
    poses = np.where(np.isfinite(log.poses), log.poses, 0.0)
    return compose(poses, log.finder.mounts[0])[:, :2]


def _require_overlap(log: SensorLog, grid: OccupancyGrid, outside: NDArray[np.bool_], posed: NDArray[np.bool_]) -> None:
    if not outside[posed].all():
        return
    low, high = log.poses[posed, :2].min(axis=0), log.poses[posed, :2].max(axis=0)
    left, bottom, right, top = grid.bounds
    raise InvalidInputError(
        f"{log.finder.name or 'log'}: all {int(posed.sum())} reference poses lie off the map: poses span "
        f"x {low[0]:.2f} to {high[0]:.2f} m, y {low[1]:.2f} to {high[1]:.2f} m; "
        f"the map x {left:.2f} to {right:.2f} m, y {bottom:.2f} to {top:.2f} m"
    )


def _jumps(log: SensorLog, options: SelectionOptions) -> NDArray[np.bool_]:
    """Scans before or after which reference and odometry disagree."""
    if not log.has_odometry:
        return np.zeros(len(log), bool)
    with np.errstate(invalid="ignore"):
        step = between(log.poses[:-1], log.poses[1:])
        driven = between(log.odometry[:-1], log.odometry[1:])
        error = between(driven, step)
        bad = (np.hypot(error[:, 0], error[:, 1]) > options.max_jump) | (np.abs(error[:, 2]) > options.max_jump_turn)
        # There it is the odometry that is wrong.
        bad &= ~odometry_jumps(driven, np.diff(log.stamps))
    return _either_side(bad)


def _either_side(steps: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(t,) scans before and after the given steps, (t - 1,)."""
    return np.asarray(np.concatenate([steps, [False]]) | np.concatenate([[False], steps]), dtype=np.bool_)


def _turns_fast(log: SensorLog, max_turn_rate: float) -> NDArray[np.bool_]:
    """Scans around which the robot turns faster than the limit."""
    track = log.odometry if log.has_odometry else log.poses
    with np.errstate(invalid="ignore", divide="ignore"):
        turn = np.abs(between(track[:-1], track[1:])[:, 2])
        rate = turn / np.diff(log.stamps)
        # Of a scan that comes twice, rounding alone turns: in no time.
        fast = (rate > max_turn_rate) & (turn > 1e-9)
    return _either_side(fast)


def _stands(log: SensorLog, candidates: NDArray[np.bool_], options: SelectionOptions) -> NDArray[np.bool_]:
    """Candidates that are too close to the last one kept."""
    rows = np.flatnonzero(candidates)
    still = candidates.copy()
    still[rows[apart(log.poses[rows], options.min_travel, options.min_turn)]] = False
    return still


def apart(poses: FloatArray, travel: float, turn: float) -> list[int]:
    """Return the indices of finite poses (t, 3) so far from the last one kept; the first is kept."""
    kept: list[int] = []
    x = y = heading = 0.0
    # Plain floats: a call of NumPy for each scan takes a hundred times as long.
    for i, pose in enumerate(poses.tolist()):
        near = math.hypot(pose[0] - x, pose[1] - y) < travel
        if kept and near and abs(math.remainder(pose[2] - heading, 2.0 * math.pi)) < turn:
            continue
        kept.append(i)
        x, y, heading = pose
    return kept
