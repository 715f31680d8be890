"""Range limits and special readings: what the driver reports against what the model expects."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beamfield.finding import Finding
from beamfield.sensors import SensorLog
from beamfield.stacks.doctor.subject import Subject

# A limit that hides more of the readings than this is worth a word.
HIDDEN_SHARE = 0.02
# Lasers of mobile robots see farther than this, metres.
SHORT_LIMIT = 3.0


def unreachable_z_max(subject: Subject) -> Iterator[Finding]:
    """Find a z_max that no reading of a REP 117 driver uses."""
    needs = subject.model.z_max_needs
    if needs is None or not subject.value("z_max"):
        return
    limit, log = subject.value("laser_max_range"), subject.log
    share = None if log is None else float(np.isposinf(log.ranges).mean())
    if limit is None or share == 0.0 or (log is not None and _reports_limit(subject, log, limit)):
        return
    seen = f"{subject.name_of('z_max')} is {subject.value('z_max'):g}"
    if share is not None:
        seen += f", and {share:.1%} of the log's readings are missing returns"
    yield subject.finding(
        "z-max-unreachable", "info", seen,
        f"{needs[0]}: with a driver that follows REP 117 and reports +inf, missing returns have no effect",
        f"{needs[1]}; else z_max has no effect",
        parameter="z_max", values={} if share is None else {"share_without_return": share},
    )  # fmt: skip


def range_limits(subject: Subject) -> Iterator[Finding]:
    """Find a longest range that is not the sensor's, or without a log can hardly be."""
    limit = subject.value("laser_max_range")
    if limit is None:
        return
    name = subject.name_of("laser_max_range")
    if subject.log is None:
        if 0.0 < limit < SHORT_LIMIT and subject.stack.drops_beyond:
            yield subject.finding(
                "range-limit-short", "warning", f"{name} is {limit:g} m",
                "nearly all lasers see farther: readings beyond it count for nothing, or are cut down to it, and they "
                "are those that tell headings best",
                "set it to the sensor's longest range, or give a log (--log) to see what it hides",
                parameter="laser_max_range", values={"limit": float(limit)},
            )  # fmt: skip
        return
    sensor = subject.log.finder.max_range
    if limit > sensor * 1.01 and not subject.stack.takes_lesser_limit:
        rand = subject.name_of("z_rand")
        yield subject.finding(
            "range-limit-above-sensor", "info", f"{name} is {limit:g} m, the sensor's limit {sensor:g} m",
            f"random readings are spread over {limit:g} m, {rand} / {limit:g} for each metre, where the sensor has "
            f"{sensor:g}: they score {limit / sensor:.1f} times too little",
            f"set it to {sensor:g}", parameter="laser_max_range", values={"limit": limit, "sensor": sensor},
        )  # fmt: skip
    elif 0.0 < limit < sensor and subject.stack.drops_beyond:
        finite = subject.log.ranges[np.isfinite(subject.log.ranges)]
        hidden = float((finite >= limit).mean()) if finite.size else 0.0
        if hidden > HIDDEN_SHARE:
            yield subject.finding(
                "range-limit-hides-readings", "warning",
                f"{name} is {limit:g} m, {hidden:.1%} of the log's readings are longer",
                "these readings are cut down to it, or count for nothing, and they determine the heading best",
                f"set it to the sensor's {sensor:g} m", parameter="laser_max_range",
                values={"limit": limit, "sensor": sensor, "hidden_share": hidden},
            )  # fmt: skip


def short_limit(subject: Subject) -> Iterator[Finding]:
    """Find a shortest range that AMCL turns real readings into missing returns with."""
    low = subject.value("laser_min_range")
    if not subject.stack.short_is_longest or subject.log is None or low is None:
        return
    finite = subject.log.ranges[np.isfinite(subject.log.ranges)]
    hidden = float((finite <= low).mean()) if finite.size else 0.0
    if low > 0.0 and hidden > HIDDEN_SHARE:
        yield subject.finding(
            "min-range-hides-readings", "warning",
            f"laser_min_range is {low:g} m, {hidden:.1%} of the log's readings are shorter",
            "AMCL turns readings that are too short into the longest range, as if nothing were there",
            "lower it, or filter such readings out first (as NaN)", parameter="laser_min_range",
            values={"limit": low, "hidden_share": hidden},
        )  # fmt: skip


def _reports_limit(subject: Subject, log: SensorLog, limit: float) -> bool:
    """Whether the driver reports missing returns as the very value that z_max counts for."""
    sensor = log.finder.max_range
    counts = limit
    if subject.stack.takes_lesser_limit:
        counts = min(sensor, limit) if limit > 0.0 else sensor
    return any(abs(value - counts) <= 1e-3 and value <= sensor + 1e-3 for value in log.no_return.values)
