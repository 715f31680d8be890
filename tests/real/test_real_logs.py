"""Public text logs: what is in them is known from their sources, not from this reader."""

from __future__ import annotations

import gzip
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.geometry import compose, transform_points, wrap_angle
from beamfield.io.logs.carmen import read_carmen, write_carmen
from beamfield.io.read_log import read_log
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.sensors import ScanLog, usable_ranges
from tests.real.posed_logs import posed_log

RADISH = "carmen_radish_corrected/{}-corrected.log.gz"

# File; scans, beams, first and last bearing in degrees, limit in metres, share of "no return" in percent.
LOGS = {
    "intel": (RADISH.format("intel"), 910, 180, -90, 89, 81.83, 2.5),
    "csail": (RADISH.format("csail"), 406, 361, -90, 90, 50.0, 2.7),
    "fr079": (RADISH.format("freiburg-079"), 4791, 360, -90, 89.5, 80.99, 2.1),
    "aces": (RADISH.format("aces"), 440, 180, -90, 89, 50.0, 0.8),
    "belgioioso": (RADISH.format("belgioioso"), 395, 361, -90, 90, 80.99, 0.5),
    # Here the source counts only the readings of 51.15 m, and there are 0.6% more of 51.09 to 51.16 m.
    "edmonton": (RADISH.format("edmonton"), 340, 180, -90, 89, 51.1, 5.5),
    "fhw": (RADISH.format("fhw"), 488, 180, -90, 89, 51.05, 0.7),
    "orebro": (RADISH.format("orebro"), 237, 181, -90, 90, 32.759, 2.3),
    "acapulco": (RADISH.format("acapulco"), 861, 181, -90, 90, 51.14, 7.9),
    "infinite corridor": (RADISH.format("infinite-corridor"), 1941, 180, -90, 89, 51.05, 1.3),
    # 81.91 m are 25.5%, 81.83 m 0.4%.
    "campus": (RADISH.format("freiburg-campus"), 2008, 360, -90, 89.5, 80.99, 25.9),
    "csail raw": ("csail_gfs/derived_csail_rawodom.log.gz", 406, 361, -90, 90, 81.91, 2.7),
    "csail gfs": ("csail_gfs/csail.corrected.gfs.gz", 406, 361, -90, 90, 80.0, 2.7),
    "csail robotlaser": ("freiburg_course/csail_robotlaser.log.gz", 686, 361, -90, 90, 80.0, 2.5),
    "intel raw": ("intel_gfs/derived_intel_rawodom.log.gz", 910, 180, -90, 89, 81.83, 2.5),
    "killian": ("killian_g2o/killian.g2o.gz", 3873, 180, -90, 89, 50.0, 1.4),
    "wean 1": ("wean_hall/robotdata1.log.gz", 713, 180, -90, 89, 81.83, 0.5),
    "wean 3": ("wean_hall/robotdata3.log.gz", 1241, 180, -90, 89, 81.87, 1.6),
    "wean 5": ("wean_hall/robotdata5.log.gz", 954, 180, -90, 89, 81.87, 2.7),
    "mines 1": ("mines_coreslam/exp1.dat.gz", 756, 682, -119.5, 119.9, 5.57, 52.5),
    "mines 2": ("mines_coreslam/exp2.dat.gz", 641, 682, -119.5, 119.9, 5.59, 55.3),
    "sonar": ("sonar_corridor", 413, 8, -90, 90, 5.11, 32.3),
}

LOST_STAMPS = ("belgioioso", "orebro", "campus", "csail", "infinite corridor")
RAW_ODOMETRY = ("csail raw", "csail gfs", "intel raw", "wean 1", "wean 3", "wean 5")
NO_REFERENCE = ("wean 1", "wean 3", "wean 5", "mines 1", "mines 2")


@cache
def log_of(data: Path, name: str) -> ScanLog:
    """A log of the table: to read one takes up to two seconds."""
    return read_log(data / LOGS[name][0])


@pytest.mark.real
@pytest.mark.parametrize("name", LOGS)
def test_log_reads_with_its_beams_limit_and_share_of_no_return(data, name):
    _, n_scans, n_beams, first, last, limit, share = LOGS[name]
    log = log_of(data, name)
    sensor = log.only_sensor()
    assert sensor.ranges.shape == (n_scans, n_beams)
    np.testing.assert_allclose(np.degrees(sensor.finder.bearings[[0, -1]]), [first, last], atol=0.05)
    assert sensor.finder.max_range == pytest.approx(limit, abs=1e-9)
    assert 100.0 * sensor.no_return.share == pytest.approx(share, abs=0.06)
    assert np.mean(np.isposinf(sensor.ranges)) == sensor.no_return.share
    assert (np.diff(sensor.stamps) >= 0.0).all()
    assert sensor.has_odometry == (name in RAW_ODOMETRY)
    assert sensor.has_poses == (name not in NO_REFERENCE)
    assert np.isfinite(sensor.poses).all() or not sensor.has_poses
    assert any("stamps are lost" in note for note in log.notes) == (name in LOST_STAMPS)


@pytest.mark.real
@pytest.mark.oracle
def test_intels_limit_is_that_of_the_frozen_calibration_set(data, oracle):
    frozen = np.load(oracle / "calibration" / "set_intel_train.npz")
    assert log_of(data, "intel").only_sensor().finder.max_range == float(frozen["zmax"])


@pytest.mark.real
def test_intels_steps_back_are_reported_and_short(data):
    log = log_of(data, "intel")
    assert any("4 of 910 stamps go backwards, by up to 0.86 s" in note for note in log.notes)
    with_zone = log_of(data, "intel raw").only_sensor()
    # The same scans with other stamps, sorted by them: they agree except where the stamps went back.
    apart = np.abs(with_zone.stamps - 976052857.337 - log.only_sensor().stamps)
    assert np.count_nonzero(apart > 0.01) <= 8
    assert apart.max() < 1.0


@pytest.mark.real
def test_acapulcos_last_beam_is_padding(data):
    log = log_of(data, "acapulco")
    assert np.isnan(log.only_sensor().ranges[:, 180]).all()
    assert any("beam 180 reads 50 m in all 861 scans" in note for note in log.notes)


@pytest.mark.real
def test_gmappings_best_particle_gives_the_published_corrected_poses(data):
    gfs = log_of(data, "csail gfs").only_sensor()
    published = log_of(data, "csail raw").only_sensor()
    np.testing.assert_array_equal(gfs.odometry, published.odometry)
    np.testing.assert_array_equal(gfs.stamps, published.stamps)
    np.testing.assert_allclose(gfs.poses[:, :2], published.poses[:, :2], atol=1e-3)
    np.testing.assert_allclose(wrap_angle(gfs.poses[:, 2] - published.poses[:, 2]), 0.0, atol=1e-4)


@pytest.mark.real
def test_freiburgs_pose_is_the_lasers_whatever_the_declared_mount(data):
    # The sharper the map, the fewer cells the end points of the scans fall into.
    sensor = log_of(data, "fr079").only_sensor()
    assert sensor.finder.mounts[0, 0] == -0.04

    def cells(shift):
        mounts = sensor.finder.mounts + np.array([shift, 0.0, 0.0])
        z = np.where(sensor.ranges < 30.0, sensor.ranges, np.nan)[::10]
        ends = np.column_stack([z.ravel(), np.zeros(z.size)])
        beams = compose(sensor.poses[::10, None, :], mounts).reshape(-1, 3)
        points = transform_points(beams, ends)
        points = points[np.isfinite(points).all(axis=1)]
        return len(np.unique(np.floor(points / 0.05).astype(int), axis=0))

    as_read = cells(0.0)
    assert as_read < cells(0.04)
    assert as_read < cells(-0.04)


@pytest.mark.real
def test_wean_halls_laser_is_25_cm_ahead_and_its_reference_attaches_by_index(data):
    log = log_of(data, "wean 1")
    np.testing.assert_allclose(log.only_sensor().finder.mounts[:, :2], np.tile([0.25, 0.0], (180, 1)), atol=1e-9)
    path = data / "wean_hall" / "reference_robotdata1.csv.gz"
    with gzip.open(path, "rt") as file:
        rows = np.loadtxt(file, delimiter=",", skiprows=1)
    good = rows[rows[:, 5] == 1]
    attached = attach_poses(log, read_trajectory(path)).only_sensor()
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(attached.poses[:, 0])), good[:, 0].astype(int))
    np.testing.assert_allclose(attached.poses[good[:, 0].astype(int)], good[:, 2:5])


@pytest.mark.real
def test_wean_hall_gives_the_same_numbers_from_text_and_mcap(data):
    pytest.importorskip("rosbags")
    text = log_of(data, "wean 1").only_sensor()
    bag = read_log(data / "derived_wean_mcap" / "bag").only_sensor()
    np.testing.assert_allclose(bag.finder.mounts, text.finder.mounts, atol=1e-6)
    np.testing.assert_allclose(bag.stamps, text.stamps + 1e9, rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        usable_ranges(bag.ranges, bag.finder), usable_ranges(text.ranges, text.finder), rtol=1e-6
    )
    logs = LOGS["wean 1"][0], "derived_wean_mcap/bag"
    by_index = [posed_log(data, log, "wean_hall/reference_robotdata1.csv.gz").poses for log in logs]
    np.testing.assert_array_equal(*by_index)


@pytest.mark.real
@pytest.mark.parametrize(
    ("log", "poses"),
    [
        ("olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/derived_ref_take_2.csv.gz"),
        ("uob_pioneer_real/trace1.bag", "uob_pioneer_real/derived_amcl_poses_trace1.csv.gz"),
    ],
)
def test_reference_files_beside_bags_attach_to_every_scan(data, log, poses):
    pytest.importorskip("rosbags")
    assert np.isfinite(posed_log(data, log, poses).poses).all()


@pytest.mark.real
def test_a_real_log_written_as_carmen_reads_the_same(data, tmp_path):
    log = log_of(data, "intel raw")
    write_carmen(tmp_path / "intel.log", log)
    first, again = log.only_sensor(), read_carmen(tmp_path / "intel.log").only_sensor()
    np.testing.assert_allclose(again.ranges, first.ranges)
    np.testing.assert_allclose(again.poses, first.poses, atol=2e-9)
    np.testing.assert_allclose(again.odometry, first.odometry, atol=2e-9)
    assert again.finder.max_range == first.finder.max_range


@pytest.mark.real
@pytest.mark.parametrize("path", ["wean_hall/wean.dat.gz", "wean_hall/SOURCE.txt", "freiburg_course/sensor_data.dat",
                                  "stage_bitmaps/cave.png", "mrclam_instant/mrclam1.mat", "ros_maps"])  # fmt: skip
def test_other_files_are_refused_in_one_line(data, path):
    with pytest.raises(FormatError) as caught:
        read_log(data / path)
    assert "\n" not in str(caught.value)
