"""The pictures of a fleet's report: drift over days, parameters robot by robot, and maps that are out of date."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from urllib.parse import quote

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

from beamfield.calibration.evaluation import Z95
from beamfield.fleet.daily import DailySeries, FaultKind
from beamfield.fleet.drift import FEWEST_DAYS, Drift
from beamfield.fleet.hierarchy import Hierarchy, Pooled
from beamfield.fleet.learning import FleetFit
from beamfield.fleet.made_tests import FEWEST_MAP_DAYS
from beamfield.fleet.robot_state import RobotState
from beamfield.fleet.stale_map import StaleMap
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.colours import DATA, FIT, HELD_OUT, MODEL, QUIET
from beamfield.report.drawing import NARROW, WIDE, new_axes, new_panel, style
from beamfield.report.map_figures import (
    colour_bar,
    draw_map,
    figure_height,
    frame,
    limits_around,
    number_place,
    squares_at,
)
from beamfield.report.page import table
from beamfield.report.panel import Panel, ReportFigure, png_panel, svg_panel
from beamfield.report.parameter_rows import with_unit
from beamfield.scan_fit.place_visits import FEWEST_BEAMS

# What is shown of each fault: its name, the unit on the axis, and how many of it are one SI unit.
FAULTS: Mapping[FaultKind, tuple[str, str, float]] = {
    "dirty-lens": ("dirty lens", "in the sector [%]", 100.0),
    "turned-mount": ("turned mount", "motion, to the left [degrees]", math.degrees(1.0)),
    "range-bias": ("range bias", "ranges too long by [cm]", 100.0),
    "wheel-scale": ("wheel scale", "odometry too short by [%]", 100.0),
}
CAUSES = {"max": "no return ", "short": "before the wall ", "": ""}
MOST_CURVES, MOST_PLACES, MOST_DATES = 16, 20, 5
PLACE_COLUMNS = ("", "what", "x [m]", "y [m]", "size [m]", "since", "runs", "robots", "share of beams", "chance")
# Squares that fewer runs saw, or with fewer beams a run, say little; and some readings disagree with every wall.
FEWEST_RUNS, LEAST_SHOWN = 3, 0.15
# Beyond so many robots, the most urgent are drawn.
MOST_ROBOTS = 40


def drift_figure(series: Sequence[DailySeries], drifts: Sequence[Drift]) -> ReportFigure:
    """Draw what each alarm is about over the days, among the same numbers of the other robots."""
    panels = []
    for number, drift in enumerate(drifts[:MOST_CURVES]):
        mine = _series_of(drift, series)
        if mine is not None:
            others = [one for one in series if one is not mine and _what(one) == _what(mine)]
            panels.append(_drift_panel(f"drift-{number}", drift, mine, others))
    more = f" {len(drifts) - MOST_CURVES} more are in series.parquet." if len(drifts) > MOST_CURVES else ""
    caption = (
        "Thick: the robot's number of each day with its 95% interval; grey: the same of the other robots. The dashed "
        f"line is the day since when it has changed; without one, it was so from the first day on.{more}"
        if panels
        else "No change was found."
        if any(len(one.days) >= 2 * FEWEST_DAYS for one in series)
        else f"Not tested: a change takes {2 * FEWEST_DAYS} days of runs."
    )
    return ReportFigure("drift", "Drift over the days", tuple(panels), caption)


def _what(of: DailySeries) -> tuple[object, ...]:
    return of.fault, of.cause, of.bearings


def _series_of(drift: Drift, series: Sequence[DailySeries]) -> DailySeries | None:
    """Return what a drift is about; of the sectors that it covers, the worst."""
    own = [
        one
        for one in series
        if (one.robot, one.site, one.fault, one.cause) == (drift.robot, drift.site, drift.fault, drift.cause)
        and _covers(drift.bearings, one.bearings)
    ]
    return max(own, key=lambda one: _level(one, drift.since), default=None)


def _level(one: DailySeries, since: datetime.date | None) -> float:
    """Return the mean of what is compared, from a day on."""
    later = [
        value for day, value in zip(one.days, one.contrasts.tolist(), strict=True) if since is None or day >= since
    ]
    return math.fsum(later) / len(later) if later else -math.inf


def _covers(whole: tuple[float, float] | None, part: tuple[float, float] | None) -> bool:
    if whole is None or part is None:
        return whole is part
    middle = 0.5 * (part[0] + part[1])
    return any(whole[0] <= middle + turn <= whole[1] for turn in (0.0, 2.0 * math.pi))


def _drift_panel(name: str, drift: Drift, mine: DailySeries, others: Sequence[DailySeries]) -> Panel:
    what, unit, scale = FAULTS[drift.fault]
    figure, axes = new_axes(NARROW, 2.7, title=f"{drift.robot}: {what}", y=CAUSES[drift.cause] + unit)
    for one in others:
        axes.plot([day.toordinal() for day in one.days], one.values * scale, color=DATA, linewidth=0.8, zorder=1)
    days, values = [day.toordinal() for day in mine.days], mine.values * scale
    axes.errorbar(
        days, values, Z95 * mine.standard_errors * scale, color=HELD_OUT, linewidth=1.8, elinewidth=1.0, marker="o",
        markersize=3.5, zorder=3,
    )  # fmt: skip
    if drift.since is not None:
        axes.axvline(drift.since.toordinal() - 0.5, color=MODEL, linestyle="--", linewidth=1.0, zorder=2)
    _date_axis(axes, mine.days)
    since = "from the first day on" if drift.since is None else f"since {drift.since.isoformat()}"
    return svg_panel(figure, name, f"{drift.robot}, {what} over the days: {drift.sentence} ({since}).")


def _date_axis(axes: Axes, days: Sequence[datetime.date]) -> None:
    """Name some of the days, which are counted from the year 1."""
    ticks = np.unique(np.linspace(0, len(days) - 1, MOST_DATES).round().astype(np.int64)).tolist()
    axes.set_xticks([days[i].toordinal() for i in ticks], [f"{days[i].day} {days[i]:%b}" for i in ticks])


def parameter_figure(fit: FleetFit, hierarchies: Sequence[Hierarchy], states: Sequence[RobotState]) -> ReportFigure:
    """Draw each robot's own estimate and the pooled one, parameter by parameter."""
    panels = []
    own = {(one.robot, one.site, one.limits): one.parameters for one in fit.fits}
    order = [(state.robot, state.site) for state in states]
    for number, hierarchy in enumerate(hierarchies):
        names = list(hierarchy.robots[0].shrinkage) if hierarchy.robots else []
        robots = sorted(hierarchy.robots, key=lambda one: order.index((str(one.robot), str(one.site))))[:MOST_ROBOTS]
        robots.sort(key=lambda one: (str(one.site), str(one.robot)))
        n_rows = -(-len(names) // 3)
        if not names:
            continue
        figure = new_panel(WIDE, n_rows * (0.9 + 0.16 * len(robots)))
        for place, name in enumerate(names, start=1):
            axes = figure.add_subplot(n_rows, 3, place)
            style(axes, title=with_unit(name), grid="x")
            axes.locator_params(axis="x", nbins=3)  # labels of small negative numbers are a third of the width
            _dots(axes, name, robots, [own[one.robot, one.site, hierarchy.limits] for one in robots])
            axes.axvline(getattr(hierarchy.fleet.parameters, name), color=QUIET, linewidth=1.0, zorder=1)
            axes.set_yticks(range(len(robots)), [str(one.robot) for one in robots] if place % 3 == 1 else [])
            axes.tick_params(axis="y", labelsize=7)
            axes.invert_yaxis()
        alt = f"Parameters of {len(robots)} robots, each robot's own estimate beside the pooled one."
        panels.append(svg_panel(figure, f"parameters-{number}", alt))
    return ReportFigure(
        "robot-parameters", "Which robots need their own parameters", tuple(panels),
        "Open: what a robot's own beams say. Filled: what to use, with its 95% interval: the robot's own estimate, "
        "moved towards that of its site as far as its data are few. Vertical line: the fleet. "
        f"At most {MOST_ROBOTS} robots are drawn.",
    )  # fmt: skip


def _dots(axes: Axes, name: str, robots: Sequence[Pooled], own: Sequence[BeamParameters]) -> None:
    for row, (pooled, alone) in enumerate(zip(robots, own, strict=True)):
        low, high = pooled.intervals[name]
        used = getattr(pooled.parameters, name)
        axes.plot([low, high], [row, row], color=FIT, linewidth=1.2, zorder=2)
        axes.plot(getattr(alone, name), row, "o", color=HELD_OUT, markerfacecolor="white", markersize=4.5, zorder=3)
        axes.plot(used, row, "o", color=FIT, markersize=3.5, zorder=4)


def stale_figure(stale: StaleMap) -> ReportFigure:
    """Draw where readings disagree with a site's map, and list the places to map again."""
    squares, listed = stale.squares, stale.lasting[:MOST_PLACES]
    name = f"map-{quote(stale.site, safe='')}-{stale.map_hash[:8]}"
    title = f"{stale.site}: where the map is out of date"
    if not len(squares.x):
        return ReportFigure(name, title, (), "No beams.")
    corners = np.column_stack([squares.x, squares.y])
    limits = limits_around(np.concatenate([corners, corners + stale.side]))
    figure, axes = new_axes(WIDE, figure_height(limits, rest=1.1, least=3.0), above=2.6)
    draw_map(axes, stale.grid, limits)
    enough = np.maximum(squares.crossed, squares.tested) >= FEWEST_BEAMS * squares.runs
    shown = enough & (squares.runs >= FEWEST_RUNS) & (squares.disagreement >= LEAST_SHOWN)
    patches = PolyCollection(squares_at(corners[shown], stale.side), cmap="YlOrRd", zorder=2.0)
    patches.set_array(squares.disagreement[shown])
    patches.set_clim(0.0, 1.0)
    axes.add_collection(patches)
    for number, place in enumerate(listed, start=1):
        outlines = squares_at(place.corners, stale.side)
        axes.add_collection(PolyCollection(outlines, facecolors="none", edgecolors=MODEL, linewidths=0.8, zorder=3.0))
        number_place(axes, number, place.x, place.y)
    frame(axes, limits)
    colour_bar(figure, axes, patches, "share of beams that disagree with the map")
    panels = [png_panel(figure, f"Map of {stale.site} with {len(stale.lasting)} places to map again.")]
    if listed:
        panels.append(Panel(table(PLACE_COLUMNS, _rows(stale), right=(2, 3)), wide=True))
    return ReportFigure(name, title, tuple(panels), _caption(stale))


def _rows(stale: StaleMap) -> list[tuple[str, ...]]:
    return [
        (
            str(number),
            place.kind,
            f"{place.x:.1f}",
            f"{place.y:.1f}",
            f"{place.width:.1f} x {place.height:.1f}",
            "before the first run" if place.since is None else place.since.isoformat(),
            f"{place.runs_changed} of {place.runs}",
            f"{place.robots_changed} of {place.robots}",
            f"{place.rate:.0%}",
            f"{place.p_value:.1g}",
        )
        for number, place in enumerate(stale.lasting[:MOST_PLACES], start=1)
    ]


def _caption(stale: StaleMap) -> str:
    left_out = f" Not asked: {', '.join(stale.not_asked)}, who see differences everywhere." if stale.not_asked else ""
    more = len(stale.lasting) - MOST_PLACES
    places = f"Places to map again: {len(stale.lasting)}."
    if stale.days < FEWEST_MAP_DAYS:
        places = f"Not tested for places to map again: it takes {FEWEST_MAP_DAYS} days of runs."
    return (
        f"{places} Squares of {stale.side:g} m, coloured by the share of "
        f"beams that disagree with the map, from {LEAST_SHOWN:.0%} on. Runs: {stale.runs}, robots: {stale.robots}, "
        f"days: {stale.days}. Outlined and numbered: places to map again, which differ in at least half of the runs "
        "since the day named, for two robots and on two days at least. Chance: that people and doors alone make so "
        "many runs differ. Colour without an outline: people, doors, and what was there for a while. Files: "
        f"maps/{quote(stale.site, safe='')}-{stale.map_hash[:8]}.yaml for RViz, .geojson."
        f"{f' {more} more places are in places.parquet.' if more > 0 else ''}{left_out}"
    )
