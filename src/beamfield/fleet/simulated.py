"""A simulated fleet: which robots drive where, what is wrong with them, and what a drive of one of them records."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import get_args

import numpy as np

from beamfield.arguments import as_count, check_fields, checked, require
from beamfield.fleet.daily import FaultKind
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, ScanLog, SensorLog
from beamfield.simulation.changed_world import Change, change_world
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.simulation.odometry import OdometryNoise

FAULT_KINDS: tuple[FaultKind, ...] = get_args(FaultKind)
# One robot in so many has each fault, and at most half of the robots have one.
ROBOTS_PER_FAULT = 12
# Size of a fault, from and to: share of readings that dirt swallows (and as many that it cuts short), radians, metres,
# share of the distance.
SIZES: dict[FaultKind, tuple[float, float]] = {
    "dirty-lens": (0.15, 0.3), "turned-mount": (0.017, 0.035), "range-bias": (0.03, 0.06), "wheel-scale": (0.02, 0.04),
}  # fmt: skip
# Width of the dirty sector, radians, and how far from the lens the light comes back from dirt, metres.
DIRTY_SECTOR, DIRT = (0.6, 1.2), (0.08, 0.8)
# What healthy robots and sites differ by: a factor's log, metres, radians.
SPREAD, SITE_SPREAD, BIAS_SPREAD, YAW_SPREAD, SCALE_SPREAD = 0.05, 0.3, 0.001, 0.001, 0.002
TYPICAL = BeamParameters(0.86, 0.06, 0.03, 0.05, sigma_hit=0.02, lambda_short=0.5, range_offset=0.01)
# Readings that people and bad surfaces spoil come in bursts.
DEPENDENCE = Dependence(angle=np.radians(3.0), time=0.5)
MAX_RANGE, MIN_RANGE, MOUNT, FIELD_OF_VIEW = 12.0, 0.05, (0.1, 0.0, 0.0), np.radians(270.0)
# Robots start their day one after the other, seconds of the day.
FIRST_START, BETWEEN_STARTS = 8 * 3600.0, 600.0
# Range finders report millimetres.
RESOLUTION = 0.001


@dataclass(frozen=True)
class FleetSize:
    """How large a simulated fleet is.

    Parameters
    ----------
    robots, sites, days
        Robots in all, spread evenly over sites; each drives once a day.
    duration
        Of a drive, seconds.
    scan_rate
        Scans per second.
    beams
        Of a scan, over 270 degrees.
    width, height
        Of each building, metres; see `draw_floor_plan`.
    first_day
        Date of the first drives.

    Raises
    ------
    InvalidInputError
        If a number is out of range or there are more sites than robots.
    """

    robots: int = 24
    sites: int = 3
    days: int = 14
    duration: float = 180.0
    scan_rate: float = 4.0
    beams: int = 90
    width: float = 30.0
    height: float = 22.0
    first_day: datetime.date = datetime.date(2026, 3, 2)

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("robots", "sites", "days", "beams"):
            as_count(getattr(self, name), name, least=1, most=10_000)
        require(self.sites <= self.robots, "sites", f"at most one per robot ({self.robots})", self.sites)
        require(0.0 < self.duration <= 80_000.0, "duration", "0 to 80000 seconds", self.duration)
        require(0.0 < self.scan_rate <= 100.0, "scan_rate", "0 to 100 scans per second", self.scan_rate)

    @property
    def drives(self) -> int:
        """How many logs there are."""
        return self.robots * self.days

    @property
    def bytes(self) -> int:
        """About how large the logs are together: a reading takes 2.4 bytes in compressed text."""
        return round(self.drives * self.duration * self.scan_rate * (2.4 * self.beams + 60.0))

    def date(self, day: int) -> datetime.date:
        """Return the date of a day, counted from 0."""
        return self.first_day + datetime.timedelta(days=day)


@dataclass(frozen=True)
class Fault:
    """What is wrong with a robot.

    Parameters
    ----------
    kind
        One of `FAULT_KINDS`.
    since
        First day, counted from 0.
    size
        Share of the sector's readings that are lost, and that are cut short, radians, metres, or share of the distance.
    sector
        First and last bearing of dirt, radians.
    """

    kind: FaultKind
    since: int
    size: float
    sector: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Site:
    """A building, its name, and the day (from 0) since when it is no longer as mapped; None: it is."""

    name: str
    seed: int
    changed_since: int | None


@dataclass(frozen=True)
class Robot:
    """A robot: its site, its truth as long as it is healthy, and what is wrong with it.

    Parameters
    ----------
    name, site
        Its name, and the number of its site.
    parameters, odometry
        Of its range finder and its wheels.
    yaw
        Of the range finder beyond its nominal mount, radians.
    fault
        None for a healthy robot.
    """

    name: str
    site: int
    parameters: BeamParameters
    odometry: OdometryNoise
    yaw: float
    fault: Fault | None


@dataclass(frozen=True)
class FleetPlan:
    """Everything that a simulated fleet's logs follow from.

    Parameters
    ----------
    size, seed
        As given.
    sites, robots
        As drawn from the seed.
    """

    size: FleetSize
    seed: int
    sites: tuple[Site, ...]
    robots: tuple[Robot, ...]


@checked
def plan_fleet(size: FleetSize, *, seed: int = 1) -> FleetPlan:
    """Draw robots, sites and faults.

    The last site changes after half of the time. Of each kind of fault there is one robot in `ROBOTS_PER_FAULT`, at
    least one, but half of the robots are healthy; the first one of a kind goes wrong within the time, so that a change
    can be seen, and every other one is wrong from the first day on, but for dirt.

    Parameters
    ----------
    size
        How large.
    seed
        Chooses everything.

    Examples
    --------
    >>> plan = plan_fleet(FleetSize(robots=8, sites=2, days=6))
    >>> [robot.name for robot in plan.robots if robot.fault is None]
    ['robot-02', 'robot-03', 'robot-06', 'robot-07']
    """
    as_count(seed, "seed", least=0)
    rng = np.random.default_rng(seed)
    sites = tuple(
        Site(f"site-{number + 1}", seed + number, size.days // 2 if number == size.sites - 1 else None)
        for number in range(size.sites)
    )
    people = TYPICAL.z_short * np.exp(SITE_SPREAD * rng.standard_normal(size.sites))
    faults = dict(zip(rng.permutation(size.robots).tolist(), _faults(size, rng), strict=False))
    robots = tuple(
        _robot(number, number % size.sites, float(people[number % size.sites]), faults.get(number), rng)
        for number in range(size.robots)
    )
    return FleetPlan(size, seed, sites, robots)


def _faults(size: FleetSize, rng: np.random.Generator) -> Iterator[Fault]:
    each = max(1, size.robots // ROBOTS_PER_FAULT)
    for number in range(min(each * len(FAULT_KINDS), size.robots // 2)):
        kind = FAULT_KINDS[number % len(FAULT_KINDS)]
        begins_later = number < len(FAULT_KINDS) or kind == "dirty-lens"
        since = int(rng.integers(max(1, size.days // 3), max(2, 2 * size.days // 3))) if begins_later else 0
        start, width = float(rng.uniform(-0.4, 0.25) * FIELD_OF_VIEW), float(rng.uniform(*DIRTY_SECTOR))
        sign = 1.0 if kind == "dirty-lens" else rng.choice([-1.0, 1.0])
        amount = float(sign * rng.uniform(*SIZES[kind]))
        yield Fault(kind, since, amount, (start, start + width) if kind == "dirty-lens" else (0.0, 0.0))


def _robot(number: int, site: int, z_short: float, fault: Fault | None, rng: np.random.Generator) -> Robot:
    log_factors = SPREAD * rng.standard_normal(4)
    z_max, z_rand, sigma = np.array([TYPICAL.z_max, TYPICAL.z_rand, TYPICAL.sigma_hit]) * np.exp(log_factors[:3])
    z_short *= float(np.exp(log_factors[3]))
    bias, yaw, scale = (np.array([BIAS_SPREAD, YAW_SPREAD, SCALE_SPREAD]) * rng.standard_normal(3)).tolist()
    parameters = BeamParameters(
        1.0 - z_short - z_max - z_rand, z_short, float(z_max), float(z_rand), float(sigma), TYPICAL.lambda_short,
        TYPICAL.range_offset + bias,
    )  # fmt: skip
    odometry = OdometryNoise(distance_scale=scale, turn_scale=scale)
    return Robot(f"robot-{number + 1:02d}", site, parameters, odometry, yaw, fault)


def nominal_finder(size: FleetSize) -> RangeFinder:
    """Return the range finder as the robots' software knows it."""
    bearings = np.linspace(-FIELD_OF_VIEW / 2, FIELD_OF_VIEW / 2, size.beams)
    return RangeFinder.from_bearings(bearings, MAX_RANGE, mount=MOUNT, min_range=MIN_RANGE, name="laser")


@lru_cache(maxsize=8)
def site_map(size: FleetSize, site: Site) -> OccupancyGrid:
    """Return the map of a site."""
    return draw_floor_plan(seed=site.seed, width=size.width, height=size.height)


@lru_cache(maxsize=8)
def changed_site(size: FleetSize, site: Site) -> tuple[OccupancyGrid, tuple[Change, ...]]:
    """Return the world of a site after it has changed, and what is new or gone there."""
    bare = draw_floor_plan(seed=site.seed, width=size.width, height=size.height, furnished=False)
    return change_world(site_map(size, site), bare, np.random.default_rng(site.seed))


def simulate_drive(plan: FleetPlan, number: int, day: int) -> tuple[ScanLog, FloatArray]:
    """Return what a robot records on a day, with odometry but without poses, and its true poses (t, 3).

    Robots and days are counted from 0.
    """
    size, robot = plan.size, plan.robots[number]
    site = plan.sites[robot.site]
    is_changed = site.changed_since is not None and day >= site.changed_since
    world = changed_site(size, site)[0] if is_changed else site_map(size, site)
    fault = robot.fault if robot.fault is not None and day >= robot.fault.since else None
    parameters, odometry, yaw = robot.parameters, robot.odometry, robot.yaw
    if fault is not None and fault.kind == "range-bias":
        parameters = replace(parameters, range_offset=parameters.range_offset + fault.size)
    if fault is not None and fault.kind == "wheel-scale":
        odometry = replace(odometry, distance_scale=odometry.distance_scale + fault.size)
    if fault is not None and fault.kind == "turned-mount":
        yaw += fault.size
    nominal = nominal_finder(size)
    drive_seed, dirt_seed = np.random.SeedSequence([plan.seed, number, day]).generate_state(2).tolist()
    midnight = datetime.datetime.combine(size.date(day), datetime.time(), datetime.UTC).timestamp()
    log = simulate_log(
        world, replace(nominal, mounts=nominal.mounts + np.array([0.0, 0.0, yaw])), parameters,
        duration=size.duration, scan_rate=size.scan_rate, seed=drive_seed,
        start=midnight + FIRST_START + number * BETWEEN_STARTS, odometry_noise=odometry, dependence=DEPENDENCE,
    )  # fmt: skip
    sensor = log.only_sensor()
    ranges = sensor.ranges
    if fault is not None and fault.kind == "dirty-lens":
        ranges = _through_dirt(ranges, nominal, fault, np.random.default_rng(dirt_seed))
    ranges = np.round(ranges / RESOLUTION) * RESOLUTION
    recorded: SensorLog = replace(sensor, finder=nominal, ranges=ranges, poses=np.full_like(sensor.poses, np.nan))
    return replace(log, sensors={"laser": recorded}), sensor.poses


def _through_dirt(ranges: FloatArray, finder: RangeFinder, fault: Fault, rng: np.random.Generator) -> FloatArray:
    """Return readings of which dirt in a sector swallows some and sends others back at once."""
    dirty = (finder.bearings >= fault.sector[0]) & (finder.bearings <= fault.sector[1])
    fate = rng.random(ranges.shape)
    ranges = np.where(dirty & (fate < fault.size), np.inf, ranges)
    cut = dirty & (fate >= fault.size) & (fate < 2.0 * fault.size)
    return np.where(cut, np.minimum(ranges, rng.uniform(*DIRT, ranges.shape)), ranges)
