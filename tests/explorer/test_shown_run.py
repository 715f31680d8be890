"""A filter's run beside its log."""

import gzip

import numpy as np
import pytest
from numpy.testing import assert_allclose

from beamfield.errors import FormatError
from beamfield.explorer.open_session import open_session
from beamfield.explorer.shown_run import AGREEMENT, ERROR, own_poses_as_run, read_shown_run
from beamfield.finding import Finding
from beamfield.io.filter_run import PARTICLES, TRAJECTORY, write_particles
from beamfield.io.trajectory import write_tum
from beamfield.sensors import Track


@pytest.fixture
def folder(tmp_path, log):
    """A run that is 0.1 m beside the way, with particles after three scans."""
    poses = log.odometry + np.array([0.0, 0.1, 0.0])
    write_tum(tmp_path / TRAJECTORY, Track(log.stamps, poses))
    write_particles(tmp_path / PARTICLES, [(log.stamps[i], poses[i] + np.zeros((i, 3))) for i in (2, 5, 8)])
    return tmp_path


def test_poses_and_particles_come_back_at_their_scans(folder, log, grid):
    run = read_shown_run(folder, log, grid)
    assert_allclose(run.poses - log.odometry, np.tile([0.0, 0.1, 0.0], (12, 1)), atol=1e-8)
    assert {i: len(cloud) for i, cloud in run.particles.items()} == {2: 2, 5: 5, 8: 8}
    assert_allclose(run.particles[5], np.tile(run.poses[5], (5, 1)), atol=1e-4)
    assert np.nanmin(run.numbers[AGREEMENT]) > 0.6
    assert run.lost is None
    start = open_session(log, grid, run=run, fit=False)[0].answer({"name": "start"})
    assert_allclose(start["numbers"][ERROR][:-1], 0.1, atol=1e-6)
    assert start["levels"] == {AGREEMENT: 0.45}
    assert sorted(start["run"]["particles"]) == [2, 5, 8]


def test_a_trajectory_of_another_program_has_no_particles_and_may_be_lost(folder, log, grid):
    write_tum(folder / "amcl.tum", Track(log.stamps[:6], log.odometry[:6] + np.array([2.5, 3.2, 1.3])))
    run = read_shown_run(folder / "amcl.tum", log, grid)
    assert run.particles == {}
    assert np.isnan(run.poses[6:]).all()
    assert run.lost.name == "robot-lost"
    assert np.nanmedian(run.numbers[AGREEMENT]) < 0.45


def test_poses_of_a_log_that_lose_the_robot_are_shown_as_a_run(log, grid):
    lost = Finding("own-poses-lost", "warning", "They leave the fitted ones.")
    own = log.with_poses(log.odometry + np.linspace(0.0, 3.0, 12)[:, None] * [0.0, 1.0, 0.0])
    run = own_poses_as_run(own, grid, lost)
    start = open_session(log.with_poses(log.odometry), grid, run=run, fit=False)[0].answer({"name": "start"})
    assert start["run"]["lost"] == "They leave the fitted ones."
    assert_allclose(np.array(start["run"]["poses"])[-1] - log.odometry[-1], [0.0, 3.0, 0.0], atol=1e-3)
    assert start["numbers"][ERROR][-1] == pytest.approx(3.0, abs=1e-3)


def test_a_run_of_another_log_is_refused(folder, log, grid):
    write_tum(folder / TRAJECTORY, Track(log.stamps + 1e6, log.odometry))
    with pytest.raises(FormatError, match=r"another log: its poses are from 1000000\.000"):
        read_shown_run(folder, log, grid)
    write_tum(folder / TRAJECTORY, Track(log.stamps, log.odometry))
    write_particles(folder / PARTICLES, [(log.stamps[3] + 0.1, log.odometry[:2])])
    with pytest.raises(FormatError, match=r"no scan at 1\.600 s"):
        read_shown_run(folder, log, grid)


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "empty"), (b"t,x,y\n1,2,3\n", "theta"), (b"t,x,y,theta\n1,2,far,0\n", ":2: .*'far'"), (None, "gzip")],
)
def test_damaged_particles_are_refused(folder, log, grid, content, words):
    path = folder / PARTICLES
    path.write_bytes(path.read_bytes()[:-9] if content is None else gzip.compress(content))
    with pytest.raises(FormatError, match=words):
        read_shown_run(folder, log, grid)
    path.unlink()
    assert read_shown_run(folder, log, grid).particles == {}
    (folder / TRAJECTORY).unlink()
    with pytest.raises(FileNotFoundError):
        read_shown_run(folder, log, grid)
