"""beamfield trajectory, by what it prints and writes."""

from __future__ import annotations

import json
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.errors import TrajectoryNotFoundError
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.trajectory import read_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import ScanLog, SensorLog


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, office: OccupancyGrid, drive: SensorLog) -> Path:
    """The map, and a log whose reference poses are not used."""
    path = tmp_path_factory.mktemp("trajectory")
    write_map(office, path / "map.yaml")
    write_carmen(path / "run.log", ScanLog({"laser": drive.select(np.arange(100))}))
    return path


def run(folder: Path, *words: str) -> int:
    return main(["trajectory", str(folder / "run.log"), "--map", str(folder / "map.yaml"), *words])


def test_poses_and_a_picture_are_written_and_numbers_printed(
    folder: Path, drive: SensorLog, capsys: pytest.CaptureFixture[str]
):
    out = folder / "run.tum"
    assert run(folder, "--out", str(out), "--json") == 0
    document = json.loads(capsys.readouterr().out)
    track = read_trajectory(out)
    assert len(track) == document["scans"] == 100
    assert np.hypot(*(track.poses - drive.poses[:100])[:, :2].T).max() < 0.1
    assert document["share_trusted"] == 1.0
    assert document["hypotheses"][0]["share_that_agrees"] > 0.5
    assert (folder / "run.png").read_bytes().startswith(b"\x89PNG")


def test_poses_that_are_not_trusted_are_left_out_if_asked(folder: Path, capsys: pytest.CaptureFixture[str]):
    out = folder / "trusted.tum"
    common = ["--out", str(out), "--json", "--max-deviation", "0.01"]
    assert run(folder, *common) == 3
    everything = read_trajectory(out)
    capsys.readouterr()
    assert run(folder, *common, "--trusted-only") == 3
    share, kept = json.loads(capsys.readouterr().out)["share_trusted"], read_trajectory(out)
    assert 0 < len(kept) == round(100 * share) < len(everything) == 100
    assert np.isin(kept.stamps, everything.stamps).all()


def test_a_start_off_the_map_and_a_name_without_an_ending_are_refused(folder: Path, capsys: pytest.CaptureFixture[str]):
    out = folder / "none.tum"
    assert run(folder, "--out", str(out), "--start", "900", "0", "0") == 2
    assert capsys.readouterr().err.endswith("error: --start: (900 m, 0 m) lies off the map\n")
    assert run(folder, "--out", str(folder / "poses.csv")) == 2
    assert not out.exists()


def test_where_nothing_fits_nothing_is_written_and_of_a_sonar_its_cones_are_blamed(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    out = folder / "none.tum"
    refused = TrajectoryNotFoundError("no trajectory through this map fits the log")
    monkeypatch.setattr("beamfield.localization.trajectory.choose_course", Mock(side_effect=refused))
    assert run(folder, "--out", str(out)) == 3
    assert "sonar" not in capsys.readouterr().err
    assert run(folder, "--opening-angle", "20", "--out", str(out)) == 3
    assert capsys.readouterr().err.endswith("are fitted as beams, which rarely works without --start X Y DEG\n")
    assert not out.exists()
