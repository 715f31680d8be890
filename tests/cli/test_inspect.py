"""``beamfield inspect``: what it says is what is in the file."""

from __future__ import annotations

import gzip
import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from beamfield.cli import options
from beamfield.cli.main import main
from beamfield.cli.parser import Parser
from beamfield.io.bags.writer import write_bag
from beamfield.io.logs.carmen_writer import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.trajectory import write_tum
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import ScanLog, Track
from tests.cli.wall_drive import make_sensor
from tests.io.mini_bag import MiniBag

# Every option that says how a log is read, with a value.
READING = {
    "--sensor": ["/scan"], "--poses-topic": ["/truth"], "--map-frame": ["world"], "--base-frame": ["base"],
    "--mount": ["1", "2", "3"], "--no-return": ["none"], "--max-range": ["5"], "--min-range": ["0"], "--mask": ["1:2"],
    "--opening-angle": ["0"], "--stamps": ["order"], "--lone-poses": ["odometry"],
}  # fmt: skip


def make_grid() -> OccupancyGrid:
    probability = np.zeros((50, 60))
    probability[35:37] = 1.0
    probability[37:] = np.nan
    return OccupancyGrid(probability, 0.1, np.array([-1.0, 0.0, 0.0]))


@pytest.fixture
def map_path(tmp_path) -> Path:
    write_map(make_grid(), tmp_path / "room.yaml")
    return tmp_path / "room.yaml"


@pytest.fixture
def log_path(tmp_path) -> Path:
    sensor = make_sensor()
    write_carmen(tmp_path / "drive.log", ScanLog({"FLASER": sensor}, Track(sensor.stamps, sensor.odometry)))
    return tmp_path / "drive.log"


@pytest.fixture
def raw_log_path(tmp_path) -> Path:
    """A log without reference poses: Wean Hall's format, in centimetres."""
    sensor = make_sensor()
    lines = []
    for stamp, pose in zip(sensor.stamps, sensor.odometry, strict=True):
        x, y, theta = pose * [100.0, 100.0, 1.0]
        ranges = " ".join(["200"] * 180)
        lines.append(f"L {x:.3f} {y:.3f} {theta:.4f} {x + 25:.3f} {y:.3f} {theta:.4f} {ranges} {stamp:.3f}\n")
    (tmp_path / "raw.log").write_text("".join(lines))
    return tmp_path / "raw.log"


def shown(capsys, *words: str | Path) -> str:
    assert main(["inspect", *map(str, words)]) == 0
    out, err = capsys.readouterr()
    assert set(err.splitlines()) <= {"reading ...", "drawing ..."}
    return out


def refused(capsys, *words: str | Path, code: int = 1) -> str:
    assert main(["inspect", "--quiet", *map(str, words)]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def test_a_map_is_described_by_its_size_place_and_cells(capsys, map_path):
    text = shown(capsys, map_path)
    assert "room.yaml: map of 60 x 50 cells of 0.1 m: 6.00 m x 5.00 m" in text
    assert "x -1 m, y 0 m, yaw 0 degrees" in text
    rows = {line.split()[0]: line.split() for line in text.splitlines() if " cells " in line and "%" in line}
    assert rows["free"][1:] == ["2,100", "cells", "70.00%", "21.0", "m2"]
    assert rows["occupied"][1:] == ["120", "cells", "4.00%", "1.2", "m2"]
    assert rows["unknown"][1:] == ["780", "cells", "26.00%", "7.8", "m2"]
    assert "--out room.png" in text
    map_path.with_name("a room 0.10.yaml").write_text(map_path.read_text())
    assert "--out 'a room 0.10.png'" in shown(capsys, map_path.with_name("a room 0.10.yaml"))


def test_the_json_of_a_map_holds_the_same_in_si_units(capsys, map_path):
    facts = json.loads(shown(capsys, map_path, "--json"))
    assert (facts["kind"], facts["source"]) == ("map", "room.yaml")
    assert (facts["rows"], facts["cols"], facts["resolution_m"]) == (50, 60, 0.1)
    assert facts["cells"]["occupied"] == {"count": 120, "share": 0.04, "area_m2": pytest.approx(1.2)}
    assert facts["origin"] == {"x_m": -1.0, "y_m": 0.0, "yaw_rad": 0.0}
    assert facts["notes"] == []


def test_unknown_cells_that_count_as_free_are_noted(capsys, map_path):
    map_path.write_text(map_path.read_text().replace("free_thresh: 0.25", "free_thresh: 0.26"))
    grey = np.full((50, 60), 205, dtype=np.uint8)
    map_path.with_suffix(".pgm").write_bytes(b"P5 60 50 255\n" + grey.tobytes())
    assert "100.0% of the pixels have grey 205" in shown(capsys, map_path)


def test_a_map_that_is_painted_black_where_nothing_is_known_is_noted(capsys, map_path):
    assert "painted black" not in shown(capsys, map_path)
    grey = np.zeros((50, 60), dtype=np.uint8)
    grey[10:40, 10:40] = 254
    map_path.with_suffix(".pgm").write_bytes(b"P5 60 50 255\n" + grey.tobytes())
    assert "no wall, but painted black: amcl's likelihood fields lose robots there" in " ".join(
        shown(capsys, map_path).split()
    )


def test_wean_maps_and_coreslam_logs_share_an_ending_and_are_told_apart(tmp_path, capsys):
    wean = "robot_specifications->resolution 10\nglobal_map[0]: 1 2\n1.0 0.0\n"
    (tmp_path / "a.dat").write_text(wean)
    (tmp_path / "a.dat.gz").write_bytes(gzip.compress(wean.encode()))
    for name in ("a.dat", "a.dat.gz"):
        assert "map of 1 x 2 cells" in shown(capsys, tmp_path / name)
    (tmp_path / "b.dat").write_text("not a map\n")
    assert "unknown format" in refused(capsys, tmp_path / "b.dat")


def test_a_bag_without_scans_is_shown_as_the_map_it_holds(tmp_path, capsys):
    path = MiniBag("ros1").grid(1.0, 60, 50, np.zeros(3000, np.int8)).write(tmp_path)
    assert "map of 60 x 50 cells" in shown(capsys, path)
    assert "map of 60 x 50 cells" in shown(capsys, path, "--map-topic", "/map")


def test_the_picture_that_is_offered_has_the_whole_name_of_a_bags_folder(tmp_path, capsys):
    folder = MiniBag().scan(1.0).write(tmp_path, "drive_3.5")
    assert "add --out drive_3.5.png" in shown(capsys, folder)
    (file,) = folder.glob("*.mcap")
    assert f"add --out {file.stem}.png" in shown(capsys, file)


def test_a_bag_with_neither_scans_nor_map_is_refused_for_its_scans(tmp_path, capsys):
    path = MiniBag("ros1").odometry(1.0, (0.0, 0.0)).write(tmp_path)
    text = refused(capsys, path)
    assert "no scans" in text
    assert "no map" not in text
    (tmp_path / "a.bag").write_bytes(b"#ROSBAG V2.0\n")
    assert "damaged" in refused(capsys, tmp_path / "a.bag")


def test_what_is_wrong_with_the_map_of_a_bag_without_scans_is_said(tmp_path, capsys):
    path = MiniBag("ros1").grid(1.0, 60, 50, np.zeros(2999, np.int8)).write(tmp_path)
    text = refused(capsys, path)
    assert "/map, message 1: expected width 60 x height 50 cells, got 2999" in text
    assert "no scans" not in text


def test_a_log_is_described_by_its_sensors_ranges_and_poses(capsys, log_path):
    text = shown(capsys, log_path)
    assert "drive.log: log with 1 sensor\n" in text
    rows = {line[2:20].strip(): line[20:] for line in text.splitlines() if line.startswith("  ")}
    assert rows["scans"] == "20 in 3.8 s (5 per second)"
    assert rows["beams"].startswith("19 from -90.0 to 90.0 degrees, spanning 180.0, every 10, counter-clockwise")
    assert rows["reference poses"] == "20 of 20 scans, path of 1.9 m"
    assert rows["odometry"] == "20 of 20 scans, path of 1.7 m"
    assert "380: 42.11% measured, 57.89% no return, 0.00% NaN, 0.00% too close" in rows["readings"]
    assert "--out drive.png" in text


def test_the_json_of_a_log_holds_the_same_in_si_units(capsys, log_path):
    facts = json.loads(shown(capsys, log_path, "--json"))
    sensor = facts["sensors"]["FLASER"]
    assert (facts["kind"], sensor["scans"], sensor["beams"]["count"]) == ("log", 20, 19)
    assert sensor["duration_s"] == pytest.approx(3.8)
    assert sensor["beams"]["step_rad"] == pytest.approx(math.radians(10.0))
    assert sensor["reference_poses"] == {"known": 20, "path_length_m": pytest.approx(1.9)}
    assert sensor["readings"]["no_return_share"] == pytest.approx(11 / 19)
    assert isinstance(facts["notes"], list)


def test_nan_may_be_a_bags_word_for_no_return(capsys, tmp_path):
    """Warnings advise --no-return nan; JSON has no number for it."""
    write_bag(tmp_path / "run", ScanLog({"/scan": make_sensor()}))
    facts = json.loads(shown(capsys, tmp_path / "run", "--no-return", "nan,0", "--json"))
    assert facts["sensors"]["/scan"]["no_return"]["values_m"] == ["nan", 0.0]


def test_options_for_reading_the_log_are_obeyed(capsys, log_path):
    facts = json.loads(shown(capsys, log_path, "--json", "--max-range", "2"))
    assert facts["sensors"]["FLASER"]["max_range_m"] == 2.0
    assert "expected detect, none or numbers" in refused(capsys, log_path, "--no-return", "often", code=2)


def test_reference_poses_come_from_a_file(capsys, tmp_path, raw_log_path):
    sensor = make_sensor()
    write_tum(tmp_path / "truth.tum", Track(sensor.stamps, sensor.poses * [2.0, 1.0, 1.0]))
    without = json.loads(shown(capsys, raw_log_path, "--json"))
    assert without["sensors"]["L"]["reference_poses"] == {"known": 0, "path_length_m": None}
    facts = json.loads(shown(capsys, raw_log_path, "--poses", tmp_path / "truth.tum", "--json"))
    assert facts["sensors"]["L"]["reference_poses"] == {"known": 20, "path_length_m": pytest.approx(3.8)}


def test_a_map_is_drawn_into_the_file(capsys, map_path, tmp_path):
    assert f"wrote {tmp_path / 'picture.png'}" in shown(capsys, map_path, "--out", tmp_path / "picture.png")
    with Image.open(tmp_path / "picture.png") as picture:
        colours = {colour for _, colour in picture.convert("RGB").getcolors(maxcolors=1 << 20)}
    assert {(0xFF, 0xFF, 0xFF), (0xE1, 0xE5, 0xEA), (0x3C, 0x44, 0x4D)} <= colours
    assert sorted(p.name for p in tmp_path.iterdir()) == ["picture.png", "room.pgm", "room.yaml"]


def test_a_log_is_drawn_over_a_map(capsys, log_path, map_path, tmp_path):
    shown(capsys, log_path, "--map", map_path, "--out", tmp_path / "a.png")
    shown(capsys, log_path, "--out", tmp_path / "b.png")
    with Image.open(tmp_path / "a.png") as a, Image.open(tmp_path / "b.png") as b:
        walls = [(np.asarray(picture.convert("RGB")) == (0x3C, 0x44, 0x4D)).all(axis=-1).sum() for picture in (a, b)]
    assert walls[0] > 1000
    assert walls[1] == 0


def test_a_picture_in_an_unknown_format_is_refused_before_anything_is_read(capsys, tmp_path):
    error = refused(capsys, tmp_path / "none.yaml", "--out", tmp_path / "a.exe", code=2)
    assert "--out: expected a name ending in .png, .svg or .pdf, got 'a.exe'" in error


@pytest.mark.parametrize("suffix", options.PICTURES)
def test_every_offered_format_is_written(capsys, map_path, tmp_path, suffix):
    shown(capsys, map_path, "--out", tmp_path / f"a{suffix}")
    start = (tmp_path / f"a{suffix}").read_bytes()[:5]
    assert start in (b"\x89PNG\r", b"<?xml", b"%PDF-")


@pytest.fixture
def poses_path(tmp_path) -> Path:
    sensor = make_sensor()
    write_tum(tmp_path / "truth.tum", Track(sensor.stamps, sensor.poses))
    return tmp_path / "truth.tum"


def test_a_file_of_poses_is_described_by_its_time_path_and_extent(capsys, poses_path):
    text = shown(capsys, poses_path)
    assert "truth.tum: 20 poses in 3.8 s (5 per second), path of 1.9 m" in text
    assert "x 1.00 m to 2.90 m, y 2.00 m to 2.00 m" in text
    assert "--poses" in text
    facts = json.loads(shown(capsys, poses_path, "--json"))
    assert (facts["kind"], facts["poses"], facts["start_s"]) == ("poses", 20, 10.0)
    assert facts["path_length_m"] == pytest.approx(1.9)
    assert facts["extent"] == {"x_m": pytest.approx([1.0, 2.9]), "y_m": [2.0, 2.0]}


def test_poses_are_drawn_over_a_map(capsys, poses_path, map_path, tmp_path):
    assert "wrote" in shown(capsys, poses_path, "--map", map_path, "--out", tmp_path / "a.png")
    with Image.open(tmp_path / "a.png") as picture:
        assert len(np.unique(np.asarray(picture.convert("L")))) > 20


def test_a_bad_line_among_poses_is_named(capsys, poses_path):
    with poses_path.open("a") as file:
        file.write("14 1 2\n")
    assert "truth.tum:22: expected 8 numbers" in refused(capsys, poses_path)
    assert "--poses: goes with a log" in refused(capsys, poses_path, "--poses", poses_path, code=2)
    other = poses_path.with_name("other.csv")
    other.write_text("seconds,east,north\n1,2,3\n")
    assert "other.csv:1: expected poses (TUM lines, or CSV with a header t,x,y,theta)" in refused(capsys, other)
    assert "--stamps: says how a log is read" in refused(capsys, poses_path, "--stamps", "order", code=2)


def test_bad_input_is_one_line_that_names_the_file(capsys, tmp_path, map_path, log_path):
    assert "none.yaml: No such file" in refused(capsys, tmp_path / "none.yaml")
    assert "none.log: No such file" in refused(capsys, tmp_path / "none.log")
    (tmp_path / "text.log").write_text("hello\n")
    assert "unknown format" in refused(capsys, tmp_path / "text.log")
    assert "give the map_server YAML file" in refused(capsys, map_path.with_suffix(".pgm"))
    map_path.with_suffix(".pgm").unlink()
    error = refused(capsys, map_path, "--out", tmp_path / "a.png")
    assert "room.yaml:1: image" in error
    assert "room.pgm' does not exist" in error
    assert not (tmp_path / "a.png").exists()
    assert f"{map_path}: Not a directory" in refused(capsys, log_path, "--out", map_path / "a.png")


def test_options_that_do_not_fit_are_refused(capsys, tmp_path, map_path, log_path, raw_log_path):
    assert "--map: the map is only drawn, so give --out too" in refused(capsys, log_path, "--map", map_path, code=2)
    picture = ("--out", tmp_path / "a.png")
    assert "--map: goes with a log" in refused(capsys, map_path, "--map", map_path, *picture, code=2)
    assert "--poses: goes with a log" in refused(capsys, map_path, "--poses", log_path, code=2)
    parser = Parser()
    options.add_log(parser)
    assert READING.keys() == parser._option_string_actions.keys() - {"-h", "--help", "--max-unpacked"}
    for option, value in READING.items():
        assert f"{option}: says how a log is read, and {map_path}" in refused(capsys, map_path, option, *value, code=2)
    assert "topic applies to bags only" in refused(capsys, map_path, "--map-topic", "/map", code=2)
    error = refused(capsys, raw_log_path, "--map", map_path, *picture)
    assert "no scan has a reference pose to draw it on a map; give --poses FILE" in error
    assert not (tmp_path / "a.png").exists()


def test_a_parameter_file_is_for_the_doctor(tmp_path, capsys):
    (tmp_path / "nav2_params.yaml").write_text("amcl:\n  ros__parameters:\n    z_hit: 0.5\n    laser_max_range: 9.0\n")
    (tmp_path / "metadata.yaml").write_text("rosbag2_bagfile_information:\n  version: 5\n")
    assert "of a ROS 2 bag: give its folder" in refused(capsys, tmp_path / "metadata.yaml")
    error = refused(capsys, tmp_path / "nav2_params.yaml")
    assert "this is a parameter file of nav2, not a map: use `beamfield doctor nav2_params.yaml`" in error


@pytest.mark.parametrize(("log", "grid", "kind"), [("run.bag", "nav2.yaml", "map"), ("nav2.yaml", "map.yaml", "log")])
def test_a_parameter_file_in_place_of_another_is_named(capsys, map_path, tmp_path, monkeypatch, log, grid, kind):
    (tmp_path / "nav2.yaml").write_text("amcl:\n  ros__parameters:\n    z_hit: 0.5\n    laser_max_range: 9.0\n")
    monkeypatch.chdir(tmp_path)
    words = ["calibrate", log, "--map", str(map_path) if grid == "map.yaml" else grid, "--quiet"]
    assert main(words) == 1
    assert f"nav2.yaml: this is a parameter file of nav2, not a {kind}" in capsys.readouterr().err


def test_the_picture_comes_into_a_new_folder_but_an_error_leaves_none(capsys, log_path, tmp_path):
    shown(capsys, log_path, "--out", tmp_path / "new" / "folder" / "a.png")
    assert (tmp_path / "new" / "folder" / "a.png").is_file()
    refused(capsys, tmp_path / "none.log", "--out", tmp_path / "other" / "a.png")
    assert not (tmp_path / "other").exists()


def test_quiet_leaves_one_line(capsys, log_path):
    assert main(["inspect", str(log_path), "--quiet"]) == 0
    assert capsys.readouterr() == ("drive.log: log with 1 sensor\n", "")
