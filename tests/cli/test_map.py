from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from beamfield.cli import map as map_command
from beamfield.errors import BeamfieldError, InvalidInputError, TooLittleDataError
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.maps.mapping import InverseSensorModel, build_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, ScanLog, SensorLog

FINDER = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 91.0, 3.0)), max_range=12.0, name="FLASER")


def run(log: Path, out: Path, *words: str) -> int:
    parser = argparse.ArgumentParser()
    map_command.add_parser(parser.add_subparsers())
    arguments = parser.parse_args(["map", str(log), "--out", str(out), "--quiet", *words])
    code: int = arguments.run(arguments)
    return code


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
    assert f"map of 40 scans: {cols * 0.1:.2f} m x {rows * 0.1:.2f} m, {rows} x {cols} cells of 0.1 m" in out
    assert f"{built.free.sum()} free, {built.occupied.sum()} occupied" in out
    share = float(out.split("sharpness: ")[1].split(" %")[0])
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


def test_a_map_that_is_there_is_kept_unless_overwritten(log, tmp_path):
    out = tmp_path / "room.yaml"
    out.with_suffix(".pgm").write_text("mine")
    with pytest.raises(InvalidInputError, match=r"room\.pgm: is there already; .* --overwrite"):
        run(log, out)
    assert out.with_suffix(".pgm").read_text() == "mine"
    assert run(log, out, "--overwrite") == 0
    assert read_map(out).occupied.any()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--hit", "0.4"), "hit: expected a probability"),
        (("--resolution", "0"), "--resolution: expected a positive number of metres, got 0.0"),
        (("--resolution", "1e-5"), "the limit is 100000000"),
        (("--sensor", "a", "--sensor", "b"), "--sensor: expected one for a map, got a, b"),
        (("--sensor", "RAWLASER1"), "RAWLASER1"),
        (("--odometry", "--poses", "x.tum"), "--odometry: poses come from --poses already"),
        (("--poses", "no_such_file.tum"), "no_such_file.tum"),
        (("--lone-poses", "odometry"), "no scan has a reference pose"),
    ],
)
def test_what_cannot_be_done_leaves_no_file(log, tmp_path, words, message):
    with pytest.raises((BeamfieldError, OSError)) as error:
        run(log, tmp_path / "room.yaml", *words)
    assert message in str(error.value)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_refused_before_the_log_is_read(tmp_path):
    with pytest.raises(FileNotFoundError, match="No such folder to write into"):
        run(tmp_path / "no.log", tmp_path / "no folder" / "room.yaml")


def test_the_name_must_be_that_of_a_yaml_file(log, tmp_path):
    with pytest.raises(InvalidInputError, match=r"--out: expected a name ending in .yaml or .yml, got 'room.png'"):
        run(log, tmp_path / "room.png")


def test_odometry_may_stand_in_for_reference_poses(tmp_path, log):
    words = ("--odometry", "--lone-poses", "odometry")
    assert run(log, tmp_path / "room.yaml", *words) == 0
    assert run(log, tmp_path / "same.yaml") == 0
    assert (tmp_path / "room.pgm").read_bytes() == (tmp_path / "same.pgm").read_bytes()


def test_a_log_without_hits_makes_no_map(tmp_path):
    sensor = SensorLog(FINDER, [1.0, 2.0], np.full((2, 61), 12.0), np.zeros((2, 3)), np.zeros((2, 3)))
    write_carmen(tmp_path / "blind.log", ScanLog({"FLASER": sensor}))
    with pytest.raises(TooLittleDataError, match="2 scans mark no cell as occupied; no map written"):
        run(tmp_path / "blind.log", tmp_path / "map.yaml", "--max-range", "12")
    assert [path.name for path in tmp_path.iterdir()] == ["blind.log"]
