"""Where a site's map is out of date: places that differ for several robots on several days."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.stats import false_discovery_control

from beamfield.fleet.catalogue import Catalogue
from beamfield.fleet.engine import Engine, Progress
from beamfield.fleet.learning import FleetFit
from beamfield.fleet.place_counts import READINGS, CountJob, count_places
from beamfield.fleet.place_votes import PlaceTest, judge_places
from beamfield.fleet.run_record import RunRecord
from beamfield.fleet.shard_passes import sensor_limits
from beamfield.fleet.site_runs import SiteRuns, SquareRates
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.changed_places import LASTING, NEIGHBOURS, Kind, Reading
from beamfield.scan_fit.place_tallies import Lattice
from beamfield.scan_fit.place_visits import MOST_PASSING, Tally, Visits
from beamfield.short_repr import short_repr

# What differs for good does so in at least half of the runs since then.
LEAST_RUNS = 0.5
# Accepted share of false places among those found.
FALSE_DISCOVERIES = 0.05


@dataclass(frozen=True, eq=False)
class StalePlace:
    """A place where the world has differed from the map from one day on.

    Parameters
    ----------
    kind, reading
        As of a `ChangedPlace`: "new obstacle", "missing wall" or "no return (glass?)", or "undecided" for what differs
        too often to be people, but in less than half of the runs (a door, a parking place).
    x, y
        Middle of its squares, weighted by readings, metres in the map frame.
    width, height
        Extent of its squares along x and y, metres.
    since
        First day from which on it differs, of 30 days that are tried at most; None: from the first day that the place
        was seen.
    rate
        Share of the beams since then with the chance to tell that differ.
    readings, beams
        The numbers behind the rate.
    runs_changed, runs, robots_changed, robots
        Runs in which the place differed since then, and in which it was seen; the same for robots.
    p_value
        Chance of so many runs that differ where nothing lasts; see `find_stale_places`.
    q_value
        The same, adjusted for all places of the site: of places with at most this, so large a share is false.
    corners
        (m, 2) lower left corners of its squares, metres.
    """

    kind: Kind
    reading: Reading
    x: float
    y: float
    width: float
    height: float
    since: datetime.date | None
    rate: float
    readings: int
    beams: int
    runs_changed: int
    runs: int
    robots_changed: int
    robots: int
    p_value: float
    q_value: float
    corners: FloatArray

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class StaleMap:
    """What the runs at one site say about its map.

    Parameters
    ----------
    site, map_hash
        Which map.
    grid
        The map.
    side
        Side of the squares, metres.
    places
        Those that differ for good first, and those with the most readings first.
    squares
        Rates per square.
    runs, robots, days
        How many runs, robots and days they come from.
    not_asked
        Robots left out of the count because too much differs for them everywhere.
    """

    site: str
    map_hash: str
    grid: OccupancyGrid
    side: float
    places: tuple[StalePlace, ...]
    squares: SquareRates
    runs: int
    robots: int
    days: int
    not_asked: tuple[str, ...]

    __repr__ = short_repr

    @property
    def lasting(self) -> tuple[StalePlace, ...]:
        """The places to map again."""
        return tuple(place for place in self.places if place.kind != "undecided")


def find_stale_places(
    catalogue: Catalogue, engine: Engine, fit: FleetFit, *, progress: Progress | None = None
) -> tuple[StaleMap, ...]:
    """Find the places to map again, site by site.

    Parameters
    ----------
    catalogue
        The fleet's beams.
    engine
        Where beams are judged; each run once.
    fit
        Parameters of robots, sites or the fleet.
    progress
        Called with shards done and in all.

    Returns
    -------
    One per site and map, by site. Of the places found, 5% may be false.

    Notes
    -----
    - Beams are judged as by `find_changed_places`. A run differs at a place if enough of its beams there do. So runs
      are counted, not beams: what stands there for one run makes a thousand readings and counts once.
    - Where nothing lasts, a run differs with a probability of at most 0.2, for people and doors. The p-value is the
      chance that so many of the runs from one day on differ, the largest over leaving out any one robot (one dirty
      lens is no new wall) and any one day (nor is a trolley that was parked for a day): at least two robots and two
      days must show it. It is multiplied by the number of days that were tried. A site with a single robot is judged
      by days alone.
    - Windows of 2 x 2 squares are tested; Benjamini and Hochberg's q-values hold over all windows that runs saw and
      all three kinds of readings. Windows overlap, and are positively dependent.
    - Robots for whom more than a fifth of all windows differ are not asked: their sensor, or their poses, are wrong.

    References
    ----------
    Benjamini and Hochberg, "Controlling the false discovery rate", Journal of the Royal Statistical Society B 57, 1995;
    Benjamini and Heller, "Screening for partial conjunction hypotheses", Biometrics 64, 2008, for what two or more must
    show. Probabilistic Robotics, section 6.3.1: unexpected objects make ranges shorter.
    """
    jobs, found = _jobs(catalogue, fit), list[StaleMap]()
    # One site at a time: that much is in memory.
    for (site, map_hash), some in groupby(jobs, key=lambda job: (job.shard.site, job.map_hash)):
        mine, before = list(some), sum(one.runs for one in found)
        show = None if progress is None else _later(progress, before, len(jobs))
        counts = engine.map(count_places, mine, progress=show)
        grid = catalogue.grid(mine[0].record)
        runs = SiteRuns.of([job.shard for job in mine], counts, Lattice.over(grid))
        found.append(_stale_map(site, map_hash, grid, runs))
    return tuple(found)


def _later(progress: Progress, before: int, total: int) -> Progress:
    """Return a progress that counts on from what was done before."""

    def show(done: int, _total: int) -> None:
        progress(before + done, total)

    return show


def _jobs(catalogue: Catalogue, fit: FleetFit) -> list[CountJob]:
    """Return the runs of lasers whose parameters are known, site by site."""
    records = {record.run: record for record in catalogue.used}
    # A copy without the records, which a catalogue keeps once it has read them.
    sent, jobs = replace(catalogue), []
    for shard in catalogue.shards():
        record = records[shard.run]
        parameters = _parameters(fit, record)
        if parameters is not None and sensor_limits(record).opening_angle == 0.0:
            jobs.append(CountJob(sent, shard, record, parameters))
    return sorted(jobs, key=lambda job: (job.shard.site, job.map_hash, job.shard.day, job.shard.path))


def _parameters(fit: FleetFit, record: RunRecord) -> BeamParameters | None:
    """Return the parameters of a run's robot, site or fleet, for its sensor's limits; None if there are none."""
    limits = sensor_limits(record)
    for one in fit.fits:
        if one.site in (None, record.site) and one.robot in (None, record.robot) and one.limits == limits:
            return one.parameters
    return None


def _stale_map(site: str, map_hash: str, grid: OccupancyGrid, runs: SiteRuns) -> StaleMap:
    not_asked = _not_asked(runs)
    runs = runs.without(not_asked)
    n = runs.lattice.rows * runs.lattice.cols
    visits = runs.visits()
    windows = [one.in_windows(runs.lattice.cols) for one in visits]
    tests = [judge_places(one, runs.robot, runs.day, n) for one in windows]
    # Every window that runs saw is a test, for each kind of readings.
    seen = [np.unique(one.place) for one in windows]
    q_values = [np.ones(n) for _ in READINGS]
    p_values = np.concatenate([test.p_value[of] for test, of in zip(tests, seen, strict=True)])
    if len(p_values):
        adjusted = np.split(false_discovery_control(p_values), np.cumsum([len(of) for of in seen])[:-1])
        for q, of, values in zip(q_values, seen, adjusted, strict=True):
            q[of] = values
    places = [
        place
        for reading, tally, visit, test, q in zip(READINGS, runs.tallies, visits, tests, q_values, strict=True)
        for place in _places(_Found(reading, runs, tally, visit, test, q), q <= FALSE_DISCOVERIES)
    ]
    places.sort(key=lambda place: (place.kind == "undecided", -place.readings))
    return StaleMap(
        site, map_hash, grid, runs.lattice.side, tuple(places), runs.rates(), len(runs.robot), len(runs.robots),
        len(runs.days), tuple(runs.robots[i] for i in not_asked),
    )  # fmt: skip


def _not_asked(runs: SiteRuns) -> NDArray[np.int64]:
    """Return the robots for whom more than the share of passing people differs everywhere."""
    windows = [one.in_windows(runs.lattice.cols) for one in runs.visits()]
    robot = np.concatenate([runs.robot[one.visit] for one in windows])
    differs = np.concatenate([one.differs for one in windows])
    seen, changed = (np.bincount(robot[rows], minlength=len(runs.robots)) for rows in (slice(None), differs))
    return np.flatnonzero(changed > MOST_PASSING * seen)


class _Found(NamedTuple):
    """Readings of one kind, in which runs squares differ, and the chances of windows."""

    reading: Reading
    runs: SiteRuns
    tally: Tally
    visits: Visits
    test: PlaceTest
    q_value: FloatArray


def _places(found: _Found, sure: NDArray[np.bool_]) -> Iterator[StalePlace]:
    """Join squares of windows that differ to places, and describe them."""
    shape = found.runs.lattice.shape
    sometimes = (found.visits.counts(len(sure))[0] > 0).reshape(shape)
    # Each window stands for its lowest square and the neighbours to the right and above.
    around = ndimage.binary_dilation(sure.reshape(shape), np.array([[0, 0, 0], [0, 1, 1], [0, 1, 1]]))
    labels, n_places = ndimage.label(sometimes & around, NEIGHBOURS)
    # The squares of a window adjoin, so those that are labelled have one label.
    of_window = ndimage.maximum_filter(labels, size=2, origin=-1, mode="constant").ravel()
    best = np.full(n_places + 1, -1)
    windows = np.flatnonzero(sure)
    windows = windows[np.argsort(-found.test.p_value[windows], kind="stable")]
    best[of_window[windows]] = windows
    joined = found.visits.joined(labels.ravel().astype(np.int64) - 1)
    for number in range(n_places):
        squares = np.flatnonzero(labels.ravel() == number + 1)
        yield _place(found, squares, joined.select(joined.place == number), int(best[number + 1]))


def _place(found: _Found, squares: NDArray[np.int64], visits: Visits, window: int) -> StalePlace:
    """Describe a place of these squares, by the runs to it and its most telling window."""
    runs, tally, start = found.runs, found.tally, int(found.test.since[window])
    later = runs.day[visits.visit] >= start
    changed = visits.visit[later & visits.differs]
    rows = np.isin(tally.place, squares) & (runs.day[tally.visit] >= start)
    readings, beams = int(tally.readings[rows].sum()), int(tally.beams[rows].sum())
    corners = runs.lattice.corners(squares)
    weights = np.bincount(np.searchsorted(squares, tally.place[rows]), tally.readings[rows], len(squares))
    x, y = (np.average(corners, axis=0, weights=weights) + 0.5 * runs.lattice.side).tolist()
    width, height = (np.ptp(corners, axis=0) + runs.lattice.side).tolist()
    lasts = len(changed) >= LEAST_RUNS * later.sum()
    return StalePlace(
        kind=LASTING[found.reading] if lasts else "undecided",
        reading=found.reading,
        x=x,
        y=y,
        width=width,
        height=height,
        since=runs.days[start] if start > runs.day[visits.visit].min() else None,
        rate=readings / beams,
        readings=readings,
        beams=beams,
        runs_changed=len(changed),
        runs=int(later.sum()),
        robots_changed=len(np.unique(runs.robot[changed])),
        robots=len(np.unique(runs.robot[visits.visit[later]])),
        p_value=float(found.test.p_value[window]),
        q_value=float(found.q_value[window]),
        corners=corners,
    )
