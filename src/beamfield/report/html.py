"""The calibration report as one HTML page that needs nothing else: no script, no network, no other file."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from beamfield import __version__
from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.cross_fit import CrossFitMaps
from beamfield.calibration.evaluation import LEAST_GAIN
from beamfield.calibration.hit_forms import Candidate
from beamfield.finding import Finding
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import EXTENSIONS, BeamParameters
from beamfield.report.as_json import plain
from beamfield.report.escape import escaped
from beamfield.report.figures import report_figures
from beamfield.report.page import LEVELS, document, figure, finding_list, fold, table, verdict_box
from beamfield.report.page_section import PageSection
from beamfield.report.parameter_rows import HEADER, parameter_rows
from beamfield.report.text_table import form_line, form_name, plus_minus, score_rows
from beamfield.report.verdict import doubts, verdict, verdict_level
from beamfield.scan_fit.calibration_fit import CalibrationFit
from beamfield.sensors import SensorLog

AMCL = (
    "AMCL's beam model (laser_model_type: beam) has the six parameters under these names, in ROS 1 with the prefix "
    "laser_, but it leaves out the normalisers of (6.4) and (6.7) and sums cubes: these values are a start there, not "
    "an optimum. <code>beamfield calibrate --stack nav2</code> (or ros1, beluga, mrpt, f1tenth) fits the program's own "
    "model."
)
KEY = (
    f"The box above is green ({LEVELS['good'].lower()}), orange ({LEVELS['care'].lower()}) or red "
    f"({LEVELS['bad'].lower()}); blue boxes are notes. A click on a line with a triangle "
    "unfolds it; what is unfolded is printed. Sections, figures and equations such as (6.12) are those of "
    "chapter 6 of Probabilistic Robotics (Thrun, Burgard and Fox, 2005), called the book below."
)
LEFT_OUT_AT_ZERO = (*EXTENSIONS, "min_range")
# The picture that opens the page, and those under "Figures" that are not folded.
FIRST, SHOWN = "cause-map", ("scan-fit",)
UNSURE = "left out, or for the weights alone: the drawn map has no straight wall there"


def render_report(
    calibration: Calibration,
    grid: OccupancyGrid | CrossFitMaps,
    log: SensorLog,
    provenance: Mapping[str, Any] | None = None,
    *,
    sections: Sequence[PageSection] = (),
    scan_fit: CalibrationFit | None = None,
) -> str:
    """Return the report as one HTML document.

    The map may be the two maps that the log drew itself. Of the provenance, these are used by name: "inputs" (role ->
    name, or mapping with "name" and "sha256"; the roles "log", "map" and "poses" go into the head of the page),
    "program" (name and version), "notes" (sentences on how the log was read), "options" (with "odometry", if that is
    what the poses are); the rest is listed at the end. A section with a verdict opens the page, before the beam model;
    the others follow the score, those that are folded the figures.
    """
    origin = dict(provenance or {})
    name = log.finder.name or "the range finder"
    lead = next((part for part in sections if part.verdict), None)
    rest = [part for part in sections if part is not lead]
    title = f"Beam model of {name}" if lead is None else f"{lead.title} for {name}"
    drawn = report_figures(calibration, grid, log, scan_fit)
    first = [part for part in drawn if part.name == FIRST]
    figures = sorted((part for part in drawn if part.name != FIRST), key=lambda part: part.name not in SHOWN)
    contents = [
        *([(lead.anchor, lead.title), ("beam-model", "Beam model")] if lead else []),
        *((part.name, part.title) for part in first),
        *([("warnings", "Warnings")] if _warnings(calibration) else []),
        ("parameters", "Parameters"),
        ("score", "Score"),
        *((part.anchor, part.title) for part in rest if not part.folded),
        ("figures", "Figures"),
        ("details", "Details"),
    ]
    main = [
        f'<h1>{escaped(title)}</h1>\n<p class="facts">{_facts(calibration, log, origin)}</p>',
        *_answers(calibration, lead),
        *map(figure, first),
        _findings(calibration),
        _parameters(calibration, log, for_amcl=lead is None),
        _score(calibration),
        *(_section(part) for part in rest if not part.folded),
        '<h2 id="figures">Figures</h2>',
        *(figure(part, folded=part.name not in SHOWN) for part in figures),
        '<h2 id="details">Details</h2>',
        *(fold(part.title, part.markup, part.anchor) for part in rest if part.folded),
        _data(calibration, log, origin),
        _origin(calibration, origin),
    ]
    return document(title, "\n".join(main), contents, f"Made by {_program(origin)}.", figures)


def _program(origin: Mapping[str, Any]) -> str:
    return str(origin.get("program", f"beamfield {__version__}"))


def _facts(calibration: Calibration, log: SensorLog, origin: Mapping[str, Any]) -> str:
    inputs = origin.get("inputs", {}).items()
    named = {role: entry["name"] if isinstance(entry, Mapping) else entry for role, entry in inputs}
    facts = [f"{role} <b>{escaped(named[role])}</b>" for role in ("log", "map", "poses") if role in named]
    if "map" not in named and calibration.map_from_log:
        facts.append("map <b>drawn from the log</b>")
    if origin.get("options", {}).get("odometry"):
        facts.append("poses <b>odometry of the log</b>")
    recorded = _recorded(log)
    if recorded:
        facts.append(f"recorded {recorded}")
    return " · ".join([*facts, escaped(_program(origin))])


def _answers(calibration: Calibration, lead: PageSection | None) -> list[str]:
    """The verdicts, that of the part which was asked for first: no value is good where map or poses are not."""
    key = f'<p class="key">{escaped(KEY)}</p>'
    own = verdict_box(verdict_level(calibration), verdict(calibration))
    if lead is None:
        return [own, key]
    doubt = doubts(calibration)
    first = verdict_box("bad" if doubt else lead.level, doubt or lead.verdict)
    return [first, key, _section(lead), f'<h2 id="beam-model">Beam model</h2>\n{own}']


def _section(part: PageSection) -> str:
    return f'<h2 id="{part.anchor}">{escaped(part.title)}</h2>\n{part.markup}'


def _recorded(log: SensorLog) -> str:
    """Date of the log in UTC, if its stamps count from 1970; empty otherwise."""
    start = float(log.stamps[0]) if len(log) else 0.0
    # Stamps before September 2001 (1e9 s) count from something else; later than 2100 they are no dates either.
    if not 1e9 < start < 4.1e9:
        return ""
    return datetime.datetime.fromtimestamp(start, tz=datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


def _warnings(calibration: Calibration) -> list[Finding]:
    return [finding for finding in calibration.findings if finding.severity != "info"]


def _findings(calibration: Calibration) -> str:
    warnings = _warnings(calibration)
    notes = [finding for finding in calibration.findings if finding.severity == "info"]
    parts = []
    if warnings:
        parts.append(f'<h2 id="warnings">Before you trust it</h2>\n{finding_list(warnings)}')
    if notes:
        parts.append(fold(f"{len(notes)} more observation{'s' if len(notes) > 1 else ''}", finding_list(notes)))
    if not calibration.findings:
        parts.append("<p>No warnings: map, reference poses and data give no reason to distrust the result.</p>")
    return "\n".join(parts)


def _parameters(calibration: Calibration, log: SensorLog, *, for_amcl: bool) -> str:
    rows = parameter_rows(calibration)
    return (
        f'<h2 id="parameters">Parameters</h2>\n{table(HEADER, rows, right=(1,), css="parameters")}\n'
        f"<p>{_interval_line(calibration)}</p>\n{f'<p>{AMCL}</p>' if for_amcl else ''}\n"
        f"{fold('The values to copy', _snippets(calibration, log))}"
    )


def _interval_line(calibration: Calibration) -> str:
    if not calibration.intervals.intervals:
        return "There are no intervals: they need several blocks of time, and there is only one."
    return (
        f"The intervals come from leaving out one of {calibration.intervals.n_blocks} blocks of time after the other: "
        "beams of one scan and neighbouring scans share their errors and do not count as independent."
    )


def _snippets(calibration: Calibration, log: SensorLog) -> str:
    """The parameters to copy; those of the book's form as well, for programs that know no other."""
    parts = [_snippet("The result:", calibration.parameters, log)]
    plain_form = next((c for c in calibration.candidates if c.is_chapter), None)
    if plain_form is not None and not plain_form.chosen:
        less = next(c for c in calibration.candidates if c.chosen).gain - plain_form.gain
        head = (
            "For programs that know only the book's six parameters, the best fit of that form (it scores "
            f"{less:.4f} nats less per held-out beam):"
        )
        parts.append(_snippet(head, plain_form.result.parameters, log))
    return "\n".join(parts)


def _snippet(head: str, parameters: BeamParameters, log: SensorLog) -> str:
    values = asdict(parameters) | {"max_range": log.finder.max_range, "min_range": log.finder.min_range}
    lines = [f"# beam model of {log.finder.name!r}, by beamfield {__version__}"]
    lines += [f"{name}: {value:.6g}" for name, value in values.items() if value or name not in LEFT_OUT_AT_ZERO]
    return f"<p>{escaped(head)}</p>\n<pre>{escaped(chr(10).join(lines))}</pre>"


def _score(calibration: Calibration) -> str:
    header = ("model", "nats per beam", "gain of the fit")
    return (
        f'<h2 id="score">Held-out score</h2>\n{table(header, score_rows(calibration), right=(1, 2), bold=(0,))}\n'
        "<p>The defaults' weights sum to more than 1 and are scaled to sum 1; ± is one standard error, from blocks of "
        f"time. One nat more makes a beam 2.7 times as likely. {escaped(form_line(calibration))}</p>\n"
        f"{_forms(calibration.candidates)}"
    )


def _forms(candidates: Sequence[Candidate]) -> str:
    """The gain of every form of the hit component; nothing if only one was allowed."""
    if len(candidates) < 2:
        return ""
    rows = [(form_name(c), plus_minus(c.gain, c.gain_se, sign=True) if i else "") for i, c in enumerate(candidates)]
    kept = [i for i, candidate in enumerate(candidates) if candidate.chosen]
    compared = (
        f"{table(('form of a hit', 'gain, nats per beam'), rows, right=(1,), bold=kept)}\n"
        "<p>A range offset lets hits lie beside the expected range (walls drawn too thick or too thin); a sigma slope "
        f"lets the noise grow with range. A further parameter must gain {LEAST_GAIN:g} nats per held-out beam and "
        "twice the standard error.</p>"
    )
    return fold("Forms of a hit that were compared", compared)


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
    markup = (
        f'<div class="panels">{_counts(scans)}{_counts(beams)}</div>\n'
        f"<p>No return: {policy.share:.2%} of the log's readings were converted ({escaped(policy.origin)}: "
        f"{escaped(policy.explanation)}). The sensor's limit is {log.finder.max_range:g} m. "
        f"{_duration(calibration)}</p>{_notes(origin)}"
    )
    return fold("Data used", markup, "data")


def _notes(origin: Mapping[str, Any]) -> str:
    """How the log was read: what was assumed there decides what the numbers mean."""
    notes = [f"<li>{escaped(note)}</li>" for note in origin.get("notes", ())]
    return f"\n<p>How the log was read:</p>\n<ul>{''.join(notes)}</ul>" if notes else ""


def _duration(calibration: Calibration) -> str:
    share, span = float(np.mean(calibration.held_out)), float(np.ptp(calibration.table.stamps))
    return f"The used scans span {span:.0f} s; {share:.0%} of their beams, in whole blocks of time, are held out."


def _counts(rows: list[tuple[str, int]]) -> str:
    total = max(rows[0][1], 1)
    return table((), [(name, f"{n:,}", f"{n / total:.1%}") for name, n in rows], right=(1, 2))


def _origin(calibration: Calibration, origin: Mapping[str, Any]) -> str:
    rest = {name: value for name, value in origin.items() if name != "notes"}
    given = _tree(plain(rest)) if rest else "<p>Not recorded.</p>"
    options = f"<h4>Options of the calibration</h4>\n{_tree(plain(calibration.options))}"
    return fold("Origin: inputs, program, options", f"{given}\n{options}", "origin")


def _tree(value: Any) -> str:
    """A nested mapping as a table of dotted names; what was not given is named in one line."""
    leaves = _leaves("", value)
    missing = [name for name, item in leaves if item is None]
    rest = f"<p>Not given: {escaped(', '.join(missing))}.</p>" if missing else ""
    return table((), [(name, item) for name, item in leaves if item is not None], css="origin") + rest


def _leaves(prefix: str, value: Any) -> list[tuple[str, str | None]]:
    if isinstance(value, Mapping):
        return [leaf for k, v in value.items() for leaf in _leaves(f"{prefix}.{k}" if prefix else str(k), v)]
    if isinstance(value, list):
        return [(prefix, ", ".join(str(item) for item in value) or None)]
    return [(prefix, None if value is None else str(value))]
