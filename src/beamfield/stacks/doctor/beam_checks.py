"""How many beams a model really uses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.stacks.doctor.diagnosis import Diagnosis
from beamfield.stacks.doctor.patient import Patient
from beamfield.stacks.emulation.beam_selection import ceil_step_beams, even_beams, floor_step_beams

# With fewer readings that end at a wall, one scan hardly tells a pose.
FEWEST_USABLE = 15
# Products treat every beam as independent; more than this many of them never are.
MANY_IN_PRODUCT = 30


def beam_count(patient: Patient) -> Iterator[Diagnosis]:
    """Find a number of beams that the program cannot handle, or that its rounding changes."""
    if not patient.is_amcl or patient.log is None:
        return
    n, asked = patient.log.finder.n_beams, patient.value("max_beams")
    if asked is None:
        return
    name = patient.name_of("max_beams")
    if _never_returns(patient, n, asked):
        yield patient.finds(
            "max-beams-above-scan", "error", f"{name} is {asked}, the scans have {n} beams",
            f"the beam model's step over beams becomes floor((n - 1) / ({name} - 1)) = 0, which it does not test: the "
            "first update never returns",
            f"set {name} to at most {n}", parameter="max_beams", values={"beams": n, "max_beams": asked},
        )  # fmt: skip
        return
    used = len(_selected(patient, n))
    # Stepping by whole beams takes nearly twice as many, or little more than half as many.
    if n >= asked and not 0.75 <= used / asked <= 1.34:
        yield patient.finds(
            "max-beams-rounded", "info", f"{name} is {asked}, but of {n} beams the program uses {used}",
            "it steps over beams by a whole number",
            "count with the number that is used", parameter="max_beams", values={"used": used, "max_beams": asked},
        )  # fmt: skip


def usable_beams(patient: Patient) -> Iterator[Diagnosis]:
    """Find scans of which, after NaN and missing returns, few of the chosen beams are left."""
    if not patient.is_amcl or patient.log is None or len(patient.log) == 0:
        return
    n, asked = patient.log.finder.n_beams, patient.value("max_beams")
    if asked is None or _never_returns(patient, n, asked):
        return
    selected = _selected(patient, n)
    ranges = patient.log.ranges[:, selected]
    limit = min(patient.log.finder.max_range, _limit(patient))
    with np.errstate(invalid="ignore"):
        usable = ((ranges >= patient.log.finder.min_range) & (ranges < limit)).sum(axis=1)
    median = float(np.median(usable))
    poor = float((usable < FEWEST_USABLE).mean())
    if median < FEWEST_USABLE or poor > 0.2:
        yield patient.finds(
            "few-usable-beams", "warning",
            f"of {len(selected)} chosen beams the median scan has {median:.0f} with a range below {limit:g} m; "
            f"{poor:.0%} of the scans have fewer than {FEWEST_USABLE}",
            "beams are chosen first; those that turn out NaN, without return or too far then tell nothing about walls, "
            "and the program does not say so",
            f"raise {patient.name_of('max_beams')}, or have the driver report what it knows", parameter="max_beams",
            values={"median_usable": median, "chosen": len(selected), "share_of_poor_scans": poor},
        )  # fmt: skip


def many_beams_in_product(patient: Patient) -> Iterator[Diagnosis]:
    """Find products over so many beams that they cannot be independent."""
    asked = None
    if patient.file.model == "likelihood_field_prob":
        asked = patient.value("max_beams")
    elif patient.file.stack == "mrpt" and patient.log is not None:
        step = patient.value("beam_step")
        averages = patient.is_field and patient.parameters.LF_alternateAverageMethod
        asked = None if step is None or averages else -(-patient.log.finder.n_beams // step)
    if asked is not None and asked > MANY_IN_PRODUCT:
        yield patient.finds(
            "many-beams-in-product", "info", f"{patient.file.model} multiplies up to {asked} beams",
            "neighbouring beams err together (a person, a door, a map a little off), so the product is too sure; this "
            "stack has no exponent, fewer beams are the only cure",
            "calibrate: the number of beams is chosen with the other values",
            parameter="beam_step" if patient.file.stack == "mrpt" else "max_beams", values={"beams": asked},
        )  # fmt: skip


def nan_readings(patient: Patient) -> Iterator[Diagnosis]:
    """Find scans with a NaN among the beams that ROS 1's beam model looks at, which does not test for it."""
    if (patient.file.stack, patient.file.model) != ("ros1", "beam") or patient.log is None or len(patient.log) == 0:
        return
    n, asked = patient.log.finder.n_beams, patient.value("max_beams")
    if asked is None or _never_returns(patient, n, asked):
        return
    share = float(np.isnan(patient.log.ranges[:, _selected(patient, n)]).any(axis=1).mean())
    if share > 0.0:
        yield patient.finds(
            "nan-readings", "error", f"{share:.1%} of the scans have a NaN among the beams that are looked at",
            "amcl's beam model has no test for NaN: one of them makes the weights of all particles NaN, and the filter "
            "then makes all particles equal: such a scan undoes earlier ones instead of helping",
            "filter NaN out before amcl (as +inf), or use a field model, which leaves NaN out",
            values={"share": share},
        )  # fmt: skip


def _never_returns(patient: Patient, n_beams: int, max_beams: int) -> bool:
    """Whether the program's step over beams becomes 0: fields raise it to 1, the beam models do not."""
    return patient.file.stack in ("nav2", "ros1") and patient.file.model == "beam" and n_beams < max_beams


def _selected(patient: Patient, n: int) -> NDArray[np.int64]:
    asked: Any = patient.value("max_beams")
    if patient.file.stack == "beluga":
        return even_beams(n, asked)
    if patient.file.model == "likelihood_field_prob":
        return ceil_step_beams(n, asked)
    return floor_step_beams(n, asked, least_step=1)


def _limit(patient: Patient) -> float:
    limit = patient.value("laser_max_range")
    return float(limit) if limit is not None and limit > 0.0 else float("inf")
