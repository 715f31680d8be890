"""A fleet's catalogue in memory, with beams drawn from known parameters."""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beamfield.fleet.run_record import MapInfo, OdometryErrors, RunRecord
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams

FIRST_DAY = datetime.date(2026, 3, 1)
# What the record of a run says of files that there are not.
_WITHOUT_LOGS = ("key", "log", "map", "poses", "log_sensor", "log_hash")


@dataclass(frozen=True, eq=False)
class MemoryShard:
    site: str
    robot: str
    day: datetime.date
    run: str
    columns: Mapping[str, np.ndarray]
    path: str = ""

    @property
    def rows(self) -> int:
        return len(self.columns["range"])

    def read(self, columns: Sequence[str], *, fit_only: bool = False, thin: int = 1) -> dict[str, np.ndarray]:
        rows = (self.columns["scan"] + self.columns["beam"]) % thin == 0
        if fit_only:
            rows &= ~self.columns["held_out"]
        return {name: self.columns[name][rows] for name in columns}

    def batches(self, columns: Sequence[str], rows: int, **options: Any) -> Iterator[dict[str, np.ndarray]]:
        whole = self.read(columns, **options)
        n = len(whole[columns[0]])
        for start in range(0, n, rows):
            yield {name: column[start : start + rows] for name, column in whole.items()}


@dataclass(frozen=True, eq=False)
class MemoryCatalogue:
    used: tuple[RunRecord, ...]
    all_shards: tuple[MemoryShard, ...]
    mapped: OccupancyGrid | None = None

    @property
    def runs(self) -> tuple[RunRecord, ...]:
        return self.used

    def shards(self) -> tuple[MemoryShard, ...]:
        return self.all_shards

    def grid(self, _record: RunRecord) -> OccupancyGrid | None:
        return self.mapped


def memory_shard(
    rng: np.random.Generator,
    parameters: BeamParameters,
    *,
    site: str = "north",
    robot: str = "r1",
    day: int = 0,
    n_scans: int = 40,
    n_beams: int = 90,
    max_range: float = 8.1,
    min_range: float = 0.0,
) -> MemoryShard:
    """Scans every 10 s of beams all around; a tenth of the rays hit nothing, a third of the time is held out."""
    n = n_scans * n_beams
    scan, beam = np.divmod(np.arange(n), n_beams)
    expected = rng.uniform(0.3, 8.0, n)
    expected[rng.random(n) < 0.1] = max_range
    ranges = sample_beams(expected, max_range, parameters, rng, min_range=min_range)
    date = FIRST_DAY + datetime.timedelta(days=day)
    start = datetime.datetime(date.year, date.month, date.day, 8, tzinfo=datetime.UTC).timestamp()
    columns = {
        "stamp": start + 10.0 * scan,
        "scan": scan.astype(np.int32),
        "beam": beam.astype(np.int32),
        "bearing": (-np.pi + (beam + 0.5) * (2.0 * np.pi / n_beams)).astype(np.float32),
        "range": ranges.astype(np.float32),
        "expected_range": expected.astype(np.float32),
        "held_out": scan // 8 % 3 == 1,
    }
    return MemoryShard(site, robot, date, f"{robot}-{day}", columns, f"site={site}/robot={robot}/day={date}")


def memory_catalogue(shards: Sequence[MemoryShard], odometry: Mapping[str, OdometryErrors] | None = None,
                     max_range: float = 8.1, min_range: float = 0.0) -> MemoryCatalogue:  # fmt: skip
    """Return the catalogue of shards, and of the systematic errors of odometry by run."""
    records = tuple(
        RunRecord(
            **dict.fromkeys(_WITHOUT_LOGS, ""),
            run=shard.run,
            robot=shard.robot,
            site=shard.site,
            status="used",
            first_stamp=float(shard.columns["stamp"][0]),
            last_stamp=float(shard.columns["stamp"][-1]),
            sensor={"mounts": [[0.0, 0.0, 0.0]], "max_range": max_range, "min_range": min_range, "opening_angle": 0.0},
            map_info=MapInfo(0.05, (0.0, 0.0, 0.0), (1, 1), 64 * "0"),
            odometry=(odometry or {}).get(shard.run),
        )
        for shard in shards
    )
    return MemoryCatalogue(records, tuple(shards))
