"""GMapping, g2o, CoreSLAM and sonar logs."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.io.logs.coreslam import read_coreslam
from beamfield.io.logs.g2o import read_g2o
from beamfield.io.logs.gfs import read_gfs
from beamfield.io.logs.sonar_log import read_sonar_log
from beamfield.io.logs.text_scans import TextOptions
from tests.io.test_carmen import write


def laser_reading(i, n=180):
    return f"LASER_READING {n} " + " ".join(str(1 + (i + j) % 9) for j in range(n)) + f" {i} 0.5 0.1 {100 + i}"


def particles(*poses_and_weights):
    return f"SM_UPDATE {len(poses_and_weights)} " + " ".join(" ".join(map(str, p)) for p in poses_and_weights)


GFS = (
    "PARAM maxrange 80",
    "ODO_UPDATE 2 0 0 0 0 0 0 0 0",
    "ODOM 0 0.5 0.1 99",
    laser_reading(0),
    particles((0, 0, 0, -5.0), (1, 0, 0, -9.0)),
    "RESAMPLE 2 1 0",
    laser_reading(1),
    particles((10, 0, 0, -10.0), (11, 0, 0, -7.0)),
    laser_reading(2),
    particles((20, 0, 0, -18.0), (21, 0, 7.0, -20.0)),
)


def test_gmapping_reference_is_the_path_of_the_particle_that_is_best_in_sum(tmp_path):
    log = read_gfs(write(tmp_path, *GFS))
    sensor = log.only_sensor()
    # Particle 0 ends with -9 (its ancestor 1) - 18 = -27, particle 1 with -5 - 20 = -25: the second, whose ancestor
    # in the first scan is particle 0.
    np.testing.assert_allclose(sensor.poses, [[0.0, 0.0, 0.0], [11.0, 0.0, 0.0], [21.0, 0.0, 7.0 - 2.0 * np.pi]])
    np.testing.assert_allclose(sensor.odometry[:, 0], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(sensor.stamps, [100, 101, 102])
    assert sensor.finder.max_range == 80.0
    assert log.odometry is not None
    assert len(log.odometry) == 1


def test_gmapping_log_without_particles_has_no_reference(tmp_path):
    assert not read_gfs(write(tmp_path, laser_reading(0), laser_reading(1))).only_sensor().has_poses


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (laser_reading(3).rsplit(" ", 1)[0], "LASER_READING: expected 186 words, got 185"),
        (particles((1, 2, 3, 4)) + " 5", "SM_UPDATE: expected 6 words, got 7"),
        (particles((0, 1e300, 0, -1)), "SM_UPDATE: expected a finite pose and its weight, got 0.0 1e"),
        (particles((0, 0, 0, "nan")), "SM_UPDATE: expected a finite pose and its weight, got 0.0 0.0 0.0 nan"),
        ("RESAMPLE 2 0 x", "RESAMPLE: expected a number of readings, got 'x'"),
        ("SCAN 1 2", "expected a line of a GMapping log, got 'SCAN'"),
        ("ODOM 1 2", "ODOM: expected 5 words"),
    ],
)
def test_gmapping_bad_line_is_named(tmp_path, line, message):
    with pytest.raises(FormatError, match=message) as caught:
        read_gfs(write(tmp_path, *GFS, line))
    assert caught.value.line == len(GFS) + 1


def test_gmapping_counts_that_disagree_are_refused(tmp_path):
    with pytest.raises(FormatError, match="do not fit its 2 particles"):
        read_gfs(write(tmp_path, *GFS, "RESAMPLE 2 0 2"))
    with pytest.raises(FormatError, match="number of particles changes at scan 4 to 3"):
        read_gfs(write(tmp_path, *GFS, laser_reading(3), particles(*[(1, 2, 3, 4)] * 3)))
    with pytest.raises(FormatError, match="7 beams: the format does not give their bearings"):
        read_gfs(write(tmp_path, laser_reading(0, 7)))
    with pytest.raises(FormatError, match="no line LASER_READING"):
        read_gfs(write(tmp_path, *GFS[:3]))


def g2o_scan(i, n=3):
    ranges = " ".join(str(1 + (i + j) % 5) for j in range(n))
    return f"ROBOTLASER1 0 -1.0 2.0 1.0 50 0.1 0 {n} {ranges} 0 {i + 0.1} 0 0 {i} 0 0 0 0 0 0 0 {10 + i} nohost {i}"


def test_g2o_vertices_are_the_reference_and_edges_are_left(tmp_path):
    lines = [text for i in range(4) for text in (f"VERTEX_SE2 {i} {2 * i} 1 0.5", g2o_scan(i))]
    sensor = read_g2o(write(tmp_path, "# graph", *lines, "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1")).only_sensor()
    np.testing.assert_allclose(sensor.poses, [[2.0 * i, 1.0, 0.5] for i in range(4)])
    np.testing.assert_allclose(sensor.finder.mounts, [[0.1, 0.0, b] for b in (-1.0, 0.0, 1.0)])
    np.testing.assert_array_equal(sensor.stamps, [10, 11, 12, 13])
    assert sensor.finder.max_range == 50.0


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((g2o_scan(0),), r":1: ROBOTLASER1: the scan has no line VERTEX_SE2"),
        (("VERTEX_SE2 0 1 2 3", g2o_scan(0), g2o_scan(1)), r":3: ROBOTLASER1: the scan has no line VERTEX_SE2"),
        (("VERTEX_SE2 0 1 2",), r":1: VERTEX_SE2: expected 5 words"),
        (("VERTEX_SE2 0 1 2 nan",), r":1: VERTEX_SE2: expected a finite pose"),
        (("VERTEX_SE2 0 1 2 3", g2o_scan(0).rsplit(" ", 1)[0]), r":2: ROBOTLASER1: expected 27 words \(3 .*\), got 26"),
        (("VERTEX_SE2 0 1 2 3", g2o_scan(0), "VERTEX_SE2 1 1 2 3", g2o_scan(1, n=4)), r":4: .*4 beams, the first"),
        (("VERTEX_SE2 0 1 2 3",), "no scans"),
    ],
)
def test_g2o_bad_line_is_named(tmp_path, lines, message):
    with pytest.raises(FormatError, match=message):
        read_g2o(write(tmp_path, *lines))


def coreslam_line(i, rng, zeros=0.5, extra=" 0"):
    ranges = np.where(rng.random(682) < zeros, 0, rng.integers(300, 5500, 682))
    return f"{1_000_000 + 100_000 * i} 0 {10 * i} {11 * i} " + "0 " * 20 + " ".join(map(str, ranges)) + extra


def test_coreslam_zeros_are_no_return_and_the_front_beam_looks_ahead(tmp_path, rng):
    path = write(tmp_path, *[coreslam_line(i, rng) for i in range(20)])
    log = read_coreslam(path)
    sensor = log.only_sensor()
    words = np.array([line.split() for line in path.read_text().splitlines()])[:, 24:706].astype(float)
    np.testing.assert_array_equal(np.isposinf(sensor.ranges), words == 0)
    np.testing.assert_allclose(sensor.ranges[words > 0], words[words > 0] / 1000)
    np.testing.assert_allclose(sensor.stamps, 1.0 + 0.1 * np.arange(20))
    assert sensor.finder.bearings[340] == 0.0
    assert sensor.finder.min_range == 0.02  # nearer "ranges" are error codes
    assert np.degrees(np.ptp(sensor.finder.bearings)) == pytest.approx(239.4, abs=0.1)
    assert any("ticks are not read as odometry" in note for note in log.notes)


def test_coreslam_bad_line_is_named(tmp_path, rng):
    good = coreslam_line(0, rng)
    with pytest.raises(FormatError, match=r":2: expected 706 or 707 words, got 705"):
        read_coreslam(write(tmp_path, good, coreslam_line(1, rng, extra="").rsplit(" ", 1)[0]))
    with pytest.raises(FormatError, match=r":2: ranges: expected a number, got 'five'"):
        read_coreslam(write(tmp_path, good, coreslam_line(1, rng, zeros=1.0).replace(" 0 0 0", " 0 0 five", 20)))


def sonar_folder(tmp_path, n=300, break_pose=None):
    rng = np.random.default_rng(8)
    measured = np.where(rng.random((n, 8)) < 0.3, 5110, 10 * rng.integers(40, 400, (n, 8)))
    measurements = [f"{1000 + 200 * i} " + " ".join(map(str, row)) for i, row in enumerate(measured)]
    poses = [f"{1000 + 200 * i} {10 * i} 0 {i}" for i in range(n)]
    if break_pose is not None:
        poses[break_pose] = poses[break_pose].replace(" ", "1 ", 1)
    write(tmp_path, *measurements, name="measurement.txt")
    write(tmp_path, *poses, name="poses.txt")
    return measured


def test_sonar_folder_has_eight_cones_and_its_no_echo_value(tmp_path):
    measured = sonar_folder(tmp_path)
    sensor = read_sonar_log(tmp_path).only_sensor()
    np.testing.assert_array_equal(np.isposinf(sensor.ranges), measured == 5110)
    assert sensor.finder.max_range == 5.11
    assert np.degrees(sensor.finder.opening_angle) == pytest.approx(20.0)
    np.testing.assert_allclose(np.degrees(sensor.finder.bearings), [-90, -37.5, -22.5, -7.5, 7.5, 22.5, 37.5, 90])
    np.testing.assert_allclose(sensor.poses[10], [0.1, 0.0, np.radians(1.0)])
    assert sensor.stamps[0] == 1.0


def test_sonar_poses_can_be_odometry(tmp_path):
    sonar_folder(tmp_path)
    sensor = read_sonar_log(tmp_path, TextOptions(lone_poses="odometry")).only_sensor()
    assert not sensor.has_poses
    assert sensor.has_odometry


def test_sonar_times_that_differ_are_named(tmp_path):
    sonar_folder(tmp_path, break_pose=4)
    with pytest.raises(FormatError, match=r"measurement\.txt:5: the measurement at 1800 ms has no pose"):
        read_sonar_log(tmp_path)


def test_sonar_poses_beyond_the_last_measurement_are_named(tmp_path):
    sonar_folder(tmp_path, n=3)
    with (tmp_path / "poses.txt").open("a") as file:
        file.write("1600 30 0 3\n")
    with pytest.raises(FormatError, match=r"poses\.txt:4: the pose has no measurement: measurement\.txt ends after 3"):
        read_sonar_log(tmp_path)
