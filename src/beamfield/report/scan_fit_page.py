"""The page and the documents of ``beamfield check``: how well the scans of a log fit a map."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield import __version__
from beamfield.report.as_json import plain
from beamfield.report.drawing import ReportFigure
from beamfield.report.escape import escaped
from beamfield.report.page_style import STYLE
from beamfield.report.scan_fit_figures import LEVEL
from beamfield.scan_fit.reference import ScanFitReference
from beamfield.scan_fit.scan_fit import PROBLEMS, ScanFits

SCHEMA = "beamfield-fit/1"
COLUMNS = ("stamp", "statistic", "p_value", "lost_probability", "surprise", "through", "short", "beams", "problem")


def fit_table(fits: ScanFits, worst: NDArray[np.int64]) -> str:
    """Return the short table that the command prints.

    Parameters
    ----------
    fits
        Result of `judge_log`.
    worst
        Indices of the scans to list.
    """
    judged = int((~np.isnan(fits.p_value)).sum())
    share = fits.share_that_fits(LEVEL)
    fit_line = f"{share:.1%} of {judged} scans fit at {LEVEL:.0%}" if judged else "no scan could be judged"
    lines = [f"{fit_line} (95 % of good scans do)" if judged else fit_line]
    for number, name in enumerate(PROBLEMS):
        count = int((fits.problem == number).sum())
        if number and count:
            lines.append(f"{count} scans: {name}")
    lines.append(lost_line(fits))
    if len(worst):
        lines += [
            "",
            "worst scans (through, short: share of beams beyond the mapped obstacle and before it, minus the expected)",
            "  scan       stamp [s]  p-value    lost  through   short",
        ]
        lines += [
            f"{i:6d}  {fits.stamps[i]:14.3f}  {fits.p_value[i]:7.4f}  {fits.lost[i]:6.3f}"
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
    return (
        f"lost probability above 0.5 for {span[1] - span[0]:.1f} s at the longest, from {span[0]:.3f} to {span[1]:.3f}"
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

    Parameters
    ----------
    fits, reference, worst
        What was found, what it was compared with, the worst scans.
    own
        Whether the reference is learned from the same log.
    """
    span = fits.longest_lost()
    problems = {
        name: int((fits.problem == i).sum()) for i, name in enumerate(PROBLEMS) if i and (fits.problem == i).any()
    }
    return {
        "schema": SCHEMA,
        "program": f"beamfield {__version__}",
        "n_scans": len(fits),
        "n_judged": int((~np.isnan(fits.p_value)).sum()),
        "level": LEVEL,
        "share_that_fits": plain(fits.share_that_fits(LEVEL)),
        "longest_lost": None if span is None else {"from": span[0], "to": span[1], "seconds": span[1] - span[0]},
        "highest_lost_probability": plain(float(fits.lost.max())) if len(fits) else None,
        "problems": problems,
        "worst": [
            {
                "scan": int(i),
                "stamp": float(fits.stamps[i]),
                "p_value": plain(float(fits.p_value[i])),
                "lost_probability": float(fits.lost[i]),
                "through": plain(float(fits.statistics.through[i])),
                "short": plain(float(fits.statistics.short[i])),
            }
            for i in worst
        ],
        "reference": {
            "own_log": own,
            "n_scans": len(reference),
            "n_effective": reference.n_effective,
            "smallest_p_value": reference.smallest_p_value,
            "correlation_s": reference.correlation_s,
            "evidence_correlation_s": reference.evidence.correlation_s,
            "gap_s": reference.gap_s,
            "reliability": plain(reference.reliability),
        },
    }


def render_fit_page(
    title: str, fits: ScanFits, reference: ScanFitReference, figures: Sequence[ReportFigure], origin: Mapping[str, Any]
) -> str:
    """Return the result as one HTML document that needs nothing else.

    Parameters
    ----------
    title
        Heading.
    fits, reference
        What was found, and what it was compared with.
    figures
        Drawn figures, in order.
    origin
        Inputs, options and program; see `cli.provenance`.
    """
    good = fits.longest_lost() is None
    judged = int((~np.isnan(fits.p_value)).sum())
    share = f"{fits.share_that_fits(LEVEL):.1%} of {judged} scans fit the map at {LEVEL:.0%}; of good scans 95 % do."
    sentence = f"{share} {lost_line(fits).capitalize()}." if judged else "No scan could be judged."
    rows = "".join(
        f'<tr><td class="n">{r.predicted:.3f}</td><td class="n">{r.observed:.3f}</td><td class="n">{r.n:,}</td></tr>'
        for r in reference.reliability
    )
    reliability = (
        '<h2 id="reliability">Can the lost probability be trusted?</h2>\n<table><thead><tr><th class="n">predicted</th>'
        f'<th class="n">was lost</th><th class="n">scans</th></tr></thead><tbody>{rows}</tbody></table>\n'
        "<p>Simulated kidnappings (scored at wrong poses for stretches of 20 s on average) in blocks of time that the "
        "evidence was not learned from: where the filter said about the first number, the robot was lost in the "
        "second.</p>"
        if rows
        else ""
    )
    table = "".join(
        f'<tr><td class="w">{escaped(role)}</td><td class="w">{escaped(entry["name"])}</td>'
        f'<td class="hash">{entry["sha256"]}</td></tr>'
        for role, entry in origin.get("inputs", {}).items()
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escaped(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<h1>{escaped(title)}</h1>\n"
        f'<p class="verdict{"" if good else " bad"}">{escaped(sentence)}</p>\n'
        + "\n".join(_figure(figure) for figure in figures)
        + f'\n{reliability}\n<h2 id="origin">Origin</h2>\n'
        f'<div class="scroll"><table><tbody>{table}</tbody></table></div>\n'
        f"<footer>Made by {escaped(origin.get('program', f'beamfield {__version__}'))}.</footer>\n"
        "</body>\n</html>\n"
    )


def _figure(figure: ReportFigure) -> str:
    panels = "\n".join(f'<div class="{"wide" if p.wide else "narrow"}">{p.markup}</div>' for p in figure.panels)
    return (
        f'<figure id="{figure.name}">\n<h3>{escaped(figure.title)}</h3>\n<div class="panels">{panels}</div>\n'
        f"<figcaption>{escaped(figure.caption)}</figcaption>\n</figure>"
    )
