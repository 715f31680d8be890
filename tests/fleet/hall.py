"""A hall whose map is out of date, seen by a few robots for a few days."""

from __future__ import annotations

import datetime
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
from benchmarks.fleet_beams import FIRST_DAY, MemoryCatalogue, MemoryShard

from beamfield.calibration.beam_table import build_beam_table
from beamfield.fleet.engine import Engine
from beamfield.fleet.run_record import MapInfo, RunRecord
from beamfield.fleet.shard_passes import SensorLimits
from beamfield.fleet.stale_map import StaleMap, find_stale_places
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.sensors import RangeFinder, SensorLog

TRUTH = BeamParameters(0.9, 0.02, 0.03, 0.05, 0.02, 0.5)
FINDER = RangeFinder.from_bearings(np.linspace(-3.0, 3.0, 60), 10.0)
MAPPED_BOX, NEW_BOX, TROLLEY, PHANTOM = ((1.0, 1.0), (5.0, 3.0), (2.0, 4.5), (6.5, 1.5))
ORIGIN = np.array([3.0, -2.0, 0.4])
SITE = "hall/<1>"
SINCE, DAYS, ROBOTS = 2, 6, 3


def room(*boxes: tuple[float, float]) -> OccupancyGrid:
    """A room of 8 x 6 metres with boxes of half a metre, turned in the map frame."""
    cells = np.zeros((120, 160), np.float32)
    cells[[0, 1, -2, -1]] = cells[:, [0, 1, -2, -1]] = 1.0
    for x, y in boxes:
        cells[round(y / 0.05) - 5 : round(y / 0.05) + 5, round(x / 0.05) - 5 : round(x / 0.05) + 5] = 1.0
    return OccupancyGrid(cells, 0.05, ORIGIN)


def in_map(point: tuple[float, float]) -> np.ndarray:
    return compose(ORIGIN, [*point, 0.0])[:2]


@cache
def stale_hall() -> StaleMap:
    """From a day on a mapped box stands elsewhere; on one day a trolley is there, and one robot sees a phantom."""
    rng, grid = np.random.default_rng(0), room(MAPPED_BOX)
    shards = []
    for day in range(DAYS):
        for robot in range(ROBOTS):
            boxes = [MAPPED_BOX] if day < SINCE else [NEW_BOX]
            boxes += [TROLLEY] if day == 4 else []
            boxes += [PHANTOM] if robot == 1 else []
            world = room(*boxes)
            poses = compose(ORIGIN, np.column_stack([rng.uniform(2.4, 4.2, 40), rng.uniform(0.8, 4.0, 40),
                                                     rng.uniform(-3.0, 3.0, 40)]))  # fmt: skip
            expected = RayCaster(world).expected_ranges(poses, FINDER)
            ranges = sample_beams(expected, 10.0, TRUTH, rng)
            log = SensorLog(FINDER, np.arange(40.0), ranges, poses, np.full_like(poses, np.nan))
            beams = build_beam_table(log, grid, np.arange(40))
            x, y, heading = poses[beams.scan].T
            columns = {
                "scan": beams.scan, "beam": beams.beam, "stamp": beams.stamps + 1e5 * day, "x": x, "y": y,
                "range": beams.ranges.astype(np.float32), "heading": heading,
                "expected_range": beams.expected_ranges.astype(np.float32),
            }  # fmt: skip
            date = FIRST_DAY + datetime.timedelta(days=day)
            run = f"r{robot}-{day}"
            shards.append(MemoryShard(SITE, f"r{robot}", date, run, columns, path=run))
    sensor = {"mounts": FINDER.mounts.tolist(), "max_range": 10.0, "min_range": 0.0, "opening_angle": 0.0}
    known = MapInfo(0.05, (0.0, 0.0, 0.0), grid.shape, "0123456789abcdef" * 4)
    records = tuple(
        RunRecord(run=one.run, robot=one.robot, site=one.site, key="", log="", map="", poses="", log_sensor="",
                  log_hash="", status="used", sensor=sensor, map_info=known)
        for one in shards
    )  # fmt: skip
    # A sonar of equal limits, whose parameters are not the laser's.
    fits = [
        SimpleNamespace(site=None, robot=None, limits=SensorLimits(10.0, 0.0, angle), parameters=parameters)
        for angle, parameters in ((0.3, replace(TRUTH, sigma_hit=5.0)), (0.0, TRUTH))
    ]
    fit = SimpleNamespace(fits=fits)
    with Engine("serial") as engine:
        (found,) = find_stale_places(MemoryCatalogue(records, tuple(shards), grid), engine, fit)
    return found
