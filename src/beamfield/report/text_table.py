"""Plain-text tables for the terminal."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Iterable, Sequence

from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.hit_forms import Candidate
from beamfield.finding import Finding
from beamfield.report.parameter_rows import HEADER, parameter_rows

GAP = "  "
# Narrower than this a column of sentences reads worse than lines that the terminal breaks.
LEAST_ROOM = 18


def parameter_table(calibration: Calibration, *, width: int | None = None) -> str:
    """Return a table of the parameters, each with its 95% interval and its unit, `width` characters wide."""
    return aligned(HEADER, parameter_rows(calibration), right=(1,), width=width)


def readings_line(calibration: Calibration) -> str:
    """Return one sentence: what became of the readings of the used scans."""
    table = calibration.table
    total = max(table.n_readings, 1)
    nothing = int(table.hits_nothing.sum())
    left_out = (
        ("NaN", table.n_nan),
        (f"nearer than {table.min_range:g} m", table.n_too_close),
        ("into unknown space", table.n_unknown),
        ("at what the other half has not drawn exactly", table.n_unsure),
        ("at nothing within max_range", nothing),
    )
    reasons = ", ".join(f"{n:,} ({n / total:.1%}) {why}" for why, n in left_out if n)
    used = len(table) - nothing
    return f"{used:,} of their {table.n_readings:,} readings used ({used / total:.1%})" + (
        f"; left out: {reasons}" if reasons else ""
    )


def score_table(calibration: Calibration) -> str:
    """Return a table of the held-out log-likelihoods per beam in nats."""
    header = ("held-out beams", "nats per beam ± s.e.", "gain of the fit")
    return aligned(header, score_rows(calibration), right=(1, 2))


def score_rows(calibration: Calibration) -> list[tuple[str, ...]]:
    """Return the name of each model, its score, and by how much the fit, which is the first, is better."""
    rows = [(s, plus_minus(s.behind_fit, s.behind_fit_se, sign=True)) for s in calibration.scores]
    return [
        (s.name, plus_minus(s.log_likelihood, s.standard_error), gain if i else "") for i, (s, gain) in enumerate(rows)
    ]


def warning_lines(
    findings: Iterable[Finding], *, width: int | None = None, wording: Callable[[str], str] = str
) -> list[str]:
    """Return one paragraph for each warning or error among the findings.

    Lines are `width` characters long, for a terminal; `wording` turns the names of arguments in a text into those of
    the reader.
    """
    texts = [finding_line(finding, wording) for finding in findings if finding.severity != "info"]
    return texts if width is None else [textwrap.fill(text, width, subsequent_indent="  ") for text in texts]


def finding_line(finding: Finding, wording: Callable[[str], str] = str) -> str:
    """Return a finding with its severity and name; `wording` as for `warning_lines`."""
    return f"{finding.severity} ({finding.name}): {wording(finding.full_text)}"


def form_line(calibration: Calibration) -> str:
    """Return one sentence: which form of the hit component was chosen, from which, and for what gain."""
    chosen = next(c for c in calibration.candidates if c.chosen)
    others = len(calibration.candidates) - 1
    name = form_name(chosen)
    if others == 0:
        return f"Hit model: {name} (the only one allowed)."
    simplest = calibration.candidates[0]
    if chosen is simplest:
        tried = "1 extension" if others == 1 else f"{others} extensions"
        return f"Hit model: {name}. {tried} did not improve held-out likelihood enough."
    gain = plus_minus(chosen.gain, chosen.gain_se, sign=True)
    return f"Hit model: {name}, {gain} nats per held-out beam over {form_name(simplest)}."


def form_name(candidate: Candidate) -> str:
    """Return what to call a form of the hit component."""
    return "plain Gaussian" if candidate.is_chapter else candidate.name


def plus_minus(value: float, standard_error: float, *, sign: bool = False) -> str:
    """Return ``value ± standard error`` with four decimals; without the error where it is not known."""
    plus = "+" if sign else ""
    if not math.isfinite(value):
        return "-inf" if value < 0 else "+inf" if value > 0 else "unknown"
    text = f"{value:{plus}.4f}"
    return f"{text} ± {standard_error:.4f}" if math.isfinite(standard_error) else text


def interval_text(low: float, high: float) -> str:
    """Return an interval in three digits; in words where it is open above."""
    return f"[{low:.3g}, {high:.3g}]" if math.isfinite(high) else "not determined"


def aligned(
    header: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, right: tuple[int, ...], width: int | None = None
) -> str:
    """Return rows under a header, columns padded to their widest cell, those of `right` aligned to the right.

    In lines of `width` characters, headers are broken to fit, and the last column, if it has room for words at all.
    """
    above, below = [header], list(rows)
    if width is not None:
        above = _folded(header, rows, width)
        room = width - sum(one + len(GAP) for one in _widths([*above, *rows])[:-1])
        below = [part for line in rows for part in _broken(line, room)] if room >= LEAST_ROOM else below
    widths = _widths([*above, *below])
    lines = [*above, tuple("-" * width for width in widths), *below]
    return "\n".join(
        GAP.join(
            cell.rjust(width) if i in right else cell.ljust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def _widths(lines: Sequence[tuple[str, ...]]) -> list[int]:
    return [max(map(len, column)) for column in zip(*lines, strict=True)]


def _folded(header: tuple[str, ...], rows: Sequence[tuple[str, ...]], width: int) -> list[tuple[str, ...]]:
    """Return the header in as many lines as it takes for the table to be no wider; in one if no number is enough."""
    for longest in range(max(map(len, header)), 0, -1):
        parts = [textwrap.wrap(title, longest, break_long_words=False) for title in header]
        most = max(map(len, parts))
        lines = list(zip(*([""] * (most - len(part)) + part for part in parts), strict=True))
        if sum(_widths([*lines, *rows])) + len(GAP) * (len(header) - 1) <= width:
            return lines
    return [header]


def _broken(line: tuple[str, ...], room: int) -> list[tuple[str, ...]]:
    """Return the line with its last cell in as many lines as it takes, the other cells empty below the first."""
    first, *rest = textwrap.wrap(line[-1], room) or [""]
    return [(*line[:-1], first), *(("",) * (len(line) - 1) + (part,) for part in rest)]
