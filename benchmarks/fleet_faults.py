"""Simulated fleets with known faults: how often each is found, how soon, and how often there is a false alarm.

``python -m benchmarks.fleet_faults [FLEETS]`` prints the table of docs/evidence/fleet.md. Beams are drawn without
ray casting.
What varies without being a fault: people (shorts vary by robot, day and stretch of time), glass (no returns, by robot,
day and sector), maps (an offset per site), poses (an offset per day) and odometry (by robot and day).
"""

from __future__ import annotations

import datetime
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from benchmarks.fleet_beams import FIRST_DAY, MemoryCatalogue, MemoryShard, memory_catalogue

from beamfield.fleet.daily import DailySeries, daily_series
from beamfield.fleet.drift import Drift, find_drift
from beamfield.fleet.engine import Engine
from beamfield.fleet.learning import learn
from beamfield.fleet.run_record import OdometryErrors

MAX_RANGE = 8.0
N_BEAMS, N_SCANS = 180, 60
N_ROBOTS, N_SITES, N_DAYS = 24, 3, 14
# Standard deviations without any fault.
PEOPLE_OF_DAYS, PEOPLE_OF_BLOCKS, GLASS = 0.4, 0.7, 0.25
MAP_OFFSET, ROBOT_OFFSET, DAY_OFFSET = 0.01, 0.003, 0.002
ROBOT_YAW, DAY_YAW = np.radians(0.2), np.radians(0.1)
ROBOT_SCALE, DAY_SCALE = 0.003, 0.002


@dataclass(frozen=True)
class Planted:
    """A fault: its kind and size, and the index of its first day; day 0 is from the beginning.

    A dirty lens loses this share of the readings, more than before, within 22.5 degrees of a bearing, in radians: that
    fills one of the sectors of 30 degrees in which it is looked for.
    """

    fault: str
    size: float
    day: int
    bearing: float = 0.0


SIZES = {
    "dirty-lens": (0.05, 0.1, 0.3),
    "turned-mount": tuple(np.radians([0.3, 0.6, 1.5])),
    "range-bias": (0.01, 0.02, 0.05),
    "wheel-scale": (0.005, 0.01, 0.03),
}


def simulated_fleet(
    rng: np.random.Generator, planted: dict[int, Planted], *, n_robots: int = N_ROBOTS, n_sites: int = N_SITES,
    n_days: int = N_DAYS, n_scans: int = N_SCANS,
) -> MemoryCatalogue:  # fmt: skip
    """Return a fleet's beams and odometry; `planted` has the faults by number of the robot."""
    shards, odometry = [], {}
    of_sites = MAP_OFFSET * rng.normal(size=n_sites)
    for robot in range(n_robots):
        fault = planted.get(robot)
        people, glass = np.exp(0.3 * rng.normal(size=2)) * (0.08, 0.03)
        of_sectors = 0.4 * rng.normal(size=(24, 2))
        offset = of_sites[robot % n_sites] + ROBOT_OFFSET * rng.normal()
        yaw, scale = ROBOT_YAW * rng.normal(), ROBOT_SCALE * rng.normal()
        for day in range(n_days):
            now = fault if fault is not None and day >= fault.day else None
            shard = _day_of_beams(rng, robot, robot % n_sites, day, n_scans, (people, glass), of_sectors, offset, now)
            shards.append(shard)
            odometry[shard.run] = _odometry(rng, yaw, scale, now)
    return memory_catalogue(shards, odometry, max_range=MAX_RANGE)


def _day_of_beams(
    rng: np.random.Generator, robot: int, site: int, day: int, n_scans: int, shares: tuple[float, float],
    of_sectors: np.ndarray, offset: float, fault: Planted | None,
) -> MemoryShard:  # fmt: skip
    n = n_scans * N_BEAMS
    scan, beam = np.divmod(np.arange(n), N_BEAMS)
    bearing = -np.pi + (beam + 0.5) * (2.0 * np.pi / N_BEAMS)
    sector = beam * 24 // N_BEAMS
    odds = np.log(np.array(shares)) + of_sectors + GLASS * rng.normal(size=(24, 2))
    odds[:, 0] += PEOPLE_OF_DAYS * rng.normal()
    bursts = PEOPLE_OF_BLOCKS * rng.normal(size=n_scans // 5 + 1)[scan // 5]
    short = 1.0 / (1.0 + np.exp(-(odds[sector, 0] + bursts)))
    lost = 1.0 / (1.0 + np.exp(-odds[sector, 1]))
    bias = offset + DAY_OFFSET * rng.normal()
    if fault is not None and fault.fault == "dirty-lens":
        near = np.abs((bearing - fault.bearing + np.pi) % (2.0 * np.pi) - np.pi) < np.radians(22.5)
        lost = np.where(near, np.minimum(lost + fault.size, 1.0), lost)
    elif fault is not None and fault.fault == "range-bias":
        bias += fault.size
    expected = rng.uniform(0.5, 7.5, n)
    cause = rng.random(n)
    ranges = np.clip(expected + bias + 0.02 * rng.normal(size=n), 0.0, MAX_RANGE)
    ranges = np.where(cause < short, rng.uniform(0.0, expected), ranges)
    ranges = np.where(cause > 0.98, rng.uniform(0.0, MAX_RANGE, n), ranges)
    ranges = np.where(rng.random(n) < lost, MAX_RANGE, ranges)
    date = FIRST_DAY + datetime.timedelta(days=day)
    start = datetime.datetime(date.year, date.month, date.day, 8, tzinfo=datetime.UTC).timestamp()
    columns = {
        "stamp": start + 4.0 * scan,
        "scan": scan.astype(np.int32),
        "beam": beam.astype(np.int32),
        "bearing": bearing.astype(np.float32),
        "range": ranges.astype(np.float32),
        "expected_range": expected.astype(np.float32),
        "held_out": scan // 5 % 3 == 1,
    }
    name = f"r{robot:02d}"
    return MemoryShard(f"s{site}", name, date, f"{name}-{day}", columns, f"site=s{site}/robot={name}/day={date}")


def _odometry(rng: np.random.Generator, yaw: float, scale: float, fault: Planted | None) -> OdometryErrors:
    errors = np.array([np.radians(0.1), 0.002])
    values = np.array([yaw + DAY_YAW * rng.normal(), scale + DAY_SCALE * rng.normal()]) + errors * rng.normal(size=2)
    for i, kind in enumerate(("turned-mount", "wheel-scale")):
        if fault is not None and fault.fault == kind:
            values[i] += fault.size
    covariance = np.diag(errors**2)
    return OdometryErrors(("yaw", "distance_scale"), tuple(values), tuple(map(tuple, covariance)))


def series_of(catalogue: MemoryCatalogue) -> tuple[DailySeries, ...]:
    """Return the daily numbers of a fleet, learned as a user's program does."""
    with Engine("serial") as engine:
        return daily_series(catalogue, engine, learn(catalogue, engine, thin=20))


def find(drifts: Sequence[Drift], robot: int, planted: Planted) -> Drift | None:
    """Return the alarm that names a planted fault: the right robot, the right fault, the right kind of beginning."""
    for drift in drifts:
        same = drift.robot == f"r{robot:02d}" and drift.fault == planted.fault
        if drift.alarm and same and (drift.since is None) == (planted.day == 0):
            return drift
    return None


def up_to(series: Sequence[DailySeries], n_days: int) -> tuple[DailySeries, ...]:
    """Return what was known after so many days."""
    kept = []
    for item in series:
        n = sum((day - FIRST_DAY).days < n_days for day in item.days)
        cut = {name: getattr(item, name)[:n] for name in ("values", "standard_errors", "contrasts", "contrast_errors")}
        if n:
            kept.append(replace(item, days=item.days[:n], **cut))
    return tuple(kept)


def plant(rng: np.random.Generator, fleet: int) -> dict[int, Planted]:
    """Return one fault of each kind on its robot; sizes and first days take turns over the fleets."""
    planted = {}
    for k, (fault, sizes) in enumerate(SIZES.items()):
        size = sizes[fleet % 3] * (1.0 if fault == "dirty-lens" else rng.choice([-1.0, 1.0]))
        for robot, day in ((2 * k, int(rng.integers(4, 11))), (2 * k + 1, 0)):
            planted[robot] = Planted(fault, size, day, rng.uniform(-np.pi, np.pi))
    return planted


def main() -> None:
    """Print the table."""
    n_fleets = int(sys.argv[1]) if len(sys.argv) > 1 else 6
    found: dict[tuple[str, float, bool], list[Outcome]] = {}
    false_alarms = 0
    for fleet in range(n_fleets):
        rng = np.random.default_rng(fleet)
        planted = plant(rng, fleet)
        series = series_of(simulated_fleet(rng, planted))
        reports = {day: find_drift(up_to(series, day)) for day in range(5, N_DAYS + 1)}
        for robot, fault in planted.items():
            key = (fault.fault, abs(fault.size), fault.day == 0)
            found.setdefault(key, []).append(outcome(reports, robot, fault))
        healthy = {f"r{robot:02d}" for robot in range(len(planted), N_ROBOTS)}
        false_alarms += sum(drift.alarm and drift.robot in healthy for drift in reports[N_DAYS])
        print(f"fleet {fleet + 1} of {n_fleets}", file=sys.stderr)
    print("| fault | size | since | fleets | found | days to the alarm | first day within 1 | intervals hold |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for (fault, size, first), outcomes in sorted(found.items()):
        print(_line(fault, size, first, outcomes))
    print(f"\nFalse alarms of {N_ROBOTS - len(planted)} healthy robots in {n_fleets} fleets: {false_alarms}")


@dataclass(frozen=True)
class Outcome:
    """Days of the fault until the first alarm (None: none in 14 days), and what the last report says of it."""

    delay: int | None
    day_is_right: bool
    interval_holds: bool


def outcome(reports: dict[int, tuple[Drift, ...]], robot: int, planted: Planted) -> Outcome:
    """Return what the reports of a fleet say of a planted fault."""
    last = find(reports[N_DAYS], robot, planted)
    if last is None:
        return Outcome(None, False, False)
    first = min(day for day, drifts in reports.items() if find(drifts, robot, planted) is not None)
    day_is_right = last.since is None or abs((last.since - FIRST_DAY).days - planted.day) <= 1
    return Outcome(first - planted.day, day_is_right, last.low <= planted.size <= last.high)


def _line(fault: str, size: float, first: bool, outcomes: Sequence[Outcome]) -> str:
    scale, unit = {"turned-mount": (180.0 / np.pi, "deg"), "range-bias": (100.0, "cm")}.get(fault, (100.0, "%"))
    seen = [item for item in outcomes if item.delay is not None]
    cells = [fault, f"{size * scale:.3g} {unit}", "first day" if first else "day 5 to 11", str(len(outcomes))]
    cells.append(f"{100.0 * len(seen) / len(outcomes):.0f}%")
    cells.append(f"{np.median([item.delay for item in seen]):.0f}" if seen else "")
    cells.append(f"{100.0 * np.mean([item.day_is_right for item in seen]):.0f}%" if seen and not first else "")
    cells.append(f"{100.0 * np.mean([item.interval_holds for item in seen]):.0f}%" if seen else "")
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
