"""The page of a fleet's report: what is wrong with which robot and which map, for who runs the fleet."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping

from beamfield import __version__
from beamfield.fleet.comparison import FEWEST_ROBOTS
from beamfield.fleet.fleet_report import FleetReport
from beamfield.fleet.hierarchy import Pooled
from beamfield.fleet.report_figures import drift_figure, parameter_figure, stale_figure
from beamfield.fleet.robot_state import Light, RobotState
from beamfield.fleet.run_record import RunRecord
from beamfield.report.escape import escaped
from beamfield.report.page import document, figure, finding_list, table, verdict_box
from beamfield.report.page_section import Level
from beamfield.report.parameter_rows import with_unit
from beamfield.report.verdict import VAGUE

# Colours alone tell nothing to many readers: each light is named.
LEVELS: Mapping[Light, Level | str] = {"red": "bad", "amber": "care", "green": "good", "grey": ""}
MOST_LEFT_OUT = 50
# On narrow screens the table is moved aside, rather than set in columns of a word; phones show a robot as a block.
ONE_LINE, WIDE = 'style="white-space: nowrap"', 'style="min-width: 15rem"'
KEY = (
    "Red: a fault to see to now. Amber: one to watch, or many runs that cannot be used. Green: no fault was found in "
    "the days that the report covers, by the tests that could be made. Grey: nothing could be tested. "
    "Robots are listed by urgency."
)
OWN = (
    "Robots listed here differ from the others in these parameters by more than chance and the usual spread explain, "
    "so they are better served by parameters of their own; of those listed, about 5% are expected to be false."
)


def render_fleet_page(report: FleetReport) -> str:
    """Return the report as one HTML document that needs nothing else."""
    drift = drift_figure(report.series, report.alarms)
    parameters = parameter_figure(report.fit, report.hierarchies, report.states)
    maps = [stale_figure(stale) for stale in report.stale_maps]
    title = f"Fleet report: {_count(report.states, 'robot')} at {_count(report.sites, 'site')}"
    contents = [
        ("robots", "Robots"), ("tests", "Tests"), ("drift", "Drift"), ("maps", "Maps"), ("parameters", "Parameters"),
        ("runs", "Runs"),
    ]  # fmt: skip
    main = [
        f'<h1>{escaped(title)}</h1>\n<p class="facts">{_facts(report)}</p>',
        verdict_box(*_verdict(report)),
        f'<p class="key">{escaped(KEY)}</p>',
        f'<h2 id="robots">Robots</h2>\n{_lights(report)}',
        f'<h2 id="tests">Tests</h2>\n{_tests(report)}',
        figure(drift).replace("<h3>", "<h2>").replace("</h3>", "</h2>"),
        '<h2 id="maps">Maps</h2>',
        *(map(figure, maps) if maps else ["<p>No laser's beams tell about a map.</p>"]),
        f'<h2 id="parameters">Parameters</h2>\n{_parameter_table(report)}\n{_differences(report)}',
        figure(parameters),
        f'<h2 id="runs">Runs</h2>\n{_runs(report)}',
    ]
    return document(title, "\n".join(main), contents, f"Made by beamfield {__version__}.", maps)


def _count(items: Iterable[object], noun: str) -> str:
    n = len(list(items))
    return f"{n} {noun}{'' if n == 1 else 's'}"


def _facts(report: FleetReport) -> str:
    days = report.days
    span = "no run could be used"
    if days:
        span = days[0].isoformat() if len(days) == 1 else f"{days[0].isoformat()} to {days[-1].isoformat()}"
    used = [record for record in report.records if record.is_used]
    beams = sum(record.beams for record in used)
    return f"{span} · {len(used)} of {_count(report.records, 'run')} used · {beams:,} beams"


def _verdict(report: FleetReport) -> tuple[Level, str, str]:
    lights = Counter(state.light for state in report.states)
    stale = [one.site for one in report.stale_maps if one.lasting]
    sentences = []
    if lights["red"]:
        names = ", ".join(state.robot for state in report.states if state.light == "red")
        need = "needs" if lights["red"] == 1 else "need"
        sentences.append(f"{lights['red']} of {_count(report.states, 'robot')} {need} attention now: {names}.")
    if lights["amber"]:
        sentences.append(f"{_count(range(lights['amber']), 'robot')} to keep an eye on.")
    if stale:
        places = sum(len(one.lasting) for one in report.stale_maps)
        sentences.append(f"The map of {', '.join(stale)} is out of date at {_count(range(places), 'place')}.")
    if lights["grey"]:
        sentences.append(f"Of {_count(range(lights['grey']), 'robot')} nothing is known yet.")
    if report.findings:
        sentences.append("Read what is said about runs, at the end.")
    untested = [test.name for test in report.tests if test.made < test.of]
    if untested:
        sentences.append(f"Not tested, or not of all robots and maps: {', '.join(untested)}.")
        if len(sentences) == 1:
            return "care", f"No robot shows a fault in what was tested. {sentences[0]}", "Not all was tested"
    if not sentences:
        return "good", "No robot shows a fault, and the maps are as the robots see them.", "All well"
    level: Level = "bad" if lights["red"] else "care"
    return level, " ".join(sentences), "See to it" if lights["red"] else "Keep an eye on it"


def _lights(report: FleetReport) -> str:
    """All robots but the green ones, with what to do; those are folded away."""
    others = [state for state in report.states if state.light != "green"]
    differ: dict[tuple[str, str], list[str]] = {}
    for one in report.differences:
        if one.differs:
            differ.setdefault((one.robot, one.site), []).append(one.parameter)
    green = [
        (state.robot, state.site, "; ".join(state.not_tested) or "-",
         ", ".join(differ.get((state.robot, state.site), ["-"])), f"{state.runs} of {state.runs + state.left_out}")
        for state in report.states
        if state.light == "green"
    ]  # fmt: skip
    parts = []
    if others:
        names = ("", "robot", "site", "what was found", "what to do", "runs used")
        columns = "".join(f'<th scope="col">{name}</th>' for name in names)
        body = "\n".join(map(_light, others))
        head = f"<thead><tr>{columns}</tr></thead>"
        parts.append(f'<div class="scroll"><table class="robots">{head}\n<tbody>{body}</tbody></table></div>')
    if green:
        listed = table(("robot", "site", "not tested", "differs in", "runs used"), green, right=(4,))
        missing = ", but not everything was tested" if any(row[2] != "-" for row in green) else ""
        unlike = [row[0] for row in green if row[3] != "-"]
        too = f"; unlike the others in parameters: {escaped(', '.join(unlike))}" if unlike else ""
        head = f'<b class="label">Green</b> {_count(green, "robot")}: no fault found{missing}{too}'
        parts.append(f'<details><summary><span class="good">{head}</span></summary>{listed}</details>')
    return "\n".join(parts)


def _tests(report: FleetReport) -> str:
    rows = [(test.name, f"{test.made} of {test.of} {test.what}{'s' * (test.of != 1)}", test.takes)
            for test in report.tests]  # fmt: skip
    return table(("test", "made of", "it takes"), rows)


def _light(state: RobotState) -> str:
    # A dirty lens may swallow readings and cut others short: two findings, and one thing to do.
    kinds = {one.name: one for one in reversed(state.findings)}
    found = "<br>".join(
        " ".join([*(escaped(one.text) for one in state.findings if one.name == name), escaped(kind.why)])
        for name, kind in reversed(kinds.items())
    )
    if state.not_tested and state.light != "grey":
        found += f"<br>Not tested: {escaped('; '.join(state.not_tested))}."
    do = "<br>".join(escaped(one.do) for one in reversed(kinds.values()))
    used = f"{state.runs} of {state.runs + state.left_out}"
    return (
        f'<tr><td class="{LEVELS[state.light]}" style="padding-left: .5rem"><b class="label">{state.light}</b></td>'
        f'<th scope="row" {ONE_LINE}><b>{escaped(state.robot)}</b></th><td {ONE_LINE}>{escaped(state.site)}</td>'
        f'<td {WIDE}>{found}</td><td {WIDE} data-label="What to do">{do}</td>'
        f'<td class="n" data-label="Runs used">{used}</td></tr>'
    )


def _parameter_table(report: FleetReport) -> str:
    """Fleet and sites; robots are in the picture and, number by number, folded away."""
    parts = []
    for hierarchy in report.hierarchies:
        names = list(hierarchy.fleet.intervals)
        groups = (hierarchy.fleet, *hierarchy.sites)
        rows = [
            (one.site or "fleet", *(_value(getattr(one.parameters, name), one.intervals[name]) for name in names))
            for one in groups
        ]
        robots = [
            (
                f"{one.robot} ({one.site})",
                *(
                    f"{_value(getattr(one.parameters, name), one.intervals[name])}{_shrunk(one, name)}"
                    for name in names
                ),
            )
            for one in hierarchy.robots
        ]
        header = (hierarchy.limits.text, *map(with_unit, names))
        parts.append(f"{table(header, rows, bold=(0,))}\n<details><summary>Robot by robot</summary>"
                     f"{table(header, robots)}</details>")  # fmt: skip
    return "\n".join(parts) or "<p>No robot has beams enough to learn from.</p>"


def _value(value: float, interval: tuple[float, float]) -> str:
    low, high = interval
    # Of numbers that may have either sign the ratio of the ends says nothing.
    vague = ", hardly determined" if low > 0.0 and high > VAGUE * low else ""
    return f"{value:.3g} [{low:.3g}, {high:.3g}]{vague}"


def _shrunk(one: Pooled, name: str) -> str:
    return f", {one.shrinkage[name]:.0%} of its site" if name in one.shrinkage else ""


def _differences(report: FleetReport) -> str:
    rows = [
        (one.robot, one.site, one.parameter, f"{one.value:.3g} [{one.low:.3g}, {one.high:.3g}]", f"{one.usual:.3g}",
         f"{one.q_value:.1g}")
        for one in report.differences
        if one.differs
    ]  # fmt: skip
    if not report.differences:
        return f"<p>No robots were compared: it takes {FEWEST_ROBOTS} with range finders of the same limits.</p>"
    if not rows:
        return "<p>One set of parameters serves the whole fleet: no robot differs by more than chance explains.</p>"
    header = ("robot", "site", "parameter", "its own", "usual", "chance (q)")
    return f"<p>{escaped(OWN)}</p>\n{table(header, rows, right=(5,))}"


def _runs(report: FleetReport) -> str:
    notes = _notes(report.records)
    read = f"<p>How logs were read:</p>\n{table(('note', 'in run', 'and others'), notes, right=(2,))}" if notes else ""
    return f"{_left_out(report)}\n{read}"


def _notes(records: Iterable[RunRecord]) -> list[tuple[str, str, int]]:
    """Return the notes of all logs, those once that differ in their numbers alone: a run, and how many more."""
    alike: dict[str, dict[str, str]] = {}
    for record in records:
        for note in record.notes:
            alike.setdefault(re.sub(r"[0-9.]+", "", note), {}).setdefault(record.run, note)
    rows = ((next(iter(runs.items())), len(runs) - 1) for runs in alike.values())
    return [(note, run, others) for (run, note), others in rows]


def _left_out(report: FleetReport) -> str:
    left_out = [record for record in report.records if not record.is_used]
    warned = finding_list(report.findings) if report.findings else ""
    if not left_out:
        return f"{warned}<p>Every run could be used.</p>"
    rows = [(record.run, record.robot, record.site, record.reason) for record in left_out[:MOST_LEFT_OUT]]
    more = len(left_out) - MOST_LEFT_OUT
    rest = f"<p>{more} more are in fleet_report.json.</p>" if more > 0 else ""
    return f"{warned}<p>Left out:</p>\n{table(('run', 'robot', 'site', 'reason'), rows)}{rest}"
