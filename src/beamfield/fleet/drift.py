"""Robots that changed from one day on, and robots that are unlike the others from the first day."""

from __future__ import annotations

import datetime
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from beamfield.fleet.learning import FleetFit
from beamfield.geometry import FloatArray
from beamfield.short_repr import short_repr

Fault = Literal["dirty-lens", "turned-mount", "range-bias", "wheel-scale"]


@dataclass(frozen=True, eq=False)
class DailySeries:
    """One number per robot and day.

    Parameters
    ----------
    robot, site
        Whose.
    fault
        What shows in it: "dirty-lens" (share of readings without return, or shorter than expected, in a sector of
        bearings), "turned-mount" (yaw of the laser against the direction of motion, rad), "range-bias" (median
        residual of hits, metres), "wheel-scale" (relative error of odometry's distances).
    unit
        "share", "rad", "m" or "1".
    days
        Of the values, ascending.
    values, standard_errors
        In `unit`, shape (d,).
    bearings
        (from, to) of the sector, radians in the robot frame; None for the other faults.
    cause
        "max" or "short" for a dirty lens, else "".
    contrasts
        What is compared over days, shape (d,): for a dirty lens the log odds of the share in the sector less those in
        all other sectors, else the values.
    """

    robot: str
    site: str
    fault: Fault
    unit: str
    days: tuple[datetime.date, ...]
    values: FloatArray
    standard_errors: FloatArray
    bearings: tuple[float, float] | None
    cause: str
    contrasts: FloatArray

    __repr__ = short_repr


@dataclass(frozen=True)
class Drift:
    """A fault that a robot shows.

    Parameters
    ----------
    robot, site, fault
        Which robot, and what.
    since
        First day with the fault; None: from the robot's first day on, by comparison with the other robots.
    size, low, high
        How much the number changed, or how far it is from that of the other robots, with its 95 % interval.
    before, after
        The number before that day (of the other robots, where `since` is None) and from it on.
    unit
        "share", "rad", "m" or "1".
    bearings
        (from, to) of the dirty sector, radians in the robot frame; None for other faults.
    cause
        "max" (no returns) or "short" (readings before the wall) for a dirty lens, else "".
    p_value, q_value
        Chance of such a series in a robot without the fault, adjusted for all its days (and sectors); the same
        adjusted for all robots and faults.
    alarm
        Whether it counts: see `find_drift`.
    """

    robot: str
    site: str
    fault: Fault
    since: datetime.date | None
    size: float
    low: float
    high: float
    before: float
    after: float
    unit: str
    bearings: tuple[float, float] | None
    cause: str
    p_value: float
    q_value: float
    alarm: bool

    @property
    def sentence(self) -> str:
        """What a person reads."""
        raise NotImplementedError


def daily_series(catalogue: Any, engine: Any, fleet: FleetFit) -> tuple[DailySeries, ...]:
    """Return the daily numbers of all robots; beams are read once."""
    raise NotImplementedError


def find_drift(series: Sequence[DailySeries], *, false_alarms: float = 0.05) -> tuple[Drift, ...]:
    """Return what each robot shows, the least likely by chance first; at most `false_alarms` expected per report."""
    raise NotImplementedError
