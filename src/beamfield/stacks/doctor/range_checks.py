"""Range limits and special readings: what the driver reports against what the model expects."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beamfield.stacks.doctor.diagnosis import Diagnosis
from beamfield.stacks.doctor.patient import Patient

# A limit that hides more of the readings than this is worth a word.
HIDDEN_SHARE = 0.02


def unreachable_z_max(patient: Patient) -> Iterator[Diagnosis]:
    """Find a z_max that no reading of a REP 117 driver brings in."""
    if patient.file.stack not in ("nav2", "ros1") or patient.file.model != "beam" or not patient.value("z_max"):
        return
    share = None if patient.log is None else float(np.isposinf(patient.log.ranges).mean())
    if share == 0.0:
        return
    seen = f"{patient.name_of('z_max')} is {patient.value('z_max'):g}"
    if share is not None:
        seen += f", and {share:.1%} of the log's readings are missing returns"
    yield patient.finds(
        "z-max-unreachable", "info" if share is None else "warning", seen,
        "z_max counts only readings that are exactly the longest range; drivers that follow REP 117 report +inf, which "
        "scores 0, so that missing returns say nothing",
        "have the driver report range_max, or set laser_max_range below the sensor's limit; else z_max has no effect",
        parameter="z_max", values={} if share is None else {"share_without_return": share},
    )  # fmt: skip


def range_limits(patient: Patient) -> Iterator[Diagnosis]:
    """Find a longest range that is not the sensor's."""
    limit = patient.value("laser_max_range")
    if patient.log is None or limit is None or patient.file.model in ("rayTracing",):
        return
    sensor = patient.log.finder.max_range
    name = patient.name_of("laser_max_range")
    if limit > sensor * 1.01:
        divides_by_own = patient.file.stack in ("beluga", "mrpt", "f1tenth")
        yield patient.finds(
            "range-limit-above-sensor", "warning" if divides_by_own else "info",
            f"{name} is {limit:g} m, the sensor's limit {sensor:g} m",
            f"random readings get the density z_rand / {limit:g} instead of z_rand / {sensor:g}: they are worth "
            f"{limit / sensor:.1f} times too little"
            if divides_by_own else "the sensor's limit holds; the parameter does nothing",
            f"set it to {sensor:g}", parameter="laser_max_range", values={"limit": limit, "sensor": sensor},
        )  # fmt: skip
    elif 0.0 < limit < sensor and patient.file.stack != "mrpt":  # MRPT only divides by it
        finite = patient.log.ranges[np.isfinite(patient.log.ranges)]
        hidden = float((finite >= limit).mean()) if finite.size else 0.0
        if hidden > HIDDEN_SHARE:
            yield patient.finds(
                "range-limit-hides-readings", "warning",
                f"{name} is {limit:g} m, {hidden:.1%} of the log's readings are longer",
                "these readings are dropped or taken for missing returns, and they are those that tell headings best",
                f"set it to the sensor's {sensor:g} m", parameter="laser_max_range",
                values={"limit": limit, "sensor": sensor, "hidden_share": hidden},
            )  # fmt: skip


def short_limit(patient: Patient) -> Iterator[Diagnosis]:
    """Find a shortest range that AMCL turns real readings into missing returns with."""
    if patient.file.stack not in ("nav2", "ros1") or patient.log is None:
        return
    low = patient.value("laser_min_range")
    finite = patient.log.ranges[np.isfinite(patient.log.ranges)]
    hidden = float((finite <= low).mean()) if finite.size else 0.0
    if low > 0.0 and hidden > HIDDEN_SHARE:
        yield patient.finds(
            "min-range-hides-readings", "warning",
            f"laser_min_range is {low:g} m, {hidden:.1%} of the log's readings are shorter",
            "AMCL turns readings that are too short into the longest range, as if nothing were there",
            "lower it, or filter such readings out before (NaN)", parameter="laser_min_range",
            values={"limit": low, "hidden_share": hidden},
        )  # fmt: skip
