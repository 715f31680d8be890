"""The picture of changed places: what is drawn where, the table beside it, and what JSON holds."""

from __future__ import annotations

import base64
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report.as_json import json_text, plain
from beamfield.report.places_figure import COLOURS, places_figure
from beamfield.scan_fit.changed_places import KINDS, ChangedPlace, ChangedPlaces

GRID = OccupancyGrid.from_ros(np.zeros((80, 80), int), 0.1)
PATH = np.array([[1.0, 1.0], [1.5, 1.0], [np.nan, np.nan], [7.0, 1.0]])


def place(kind, reading, x: float, readings: int = 50) -> ChangedPlace:
    corners = np.array([[x + 0.25 * i, 4.0 + 0.25 * j] for i in range(4) for j in range(4)])
    numbers = (x + 0.5, 4.5, 1.0, 0.9, 0.5, (0.25, 0.75), readings, 2 * readings, 3, 4, 0.97)
    return ChangedPlace(kind, reading, *numbers, corners=corners)


@pytest.fixture
def found() -> ChangedPlaces:
    places = (
        place("new obstacle", "short", 1.0),
        place("missing wall", "beyond", 2.5, readings=70),
        place("passing (people)", "short", 4.0),
        place("undecided", "no return", 5.5),
    )
    return ChangedPlaces(places, 0.25, 0.04, 100, 20.0, ())


def pixels(markup: str) -> np.ndarray:
    data = base64.b64decode(re.search(r'base64,([^"]+)"', markup)[1])
    return np.asarray(Image.open(io.BytesIO(data)).convert("RGB")).astype(int)


def colour(text: str) -> np.ndarray:
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)])


def test_each_kind_is_drawn_in_its_colour_and_counted_in_words(found):
    drawn = places_figure(found, GRID, PATH)
    picture = drawn.panels[0].markup
    image = pixels(picture)
    assert "1 new obstacle, 1 missing wall, 0 no return (glass?), 1 passing (people), 1 undecided" in picture
    area = 16 * (0.25 / 8.0 * 0.8 * image.shape[1]) ** 2
    for kind in ("new obstacle", "passing (people)"):
        shade = 255 + 0.85 * (colour(COLOURS[kind]) - 255)
        assert (np.abs(image - shade).max(axis=2) < 12).sum() > 0.5 * area, kind
    pale = 255 + 0.35 * (colour(COLOURS["no return (glass?)"]) - 255)
    assert (np.abs(image - pale).max(axis=2) < 12).sum() > 0.5 * area
    assert "A visit is a block of 20 s" in drawn.caption


def test_the_table_lists_what_differs_for_good_with_the_most_readings_first(found):
    table = places_figure(found, GRID, PATH).panels[1].markup
    rows = [re.findall(r"<t[hd][^>]*>([^<]*)</t[hd]>", row) for row in re.findall(r"<tr>.*?</tr>", table)][1:]
    assert rows == [
        ["1", "missing wall", "3.00", "4.50", "1.0 x 0.9", "50%", "25% to 75%", "3 of 4"],
        ["2", "new obstacle", "1.50", "4.50", "1.0 x 0.9", "50%", "25% to 75%", "3 of 4"],
    ]


def test_places_that_do_not_last_need_no_table_and_none_no_picture(found):
    people = replace(found, places=found.of_kind("passing (people)"))
    assert len(places_figure(people, GRID, PATH).panels) == 1
    nothing = places_figure(replace(found, places=()), GRID, PATH)
    assert nothing.panels == ()
    assert "as mapped" in nothing.caption


def test_json_holds_all_places(found):
    document = json.loads(json_text(plain(found)))
    assert [p["kind"] for p in document["places"]] == ["new obstacle", "missing wall", "passing (people)", "undecided"]
    assert document["places"][0]["interval"] == [0.25, 0.75]
    assert len(document["places"][0]["corners"]) == 16
    assert set(COLOURS) == set(KINDS) - {"undecided"}
