from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.maps.mapping import InverseSensorModel, build_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, ScanLog, SensorLog

FINDER = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 91.0, 3.0)), max_range=12.0, name="FLASER")


def run(log: Path, out: Path, *words: str) -> int:
    return main(["map", str(log), "--out", str(out), *words])


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Forty scans in a room of 9 m x 6 m."""
    values = np.zeros((120, 180))
    values[[0, -1]], values[:, [0, -1]], values[50, :80] = 100, 100, 100
    room = OccupancyGrid.from_ros(values, 0.05, (-2.0, 1.0, 0.0))
    rng = np.random.default_rng(4)
    poses = np.column_stack([rng.uniform(-1, 6, 40), rng.uniform(1.5, 3.0, 40), rng.uniform(-3, 3, 40)])
    ranges = RayCaster(room).expected_ranges(poses, FINDER) + rng.normal(0.02, 0.005, (40, 61))
    sensor = SensorLog(FINDER, 100.0 + np.arange(40.0), ranges, poses, poses)
    path = tmp_path_factory.mktemp("log") / "room.log"
    write_carmen(path, ScanLog({"FLASER": sensor}))
    return path


def test_writes_a_map_that_reads_back_as_the_one_in_memory(log, tmp_path, capsys):
    assert run(log, tmp_path / "room.yaml", "--resolution", "0.1") == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["room.pgm", "room.yaml"]
    read = read_map(tmp_path / "room.yaml")
    built = build_map(read_log(log).only_sensor(), resolution=0.1)
    np.testing.assert_array_equal(read.occupied, built.occupied)
    np.testing.assert_array_equal(read.free, built.free)
    np.testing.assert_allclose(read.origin, built.origin)
    assert read.resolution == 0.1
    out = capsys.readouterr().out
    rows, cols = built.shape
    # As `beamfield inspect` says it: columns first.
    assert f"map of {cols} x {rows} cells of 0.1 m: {cols * 0.1:.2f} m x {rows * 0.1:.2f} m" in out
    assert re.search(rf"free +{built.free.sum():,} cells", out)
    assert re.search(rf"occupied +{built.occupied.sum():,} cells", out)
    share = float(out.split("sharpness: ")[1].split("%")[0])
    assert share > 95.0
    assert f"wrote {tmp_path / 'room.yaml'} and room.pgm" in out


def test_raw_mode_keeps_percents(log, tmp_path):
    assert run(log, tmp_path / "room.yaml", "--mode", "raw", "--resolution", "0.1") == 0
    read = read_map(tmp_path / "room.yaml")
    built = build_map(read_log(log).only_sensor(), resolution=0.1)
    np.testing.assert_allclose(read.probability, built.probability, atol=0.00501)


def test_options_reach_the_inverse_sensor_model(log, tmp_path):
    words = ("--hit", "0.98", "--passed", "0.02", "--longest-hit", "3", "--clear-without-return", "1")
    assert run(log, tmp_path / "room.yaml", *words, "--max-range", "4") == 0
    model = InverseSensorModel(0.98, 0.02, 0.02, 0.98, longest_hit=3.0, clear_without_return=1.0)
    built = build_map(read_log(log, max_range=4.0).only_sensor(), inverse_model=model)
    read = read_map(tmp_path / "room.yaml")
    np.testing.assert_array_equal(read.occupied, built.occupied)
    np.testing.assert_array_equal(read.free, built.free)


def test_a_map_that_is_there_is_replaced_and_missing_folders_are_made(log, tmp_path):
    out = tmp_path / "new" / "room.yaml"
    assert run(log, out) == 0
    first = out.with_suffix(".pgm").read_bytes()
    assert run(log, out, "--resolution", "0.1") == 0
    assert out.with_suffix(".pgm").read_bytes() != first
    assert read_map(out).resolution == 0.1


@pytest.mark.parametrize(
    ("words", "message", "code"),
    [
        (("--hit", "0.4"), "hit: expected a probability", 2),
        (("--resolution", "0"), "--resolution: expected a number > 0, got '0'", 2),
        (("--resolution", "1e-5"), "the limit is 100000000", 1),
        (("--sensor", "a", "--sensor", "b"), "--sensor: expected one, got a, b", 2),
        (("--sensor", "RAWLASER1"), "RAWLASER1", 2),
        (("--odometry", "--poses", "x.tum"), "--odometry: poses come from --poses already", 2),
        (("--poses", "no_such_file.tum"), "no_such_file.tum", 1),
        (("--lone-poses", "odometry"), "or a TUM or CSV file with --poses, or --odometry", 1),
    ],
)
def test_what_cannot_be_done_leaves_no_file(log, tmp_path, capsys, words, message, code):
    assert run(log, tmp_path / "new" / "room.yaml", "--quiet", *words) == code
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_named_before_the_log_is_read(tmp_path, capsys):
    (tmp_path / "file").write_text("in the way")
    assert run(tmp_path / "no.log", tmp_path / "file" / "room.yaml") == 1
    assert capsys.readouterr().err == f"beamfield: error: {tmp_path / 'file'}: Not a directory\n"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="a system without /proc")
def test_where_nothing_can_be_created_the_users_path_is_named(tmp_path, capsys):
    assert run(tmp_path / "no.log", Path("/proc/room.yaml")) == 1
    assert capsys.readouterr().err.startswith("beamfield: error: /proc/room.yaml: ")


def test_the_name_must_be_that_of_a_yaml_file(log, tmp_path, capsys):
    assert run(log, tmp_path / "room.png") == 2
    assert "--out: expected a name ending in .yaml or .yml, got 'room.png'" in capsys.readouterr().err


def test_odometry_may_stand_in_for_reference_poses(tmp_path, log):
    words = ("--odometry", "--lone-poses", "odometry")
    assert run(log, tmp_path / "room.yaml", *words) == 0
    assert run(log, tmp_path / "same.yaml") == 0
    assert (tmp_path / "room.pgm").read_bytes() == (tmp_path / "same.pgm").read_bytes()


def test_a_log_without_hits_makes_no_map(tmp_path, capsys):
    sensor = SensorLog(FINDER, [1.0, 2.0], np.full((2, 61), 12.0), np.zeros((2, 3)), np.zeros((2, 3)))
    write_carmen(tmp_path / "blind.log", ScanLog({"FLASER": sensor}))
    assert run(tmp_path / "blind.log", tmp_path / "map.yaml", "--max-range", "12") == 3
    assert "2 scans mark no cell as occupied; no map written" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["blind.log"]


@pytest.mark.parametrize(("command", "out"), [("calibrate", "out"), ("map", "out.yaml")])
def test_of_several_sensors_one_is_to_be_chosen(tmp_path, capsys, command, out):
    log = tmp_path / "two.log"
    log.write_text("".join(f"{name} 3 1 2 3 0 0 0 0 0 0 1 host 1\n" for name in ("FLASER", "RLASER")))
    assert main([command, str(log), "--quiet", "--out", str(tmp_path / out)]) == 1
    expected = "two.log: expected one sensor, the log has 'FLASER', 'RLASER': choose with --sensor\n"
    assert capsys.readouterr().err.endswith(expected)
