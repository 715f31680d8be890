"""What ``beamfield localize`` says: the numbers of a run as plain values, and the text that is printed."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from beamfield.cli.wording import pose_text
from beamfield.finding import Finding
from beamfield.localization.particle_filter import FOUND_SPREAD, FOUND_TURN
from beamfield.localization.replay import PoseBelief, ReplayErrors
from beamfield.localization.scan_localizer import Localization
from beamfield.sensors import SensorLog

# Metres from the reference within which a robot counts as found.
FOUND_WITHIN = 0.5


def run_facts(
    found: Localization, errors: ReplayErrors | None, log: SensorLog, start: PoseBelief | None,
    of_poses: tuple[Finding, ...],
) -> dict[str, Any]:  # fmt: skip
    """Return the numbers of a run for localization.json; where it started is None if anywhere.

    `of_poses` are findings on the reference poses.
    """
    scale = found.distance_scale
    spread = np.sqrt(np.trace(found.covariances[:, :2, :2], axis1=1, axis2=2))
    is_sure = not any(finding.name in ("robot-lost", "not-found") for finding in found.findings)
    sure = sure_from(found) if is_sure else None
    # Not the mean: the first update makes the model's tables, and may compile.
    seconds = float(np.median(found.seconds))
    return {
        "start": None if start is None else [float(value) for value in start.mean],
        "n_scans": len(log),
        "n_updates": len(found.updates),
        "mean_particles": float(found.particles.mean()),
        "updates_per_second": 1.0 / seconds if seconds > 0.0 else None,
        "last_pose": [float(value) for value in found.poses[np.isfinite(found.poses).all(axis=1)][-1]],
        "last_spread_m": float(spread[-1]),
        "distance_scale": None if scale is None else scale._asdict(),
        "sure_after_s": None if sure is None else float(log.stamps[sure] - log.stamps[0]),
        "errors": None if errors is None else asdict(errors),
        "found_after_s": None if errors is None else _found_after(found, log),
        "findings": [asdict(finding) for finding in (*of_poses, *found.findings)],
    }


def sure_from(found: Localization) -> int | None:
    """Return the first scan, since the robot was searched for last, at which the cloud is narrow."""
    variances = np.trace(found.covariances[:, :2, :2], axis1=1, axis2=2)
    sure = found.updates[(variances <= FOUND_SPREAD**2) & (found.covariances[:, 2, 2] <= FOUND_TURN**2)]
    sure = sure[sure >= found.searched_from]
    return int(sure[0]) if len(sure) else None


def _found_after(found: Localization, log: SensorLog) -> float | None:
    """Return the seconds after which the published pose stays near the reference; None if it never does."""
    known = np.isfinite(log.poses).all(axis=1) & np.isfinite(found.poses).all(axis=1)
    far = np.hypot(*(found.poses - log.poses)[known, :2].T) > FOUND_WITHIN
    stamps = log.stamps[known]
    last = int(np.flatnonzero(far)[-1]) if far.any() else -1
    return None if last + 1 == len(stamps) else float(stamps[last + 1] - log.stamps[0])


def run_summary(
    document: Mapping[str, Any], errors: ReplayErrors | None, arguments: argparse.Namespace, *, is_sonar: bool
) -> str:
    """Return the text that is printed."""
    rate = document["updates_per_second"]
    speed = "" if rate is None else f", {rate:.0f} updates/s"
    if document["start"] is None:
        where = "anywhere on the map" + ("" if arguments.anywhere else ": no --start, and no reference pose in the log")
    else:
        where = pose_text(document["start"]) + ("" if arguments.start else ", the first reference pose")
    lines = [
        f"filter: {document['filter']}",
        f"started from: {where}",
        f"used {document['n_updates']} of {document['n_scans']} scans{speed}",
        ended_at(document),
    ]
    if document["start"] is None and document["sure_after_s"] is not None:
        lines.append(_sure(document) + ("" if errors is None else ", and their errors do not count"))
    if errors is None:
        fitted = "" if is_sonar else ": beamfield trajectory fits some, which --poses takes"
        lines.append(f"no reference poses to judge by{fitted}")
        return "\n".join(lines)
    found = document["found_after_s"]
    within = f"{FOUND_WITHIN:g} m of the reference"
    lines.append(f"within {within} from {found:.1f} s on" if found is not None else f"not within {within} at the end")
    return "\n".join([*lines, errors.summary()])


def _sure(document: Mapping[str, Any]) -> str:
    """Return from when on the filter was sure of its place, and what the poses before are."""
    after = f"{document['sure_after_s']:.1f} s on; before that, poses are"
    if any(finding["name"] == "relocalized" for finding in document["findings"]):
        return f"sure of the last place from {after} of earlier places"
    return f"sure of the place from {after} a best guess"


def ended_at(document: Mapping[str, Any]) -> str:
    """Return the last pose of a run, and how sure the filter was of it."""
    spread = document["last_spread_m"]
    return f"ended at: {pose_text(document['last_pose'])}, within {spread:.2f} m (standard deviation)"
