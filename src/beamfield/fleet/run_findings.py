"""What the records of a fleet's runs say against each other: clocks that differ, runs and sensors at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np

from beamfield.finding import Finding
from beamfield.fleet.run_record import RunRecord

# Clocks that were never set count from 0 or from the start; no robot had a lidar before (1980-01-01).
FIRST_DATE = 315_532_800.0
# Fleets are looked at over days and months: a robot whose runs lie this far from the others' has a wrong clock.
CLOCK_DIFFERS_S = 365.0 * 86_400.0


def run_findings(records: Sequence[RunRecord]) -> Iterator[Finding]:
    """Yield what to know of the runs' times before days are compared; runs that are left out do not count."""
    used = [record for record in records if record.is_used]
    dated = [record for record in used if record.first_stamp >= FIRST_DATE]
    yield from _no_date(used)
    yield from _clocks(dated)
    yield from _overlaps(dated)
    yield from _several_sensors(dated)


def leftover_finding(files: Sequence[str]) -> Iterator[Finding]:
    """Yield what to know of files of beams that belong to no run; see `Catalogue.files_of_no_run`."""
    if files:
        yield Finding(
            "files-of-no-run",
            "info",
            f"{len(files)} files of beams belong to no run, as {files[0]}.",
            {"files": float(len(files))},
            why="Scans that were killed have left them, or others are at work now. Nothing reads them.",
            do="The next scan of their logs replaces them; those of logs that are gone can go when no scan runs.",
        )


def _no_date(used: Sequence[RunRecord]) -> Iterator[Finding]:
    without = [record for record in used if record.first_stamp < FIRST_DATE]
    if without:
        yield Finding(
            "no-date",
            "warning",
            f"{len(without)} of {len(used)} runs have stamps that count from 0, not from 1970: {_robots(without)}.",
            {"runs": float(len(without))},
            why="They are all put on 1970-01-01, so that nothing can be said of how these robots change over days.",
            do="Set the robots' clocks before recording, or shift the stamps of the logs to when they were recorded.",
        )


def _clocks(dated: Sequence[RunRecord]) -> Iterator[Finding]:
    if not dated:
        return
    middle = float(np.median([record.first_stamp for record in dated]))
    far = [record for record in dated if abs(record.first_stamp - middle) > CLOCK_DIFFERS_S]
    if far:
        yield Finding(
            "clock-differs",
            "warning",
            f"{len(far)} of {len(dated)} runs are more than a year from the others: {_robots(far)}.",
            {"runs": float(len(far))},
            why="A clock that jumps or was set wrong puts runs on days at which they did not happen.",
            do="Compare these logs' stamps with when they were recorded; scan the fleet's years into catalogues of "
            "their own if they are right.",
        )


def _overlaps(dated: Sequence[RunRecord]) -> Iterator[Finding]:
    pairs = []
    ordered = sorted(dated, key=lambda one: (one.site, one.robot, one.log_sensor, one.first_stamp, one.run))
    for _, runs in groupby(ordered, key=lambda one: (one.site, one.robot, one.log_sensor)):
        last, *later = runs
        for record in later:
            if record.first_stamp < last.last_stamp:
                pairs.append((last, record))
            last = max(last, record, key=lambda one: one.last_stamp)
    if pairs:
        first, second = pairs[0]
        yield Finding(
            "runs-overlap",
            "warning",
            f"{len(pairs)} runs begin before an earlier run of the same robot has ended: {second.log} and {first.log} "
            f"of {first.robot}.",
            {"runs": float(len(pairs))},
            why="A robot is in one place at a time: a log that is there in two formats counts twice, or a clock has "
            "jumped.",
            do="Take the copies out of the manifest and scan into a new catalogue, or give robots their own names.",
        )


def _several_sensors(dated: Sequence[RunRecord]) -> Iterator[Finding]:
    found = []
    ordered = sorted(dated, key=lambda one: (one.site, one.robot, one.first_stamp, one.run))
    for _, runs in groupby(ordered, key=lambda one: (one.site, one.robot)):
        ends: dict[str, RunRecord] = {}
        for record in runs:
            beside = [end for sensor, end in ends.items() if sensor != record.log_sensor]
            found += [(end, record) for end in beside if record.first_stamp < end.last_stamp]
            ends[record.log_sensor] = max(ends.get(record.log_sensor, record), record, key=lambda one: one.last_stamp)
    if found:
        first, second = found[0]
        yield Finding(
            "several-sensors",
            "warning",
            f"Runs of several sensors at the same time count as one robot: {_robots([one for _, one in found])}, "
            f"as {first.log_sensor!r} and {second.log_sensor!r} of {first.robot}.",
            {"runs": float(len(found))},
            why="Their daily numbers are averaged: a fault of one of two sensors seems half as large, and which one "
            "has it is not said.",
            do="Give each sensor a robot of its own in the manifest, such as ann-front and ann-rear, and scan again.",
        )


def _robots(records: Sequence[RunRecord]) -> str:
    names = sorted({f"{record.robot} ({record.site})" for record in records})
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
