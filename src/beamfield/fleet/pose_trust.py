"""Whether the poses of a run hold up: against its map, and against its odometry."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from beamfield.calibration.findings import selection_findings
from beamfield.calibration.reference_checks import pose_findings
from beamfield.calibration.selection import Selection
from beamfield.finding import Finding
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog

# Beams cast at poses with such a finding say nothing of the sensor, as for `calibrate`; nor do those in a map that is
# out of date, where `calibrate` learns for a filter that runs there.
DOUBTS = (
    "map-disagrees", "map-out-of-date", "poses-off-map", "reference-stands-still", "reference-slides",
    "few-poses-trusted",
)  # fmt: skip
# From here on a robot does not know where it is (metres): beyond what a filter that works is off by.
LOST_M = 0.5
LOST = "robot-lost"


def pose_warnings(log: SensorLog, grid: OccupancyGrid, selection: Selection) -> tuple[Finding, ...]:
    """Return the warnings about the poses of a run."""
    return warnings_in((*pose_findings(log, grid), *selection_findings(selection)))


def warnings_in(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings that are more than worth knowing, with the numbers that a record can hold."""
    return tuple(
        replace(one, values={name: float(value) for name, value in one.values.items() if np.isfinite(value)})
        for one in findings
        if one.severity != "info"
    )


def doubts_in(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings with which beams are not to be used."""
    return tuple(finding for finding in findings if finding.name in DOUBTS)


def partly_disagrees(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the finding that many scans, but not most, disagree with the map, if it is there."""
    return tuple(finding for finding in findings if finding.name == "map-disagrees-in-part")


def lost_finding(own: SensorLog, fitted: SensorLog, doubts: Sequence[Finding]) -> Finding | None:
    """Return how far a robot's own poses are from those that fit its scans; None if it knew where it was.

    The same scans have both, NaN where there is none; the doubts say what is wrong with its own, at least one finding.
    """
    apart = np.hypot(*(own.poses - fitted.poses)[:, :2].T)
    apart = apart[np.isfinite(apart)]
    if len(apart) == 0 or apart.max() < LOST_M:
        return None
    largest, share = float(apart.max()), float(np.mean(apart >= LOST_M))
    return Finding(
        LOST,
        "warning",
        f"The robot was lost: its own poses are up to {largest:.1f} m from those that fit its scans, and {LOST_M:g} m "
        f"or more in {share:.0%} of them. {doubts[0].text}",
        {"largest_m": largest, "share": share},
        why="It does not drive where it believes to drive. Its beams are judged at the fitted poses.",
        do="Look at its localisation there: at the start that it is given, at its filter's settings "
        "(beamfield doctor) and at its odometry.",
    )
