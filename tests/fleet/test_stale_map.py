"""Where a map is out of date: what stands for good is found with its day, what stood for a day or one robot is not."""

from __future__ import annotations

import datetime
import json
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from beamfield.calibration.beam_table import build_beam_table
from beamfield.fleet.report_files import disagreement_map, places_as_geojson
from beamfield.fleet.run_record import MapInfo, RunRecord
from beamfield.fleet.stale_map import StaleMap, find_stale_places
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.sensors import RangeFinder, SensorLog
from tests.fleet.beams import FIRST_DAY, MemoryCatalogue, MemoryShard, SerialEngine

TRUTH = BeamParameters(0.9, 0.02, 0.03, 0.05, 0.02, 0.5)
FINDER = RangeFinder.from_bearings(np.linspace(-3.0, 3.0, 60), 10.0)
MAPPED_BOX, NEW_BOX, TROLLEY, PHANTOM = ((1.0, 1.0), (5.0, 3.0), (2.0, 4.5), (6.5, 1.5))
ORIGIN = np.array([3.0, -2.0, 0.4])
SINCE, DAYS, ROBOTS = 3, 8, 4


@dataclass(frozen=True, eq=False)
class MappedCatalogue(MemoryCatalogue):
    mapped: Any = None

    def grid(self, _record: Any) -> OccupancyGrid:
        return self.mapped


def room(*boxes: tuple[float, float]) -> OccupancyGrid:
    """A room of 8 x 6 metres with boxes of half a metre, turned in the map frame."""
    cells = np.zeros((120, 160), np.float32)
    cells[[0, 1, -2, -1]] = cells[:, [0, 1, -2, -1]] = 1.0
    for x, y in boxes:
        cells[round(y / 0.05) - 5 : round(y / 0.05) + 5, round(x / 0.05) - 5 : round(x / 0.05) + 5] = 1.0
    return OccupancyGrid(cells, 0.05, ORIGIN)


def in_map(point: tuple[float, float]) -> np.ndarray:
    return compose(ORIGIN, [*point, 0.0])[:2]


@pytest.fixture(scope="module")
def stale() -> StaleMap:
    rng, grid = np.random.default_rng(0), room(MAPPED_BOX)
    shards = []
    for day in range(DAYS):
        for robot in range(ROBOTS):
            boxes = [MAPPED_BOX] if day < SINCE else [NEW_BOX]
            boxes += [TROLLEY] if day == 5 else []
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
            shards.append(MemoryShard("hall", f"r{robot}", date, f"r{robot}-{day}", columns, f"{day}/{robot}"))
    sensor = {"mounts": FINDER.mounts.tolist(), "max_range": 10.0, "min_range": 0.0, "opening_angle": 0.0}
    known = MapInfo(0.05, (0.0, 0.0, 0.0), grid.shape, "0123456789abcdef")
    records = tuple(
        RunRecord(run=one.run, robot=one.robot, site=one.site, key="", log="", map="", poses="", log_sensor="",
                  log_hash="", status="used", sensor=sensor, map_info=known)
        for one in shards
    )  # fmt: skip
    limits = SimpleNamespace(max_range=10.0, min_range=0.0)
    fit = SimpleNamespace(fits=[SimpleNamespace(site=None, robot=None, limits=limits, parameters=TRUTH)])
    (found,) = find_stale_places(MappedCatalogue(records, tuple(shards), grid), SerialEngine(), fit)
    return found


def test_what_is_new_or_gone_for_good_is_found_since_its_day_and_nothing_else(stale):
    assert (stale.site, stale.runs, stale.robots, stale.days, stale.not_asked) == ("hall", 32, 4, 8, ())
    day = FIRST_DAY + datetime.timedelta(days=SINCE)
    assert {place.kind for place in stale.lasting} == {"new obstacle", "missing wall"}
    for place in stale.lasting:
        at = in_map(NEW_BOX if place.kind == "new obstacle" else MAPPED_BOX)
        assert np.hypot(*(at - [place.x, place.y])) < 0.5
        assert place.since == day
        assert (place.robots_changed, place.robots) == (4, 4)
        assert place.runs_changed >= 0.9 * place.runs
        assert place.p_value <= place.q_value < 1e-3
        assert place.rate == pytest.approx(place.readings / place.beams)
    assert stale.places == stale.lasting


def test_rates_of_squares_are_those_of_the_beams(stale):
    squares = stale.squares
    assert squares.runs.max() == 32
    assert squares.robots.max() == 4
    middle = np.column_stack([squares.x, squares.y]) + 0.125

    def near(point):
        return np.hypot(*(middle - in_map(point)).T) < 0.5

    assert (squares.short / np.maximum(squares.crossed, 1))[near(NEW_BOX)].max() > 0.3
    assert (squares.beyond / np.maximum(squares.tested, 1))[near(MAPPED_BOX)].max() > 0.5
    # A quarter of the robots see the phantom; it is in the rates, but is no place to map again.
    assert (squares.short / np.maximum(squares.crossed, 1))[near(PHANTOM)].max() > 0.1
    walls = (squares.tested >= 50) & ~near(MAPPED_BOX)
    assert np.median(squares.disagreement[walls]) < 0.15


def test_places_are_drawn_where_they_are(stale):
    drawn = disagreement_map(stale)
    assert drawn.shape == stale.grid.shape
    np.testing.assert_array_equal(drawn.origin, stale.grid.origin)
    values = np.nan_to_num(drawn.probability)
    np.testing.assert_allclose(100.0 * values, np.round(100.0 * values), atol=1e-4)
    row, col = (int(v / 0.05) for v in NEW_BOX[::-1])
    assert values[row - 6 : row + 6, col - 8 : col].max() > 0.3
    collection = json.loads(json.dumps(places_as_geojson(stale), allow_nan=False))
    assert len(collection["features"]) == len(stale.lasting)
    for feature, place in zip(collection["features"], stale.lasting, strict=True):
        rings = np.array(feature["geometry"]["coordinates"])
        assert rings.shape == (len(place.corners), 1, 5, 2)
        np.testing.assert_allclose(rings[:, 0, 0], place.corners)
        assert feature["properties"]["since"] == place.since.isoformat()
