"""Everything that a catalogue says about a fleet: robots, their drift and parameters, and maps."""

from __future__ import annotations

import datetime
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

from beamfield.errors import TooLittleDataError
from beamfield.finding import Finding
from beamfield.fleet.catalogue import Catalogue
from beamfield.fleet.comparison import Difference, compare_robots
from beamfield.fleet.daily import DailySeries, daily_series
from beamfield.fleet.drift import Drift, find_drift
from beamfield.fleet.engine import Engine
from beamfield.fleet.hierarchy import Hierarchy, pool
from beamfield.fleet.learning import FleetFit, learn
from beamfield.fleet.made_tests import MadeTest, made_tests
from beamfield.fleet.robot_state import RobotState, robot_states, site_findings
from beamfield.fleet.run_findings import run_findings
from beamfield.fleet.run_record import RunRecord
from beamfield.fleet.stale_map import StaleMap, find_stale_places
from beamfield.short_repr import short_repr

# Called with a stage, and how much of it is done.
StageProgress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class FleetReport:
    """What is known about a fleet.

    Parameters
    ----------
    records
        All runs.
    fit, hierarchies, differences
        Parameters robot by robot, pooled, and which robots differ.
    series, drifts
        Daily numbers, and what robots show.
    stale_maps
        One per site and map.
    states
        Traffic lights, the most urgent robot first.
    findings
        What to know of sites with many runs that cannot be used, and of the runs' times.
    """

    records: tuple[RunRecord, ...]
    fit: FleetFit
    hierarchies: tuple[Hierarchy, ...]
    differences: tuple[Difference, ...]
    series: tuple[DailySeries, ...]
    drifts: tuple[Drift, ...]
    stale_maps: tuple[StaleMap, ...]
    states: tuple[RobotState, ...]
    findings: tuple[Finding, ...]

    __repr__ = short_repr

    @property
    def alarms(self) -> tuple[Drift, ...]:
        """The drifts that count, those of the most urgent robots first."""
        order = [(state.robot, state.site) for state in self.states]
        return tuple(sorted((d for d in self.drifts if d.alarm), key=lambda d: order.index((d.robot, d.site))))

    @property
    def tests(self) -> tuple[MadeTest, ...]:
        """Which tests the runs allowed, and of how many robots and maps."""
        robots = [(state.robot, state.site) for state in self.states]
        return made_tests(robots, self.drifts, self.differences, self.stale_maps)

    @property
    def sites(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(sorted({record.site for record in self.records}))

    @property
    def days(self) -> tuple[datetime.date, ...]:
        """The first day and the last one (UTC) of the runs used; empty if there is none."""
        stamps = [stamp for one in self.records if one.is_used for stamp in (one.first_stamp, one.last_stamp)]
        ends = (min(stamps), max(stamps)) if stamps else ()
        return tuple(sorted({datetime.datetime.fromtimestamp(stamp, datetime.UTC).date() for stamp in ends}))


def judge_fleet(catalogue: Catalogue, engine: Engine, *, progress: StageProgress | None = None) -> FleetReport:
    """Learn parameters, look for drift, and find places to map again.

    Parameters
    ----------
    catalogue
        The fleet's runs and beams.
    engine
        Where beams are read.
    progress
        Called with a stage, what is done of it and what there is.
    """
    show: StageProgress = progress or (lambda _stage, _done, _total: None)
    show("learning", 0, 1)
    whole = learn(catalogue, engine, by="fleet")
    fit = learn(catalogue, engine, by="robot")
    show("looking for drift", 0, 1)
    series = daily_series(catalogue, engine, whole)
    drifts = find_drift(series)
    stale = find_stale_places(
        catalogue, engine, fit, progress=lambda done, total: show("comparing with maps", done, total)
    )
    records = catalogue.runs
    return FleetReport(
        records, fit, _pooled(fit), compare_robots(fit), series, drifts, stale, robot_states(records, drifts),
        (*site_findings(records), *run_findings(records)),
    )  # fmt: skip


def _pooled(fit: FleetFit) -> tuple[Hierarchy, ...]:
    """Pool the robots of each kind of sensor; those whose beams do not suffice are left out."""
    found: list[Hierarchy] = []
    for robots in fit.robots_by_limits():
        with suppress(TooLittleDataError):
            found += pool(replace(fit, fits=robots))
    return tuple(found)
