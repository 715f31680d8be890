"""How many beams a model really uses."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError
from beamfield.finding import Finding
from beamfield.sensors.robot_in_sight import robot_in_sight
from beamfield.stacks.doctor.subject import Subject

# With fewer readings that end at a wall, one scan hardly tells a pose: of a sum over beams, and of a product. Products
# of 6 beams err at most 0.03 m more than those of 30 on four logs; with 4 they err more, and lose a robot in an office.
FEWEST_USABLE, FEWEST_IN_PRODUCT = 15, 6
# Products treat every beam as independent; more than this many of them never are.
MANY_IN_PRODUCT = 30


def beam_count(subject: Subject) -> Iterator[Finding]:
    """Find a number of beams that the program cannot handle, or that its rounding changes."""
    asked = subject.value("max_beams")
    if asked is None or subject.log is None:
        return
    n, name, selected = subject.log.finder.n_beams, subject.name_of("max_beams"), _selected(subject)
    if selected is None:
        yield subject.finding(
            "max-beams-above-scan", "error", f"{name} is {asked}, the scans have {n} beams",
            f"the beam model's step over beams becomes floor((n - 1) / ({name} - 1)) = 0, which it does not test: the "
            "first update never returns",
            f"set {name} to at most {n}", parameter="max_beams", values={"beams": n, "max_beams": asked},
        )  # fmt: skip
        return
    used = len(selected)
    # Stepping by whole beams takes nearly twice as many, or little more than half as many.
    if n >= asked and not 0.75 <= used / asked <= 1.34:
        yield subject.finding(
            "max-beams-rounded", "info", f"{name} is {asked}, but of {n} beams the program uses {used}",
            "it steps over beams by a whole number",
            "plan with the number that is used", parameter="max_beams", values={"used": used, "max_beams": asked},
        )  # fmt: skip


def own_body(subject: Subject) -> Iterator[Finding]:
    """Find beams that see the robot itself."""
    if subject.log is not None:
        yield from robot_in_sight(subject.log)


def usable_beams(subject: Subject) -> Iterator[Finding]:
    """Find scans of which, after NaN and missing returns, few of the chosen beams are left."""
    selected = _selected(subject)
    if selected is None or subject.log is None or len(subject.log) == 0:
        return
    ranges = subject.log.ranges[:, selected]
    limit = min(subject.log.finder.max_range, _limit(subject))
    usable = ((ranges >= subject.log.finder.min_range) & (ranges < limit)).sum(axis=1)
    fewest = FEWEST_IN_PRODUCT if _counts_each_fully(subject) else FEWEST_USABLE
    median = float(np.median(usable))
    poor = float((usable < fewest).mean())
    if median < fewest or poor > 0.2:
        yield subject.finding(
            "few-usable-beams", "warning",
            f"of {len(selected)} chosen beams the median scan has {median:.0f} with a range below {limit:g} m; "
            f"{poor:.0%} of the scans have fewer than {fewest}",
            "beams are chosen first; those that are NaN, without return or too far then carry no information about "
            "walls, and the program gives no warning",
            f"raise {subject.name_of('max_beams')}, or have the driver report what it knows", parameter="max_beams",
            values={"median_usable": median, "chosen": len(selected), "share_of_poor_scans": poor},
        )  # fmt: skip


def many_beams_in_product(subject: Subject) -> Iterator[Finding]:
    """Find products over more beams than can be independent."""
    if not _counts_each_fully(subject):
        return
    asked = subject.beams_used()
    if asked is not None and asked > MANY_IN_PRODUCT:
        yield subject.finding(
            "many-beams-in-product", "info", f"{subject.model.name} multiplies up to {asked} beams",
            "neighbouring beams err together (a person, a door, a slightly wrong map), so the product is "
            "overconfident; this stack has no exponent, so only fewer beams help",
            "calibrate: the number of beams is chosen with the other values",
            parameter="max_beams" if subject.model.has("max_beams") else "beam_step", values={"beams": asked},
        )  # fmt: skip


def nan_readings(subject: Subject) -> Iterator[Finding]:
    """Find scans with a NaN among the beams that ROS 1's beam model looks at, which does not test for it."""
    selected = _selected(subject)
    if subject.model.emulator.tests_nan or selected is None or subject.log is None or len(subject.log) == 0:
        return
    share = float(np.isnan(subject.log.ranges[:, selected]).any(axis=1).mean())
    if share > 0.0:
        yield subject.finding(
            "nan-readings", "error", f"{share:.1%} of the scans have a NaN among the beams used",
            "amcl's beam model has no test for NaN: one of them makes the weights of all particles NaN, and the filter "
            "then makes all particles equal: such a scan undoes earlier ones instead of helping",
            "filter NaN out before amcl (as +inf), or use a field model, which leaves NaN out",
            values={"share": share},
        )  # fmt: skip


def _counts_each_fully(subject: Subject) -> bool:
    return subject.model.multiplies(subject.parameters) and not subject.model.weight.has_exponent


def _selected(subject: Subject) -> NDArray[np.int64] | None:
    """Return the beams that the program looks at; None if nothing says which, or it never gets through them."""
    asked = subject.value("max_beams")
    if asked is None or subject.log is None:
        return None
    try:
        return subject.model.emulator.beam_rule(subject.log.finder.n_beams, asked)
    except InvalidInputError:
        return None


def _limit(subject: Subject) -> float:
    limit = subject.value("laser_max_range")
    return float(limit) if limit is not None and limit > 0.0 else float("inf")
