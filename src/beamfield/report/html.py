"""The calibration report as one HTML page that needs nothing else: no script, no network, no other file."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from beamfield import __version__
from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.cross_fit import CrossFitMaps
from beamfield.finding import Finding
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.as_json import plain
from beamfield.report.drawing import ReportFigure
from beamfield.report.escape import escaped
from beamfield.report.figures import report_figures
from beamfield.report.page_section import PageSection
from beamfield.report.page_style import STYLE
from beamfield.report.parameter_rows import EXTENSIONS, parameter_rows
from beamfield.report.score_figures import score_plot
from beamfield.report.text_table import form_line, plus_minus
from beamfield.report.verdict import is_good, verdict
from beamfield.sensors import SensorLog

AMCL = (
    "AMCL's beam model (laser_model_type: beam) has the six parameters under these names, in ROS 1 with the prefix "
    "laser_, and laser_max_range. It leaves out the normalisers of (6.4) and (6.7) and sums cubes, so these "
    "values are a start there, not an optimum. <code>beamfield calibrate --stack nav2</code> (or ros1, beluga, mrpt, "
    "f1tenth) fits the program's own model."
)

UNSURE = "left out, or for the weights alone: the drawn map has no straight wall there"
SECTIONS = {
    "parameters": "Parameters",
    "score": "Score",
    "data": "Data used",
    "figures": "Figures",
    "origin": "Origin",
}


def render_report(
    calibration: Calibration,
    grid: OccupancyGrid | CrossFitMaps,
    log: SensorLog,
    provenance: Mapping[str, Any] | None = None,
    *,
    sections: Sequence[PageSection] = (),
) -> str:
    """Return the report as one HTML document.

    Parameters
    ----------
    calibration
        The result of `calibrate`.
    grid, log
        The map, or the two maps that the log drew itself, and the log it was made from.
    provenance
        Where the inputs come from. Used by name: "inputs" (role -> name, or mapping with "name" and "sha256"; the roles
        "log", "map" and "poses" go into the head of the page), "date", "program" (name and version), "notes" (sentences
        on how the log was read), "options" (with "odometry", if that is what the poses are). The rest is listed at
        the end of the page.
    sections
        More sections, behind the score.
    """
    origin = dict(provenance or {})
    figures = report_figures(calibration, grid, log)
    title = f"Beam model of {log.finder.name or 'the range finder'}"
    body = "\n".join(
        [
            _head(title, calibration, log, origin, sections),
            _findings(calibration.findings),
            _parameters(calibration, log),
            _score(calibration),
            *(f'<h2 id="{part.anchor}">{escaped(part.title)}</h2>\n{part.markup}' for part in sections),
            _data(calibration, log, origin),
            _figures(figures),
            _origin(calibration, origin),
        ]
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escaped(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n{body}\n"
        "<footer>Section, figure and equation numbers are those of chapter 6 of Probabilistic Robotics (Thrun, "
        f"Burgard, Fox). Made by {escaped(_program(origin))}.</footer>\n</body>\n</html>\n"
    )


def _program(origin: Mapping[str, Any]) -> str:
    return str(origin.get("program", f"beamfield {__version__}"))


def _head(
    title: str, calibration: Calibration, log: SensorLog, origin: Mapping[str, Any], sections: Sequence[PageSection]
) -> str:
    inputs = origin.get("inputs")
    named = {str(role): _input_name(entry) for role, entry in inputs.items()} if isinstance(inputs, Mapping) else {}
    facts = [f"{role} <b>{escaped(named[role])}</b>" for role in ("log", "map", "poses") if role in named]
    if "map" not in named and _drawn_by_the_log(calibration):
        facts.append("map <b>drawn from the log</b>")
    if _option(origin, "odometry"):
        facts.append("poses <b>odometry of the log</b>")
    recorded = _recorded(log)
    if recorded:
        facts.append(f"recorded {recorded}")
    if "date" in origin:
        facts.append(f"calibrated {escaped(origin['date'])}")
    facts.append(escaped(_program(origin)))
    names = list(SECTIONS.items())
    names[2:2] = [(part.anchor, part.title) for part in sections]
    links = " ".join(f'<a href="#{anchor}">{escaped(name)}</a>' for anchor, name in names)
    css = "verdict" if is_good(calibration) else "verdict bad"
    return (
        f'<h1>{escaped(title)}</h1>\n<p class="facts">{" · ".join(facts)}</p>\n'
        f'<p class="{css}">{escaped(verdict(calibration))}</p>\n<nav>{links}</nav>'
    )


def _drawn_by_the_log(calibration: Calibration) -> bool:
    return any(finding.name == "cross-fitted-map" for finding in calibration.findings)


def _option(origin: Mapping[str, Any], name: str) -> Any:
    options = origin.get("options")
    return options.get(name) if isinstance(options, Mapping) else None


def _input_name(entry: object) -> str:
    return str(entry.get("name", "")) if isinstance(entry, Mapping) else str(entry)


def _recorded(log: SensorLog) -> str:
    """Date of the log in UTC, if its stamps count from 1970; empty otherwise."""
    start = float(log.stamps[0]) if len(log) else 0.0
    # Stamps before September 2001 (1e9 s) count from something else; later than 2100 they are no dates either.
    if not 1e9 < start < 4.1e9:
        return ""
    return datetime.datetime.fromtimestamp(start, tz=datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


def _findings(findings: tuple[Finding, ...]) -> str:
    warnings = [f for f in findings if f.severity == "warning"]
    notes = [f for f in findings if f.severity != "warning"]
    parts = []
    if warnings:
        items = "\n".join(_finding(f) for f in warnings)
        parts.append(f'<h2 id="warnings">Before you trust it</h2>\n<ul class="findings">\n{items}\n</ul>')
    if notes:
        items = "\n".join(_finding(f) for f in notes)
        count = f"{len(notes)} more observation{'s' if len(notes) > 1 else ''}"
        parts.append(f'<details><summary>{count}</summary><ul class="findings">\n{items}\n</ul></details>')
    if not findings:
        parts.append("<p>No warnings: map, reference poses and data give no reason to distrust the result.</p>")
    return "\n".join(parts)


def _finding(finding: Finding) -> str:
    css = ' class="info"' if finding.severity != "warning" else ""
    return f"<li{css}>{escaped(finding.text)} <code>{escaped(finding.name)}</code></li>"


def _parameters(calibration: Calibration, log: SensorLog) -> str:
    rows = "\n".join(
        f'<tr><td class="w"><code>{row.name}</code></td><td class="n">{row.value}</td>'
        f'<td class="w">{row.interval_text}</td><td class="w">{row.unit or "-"}</td>'
        f'<td class="meaning">{row.meaning}</td></tr>'
        for row in parameter_rows(calibration)
    )
    head = '<th>parameter</th><th class="n">value</th><th>95 % interval</th><th>unit</th><th>meaning</th>'
    return (
        '<h2 id="parameters">Parameters</h2>\n'
        f'<table class="parameters"><thead><tr>{head}</tr></thead>\n<tbody>{rows}</tbody></table>\n'
        f"<p>{_interval_line(calibration)}</p>\n{_snippets(calibration, log)}"
    )


def _interval_line(calibration: Calibration) -> str:
    if not calibration.intervals.intervals:
        return "There are no intervals: they need several blocks of time, and there is only one."
    return (
        f"The intervals come from leaving out one of {calibration.intervals.n_blocks} blocks of time after the other: "
        "beams of one scan and neighbouring scans share their errors and do not count as independent."
    )


def _snippets(calibration: Calibration, log: SensorLog) -> str:
    """The parameters to copy; those of the chapter's form as well, for programs that know no other."""
    parts = [_snippet("The result, to copy:", calibration.parameters, log)]
    plain_form = next((c for c in calibration.candidates if c.name == "chapter"), None)
    if plain_form is not None and not plain_form.chosen:
        parts.append(
            _snippet(
                "For programs that know only the chapter's six parameters, the best fit of that form (it scores "
                f"{_less(calibration, plain_form.gain)} nats less per held-out beam):",
                plain_form.result.parameters,
                log,
            )
        )
    parts.append(f"<p>{AMCL}</p>")
    return "\n".join(parts)


def _less(calibration: Calibration, gain: float) -> str:
    chosen = next(c for c in calibration.candidates if c.chosen)
    return f"{chosen.gain - gain:.4f}"


def _snippet(head: str, parameters: BeamParameters, log: SensorLog) -> str:
    names = ["z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short"]
    names += [name for name in EXTENSIONS if getattr(parameters, name) != 0.0]
    lines = [f"{name}: {getattr(parameters, name):.6g}" for name in names] + [f"max_range: {log.finder.max_range:.6g}"]
    lines += [f"min_range: {log.finder.min_range:.6g}"] if log.finder.min_range > 0.0 else []
    lines.insert(0, f"# beam model of {log.finder.name!r}, by beamfield {__version__}")
    return f"<p>{escaped(head)}</p>\n<pre>{escaped(chr(10).join(lines))}</pre>"


def _score(calibration: Calibration) -> str:
    rows = "\n".join(
        f'<tr class="{"fit" if i == 0 else "rival"}"><td>{escaped(s.name)}</td>'
        f'<td class="n">{plus_minus(s.log_likelihood, s.standard_error)}</td>'
        f'<td class="n">{"" if i == 0 else plus_minus(s.behind_fit, s.behind_fit_se, sign=True)}</td></tr>'
        for i, s in enumerate(calibration.scores)
    )
    return (
        '<h2 id="score">Held-out score</h2>\n<div class="scroll"><table><thead><tr><th>model</th>'
        '<th class="n">nats per beam</th><th class="n">the fit is ahead by</th></tr></thead>\n'
        f"<tbody>{rows}</tbody></table></div>\n<p>The defaults' weights sum to more than 1 and are scaled to sum 1; "
        f"± is one standard error. {escaped(form_line(calibration))}</p>\n{_figure(score_plot(calibration))}"
    )


def _data(calibration: Calibration, log: SensorLog, origin: Mapping[str, Any]) -> str:
    selection, table = calibration.selection, calibration.table
    nothing = int(table.hits_nothing.sum())
    scans = [("scans in the log", len(selection.used)), ("used", int(selection.used.sum()))]
    scans += [(f"dropped: {reason}", n) for reason, n in selection.dropped.items()]
    beams = [
        ("readings in the used scans", table.n_readings),
        ("fitted", round(calibration.n_fit)),
        ("held out", int((calibration.held_out & ~table.hits_nothing).sum())),
        ("left out: no measurement (NaN)", table.n_nan),
        (f"left out: nearer than min_range = {table.min_range:g} m", table.n_too_close),
        ("left out: the ray enters unknown space first", table.n_unknown),
        *([(UNSURE, table.n_unsure)] if table.n_unsure else []),
        (f"left out: the ray hits nothing within {table.max_range:g} m", nothing),
    ]
    policy = log.no_return
    tables = "".join(f'<div class="scroll">{_counts(rows)}</div>' for rows in (scans, beams))
    return (
        f'<h2 id="data">Data used</h2>\n<div class="panels">{tables}</div>\n'
        f"<p>No return: {policy.share:.2%} of the log's readings were converted ({escaped(policy.origin)}: "
        f"{escaped(policy.explanation)}). The sensor's limit is {log.finder.max_range:g} m. "
        f"{_duration(calibration)}</p>{_notes(origin)}"
    )


def _notes(origin: Mapping[str, Any]) -> str:
    """How the log was read: what was assumed there decides what the numbers mean."""
    notes = [f"<li>{escaped(note)}</li>" for note in origin.get("notes", ())]
    return f"\n<p>How the log was read:</p>\n<ul>{''.join(notes)}</ul>" if notes else ""


def _duration(calibration: Calibration) -> str:
    stamps = calibration.table.stamps
    if len(stamps) == 0:
        return ""
    share = float(np.mean(calibration.held_out))
    span = float(np.ptp(stamps))
    return f"The used scans span {span:.0f} s; {share:.0%} of their beams, in whole blocks of time, are held out."


def _counts(rows: list[tuple[str, int]]) -> str:
    total = max(rows[0][1], 1)
    cells = "".join(
        f'<tr><td>{escaped(name)}</td><td class="n">{n:,}</td><td class="n">{n / total:.1%}</td></tr>'
        for name, n in rows
    )
    return f"<table><tbody>{cells}</tbody></table>"


def _figures(figures: list[ReportFigure]) -> str:
    return '<h2 id="figures">Figures</h2>\n' + "\n".join(_figure(figure) for figure in figures)


def _figure(figure: ReportFigure) -> str:
    panels = "\n".join(
        f'<div class="{"wide" if panel.wide else "narrow"}">{panel.markup}</div>' for panel in figure.panels
    )
    caption = f'{escaped(figure.caption)} <span class="source">[{escaped(figure.source)}]</span>'
    pictures = f'<div class="panels">{panels}</div>\n' if panels else ""
    return (
        f'<figure id="{figure.name}">\n<h3>{escaped(figure.title)}</h3>\n{pictures}'
        f"<figcaption>{caption}</figcaption>\n</figure>"
    )


def _origin(calibration: Calibration, origin: Mapping[str, Any]) -> str:
    rest = {name: value for name, value in origin.items() if name != "notes"}
    given = _tree(plain(rest)) if rest else "<p>Not recorded.</p>"
    return (
        '<h2 id="origin">Origin</h2>\n'
        f"<details open><summary>Inputs and program</summary>{given}</details>\n"
        f"<details><summary>Options of the calibration</summary>{_tree(plain(calibration.options))}</details>"
    )


def _tree(value: Any) -> str:
    """A nested mapping as a table of dotted names."""
    rows = "".join(
        f'<tr><td class="w"><code>{escaped(name)}</code></td><td class="hash">{escaped(item)}</td></tr>'
        for name, item in _leaves("", value)
    )
    return f'<div class="scroll"><table><tbody>{rows}</tbody></table></div>'


def _leaves(prefix: str, value: Any) -> list[tuple[str, str]]:
    if isinstance(value, Mapping):
        return [leaf for k, v in value.items() for leaf in _leaves(f"{prefix}.{k}" if prefix else str(k), v)]
    if isinstance(value, list):
        return [(prefix, ", ".join(str(item) for item in value) or "none")]
    return [(prefix, "not given" if value is None else str(value))]
