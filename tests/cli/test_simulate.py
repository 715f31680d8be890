from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import read_trajectory
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.simulation.floor_plan import draw_floor_plan

FAST = ("--duration", "20", "--scan-rate", "4", "--beams", "31")


def run(out: Path, *words: str) -> int:
    return main(["simulate", "--out", str(out), *FAST, *words])


def refused(capsys: pytest.CaptureFixture[str], out: Path, *words: str, code: int = 2) -> str:
    assert main(["simulate", "--out", str(out), "--quiet", *words]) == code
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("simulated") / "out"
    assert run(out, "--format", "both", "--seed", "7", "--range-offset", "0.03") == 0
    return out


def test_all_files_are_written_and_named_on_stdout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "new" / "out"
    assert run(out) == 0
    assert names(out) == ["log.carmen", "map.pgm", "map.yaml", "truth.json", "truth.tum"]
    assert names(tmp_path / "new") == ["out"]
    printed = capsys.readouterr()
    assert printed.out.splitlines() == [
        "simulated 80 scans of 31 beams in 20 s",
        "",
        f"wrote map.yaml, map.pgm, log.carmen, truth.tum, truth.json into {out}",
    ]
    assert printed.err.splitlines() == ["making the map ...", "measuring ...", "writing ..."]


def test_the_map_reads_back_as_the_office_of_that_seed(both: Path) -> None:
    read, drawn = read_map(both / "map.yaml"), draw_floor_plan(seed=7)
    np.testing.assert_array_equal(read.occupied, drawn.occupied)
    np.testing.assert_array_equal(read.free, drawn.free)
    np.testing.assert_allclose(read.origin, drawn.origin)
    assert read.resolution == drawn.resolution


def test_truth_holds_parameters_options_and_the_hashes_of_the_files(both: Path) -> None:
    truth = json.loads((both / "truth.json").read_text())
    assert truth["seed"] == 7
    assert truth["program"].startswith("beamfield ")
    assert truth["parameters"]["range_offset"] == 0.03
    assert truth["parameters"]["z_hit"] == 0.82
    assert truth["odometry_noise"]["distance_scale"] == 0.005
    assert truth["options"]["duration"] == 20.0
    assert truth["scans"] == 80
    assert sorted(truth["files"]) == ["bag", "log.carmen", "map.pgm", "map.yaml", "truth.tum"]
    digest = hashlib.sha256((both / "log.carmen").read_bytes()).hexdigest()
    assert truth["files"]["log.carmen"] == digest
    assert str(both) not in (both / "truth.json").read_text()


def test_both_formats_read_back_as_the_same_log(both: Path) -> None:
    text, bag = read_log(both / "log.carmen").only_sensor(), read_log(both / "bag").only_sensor()
    assert len(text) == len(bag) == 80
    np.testing.assert_allclose(text.finder.mounts, bag.finder.mounts, atol=1e-5)
    assert text.finder.max_range == pytest.approx(bag.finder.max_range)
    for log in (text, bag):
        assert np.isinf(log.ranges).sum() > 0
    np.testing.assert_array_equal(np.isinf(text.ranges), np.isinf(bag.ranges))
    returned = np.isfinite(text.ranges)
    np.testing.assert_allclose(text.ranges[returned], bag.ranges[returned], atol=1e-3)
    np.testing.assert_allclose(text.poses, bag.poses, atol=1e-5)
    np.testing.assert_allclose(text.odometry, bag.odometry, atol=1e-5)
    np.testing.assert_allclose(np.diff(text.stamps), 0.25, atol=1e-5)
    np.testing.assert_allclose(text.stamps, bag.stamps, atol=1e-5)


def test_hits_lie_at_the_expected_ranges_of_the_files_themselves(both: Path) -> None:
    log, grid = read_log(both / "log.carmen").only_sensor(), read_map(both / "map.yaml")
    expected = RayCaster(grid).expected_ranges(log.poses, log.finder)
    error = (log.ranges - expected)[(expected < 12.0) & np.isfinite(log.ranges)]
    hits = np.abs(error) < 0.2
    assert hits.mean() > 0.8
    # The offset of 3 cm, with noise of 4 cm over some 2,000 hits.
    assert np.median(error[hits]) == pytest.approx(0.03, abs=0.005)


def test_the_trajectory_file_holds_the_true_poses(both: Path) -> None:
    track = read_trajectory(both / "truth.tum")
    log = read_log(both / "log.carmen").only_sensor()
    np.testing.assert_allclose(track.stamps, log.stamps, atol=1e-5)
    np.testing.assert_allclose(track.poses, log.poses, atol=1e-5)


def test_a_log_with_odometry_only_is_the_same_without_poses(both: Path, tmp_path: Path) -> None:
    words = ("--format", "both", "--seed", "7", "--range-offset", "0.03", "--odometry-only")
    assert run(tmp_path / "out", *words) == 0
    full = read_log(both / "log.carmen").only_sensor()
    text = read_log(tmp_path / "out" / "log.carmen", lone_poses="odometry").only_sensor()
    for log in (text, read_log(tmp_path / "out" / "bag").only_sensor()):
        assert not log.has_poses
        np.testing.assert_allclose(log.odometry, full.odometry, atol=1e-5)
        np.testing.assert_allclose(log.finder.mounts, full.finder.mounts, atol=1e-5)
    np.testing.assert_array_equal(text.ranges, full.ranges)
    assert (tmp_path / "out" / "truth.tum").read_bytes() == (both / "truth.tum").read_bytes()


def test_the_same_seed_writes_the_same_files(tmp_path: Path) -> None:
    for name in ("first", "again"):
        run(tmp_path / name, "--seed", "5", "--format", "both")
    hashes = [json.loads((tmp_path / name / "truth.json").read_text())["files"] for name in ("first", "again")]
    assert hashes[0] == hashes[1]


def test_a_map_of_ones_own_is_driven_through(tmp_path: Path) -> None:
    cells = np.full((100, 160), 100)
    cells[2:-2, 2:-2] = 0
    cells[40:60, 70:90] = 100
    write_map(OccupancyGrid.from_ros(cells, 0.1, [5.0, -3.0, 0.4]), tmp_path / "hall.yaml")
    assert run(tmp_path / "out", "--map", str(tmp_path / "hall.yaml"), "--seed", "2") == 0
    saved = read_map(tmp_path / "out" / "map.yaml")
    np.testing.assert_array_equal(saved.occupied, cells == 100)
    log = read_log(tmp_path / "out" / "log.carmen").only_sensor()
    assert saved.look_up(saved.free, log.poses[:, :2]).all()
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert truth["inputs"]["map"]["name"] == "hall.yaml"
    assert truth["inputs"]["map image"]["name"] == "hall.pgm"


def test_dependence_is_passed_on_in_radians(tmp_path: Path) -> None:
    run(tmp_path / "out", "--dependence-angle", "180", "--dependence-time", "2.5")
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert truth["dependence"] == {"angle": pytest.approx(np.pi), "time": 2.5}


def test_beams_over_a_full_turn_do_not_repeat_the_first(tmp_path: Path) -> None:
    run(tmp_path / "out", "--fov", "360", "--beams", "8")
    finder = read_log(tmp_path / "out" / "log.carmen").only_sensor().finder
    np.testing.assert_allclose(np.diff(np.unwrap(finder.bearings)), np.pi / 4, atol=1e-6)


def test_files_of_the_same_name_are_replaced_and_others_stay(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "truth.json").write_text("old")
    assert run(tmp_path) == 0
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert json.loads((tmp_path / "truth.json").read_text())["scans"] == 80


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--z-hit", "0.5"), r"z_hit \+ z_short \+ z_max \+ z_rand: expected 1, got 0.68"),
        (("--sigma-hit", "0"), "sigma_hit: expected a positive"),
        (("--beams", "0"), "--beams: expected a whole number >= 1, got '0'"),
        (("--fov", "0"), "--fov: expected a number > 0, got '0'"),
        (("--fov", "361"), "--fov: expected at most 360 degrees, got '361'"),
        (("--fov", "nan"), "--fov: expected a number > 0"),
        (("--max-range", "-1"), "--max-range: expected a number > 0"),
        (("--duration", "0"), "--duration: expected a number > 0"),
        (("--seed", "-1"), "--seed: expected a whole number >= 0"),
        (("--width", "3"), "building: expected 26 x 20"),
        (("--robot-radius", "3"), r"no free place for a robot of radius 3 m"),
        (("--dependence-time", "-1"), "--dependence-time: expected a number >= 0"),
        (("--mount", "inf", "0", "0"), "--mount: expected a finite number"),
    ],
)
def test_impossible_options_are_refused_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    assert re.search(message, refused(capsys, tmp_path / "out", *words))
    assert names(tmp_path) == []


def test_a_map_that_does_not_exist_is_reported_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert "nowhere.yaml" in refused(capsys, tmp_path / "out", "--map", str(tmp_path / "nowhere.yaml"), code=1)
    assert names(tmp_path) == []


def test_an_error_while_writing_leaves_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("beamfield.io.logs.carmen.write_carmen", fail)
    assert "No space left" in refused(capsys, tmp_path / "out", *FAST, code=1)
    assert names(tmp_path) == []


SONAR = ("--sonar", "--ring", "12")


def run_sonar(out: Path, *words: str) -> int:
    return main(["simulate", "--out", str(out), "--duration", "10", "--scan-rate", "4", *SONAR, *words])


def test_a_ring_of_sonars_is_written_with_its_cones(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_sonar(tmp_path / "out", "--opening-angle", "25", "--ring-radius", "0.15", "--roughness", "0.5") == 0
    assert "simulated 40 scans of 12 sonars in 10 s" in capsys.readouterr().out
    log = read_log(tmp_path / "out" / "log.carmen").only_sensor()
    assert log.finder.n_beams == 12
    assert log.finder.opening_angle == pytest.approx(np.radians(25.0))
    assert log.finder.max_range == 5.0
    np.testing.assert_allclose(np.hypot(*log.finder.mounts[:, :2].T), 0.15)
    truth = json.loads((tmp_path / "out" / "truth.json").read_text())
    assert truth["roughness"] == 0.5
    assert truth["parameters"]["z_hit"] == 0.82


def test_rough_walls_give_the_ranges_that_a_cone_expects(tmp_path: Path) -> None:
    words = ("--roughness", "1", "--z-hit", "1", "--z-short", "0", "--z-max", "0", "--z-rand", "0")
    run_sonar(tmp_path / "out", *words, "--sigma-hit", "0.03")
    log, grid = read_log(tmp_path / "out" / "log.carmen").only_sensor(), read_map(tmp_path / "out" / "map.yaml")
    expected = ConeCaster(grid).expected_ranges(log.poses, log.finder)
    heard = np.isfinite(log.ranges)
    np.testing.assert_array_equal(heard, expected < 5.0)
    assert np.std((log.ranges - expected)[heard]) == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--sonar", "--ring", "0"), "--ring: expected 1 to 360 sensors, got 0"),
        (("--sonar", "--opening-angle", "180"), "--opening-angle: expected 0 to below 180"),
        (("--sonar", "--roughness", "2"), "roughness: expected a share"),
        (("--sonar", "--mount", "0.3", "0", "0"), "--mount: is no option of --sonar"),
        (("--sonar", "--format", "both"), "--format: a ring of sonars is written as CARMEN text"),
        (("--roughness", "0.5"), "--roughness: is an option of --sonar"),
        (("--map", "m.yaml", "--width", "30"), "--width: is of the office, and --map drives through another map"),
    ],
)
def test_options_that_change_nothing_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], message: str
) -> None:
    assert message in refused(capsys, tmp_path / "out", *words)
    assert names(tmp_path) == []
