"""The page and the documents of ``beamfield check``: how well the scans of a log fit a map."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield import __version__
from beamfield.report.as_json import LEVEL, plain, scan_fits_as_dict
from beamfield.report.escape import escaped
from beamfield.report.page import document, figure, fold, table, verdict_box
from beamfield.report.page_section import Level
from beamfield.report.panel import ReportFigure
from beamfield.scan_fit.reference import ScanFitReference
from beamfield.scan_fit.scan_fit import PROBLEMS, ScanFits

SCHEMA = "beamfield-fit/1"
RELIABILITY = "Can the lost probability be trusted?"
SOURCE = "Sections and equations are those of chapter 6 of Probabilistic Robotics (Thrun, Burgard and Fox, 2005)."
COLUMNS = ("stamp", "misfit", "p_value", "lost_probability", "surprise", "through", "short", "beams", "problem")


def fit_table(fits: ScanFits, worst: NDArray[np.int64]) -> str:
    """Return the short table that the command prints."""
    judged = int((~np.isnan(fits.p_value)).sum())
    share = fits.share_that_fits(LEVEL)
    fit_line = f"{share:.1%} of {judged} scans fit at {LEVEL:.0%}" if judged else "no scan could be judged"
    lines = [lost_line(fits), f"{fit_line} (95% of good scans do)" if judged else fit_line]
    for number, name in enumerate(PROBLEMS):
        count = int((fits.problem == number).sum())
        if number and count:
            lines.append(f"{count} scan{'s' if count > 1 else ''}: {name}")
    if len(worst):
        lines += [
            "",
            "worst scans (through, short: share of beams beyond the mapped obstacle and before it, minus the expected;",
            f"time: since the first scan, whose stamp is {fits.stamps[0]:.3f} s)",
            "  scan  time [s]  p-value    lost  through   short",
        ]
        lines += [
            f"{i:6d}  {fits.stamps[i] - fits.stamps[0]:8.1f}  {fits.p_value[i]:7.4f}  {fits.lost[i]:6.3f}"
            f"  {_share(fits.statistics.through[i])}  {_share(fits.statistics.short[i])}"
            for i in worst
        ]
    return "\n".join(lines)


def _share(value: float) -> str:
    return "      -" if np.isnan(value) else f"{value:+7.1%}"


def lost_line(fits: ScanFits) -> str:
    """Return the longest stretch in which the robot is probably lost, in words."""
    span = fits.longest_lost()
    if span is None:
        top = f", highest {fits.lost.max():.3f}" if len(fits) else ""
        return f"lost probability never above 0.5{top}"
    first, last = (end - fits.stamps[0] for end in span)
    return (
        f"lost probability above 0.5 for {last - first:.1f} s at the longest, from {first:.1f} to {last:.1f} s "
        "after the first scan"
    )


def fit_csv(fits: ScanFits) -> str:
    """Return one line per scan; empty where a number is not known."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    s = fits.statistics
    for i in range(len(fits)):
        numbers = (s.misfit[i], fits.p_value[i], fits.lost[i], s.surprise[i], s.through[i], s.short[i])
        words = ["" if np.isnan(v) else f"{v:.6g}" for v in numbers]
        # Python's repr of a float reads back the same bits.
        writer.writerow([repr(float(fits.stamps[i])), *words, int(s.n_beams[i]), PROBLEMS[int(fits.problem[i])]])
    return stream.getvalue()


def fit_as_dict(fits: ScanFits, reference: ScanFitReference, worst: NDArray[np.int64], *, own: bool) -> dict[str, Any]:
    """Return the result as values that strict JSON can hold; the scans themselves are in the CSV.

    The worst scans are indices; `own`: the reference is learned from the same log.
    """
    columns = {"scan": np.arange(len(fits)), "stamp": fits.stamps, "p_value": fits.p_value}
    columns |= {"lost_probability": fits.lost, "through": fits.statistics.through, "short": fits.statistics.short}
    return {
        "schema": SCHEMA,
        "program": f"beamfield {__version__}",
        **scan_fits_as_dict(fits, reference, own=own),
        "worst": [{name: plain(values[i]) for name, values in columns.items()} for i in worst],
    }


def render_fit_page(
    title: str,
    fits: ScanFits,
    reference: ScanFitReference,
    figures: Sequence[ReportFigure],
    origin: Mapping[str, Any],
    problem: str = "",
) -> str:
    """Return the result as one HTML document that needs nothing else.

    The origin is that of `cli.provenance`. The problem says why map or poses cannot be trusted, and what to do; empty
    if they can.
    """
    judged = int((~np.isnan(fits.p_value)).sum())
    share = f"{fits.share_that_fits(LEVEL):.1%} of {judged} scans fit the map at {LEVEL:.0%}; of good scans 95% do."
    sentence = f"{share} {lost_line(fits).capitalize()}." if judged else "No scan could be judged."
    answers: dict[bool | None, tuple[Level, str]] = {
        None: ("care", "Not judged"), True: ("bad", "Lost"), False: ("good", "Not lost")
    }  # fmt: skip
    level, word = answers[fits.longest_lost() is not None if judged else None]
    # Good scans were learned from the same poses in the same map: where these are wrong, no scan looks lost.
    level, word = ("care", "") if problem and level == "good" else (level, word)
    contents = [*((drawn.name, drawn.title) for drawn in figures), ("origin", "Origin")]
    parts = [f"<h1>{escaped(title)}</h1>"]
    if problem:
        parts.append(verdict_box("bad", problem[0].upper() + problem[1:]))
    parts.append(verdict_box(level, sentence, word))
    parts += map(figure, figures)
    if reference.reliability:
        rows = [(f"{r.predicted:.3f}", f"{r.observed:.3f}", f"{r.n:,}") for r in reference.reliability]
        contents.insert(-1, ("reliability", RELIABILITY))
        said = (
            f"{table(('predicted', 'was lost', 'scans'), rows, right=(0, 1, 2))}\n"
            "<p>Simulated kidnappings (scored at wrong poses for stretches of 20 s on average) in blocks of time that "
            "the evidence was not learned from: where the filter said about the first number, the robot was lost in "
            "the second.</p>"
        )
        parts.append(fold(RELIABILITY, said, "reliability"))
    inputs = [(role, entry["name"], entry["sha256"]) for role, entry in origin.get("inputs", {}).items()]
    parts.append(fold("Origin", table((), inputs, css="origin"), "origin"))
    program = origin.get("program", f"beamfield {__version__}")
    return document(title, "\n".join(parts), contents, f"{SOURCE} Made by {program}.")
