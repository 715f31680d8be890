"""The doctor replays the filter that a file sets up: bad values lose the robot, good ones follow it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.errors import FormatError, TooLittleDataError
from beamfield.finding import Finding
from beamfield.io.bags.writer import write_bag
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, ScanLog, SensorLog, Track
from beamfield.simulation.log import simulate_log
from beamfield.stacks.doctor.replayed import RUNS, replayed
from beamfield.stacks.files.calibration_record import MOVED_MAP
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.fit.replay_runs import shifted_map
from tests.conftest import TRUTH

GOOD = """\
amcl:
  ros__parameters:
    laser_model_type: "likelihood_field_prob"
    max_beams: 15
    sigma_hit: 0.1
    z_hit: 0.8
    z_rand: 0.2
    alpha1: 0.02
    alpha2: 0.02
    alpha3: 0.02
    alpha4: 0.02
    min_particles: 200
    max_particles: 400
"""


BAD = GOOD.replace("prob", "").replace("likelihood_field_", "likelihood_field").replace(": 0.02", ": 5.0")


@pytest.fixture(scope="module")
def drive(office: OccupancyGrid) -> SensorLog:
    finder = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 61), 10.0, name="laser")
    return simulate_log(office, finder, TRUTH, duration=60.0, scan_rate=3.0, seed=5).only_sensor()


def found(text: str, office: OccupancyGrid, drive: SensorLog, folder: Path) -> Finding:
    path = folder / "nav2.yaml"
    path.write_text(text)
    return replayed(read_stack_file(path), office, drive)


def test_values_that_follow_the_robot_are_said_to(office, drive, tmp_path):
    finding = found(GOOD, office, drive, tmp_path)
    assert finding.severity == "info"
    assert finding.values["lost"] == 0
    assert finding.values["runs"] >= RUNS
    assert finding.values["error_m"] < 0.1
    assert "none of" in finding.text


def test_values_that_lose_it_are_a_warning(office, drive, tmp_path):
    finding = found(BAD, office, drive, tmp_path)
    assert finding.severity == "warning"
    assert finding.values["lost"] > 0.5 * finding.values["runs"]
    assert f"{finding.values['lost']} of {finding.values['runs']} runs" in finding.text


def test_values_that_lag_far_behind_are_a_warning_though_no_run_is_lost(office, drive, tmp_path, monkeypatch):
    monkeypatch.setattr("beamfield.stacks.doctor.replayed.FAR", 0.01)
    finding = found(GOOD, office, drive, tmp_path)
    assert (finding.severity, finding.values["lost"]) == ("warning", 0)


@pytest.mark.parametrize(("lost", "severity", "said"), [(1, "info", "one run may be chance"), (2, "warning", "lost")])
def test_one_lost_run_is_put_down_to_chance(lost, severity, said, office, drive, tmp_path, monkeypatch):
    outcomes = iter([True] * lost + [False] * 99)
    monkeypatch.setattr(
        "beamfield.stacks.doctor.replayed.run_trials",
        lambda _, __, seeds, **___: SimpleNamespace(
            errors=[SimpleNamespace(lost=next(outcomes), mean=0.1) for _ in seeds]
        ),
    )
    finding = found(GOOD, office, drive, tmp_path)
    assert (finding.severity, finding.values["lost"]) == (severity, lost)
    assert said in finding.why


def test_a_file_for_amcls_own_map_is_replayed_on_that_map(drive, office, tmp_path):
    own = GOOD + f"# calibrated by beamfield for the map {MOVED_MAP}\n"
    # With the walls moved back as far as that map has them, its own map is the true one.
    apart = shifted_map(office, -0.5 * office.resolution)
    ours, plain = (found(text, apart, drive, tmp_path).values["error_m"] for text in (own, GOOD))
    assert ours < plain


def test_a_short_drive_and_a_bad_value_say_why_nothing_is_replayed(office, drive, tmp_path):
    with pytest.raises(TooLittleDataError, match="a replay needs 36 updates"):
        found(GOOD, office, drive[:40], tmp_path)
    with pytest.raises(FormatError, match=r"nav2\.yaml:8: alpha1"):
        found(GOOD.replace("alpha1: 0.02", "alpha1: text"), office, drive, tmp_path)


def test_the_command_replays_where_there_is_odometry(office, drive, tmp_path, capsys):
    (tmp_path / "nav2.yaml").write_text(BAD)
    write_map(office, tmp_path / "map.yaml")
    write_bag(tmp_path / "drive", ScanLog({"scan": drive}, odometry=Track(drive.stamps, drive.odometry)))
    asked = ["doctor", str(tmp_path / "nav2.yaml"), "--map", str(tmp_path / "map.yaml"), "--log"]
    assert main([*asked, str(tmp_path / "drive")]) == 1
    assert "warning: replayed\n" in capsys.readouterr().out
    write_bag(tmp_path / "short", ScanLog({"scan": drive[:40]}, odometry=Track(drive.stamps, drive.odometry)))
    main([*asked, str(tmp_path / "short")])
    said = capsys.readouterr()
    assert "replayed\n" not in said.out
    assert "the filter was not replayed" in said.err
