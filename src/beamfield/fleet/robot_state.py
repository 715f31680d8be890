"""The state of each robot in words: what is wrong, since when, and what to do."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from beamfield.finding import Finding
from beamfield.fleet.comparison import COMPARISON_TAKES
from beamfield.fleet.daily import FaultKind
from beamfield.fleet.drift import FEWEST_DAYS, Drift
from beamfield.fleet.made_tests import untested_of
from beamfield.fleet.pose_trust import doubts_in
from beamfield.fleet.run_record import RunRecord
from beamfield.fleet.run_warnings import run_warnings
from beamfield.short_repr import short_repr

Light = Literal["red", "amber", "green", "grey"]
LIGHTS: tuple[Light, ...] = ("red", "amber", "green", "grey")
# From this size on a fault is red: share of readings in the sector, radians, metres, share of the distance. Smaller
# ones cost a filter little yet.
SERIOUS: Mapping[FaultKind, float] = {
    "dirty-lens": 0.05, "turned-mount": math.radians(0.5), "range-bias": 0.02, "wheel-scale": 0.01,
}  # fmt: skip
# Why a fault matters, and what to do.
_ADVICE: Mapping[FaultKind, tuple[str, str]] = {
    "dirty-lens": (
        "The robot sees less there than it should, and may take dirt for obstacles.",
        "Clean the window of the range finder{where}; if that does not help, look for scratches or what hides it.",
    ),
    "turned-mount": (
        "Scans are turned against the map by as much: a robot localises worse and drives crooked.",
        "See that the range finder is straight and screwed tight; else correct its described yaw by {degrees} degrees.",
    ),
    "range-bias": (
        "Walls seem to be nearer or farther than they are, and docking misses by as much.",
        "Measure a wall at a known distance with this range finder; calibrate it, or replace it.",
    ),
    "wheel-scale": (
        "Odometry is off by as much on every metre, which a filter must make up for.",
        "Check the tyres and their pressure; else correct the described radius of the wheels by {percent}%.",
    ),
}
# A robot with so large a share of runs that cannot be used needs a look, and a site.
MANY_LEFT_OUT, MANY_AT_A_SITE = 1 / 3, 0.1


@dataclass(frozen=True, eq=False)
class RobotState:
    """A robot's traffic light.

    Parameters
    ----------
    robot, site
        Its name, and its site. Robots of one name at two sites are two robots.
    light
        "red": a fault to see to now; "amber": one to watch, or runs that cannot be used; "green": no fault found;
        "grey": nothing could be tested, as no run could be used or days and robots are too few.
    findings
        Why, and what to do; the worst first.
    urgency
        Largest fault in units of the size from which on it is red; robots are ranked by it.
    runs, left_out
        Runs used, and runs that could not be.
    not_tested
        The tests that could not be made of it, and the faults that nobody looked for; see `untested_of`.
    """

    robot: str
    site: str
    light: Light
    findings: tuple[Finding, ...]
    urgency: float
    runs: int
    left_out: int
    not_tested: tuple[str, ...] = ()

    __repr__ = short_repr


def robot_states(records: Sequence[RunRecord], drifts: Sequence[Drift]) -> tuple[RobotState, ...]:
    """Return the state of every robot, the most urgent first."""
    states = []
    for robot, site in sorted({(record.robot, record.site) for record in records}):
        mine = [record for record in records if (record.robot, record.site) == (robot, site)]
        used = sum(record.is_used for record in mine)
        tested = [d for d in drifts if (d.robot, d.site) == (robot, site)]
        alarms = sorted((d for d in tested if d.alarm), key=_urgency, reverse=True)
        others = [record for record in records if record.site == site and record.robot != robot]
        faults = [(_urgency(alarm), _fault(alarm)) for alarm in alarms] + list(run_warnings(mine))
        faults.sort(key=lambda fault: -fault[0])
        urgency = max((each for each, _ in faults), default=0.0)
        others_found = (*_runs_left_out(mine, others), *([] if tested or not used else [_untested()]))
        findings = (*(finding for _, finding in faults), *others_found)
        light: Light = "red" if urgency >= 1.0 else "amber" if faults or (tested and findings) else "green"
        if not tested and not faults:
            light = "grey"
        states.append(RobotState(robot, site, light, findings, urgency, used, len(mine) - used, untested_of(tested)))
    return tuple(sorted(states, key=lambda state: (LIGHTS.index(state.light), -state.urgency, state.robot, state.site)))


def _urgency(drift: Drift) -> float:
    return abs(drift.size) / SERIOUS[drift.fault]


def _fault(drift: Drift) -> Finding:
    # Without the robot's name, which stands beside it.
    seen = drift.sentence.removeprefix(f"{drift.robot} ({drift.site}): ")
    values = {"size": drift.size, "low": drift.low, "high": drift.high, "q_value": drift.q_value}
    why, do = _ADVICE[drift.fault]
    do = do.format(
        where=_sector(drift), degrees=f"{-math.degrees(drift.size):+.2g}", percent=f"{100.0 * drift.size:+.2g}"
    )
    return Finding(drift.fault, "warning", seen[:1].upper() + seen[1:], values, why, do)


def _sector(drift: Drift) -> str:
    """Say where in words: bearings grow to the left."""
    if drift.bearings is None:
        return ""
    low, high = (math.degrees(angle) for angle in drift.bearings)
    return f" from {_side(low)} to {_side(high)}"


def _side(degrees: float) -> str:
    if abs(degrees) < 0.5:
        return "straight ahead"
    return f"{abs(degrees):.0f} degrees to the {'left' if degrees > 0 else 'right'}"


def _runs_left_out(mine: Sequence[RunRecord], others: Sequence[RunRecord]) -> Iterator[Finding]:
    """Yield what to say of a robot that has no run, or more that cannot be used than the others at its site have.

    Nothing if all of them are left out for their poses, of which `run_warnings` tells.
    """
    if all(record.is_used or doubts_in(record.findings) for record in mine):
        return
    share = _share_left_out(mine)
    if share == 1.0 or (share >= MANY_LEFT_OUT and share > 2.0 * _share_left_out(others)):
        left_out, reason = _left_out(mine)
        yield Finding(
            "runs-left-out",
            "warning",
            f"{left_out} of {len(mine)} runs cannot be used; most often: {reason}.",
            {"left_out": float(left_out), "runs": float(len(mine))},
            why="What these runs would show is not known.",
            do="Look at how this robot records, and at the list of runs that were left out.",
        )


def _untested() -> Finding:
    return Finding(
        "untested",
        "info",
        f"Nothing could be tested: a change takes {2 * FEWEST_DAYS} days of runs, and a comparison {COMPARISON_TAKES}.",
        do="Scan more days, or more robots, into the catalogue.",
    )


def site_findings(records: Sequence[RunRecord]) -> Iterator[Finding]:
    """Yield what to know of sites many of whose runs cannot be used, whatever the robot."""
    for site in sorted({record.site for record in records}):
        mine = [record for record in records if record.site == site]
        if _share_left_out(mine) >= MANY_AT_A_SITE and len({one.robot for one in mine if not one.is_used}) > 1:
            left_out, reason = _left_out(mine)
            yield Finding(
                "site-runs-left-out",
                "warning",
                f"{site}: {left_out} of {len(mine)} runs, of several robots, cannot be used; most often: {reason}.",
                {"left_out": float(left_out), "runs": float(len(mine))},
                why="What these runs would show is not known.",
                do="See the reasons below. Where no trajectory fits, see whether it is the map of this site; if it is, "
                "it is far out of date.",
            )


def _share_left_out(records: Sequence[RunRecord]) -> float:
    return sum(not record.is_used for record in records) / len(records) if records else 0.0


def _left_out(records: Sequence[RunRecord]) -> tuple[int, str]:
    """Return how many runs are left out, and the most frequent reason, without a full stop."""
    reasons = [record.reason for record in records if not record.is_used]
    ((most, _),) = Counter(map(_kind, reasons)).most_common(1)
    return len(reasons), next(reason for reason in reasons if _kind(reason) == most).rstrip(".")


def _kind(reason: str) -> str:
    """Return a reason without what differs from log to log: the file that it begins with, and numbers."""
    file, _, rest = reason.partition(": ")
    return re.sub(r"[0-9].*", "", rest if "/" in file else reason)
