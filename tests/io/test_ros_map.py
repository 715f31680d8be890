"""map_server maps: every mode, negate, thresholds, origin; saving; hostile files."""

from __future__ import annotations

import re
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.maps.ros_map import between_share, image_path, read_ros_map, ros_map_notes
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.maps.occupancy import OccupancyGrid

DEFAULTS = {
    "image": "map.pgm",
    "resolution": "0.05",
    "origin": "[1.5, -2.0, 0.3]",
    "negate": "0",
    "occupied_thresh": "0.65",
    "free_thresh": "0.25",
}


@pytest.fixture
def write(tmp_path):
    """Write a map of one row with the given grey levels and keys of the YAML file; None leaves a key out."""

    def write_it(grey=(0, 255), alpha=None, **keys: str | None) -> Path:
        levels = np.atleast_2d(np.array(grey, dtype=np.uint8))
        if alpha is None:
            rows, cols = levels.shape
            (tmp_path / "map.pgm").write_bytes(b"P5 %d %d 255\n" % (cols, rows) + levels.tobytes())
        else:
            channels = np.stack([levels, np.atleast_2d(np.array(alpha, dtype=np.uint8))], axis=2)
            Image.fromarray(channels).save(tmp_path / "map.png")
            keys = {"image": "map.png", **keys}
        text = "".join(f"{key}: {value}\n" for key, value in {**DEFAULTS, **keys}.items() if value is not None)
        path = tmp_path / "map.yaml"
        path.write_text(text)
        return path

    return write_it


def values(grid: OccupancyGrid) -> list[list[int]]:
    """Return the grid as a nav_msgs/OccupancyGrid has it: -1, 0 to 100."""
    percent = np.where(np.isnan(grid.probability), -1.0, grid.probability * np.float32(100.0))
    assert np.abs(percent - percent.round()).max() < 1e-4
    return percent.round().astype(int).tolist()


def categories(grid: OccupancyGrid) -> list[list[str]]:
    names = np.where(grid.occupied, "occupied", np.where(grid.free, "free", "unknown"))
    return names.tolist()


# -------------------------------------------------------------------------------------------------------------- reading


def test_the_bottom_row_of_the_picture_is_row_0_and_the_keys_are_kept(write):
    grid = read_ros_map(write([[0, 255, 255], [255, 0, 0]]))
    assert values(grid) == [[0, 100, 100], [100, 0, 0]]
    assert grid.resolution == 0.05
    assert grid.origin.tolist() == [1.5, -2.0, 0.3]
    assert (grid.occupied_thresh, grid.free_thresh) == (0.65, 0.25)


def nav2_values(grey, mode, negate, occupied, free, alpha=None) -> list[int]:
    """One pixel after the other, as USERS.md and nav2's documentation state the rules."""
    result = []
    for i, g in enumerate(grey):
        p = g / 255.0 if negate else 1.0 - g / 255.0
        if mode == "raw":
            result.append(g if g <= 100 else -1)
        elif alpha is not None and alpha[i] < 255:
            result.append(-1)
        elif p >= occupied:
            result.append(100)
        elif p <= free:
            result.append(0)
        elif mode == "trinary":
            result.append(-1)
        else:
            result.append(int(np.floor(100.0 * (p - free) / (occupied - free) + 0.5)))
    return result


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
@pytest.mark.parametrize("negate", [0, 1])
@pytest.mark.parametrize(("occupied", "free"), [(0.65, 0.25), (0.65, 0.196), (0.6, 0.2), (1.0, 0.0), (0.51, 0.5)])
def test_all_grey_levels_in_every_mode(write, mode, negate, occupied, free):
    grey = range(256)
    path = write(grey, mode=mode, negate=str(negate), occupied_thresh=str(occupied), free_thresh=str(free))
    grid = read_ros_map(path)
    expected = nav2_values(grey, mode, negate, occupied, free)
    assert values(grid) == [expected]
    if mode == "trinary":
        names = {100: "occupied", 0: "free", -1: "unknown"}
        assert categories(grid) == [[names[v] for v in expected]]
        assert set(expected) == ({100, 0, -1} if occupied - free > 1 / 255 else set(expected))
    if mode == "scale":
        assert categories(grid) == [
            ["occupied" if v == 100 else "free" if v == 0 else "unknown" for v in expected]
        ]  # fmt: skip
    if mode == "raw":
        assert categories(grid) == [
            ["unknown" if v < 0 else "occupied" if v / 100 >= occupied else "free" if v / 100 <= free else "unknown"
             for v in expected]
        ]  # fmt: skip


def test_thresholds_themselves_belong_to_occupied_and_free(write):
    # 1 - 102/255 is 0.6 and 1 - 204/255 is just below 0.2 in floating point, like the 0.2 it stands for.
    grid = read_ros_map(write([102, 103, 203, 204], occupied_thresh="0.6", free_thresh="0.2"))
    assert categories(grid) == [["occupied", "unknown", "unknown", "free"]]


def test_map_savers_unknown_205_depends_on_the_free_threshold(write):
    # p = 50/255 = 0.196078...: unknown with ROS 1's 0.196, but free with nav2's 0.25.
    assert categories(read_ros_map(write([205], free_thresh="0.196"))) == [["unknown"]]
    assert categories(read_ros_map(write([205], free_thresh="0.25"))) == [["free"]]


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_pixels_that_are_not_fully_opaque_are_unknown_but_in_raw_mode(write, mode):
    grey, alpha = [0, 0, 0, 255, 90], [255, 254, 0, 128, 255]
    assert values(read_ros_map(write(grey, alpha=alpha, mode=mode))) == [
        nav2_values(grey, mode, 0, 0.65, 0.25, alpha)
    ]  # fmt: skip


def test_the_mode_is_trinary_when_none_is_given_and_its_case_does_not_matter(write):
    assert values(read_ros_map(write([128]))) == [[-1]]
    assert values(read_ros_map(write([50], mode="Raw"))) == [[50]]


@pytest.mark.parametrize(("word", "negated"), [
    ("0", False), ("1", True), ("false", False), ("true", True), ("False", False), ("no", False), ("yes", True),
    ("on", True), ("off", False),
])  # fmt: skip
def test_negate_is_a_number_or_a_truth_value(write, word, negated):
    assert values(read_ros_map(write([0, 255], negate=word))) == [[0, 100] if negated else [100, 0]]


def test_the_origin_may_hold_whole_numbers(write):
    assert read_ros_map(write(origin="[-10, 3, 0]")).origin.tolist() == [-10.0, 3.0, 0.0]


def test_the_yaw_of_the_origin_turns_the_map_about_its_lower_left_corner(write):
    grid = read_ros_map(write([[255, 255], [255, 255]], origin=f"[1.0, 2.0, {np.pi / 2}]", resolution="0.5"))
    np.testing.assert_allclose(grid.to_map([[0.0, 0.0], [2.0, 0.0]]), [[1.0, 2.0], [1.0, 3.0]], atol=1e-12)


def test_the_picture_is_found_relative_to_the_yaml_file_absolute_and_from_home(write, tmp_path, monkeypatch):
    path = write()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / "map.pgm").rename(elsewhere / "b c.pgm")
    monkeypatch.chdir("/")
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("elsewhere/b c.pgm", str(elsewhere / "b c.pgm"), "~/elsewhere/b c.pgm", "../elsewhere/b c.pgm"):
        if name.startswith(".."):
            path.rename(elsewhere / "map.yaml")
            path = elsewhere / "map.yaml"
        path.write_text(re.sub("image: .*", f"image: {name}", path.read_text()))
        assert read_ros_map(path).shape == (1, 2)
        assert image_path(path).resolve() == elsewhere / "b c.pgm"


# ------------------------------------------------------------------------------------------------------------ bad input


@pytest.mark.parametrize("key", list(DEFAULTS))
def test_a_missing_key_is_named(write, key):
    path = write(**{key: None})
    with pytest.raises(FormatError, match=rf"map\.yaml: the key '{key}' is missing"):
        read_ros_map(path)


LINE = {key: number for number, key in enumerate([*DEFAULTS, "mode"], start=1)}


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("image", "3", "expected text, got 3"),
        ("image", "''", "expected text, got ''"),
        ("image", "none.pgm", "none.pgm' does not exist"),
        ("image", ".", "is not a regular file"),
        ("image", '"a\\0b"', "expected the name of a file"),
        ("resolution", "wide", "expected a number, got 'wide'"),
        ("resolution", "true", "expected a number, got True"),
        ("resolution", "0", "expected a positive number of metres, got 0.0"),
        ("resolution", "-0.05", "expected a positive number of metres, got -0.05"),
        ("resolution", "1e12", "expected metres per pixel, 1e-12 to 1e+09, got 1000000000000.0"),
        ("resolution", ".nan", "expected a finite number, got nan"),
        ("resolution", ".inf", "expected a finite number, got inf"),
        ("origin", "[1, 2]", "expected three numbers [x, y, yaw], got [1, 2]"),
        ("origin", "[1, 2, 3, 4]", "expected three numbers"),
        ("origin", "0", "expected three numbers"),
        ("origin", "{x: 1, y: 2, z: 3}", "expected three numbers"),
        ("origin", "[1, two, 3]", "origin.1: expected a number, got 'two'"),
        ("origin", "[1, -1e30, 3]", "expected metres and radians up to 1e+09, got [1, -1e+30, 3]"),
        ("origin", "[1, 2, .nan]", "origin.2: expected a finite number, got nan"),
        ("negate", "2", "expected 0, 1, true or false, got 2"),
        ("negate", "maybe", "expected 0, 1, true or false, got 'maybe'"),
        ("negate", "0.0", "expected 0, 1, true or false, got 0.0"),
        ("occupied_thresh", "65", "expected a number from 0 to 1, got 65.0"),
        ("free_thresh", "-0.1", "expected a number from 0 to 1, got -0.1"),
        ("free_thresh", "0.65", "expected less than occupied_thresh, 0.65, got 0.65"),
        ("free_thresh", "0.9", "expected less than occupied_thresh, 0.65, got 0.9"),
        ("mode", "binary", "expected one of trinary, scale, raw, got 'binary'"),
        ("mode", "1", "expected text, got 1"),
    ],
)
def test_a_wrong_value_is_named_with_its_file_line_and_key(write, key, value, message):
    path = write(**{key: value})
    with pytest.raises(FormatError) as caught:
        read_ros_map(path)
    assert caught.value.line == LINE[key]
    assert str(caught.value).startswith(f"{path}:{LINE[key]}: {key}")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_picture_that_does_not_exist_names_the_yaml_file_and_the_picture(write, tmp_path):
    path = write(image="gone.pgm")
    with pytest.raises(FormatError) as caught:
        read_ros_map(path)
    assert str(path) in str(caught.value)
    assert str(tmp_path / "gone.pgm") in str(caught.value)
    # As ROS 1's map_saver writes it, on another computer.
    path = write(image="/home/robot/maps/gone.pgm")
    (tmp_path / "gone.pgm").touch()
    with pytest.raises(
        FormatError, match=r"maps/gone\.pgm' does not exist, but 'gone\.pgm' lies beside the file: write that"
    ):
        read_ros_map(path)


@pytest.mark.parametrize("text", ["", "- 1\n", "image: !!python/name:os.system\n", "a: 1\n---\nb: 1\n", "\x00\xff"])
def test_what_is_no_map_file_is_named(tmp_path, text):
    path = tmp_path / "map.yaml"
    path.write_text(text)
    with pytest.raises(FormatError, match=r"map\.yaml"):
        read_ros_map(path)


def test_a_bomb_is_refused_by_its_header_and_the_limit_can_be_set(write, tmp_path):
    path = write([0, 255, 205])
    with pytest.raises(FormatError, match=r"map\.pgm: 3 x 1 pixels exceed the limit of 2"):
        read_ros_map(path, max_pixels=2)
    (tmp_path / "map.pgm").write_bytes(b"P5 100000 100000 255\n")
    with pytest.raises(FormatError, match="100000 x 100000 pixels exceed the limit"):
        read_ros_map(path)


def test_a_truncated_picture_names_the_picture(write, tmp_path):
    path = write([0, 255, 205])
    (tmp_path / "map.pgm").write_bytes((tmp_path / "map.pgm").read_bytes()[:-1])
    with pytest.raises(FormatError, match=r"map\.pgm: truncated: 3 x 1 pixels need 3 bytes, got 2"):
        read_ros_map(path)


# --------------------------------------------------------------------------------------------------------------- saving


def assert_same_map(first: OccupancyGrid, second: OccupancyGrid) -> None:
    np.testing.assert_array_equal(first.probability, second.probability)
    np.testing.assert_array_equal(first.occupied, second.occupied)
    np.testing.assert_array_equal(first.free, second.free)
    np.testing.assert_array_equal(first.origin, second.origin)
    assert first.resolution == second.resolution
    assert (first.occupied_thresh, first.free_thresh) == (second.occupied_thresh, second.free_thresh)


@pytest.mark.parametrize("mode", ["trinary", "scale", "raw"])
def test_a_map_that_was_read_saves_and_reads_again_unchanged(write, tmp_path, mode):
    grid = read_ros_map(write(np.arange(256).reshape(8, 32), mode=mode))
    write_map(grid, tmp_path / "copy.yaml")
    assert_same_map(read_ros_map(tmp_path / "copy.yaml"), grid)


cells = st.lists(st.sampled_from([0.0, 1.0, np.nan]), min_size=6, max_size=6)
percents = st.lists(st.one_of(st.just(np.nan), st.integers(0, 100).map(lambda v: v / 100)), min_size=6, max_size=6)
thresholds = st.tuples(st.floats(0, 1), st.floats(0, 1)).filter(lambda t: t[0] != t[1]).map(sorted)
finite = st.floats(-1e6, 1e6)


@settings(max_examples=150)
@given(
    st.one_of(cells, percents),
    thresholds,
    st.tuples(finite, finite, finite),
    st.floats(1e-9, 1e3),
)
def test_any_grid_of_whole_percents_reads_again_unchanged(tmp_path_factory, probability, limits, origin, resolution):
    grid = OccupancyGrid(
        np.array(probability, dtype=np.float32).reshape(2, 3),
        resolution,
        np.array(origin),
        free_thresh=limits[0],
        occupied_thresh=limits[1],
    )
    path = tmp_path_factory.mktemp("map") / "map.yaml"
    write_map(grid, path)
    assert_same_map(read_ros_map(path), grid)


def test_the_saved_map_is_a_plain_pgm_that_others_read(tmp_path):
    grid = OccupancyGrid([[0.0, 1.0, np.nan], [1.0, 1.0, 0.0]], 0.05, free_thresh=0.196)
    write_map(grid, tmp_path / "a.yaml")
    with Image.open(tmp_path / "a.pgm") as picture:
        assert np.asarray(picture).tolist() == [[0, 0, 254], [254, 0, 205]]
    text = (tmp_path / "a.yaml").read_text()
    assert "image: a.pgm\n" in text
    assert "mode: trinary\n" in text
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.pgm", "a.yaml"]


def test_small_numbers_are_written_so_that_yaml_1_1_takes_them_for_numbers(tmp_path):
    write_map(OccupancyGrid([[0.0]], 0.05, np.array([1e-7, -1e-22, 0.0])), tmp_path / "a.yaml")
    assert "origin: [1.0e-07, -1.0e-22, 0.0]\n" in (tmp_path / "a.yaml").read_text()


@pytest.mark.parametrize("name", ["with space", "12", "#1", 'quote"and\\', "größe", "a: b", "- x", "~"])
def test_any_file_name_can_be_saved_and_read(tmp_path, name):
    grid = OccupancyGrid([[0.0, 1.0]], 0.05)
    write_map(grid, tmp_path / f"{name}.yaml")
    assert_same_map(read_ros_map(tmp_path / f"{name}.yaml"), grid)


def test_other_probabilities_are_refused_unless_the_mode_is_given(tmp_path):
    grid = OccupancyGrid([[0.123, 0.9, np.nan, 0.2]], 0.05)
    with pytest.raises(InvalidInputError, match="whole percents only"):
        write_map(grid, tmp_path / "a.yaml")
    assert list(tmp_path.iterdir()) == []
    write_map(grid, tmp_path / "a.yaml", mode="raw")
    assert values(read_ros_map(tmp_path / "a.yaml")) == [[12, 90, -1, 20]]
    write_map(grid, tmp_path / "a.yaml", mode="trinary")
    assert values(read_ros_map(tmp_path / "a.yaml")) == [[0, 100, -1, 0]]


def test_thresholds_too_close_for_a_grey_between_them_are_saved_raw(tmp_path):
    grid = OccupancyGrid([[0.0, 1.0, np.nan]], 0.05, free_thresh=0.5, occupied_thresh=0.5001)
    with pytest.raises(InvalidInputError, match="no grey level lies between"):
        write_map(grid, tmp_path / "a.yaml", mode="trinary")
    write_map(grid, tmp_path / "a.yaml")
    assert_same_map(read_ros_map(tmp_path / "a.yaml"), grid)


def test_wrong_modes_and_endings_are_refused(tmp_path):
    grid = OccupancyGrid([[0.0]], 0.05)
    with pytest.raises(InvalidInputError, match="expected 'trinary' or 'raw', got 'scale'"):
        write_map(grid, tmp_path / "a.yaml", mode="scale")
    with pytest.raises(InvalidInputError, match=r"ending in \.yaml or \.yml, got 'a\.pgm'"):
        write_map(grid, tmp_path / "a.pgm")
    with pytest.raises(InvalidInputError, match="a printable name"):
        write_map(grid, tmp_path / "a\nb.yaml")
    assert list(tmp_path.iterdir()) == []


def test_a_map_that_cannot_be_written_leaves_the_old_one(tmp_path, monkeypatch):
    write_map(OccupancyGrid([[0.0, 1.0]], 0.05), tmp_path / "a.yaml")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def fail(*_args: object, **_options: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", fail)
    with pytest.raises(OSError, match="No space"):
        write_map(OccupancyGrid([[1.0, 1.0]], 0.1), tmp_path / "a.yaml")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


# ---------------------------------------------------------------------------------------------------------------- notes


def test_a_note_says_when_the_grey_of_unknown_counts_as_free(write):
    (note,) = ros_map_notes(write([205, 255, 0, 205], free_thresh="0.25"))
    assert "50.0% of the pixels have grey 205" in note
    assert "free_thresh 0.25 they count as free" in note
    for keys in ({"free_thresh": "0.196"}, {"negate": "yes"}, {"mode": "raw"}):
        assert ros_map_notes(write([205, 255], **keys)) == []
    assert ros_map_notes(write([204, 255])) == []
    # What is transparent is unknown in any case.
    (note,) = ros_map_notes(write([205, 205, 255, 205], alpha=[255, 0, 255, 0]))
    assert "25.0% of the pixels" in note


def test_pixels_between_the_thresholds_are_counted_unless_they_stand_for_unknown(write):
    # p = 1 - g / 255: 0.65 is at 89, 0.196 at 205.02, and the middle between them at 147.
    greys = [0, 80, 100, 120, 140, 147, 205, 254]
    keys = {"free_thresh": "0.196"}
    assert between_share(write(greys, **keys)) == 3 / 8
    assert between_share(write(greys, negate="1", **keys)) == 5 / 8
    assert between_share(write([0, 205, 205, 254], free_thresh="0.1")) == 0.0
    assert between_share(write([0, 205, 150, 254], free_thresh="0.1")) == 0.0
    assert between_share(write([0, 205, 150, 151], free_thresh="0.1")) == 2 / 4
    assert between_share(write([100, 120, 140, 0], alpha=[255, 255, 0, 255], **keys)) == 2 / 4
    assert between_share(write(greys, mode="raw", **keys)) == 0.0


def test_a_map_takes_little_more_memory_while_it_is_read_than_afterwards(write, rng, monkeypatch):
    monkeypatch.setattr("beamfield.io.maps.ros_map._PIXELS_PER_BAND", 70_000)
    grey = rng.choice([0, 205, 254], (1000, 1500)).astype(np.uint8)
    path = write(grey, free_thresh="0.19")
    tracemalloc.start()
    grid = read_ros_map(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # Four bytes a cell are the map, one the picture; indices and masks of the whole picture would be eight and more.
    assert peak < 7 * grey.size
    expected = np.select([grey == 0, grey == 254], [1.0, 0.0], np.nan)[::-1]
    np.testing.assert_array_equal(grid.probability, expected.astype(np.float32))


def test_transparent_pixels_of_every_band_are_unknown(write, rng, monkeypatch):
    monkeypatch.setattr("beamfield.io.maps.ros_map._PIXELS_PER_BAND", 100)
    grey, alpha = rng.choice([0, 254], (50, 30)), rng.choice([0, 255], (50, 30))
    grid = read_ros_map(write(grey, alpha))
    np.testing.assert_array_equal(grid.unknown, alpha[::-1] == 0)
    np.testing.assert_array_equal(grid.occupied, ((grey == 0) & (alpha == 255))[::-1])
