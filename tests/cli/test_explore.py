"""The command that serves the explorer."""

import json
import socket

import numpy as np
import pytest

from beamfield.cli.main import main
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.read_log import read_log
from beamfield.sensors import ScanLog
from tests.cli.simulated import simulated

uvicorn = pytest.importorskip("uvicorn")


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("world"), "--duration 10 --beams 11 --seed 1")


@pytest.fixture
def served(monkeypatch):
    """Servers that were started; they end at once."""
    started = []
    monkeypatch.setattr(
        uvicorn.Server, "run", lambda self, sockets: started.append((self.config.app, sockets[0].getsockname()))
    )
    return started


def explore(world, *words):
    return main(["explore", str(world / "log.carmen"), "--map", str(world / "map.yaml"), "--no-browser", *words])


def test_it_prints_an_address_with_a_token_and_serves_it(world, served, capsys):
    testclient = pytest.importorskip("starlette.testclient")
    assert explore(world, "--no-fit", "--run", str(world / "truth.tum")) == 0
    out, err = capsys.readouterr()
    address = next(word for word in err.split() if word.startswith("http://127.0.0.1:"))
    ((app, (host, port)),) = served
    assert host == "127.0.0.1"
    assert address.startswith(f"http://127.0.0.1:{port}/?token=")
    assert "beamfield explorer" in testclient.TestClient(app, base_url=f"http://127.0.0.1:{port}").get(address).text
    assert out == "the explorer has ended\n"


@pytest.mark.usefixtures("served")
def test_notes_are_quiet_and_in_the_document(world, capsys):
    assert explore(world, "--no-fit", "--mask=0:10", "--quiet", "--json") == 0
    out, err = capsys.readouterr()
    assert [line.split()[0] for line in err.splitlines()] == ["serving"]
    document = json.loads(out)
    assert any("beams masked" in note for note in document["notes"])
    assert document["address"] in err


def test_a_file_is_read_as_said(world, served, capsys, tmp_path):
    file = tmp_path / "robots.yaml"
    file.write_text(
        "a: {ros__parameters: {max_beams: 9}}\nb: {ros__parameters: {max_beams: 9, laser_min_range: -1.0}}\n"
    )
    words = ("--no-fit", "--params", str(file))
    assert explore(world, *words) == 1
    assert "give --section by label or line: 'a.ros__parameters' (line 1)" in capsys.readouterr().err
    assert explore(world, *words, "--section", "a.ros__parameters", "--stack", "beluga") == 0
    assert len(served) == 1
    assert explore(world, "--no-fit", "--stack", "beluga") == 2
    assert "--stack: is for files of other programs" in capsys.readouterr().err


def test_without_poses_it_is_said_what_is_left_to_do(world, served, capsys, tmp_path):
    log, bare = read_log(world / "log.carmen").only_sensor(), tmp_path / "bare.log"
    write_carmen(bare, ScanLog({"FLASER": log.with_poses(log.odometry)}))
    words = ("--no-browser", "--lone-poses", "odometry", "--opening-angle", "5")
    assert main(["explore", str(bare), "--map", str(world / "map.yaml"), *words]) == 0
    notes = [line for line in capsys.readouterr().err.splitlines() if line.startswith("note: ")]
    assert notes[-1].endswith(
        "give poses with --poses; without poses nothing is learned from the log: drag the robot to where it was"
    )
    assert len(served) == 1


@pytest.mark.usefixtures("served")
def test_with_no_fit_poses_that_the_map_refutes_are_kept_and_it_is_said(world, capsys, tmp_path):
    log, lost = read_log(world / "log.carmen").only_sensor(), tmp_path / "lost.log"
    write_carmen(lost, ScanLog({"FLASER": log.with_poses(np.add(log.poses, [2.0, 2.0, 1.5]))}))
    assert main(["explore", str(lost), "--map", str(world / "map.yaml"), "--no-browser", "--no-fit"]) == 0
    said = capsys.readouterr().err
    assert "fitting all poses" not in said
    assert "readings agree with the map" in said


def test_a_port_in_use_is_refused_before_anything_is_read(world, served, capsys):
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        assert explore(world, "--port", str(port)) == 1
    error = f"beamfield: error: --port {port}: Address already in use; without it any free port is taken\n"
    assert capsys.readouterr().err == error
    assert served == []


def test_bad_input_is_refused_before_anything_is_served(world, served, capsys, tmp_path, monkeypatch):
    monkeypatch.setattr("beamfield.cli.explore.posed_log", None)  # takes long
    assert explore(world, "--port", "70000") == 2
    assert "65535" in capsys.readouterr().err
    (tmp_path / "nav2.yaml").write_text("amcl:\n  ros__parameters:\n    z_hit: high\n")
    assert explore(world, "--no-fit", "--params", str(tmp_path / "nav2.yaml")) == 1
    assert "nav2.yaml" in capsys.readouterr().err
    (tmp_path / "nav2.yaml").write_text("amcl:\n  ros__parameters:\n    laser_model_type: beam\n    max_beams: 60\n")
    assert explore(world, "--params", str(tmp_path / "nav2.yaml")) == 1
    assert "cannot be used with this log: max_beams" in capsys.readouterr().err
    (tmp_path / "trajectory.tum").write_text("9e9 0 0 0 0 0 0 1\n")
    assert explore(world, "--run", str(tmp_path)) == 1
    assert "the run is of another log" in capsys.readouterr().err
    assert served == []
