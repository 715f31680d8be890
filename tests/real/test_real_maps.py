"""Every map beside the real logs, against a second way to read it: Pillow, one comparison per grey level, counting."""

from __future__ import annotations

import gzip
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.read_map import read_map

pytestmark = pytest.mark.real

# File, (rows, cols), resolution, origin, cells that are (free, occupied, unknown).
MAPS = [
    ("olin_mac_tb4/map/mac_1st_floor_final.yaml", (1706, 903), 0.03, (-1.12, -39.4, 0.0), (1523647, 16871, 0)),
    ("ros_maps/aws_small_house/map.yaml", (500, 500), 0.05, (-12.5, -12.5, 0.0), (63021, 3442, 183537)),
    ("ros_maps/berlin/berlin.yaml", (600, 600), 0.05, (-11.60654, -26.520793, 0.0), (107954, 252046, 0)),
    ("ros_maps/levine_lobby/levinelobby.yaml", (836, 692), 0.05, (-20.776736, -30.670374, 0.0), (98912, 479583, 17)),
    ("ros_maps/nav2_depot/depot.yaml", (307, 604), 0.05, (0.0, 0.0, 0.0), (179481, 5947, 0)),
    ("ros_maps/nav2_warehouse/warehouse.yaml", (1674, 1006), 0.03, (-15.1, -25.0, 0.0), (1422292, 30951, 230801)),
    ("ros_maps/tb3_sandbox/tb3_sandbox.yaml", (384, 384), 0.05, (-10.0, -10.0, 0.0), (7903, 870, 138683)),
    ("ros_maps/willow_garage_010/willow-2010-02-18-0.10.yaml", (608, 566), 0.1, (0.0, 0.0, 0.0), (109207, 544, 234377)),
    ("uob_stage_sim/meeting.yaml", (602, 602), 0.05, (0.0, 0.0, 0.0), (78120, 6020, 278264)),
    ("uob_stage_sim/derived_meeting_stageframe.yaml", (602, 602), 0.05161, (-15.561, -15.761, 0.0),
     (78120, 6020, 278264)),
    ("wean_hall/derived_wean.yaml", (800, 800), 0.1, (0.0, 0.0, 0.0), (48239, 20224, 571537)),
]  # fmt: skip
NAMES = [entry[0] for entry in MAPS]


def keys_of(path: Path) -> dict[str, str]:
    return dict(re.findall(r"^(\w+):[ \t]*(.*?)[ \t]*$", path.read_text(), flags=re.MULTILINE))


def test_no_map_of_the_data_is_left_out(data):
    found = {str(path.relative_to(data)) for path in data.rglob("*.yaml") if "image:" in path.read_text()}
    assert found == set(NAMES)


@pytest.mark.parametrize(("name", "shape", "resolution", "origin", "counts"), MAPS, ids=NAMES)
def test_a_real_map_has_the_known_size_place_and_cells(data, name, shape, resolution, origin, counts):
    grid = read_map(data / name)
    assert grid.shape == shape
    assert grid.resolution == resolution
    assert tuple(grid.origin) == origin
    assert (grid.free.sum(), grid.occupied.sum(), grid.unknown.sum()) == counts


@pytest.mark.parametrize("name", NAMES)
def test_a_real_map_has_the_categories_that_exact_fractions_and_pillow_give(data, name):
    path = data / name
    keys = keys_of(path)
    assert keys["negate"] == "0"
    assert keys.get("mode", "trinary") == "trinary"
    with Image.open(path.parent / keys["image"]) as picture:
        levels = np.asarray(picture.convert("L"))
    # Whole arithmetic: no float can be blamed. None of these files has a threshold on a grey level.
    occupied = [1 - Fraction(g, 255) >= Fraction(keys["occupied_thresh"]) for g in range(256)]
    free = [1 - Fraction(g, 255) <= Fraction(keys["free_thresh"]) for g in range(256)]
    grid = read_map(path)
    np.testing.assert_array_equal(grid.occupied, np.array(occupied)[levels][::-1])
    np.testing.assert_array_equal(grid.free, np.array(free)[levels][::-1])


@pytest.mark.parametrize("name", NAMES)
def test_a_real_map_saves_and_reads_again_unchanged(data, tmp_path, name):
    grid = read_map(data / name)
    write_map(grid, tmp_path / "copy.yaml")
    again = read_map(tmp_path / "copy.yaml")
    np.testing.assert_array_equal(again.probability, grid.probability)
    np.testing.assert_array_equal(again.unknown, grid.unknown)
    np.testing.assert_array_equal(again.origin, grid.origin)
    assert again.resolution == grid.resolution


def test_wean_halls_own_file_agrees_with_the_map_derived_from_it(data):
    grid = read_map(data / "wean_hall/wean.dat.gz")
    derived = data / "wean_hall/derived_wean.yaml"
    with Image.open(derived.with_suffix(".pgm")) as picture:
        levels = np.asarray(picture)[::-1].astype(int)
    assert grid.shape == read_map(derived).shape
    assert grid.resolution == read_map(derived).resolution
    known = ~np.isnan(grid.probability)
    # The derived picture holds round(255 (1 - p)), and 205 where nothing is known.
    assert (levels[~known] == 205).all()
    assert np.abs(levels[known] - 255.0 * (1.0 - grid.probability[known])).max() < 0.5 + 1e-4


def test_wean_halls_own_file_keeps_every_digit(data):
    grid = read_map(data / "wean_hall/wean.dat.gz")
    with gzip.open(data / "wean_hall/wean.dat.gz", "rt") as file:
        lines = file.read().split("global_map[0]: 800 800\n")[1].splitlines()
    for x in (0, 300, 400, 555, 799):
        for y, word in enumerate(lines[x].split()):
            expected = np.float32(np.nan if word == "-1.000" else 1 - Fraction(word))
            assert np.array_equal(grid.probability[y, x], expected, equal_nan=True)
    assert grid.free.sum() + grid.occupied.sum() + grid.unknown.sum() == 640_000
    assert np.isnan(grid.probability).sum() == 466_143
