"""How many independent beams a scan is worth: text for the terminal, a section of the page, plain values."""

from __future__ import annotations

import math
from typing import Any

from beamfield.calibration.context.exponent import ExponentLearning, LearnedExponent
from beamfield.report.as_json import plain
from beamfield.report.escape import escaped
from beamfield.report.page import table
from beamfield.report.page_section import PageSection
from beamfield.report.text_table import aligned, interval_text

ANCHOR, TITLE = "independent-beams", "Independent beams"
HEADER = (
    "how beams count", "exponent", "95% interval", "independent beams", "covered", "nats ± s.e.", "with exponent 1"
)  # fmt: skip
# Beyond this the stated error of the reference poses, and not the beams' dependence, sets the exponent.
LIMITED = 1.5


def exponent_table(learned: ExponentLearning) -> str:
    """Return what is printed."""
    # Seven columns are too wide for a terminal.
    header, *lines = zip(HEADER, *_rows(learned), strict=True)
    return f"{exponent_sentence(learned)}\n\n{aligned(header, lines, right=(1, 2))}"


def exponent_sentence(learned: ExponentLearning) -> str:
    """Return in words how many independent beams a scan is worth."""
    said = (
        f"A scan of {learned.beams_of_scan} beams is worth about {learned.independent_beams:.2g} independent ones; in "
        f"a filter, where the errors of scan after scan go together, about {learned.independent_beams_in_drive:.2g}."
    )
    single = learned.single
    error = single.score_se if math.isfinite(single.score_se) else 0.0
    if single.score <= 2.0 * error:
        return (
            "How many independent beams a scan is worth cannot be told: on held-out blocks of time its posteriors are "
            f"not surely better than knowing nothing ({single.score:+.2f} ± {error:.2f} nats). Correct the map, the "
            "poses or the model and calibrate again."
        )
    if single.if_reference_exact > LIMITED * single.value:
        said += (
            f" The error of the reference poses, {learned.reference_error:g} m, limits this: with exact ones a scan "
            f"would be worth at least {single.if_reference_exact * learned.n_beams:.2g}."
        )
    return said


def taken_sentence(learned: ExponentLearning) -> str:
    """Return which exponent a filter takes, if it is not that of drives."""
    if not learned.single_in_filter:
        return ""
    return " The file gives a filter the exponent of one scan, too: with it, ours errs less on this log."


def exponent_section(learned: ExponentLearning) -> PageSection:
    """Return the section of the report."""
    markup = (
        f"<p>{escaped(exponent_sentence(learned))}</p>{table(HEADER, _rows(learned), right=(1, 3, 4, 5, 6))}"
        f"<p>For the beam model with {learned.n_beams} beams of each scan. Neighbouring beams err together: each "
        "beam's value to the power of the exponent makes posteriors around the reference poses whose 90% regions "
        "hold the truth in 90% of the cases. Covered: the share on held-out blocks of time. Nats: mean logarithm of "
        "the posterior's density at the truth over the prior's; 0 says nothing, far below 0 is certain and wrong."
        f"{taken_sentence(learned)}</p>"
    )
    return PageSection(ANCHOR, TITLE, markup, folded=True)


def exponent_as_dict(learned: ExponentLearning) -> dict[str, Any]:
    """Return plain values for JSON."""
    return {
        "independent_beams": learned.independent_beams,
        "independent_beams_in_drive": learned.independent_beams_in_drive,
        **plain(learned),
    }


def _rows(learned: ExponentLearning) -> list[tuple[str, ...]]:
    what = {
        f"one scan, {learned.n_beams} beams": learned.single,
        f"in a filter, {learned.n_scans} scans": learned.drive,
    }
    return [_row(name, exponent, learned.n_beams) for name, exponent in what.items()]


def _row(name: str, exponent: LearnedExponent, n_beams: int) -> tuple[str, ...]:
    score = f"{exponent.score:.2f} ± {exponent.score_se:.2f}" if math.isfinite(exponent.score_se) else ""
    return (
        name, f"{exponent.value:.3g}", interval_text(*exponent.interval), f"{exponent.value * n_beams:.2g}",
        f"{exponent.coverage:.0%}", score, f"{exponent.score_independent:.2f}",
    )  # fmt: skip
