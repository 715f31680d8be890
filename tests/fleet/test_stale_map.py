"""Where a map is out of date: what stands for good is found with its day, what stood for a day or one robot is not."""

from __future__ import annotations

import datetime
import json

import numpy as np
import pytest

from beamfield.fleet.report_files import disagreement_map, places_as_geojson
from tests.fleet.hall import DAYS, FIRST_DAY, MAPPED_BOX, NEW_BOX, PHANTOM, ROBOTS, SINCE, SITE, in_map, stale_hall


def test_what_is_new_or_gone_for_good_is_found_since_its_day_and_nothing_else():
    stale = stale_hall()
    assert (stale.site, stale.not_asked) == (SITE, ())
    assert (stale.runs, stale.robots, stale.days) == (ROBOTS * DAYS, ROBOTS, DAYS)
    day = FIRST_DAY + datetime.timedelta(days=SINCE)
    assert {place.kind for place in stale.lasting} == {"new obstacle", "missing wall"}
    for place in stale.lasting:
        at = in_map(NEW_BOX if place.kind == "new obstacle" else MAPPED_BOX)
        assert np.hypot(*(at - [place.x, place.y])) < 0.5
        assert place.since == day
        assert (place.robots_changed, place.robots) == (ROBOTS, ROBOTS)
        assert place.runs_changed >= 0.9 * place.runs
        assert place.p_value <= place.q_value < 0.01
        assert place.rate == pytest.approx(place.readings / place.beams)
    assert stale.places == stale.lasting


def test_rates_of_squares_are_those_of_the_beams():
    stale = stale_hall()
    squares = stale.squares
    assert squares.runs.max() == ROBOTS * DAYS
    assert squares.robots.max() == ROBOTS
    middle = np.column_stack([squares.x, squares.y]) + 0.125

    def near(point):
        return np.hypot(*(middle - in_map(point)).T) < 0.5

    assert (squares.short / np.maximum(squares.crossed, 1))[near(NEW_BOX)].max() > 0.3
    assert (squares.beyond / np.maximum(squares.tested, 1))[near(MAPPED_BOX)].max() > 0.5
    # One robot sees the phantom; it is in the rates, but is no place to map again.
    assert (squares.short / np.maximum(squares.crossed, 1))[near(PHANTOM)].max() > 0.1
    walls = (squares.tested >= 50) & ~near(MAPPED_BOX)
    assert np.median(squares.disagreement[walls]) < 0.15


def test_places_are_drawn_where_they_are():
    stale = stale_hall()
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
