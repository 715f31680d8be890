"""A fleet's report: lights and words follow from what was found, on the page, in JSON and in Parquet."""

from __future__ import annotations

import datetime
import json
import math
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from beamfield.fleet import report_figures
from beamfield.fleet.comparison import Difference
from beamfield.fleet.daily import UNITS, DailySeries
from beamfield.fleet.drift import Drift
from beamfield.fleet.fleet_report import FleetReport
from beamfield.fleet.hierarchy import Hierarchy, Pooled
from beamfield.fleet.learning import FleetFit
from beamfield.fleet.report_figures import parameter_figure
from beamfield.fleet.report_files import TABLES, report_as_dict, report_tables, write_fleet_report
from beamfield.fleet.report_page import render_fleet_page
from beamfield.fleet.robot_state import robot_states, site_findings
from beamfield.fleet.run_record import MapInfo, RunRecord
from beamfield.fleet.shard_passes import SensorLimits
from beamfield.models.beam_parameters import BeamParameters
from tests.fleet.hall import SITE, stale_hall

FIRST = datetime.date(2026, 3, 2)
DAYS = tuple(FIRST + datetime.timedelta(days=day) for day in range(6))
PARAMETERS = BeamParameters(0.8, 0.1, 0.04, 0.06, 0.02, 0.5)
LIMITS = SensorLimits(12.0, 0.0)


def record(robot: str, day: int, *, reason: str = "") -> RunRecord:
    stamp = datetime.datetime(2026, 3, 2 + day, 8, tzinfo=datetime.UTC).timestamp()
    sensor = {"mounts": [[0.0, 0.0, 0.0]], "max_range": 12.0, "min_range": 0.0, "opening_angle": 0.0, "name": ""}
    return RunRecord(
        run=f"{robot}-{day}", robot=robot, site=SITE, key="", log="", map="", poses="", log_sensor="", log_hash="",
        status="left out" if reason else "used", reason=reason, first_stamp=math.nan if reason else stamp,
        last_stamp=math.nan if reason else stamp + 60.0, beams=1000, sensor={} if reason else sensor,
        map_info=None if reason else MapInfo(0.05, (0.0, 0.0, 0.0), (10, 10), "0123456789abcdef" * 4),
    )  # fmt: skip


def drift(robot: str, fault: str, size: float, *, alarm: bool = True, **rest: object) -> Drift:
    known = {"since": DAYS[3], "unit": "m", "bearings": None, "cause": ""} | rest
    return Drift(robot, SITE, fault, size=size, low=size - 0.001, high=size + 0.001, before=0.0, after=size,
                 p_value=1e-9, q_value=1e-8, alarm=alarm, **known)  # fmt: skip


DRIFTS = (
    drift("r<1>", "range-bias", 0.05),
    drift("r2", "turned-mount", math.radians(0.2), unit="rad"),
    drift("r3", "range-bias", 0.05, alarm=False),
    drift("r6", "range-bias", 0.05, alarm=False),
    drift("r4", "dirty-lens", 0.3, unit="share", bearings=(0.5, 1.0), cause="max"),
)
RECORDS = (
    *(record(robot, day) for robot in ("r<1>", "r2", "r3", "r4") for day in range(6)),
    *(record("r5", day, reason="cut off") for day in range(2)), *(record("r6", day) for day in range(3)),
    *(record("r6", 3 + day, reason="robot stood <still>") for day in range(3)),
)  # fmt: skip


def series(robot: str, sector: tuple[float, float], level: float) -> DailySeries:
    values = np.where(np.arange(6) >= 3, level, 0.02)
    return DailySeries(robot, SITE, "dirty-lens", "share", DAYS, values, np.full(6, 0.01), np.log(values),
                       np.full(6, 0.1), sector, "max")  # fmt: skip


@pytest.fixture
def report() -> FleetReport:
    sectors = [series("r4", (0.4, 0.7), 0.1), series("r4", (0.7, 1.0), 0.3), series("r2", (0.7, 1.0), 0.02),
               series("r4", (-1.0, -0.7), 0.9)]  # fmt: skip
    intervals = {"z_short": (0.08, 0.12), "sigma_hit": (0.019, 0.021)}
    pooled = [Pooled(SITE, f"r{i}", PARAMETERS, intervals, dict.fromkeys(intervals, 0.25)) for i in (2, 4)]
    own = tuple(SimpleNamespace(robot=one.robot, site=SITE, limits=LIMITS, parameters=PARAMETERS) for one in pooled)
    whole = Pooled(None, None, PARAMETERS, intervals, {})
    hierarchy = Hierarchy(LIMITS, whole, (), tuple(pooled), {}, {})
    return FleetReport(
        RECORDS, FleetFit("robot", own), (hierarchy,), (), tuple(sectors), DRIFTS, (stale_hall(),),
        robot_states(RECORDS, DRIFTS), (),
    )  # fmt: skip


def test_the_light_is_that_of_the_worst_fault_and_robots_are_ranked():
    states = robot_states(RECORDS, DRIFTS)
    assert [(one.robot, one.light) for one in states] == [
        ("r4", "red"), ("r<1>", "red"), ("r2", "amber"), ("r6", "amber"), ("r3", "green"), ("r5", "grey"),
    ]  # fmt: skip
    urgency = {one.robot: one.urgency for one in states}
    assert urgency["r4"] == pytest.approx(6.0)
    assert urgency["r2"] == pytest.approx(0.4)
    found = {one.robot: one.findings for one in states}
    assert "from 29 degrees to the left to 57 degrees to the left" in found["r4"][0].do
    assert "by -0.2 degrees" in found["r2"][0].do
    assert found["r6"][0].name == "runs-left-out"
    assert "3 of 6 runs" in found["r6"][0].text
    assert found["r3"] == ()
    assert found["r5"][0].text == "2 of 2 runs cannot be used; most often: cut off."
    # Half of the runs of r6 are left out, but as many of its site's others: it is the site.
    elsewhere = tuple(replace(one, robot=f"{one.robot}b") for one in RECORDS if one.robot in ("r5", "r6"))
    mixed = (*(one for one in RECORDS if one.robot in ("r5", "r6")), *elsewhere)
    tested = tuple(replace(DRIFTS[-2], robot=robot) for robot in ("r6", "r6b"))
    assert [(one.robot, one.light) for one in robot_states(mixed, tested)] == [
        ("r6", "green"), ("r6b", "green"), ("r5", "grey"), ("r5b", "grey"),
    ]  # fmt: skip
    # A green light says that something was tested: a few days of a few robots can show nothing.
    assert [(one.light, *(f.name for f in one.findings)) for one in robot_states([record("r7", 0)], ())] == [
        ("grey", "untested")
    ]
    (site,) = site_findings(mixed)
    assert site.name == "site-runs-left-out"
    assert "10 of 16 runs" in site.text
    assert site.text.endswith("robot stood <still>.")
    missing = [record("r8", day, reason=f"/logs/{day}.log: no such file") for day in range(2)]
    assert (
        "often: /logs/0.log: no such file."
        in robot_states([record("r8", 3, reason="/b: cut"), *missing], ())[0].findings[0].text
    )
    assert not [*site_findings(RECORDS[:29])]
    assert not any(one.text.startswith("r") for all_of in found.values() for one in all_of)


def test_all_files_say_the_same(report, tmp_path):
    names = write_fleet_report(tmp_path, report)
    assert {
        "fleet_report.html",
        "fleet_report.json",
        "maps/hall%2F%3C1%3E-01234567.geojson",
        "maps/hall%2F%3C1%3E-01234567.pgm",
    } <= {*names}
    page = (tmp_path / "fleet_report.html").read_text()
    assert page.endswith("</html>\n")
    assert "r&lt;1&gt;" in page
    assert "<1>" not in page
    assert "<still>" not in page
    assert "2 of 6 robots need attention now: r4, r&lt;1&gt;." in page
    assert f"The map of hall/&lt;1&gt; is out of date at {len(report.stale_maps[0].lasting)} places." in page
    # One curve, of the worst sector that the alarm covers, beside the picture of the parameters: r2 has no series.
    assert page.count('role="img"') == 2
    assert "r4, dirty lens over the days" in page
    assert "sigma_hit [m]" in page.partition('id="robot-parameters"')[0]
    said = json.loads((tmp_path / "fleet_report.json").read_text())
    assert said == report_as_dict(report)
    assert [one["robot"] for one in said["faults"]] == ["r4", "r<1>", "r2"]
    for name, rows in report_tables(report).items():
        read = pq.read_table(tmp_path / f"{name}.parquet")
        assert read.column_names == TABLES[name].split()
        if rows:
            assert read.to_pylist() == [{column: row[column] for column in read.column_names} for row in rows]
    lights = pq.read_table(tmp_path / "robots.parquet").to_pylist()
    assert [(one["robot"], one["light"]) for one in lights] == [(one.robot, one.light) for one in report.states]


def test_what_was_not_tested_is_said_of_each_robot_and_of_the_fleet(report, tmp_path):
    assert {test.name: (test.made, test.of) for test in report.tests} == {
        "change over the days": (5, 6), "comparison with other robots": (0, 6), "dirty lens": (1, 6),
        "turned mount": (1, 6), "range bias": (3, 6), "wheel scale": (0, 6), "parameters": (0, 6), "maps": (1, 1),
    }  # fmt: skip
    states = {one.robot: one for one in report.states}
    assert states["r3"].light == "green"
    assert states["r3"].not_tested == ("comparison with other robots", "dirty lens", "turned mount", "wheel scale")
    assert states["r5"].not_tested == ("change over the days", "comparison with other robots")
    write_fleet_report(tmp_path, report)
    page = (tmp_path / "fleet_report.html").read_text()
    assert "1 robot: no fault found, but not everything was tested" in page
    assert "comparison with other robots; dirty lens; turned mount; wheel scale" in page
    assert "<td>5 of 6 robots</td><td>4 days of runs</td>" in page
    assert [one["name"] for one in json.loads((tmp_path / "fleet_report.json").read_text())["tests"]][-1] == "maps"


def test_without_a_fault_all_is_well_only_where_everything_was_tested(report):
    compared = [replace(drift("r3", fault, 0.0, alarm=False), since=since)
                for fault in UNITS for since in (None, DAYS[3])]  # fmt: skip
    records = [record("r3", day) for day in range(6)]
    differences = [Difference("r3", SITE, "sigma_hit", 0.1, 0.1, 0.0, 0.2, 0.5, 0.5, differs=False)]
    well = replace(
        report, records=tuple(records), drifts=tuple(compared), states=robot_states(records, compared),
        stale_maps=(replace(report.stale_maps[0], places=()),), differences=tuple(differences), hierarchies=(),
    )  # fmt: skip
    page = render_fleet_page(well)
    assert "All well" in page
    assert "1 robot: no fault found</span>" in page
    # A robot that the comparison of parameters names is not passed over in its light's line.
    unlike = render_fleet_page(replace(well, differences=(replace(differences[0], differs=True),)))
    assert "1 robot: no fault found; unlike the others in parameters: r3</span>" in unlike
    assert '<td>sigma_hit</td><td class="n">6 of 6</td>' in unlike
    for less in (
        {"differences": ()},
        {"drifts": tuple(one for one in compared if one.since)},
        {"stale_maps": (replace(well.stale_maps[0], days=1),)},
    ):
        page = render_fleet_page(replace(well, **less))
        assert "All well" not in page
        assert "No robot shows a fault in what was tested. Not tested" in page


def test_how_logs_were_read_is_listed_once_for_all_runs_of_which_it_is_said(report):
    assert "How logs were read" not in render_fleet_page(report)
    notes = [("12% are beyond <10 m>",), ("14% are beyond <10 m>", "two nodes publish /odom"), ()]
    records = tuple(replace(one, notes=said) for one, said in zip(RECORDS, notes, strict=False))
    page = render_fleet_page(replace(report, records=records)).partition("How logs were read")[2]
    assert page.count("are beyond &lt;10 m&gt;") == page.count("12% are beyond") == page.count("two nodes") == 1
    said = report_as_dict(replace(report, records=records))["runs"]
    assert [one["notes"] for one in said] == [list(one) for one in notes]


def test_a_map_and_a_drift_of_one_day_are_not_tested(report):
    one_day = replace(report.stale_maps[0], places=(), days=1)
    series = tuple(replace(one, days=one.days[:3], values=one.values[:3]) for one in report.series)
    page = render_fleet_page(replace(report, stale_maps=(one_day,), drifts=(), series=series))
    assert "Not tested for places to map again: it takes 2 days of runs." in page
    assert "Places to map again: 0" not in page
    assert "Not tested: a change takes 4 days of runs." in page
    assert "No change was found" not in page


def test_a_parameter_that_the_beams_hardly_determine_is_marked(report):
    (whole,) = report.hierarchies
    fleet = replace(whole.fleet, intervals={"sigma_hit": (0.00275, 9.28), "z_short": (0.05, 0.4),
                                            "range_offset": (-1.0, 1.0)})  # fmt: skip
    page = render_fleet_page(replace(report, hierarchies=(replace(whole, fleet=fleet, robots=()),)))
    assert "[0.00275, 9.28], hardly determined" in page
    assert page.count("hardly determined") == 1


def test_numbers_below_the_axes_of_parameters_do_not_touch(report, monkeypatch):
    drawn = []
    monkeypatch.setattr(report_figures, "svg_panel", lambda figure, *_: drawn.append(figure))
    (whole,) = report.hierarchies
    intervals = dict.fromkeys(("z_short", "sigma_hit", "range_offset"), (-0.0173, 0.0142))
    small = BeamParameters(0.9, 0.0, 0.04, 0.06, 1e-3, 0.5)
    known = {"parameters": small, "intervals": intervals, "shrinkage": dict.fromkeys(intervals, 0.2)}
    robots = tuple(replace(one, **known) for one in whole.robots)
    own = tuple(SimpleNamespace(robot=r.robot, site=SITE, limits=LIMITS, parameters=small) for r in robots)
    fleet = replace(whole.fleet, parameters=small)
    parameter_figure(FleetFit("robot", own), [replace(whole, fleet=fleet, robots=robots)], report.states)
    (figure,) = drawn
    FigureCanvasAgg(figure).draw()
    assert [axes.get_title("left") or axes.get_title() for axes in figure.axes] == [
        "z_short", "sigma_hit [m]", "range_offset [m]"
    ]  # fmt: skip
    for axes in figure.axes:
        low, high = axes.get_xlim()
        shown = [label for label in axes.get_xticklabels() if low <= label.get_position()[0] <= high]
        boxes = [label.get_window_extent() for label in shown]
        assert len(boxes) >= 2
        assert all(right.x0 - left.x1 > 3.0 for left, right in pairwise(boxes))


def test_parameters_say_of_which_sensors_they_are(report):
    laser = report.hierarchies[0]
    sonar = replace(laser, limits=SensorLimits(12.0, 0.2, np.radians(15.0)))
    both = replace(report, hierarchies=(laser, sonar))
    names = [hierarchy.limits.text for hierarchy in both.hierarchies]
    assert names == ["Range finders up to 12 m", "Sonars of 15 degrees from 0.2 up to 12 m"]
    rows = report_tables(both)["parameters"]
    assert {(one["max_range"], one["min_range"], one["opening_angle"]) for one in rows} == {
        (12.0, 0.0, 0.0), (12.0, 0.2, np.radians(15.0))
    }  # fmt: skip
