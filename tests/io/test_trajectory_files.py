"""Trajectories from TUM, CSV and logs, and how they attach to a log."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.trajectory import IndexedTrack, attach_poses, read_trajectory, write_tum
from beamfield.sensors import RangeFinder, ScanLog, SensorLog, Track


def write(tmp_path, text, name="poses.txt"):
    path = tmp_path / name
    path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
    return path


@pytest.fixture
def log():
    stamps = 10.0 + 0.5 * np.arange(8)
    finder = RangeFinder.from_bearings([0.0], 5.0)
    nothing = np.full((8, 3), np.nan)
    return ScanLog({"scan": SensorLog(finder, stamps, np.ones((8, 1)), nothing, nothing)}, source="run.log")


def test_tum_gives_the_yaw_of_the_quaternion(tmp_path):
    half = np.pi / 8
    text = f"# timestamp tx ty tz qx qy qz qw\n1.5 1 2 9 0 0 0 1\n\n2.5 3 4 9 0 0 {np.sin(half)} {np.cos(half)}\n"
    track = read_trajectory(write(tmp_path, text))
    np.testing.assert_array_equal(track.stamps, [1.5, 2.5])
    np.testing.assert_allclose(track.poses, [[1, 2, 0], [3, 4, np.pi / 4]], atol=1e-12)


def test_written_tum_reads_the_same(tmp_path, rng):
    track = Track(1.7e9 + np.sort(rng.uniform(0, 100, 50)), rng.uniform(-3.1, 3.1, (50, 3)))
    write_tum(tmp_path / "out.tum", track)
    back = read_trajectory(tmp_path / "out.tum")
    np.testing.assert_allclose(back.stamps, track.stamps, rtol=0, atol=5e-7)
    np.testing.assert_allclose(back.poses, track.poses, atol=1e-8)


def test_poses_that_are_not_known_are_not_written(tmp_path):
    with pytest.raises(InvalidInputError, match="expected finite poses"):
        write_tum(tmp_path / "out.tum", Track(np.zeros(1), np.full((1, 3), np.nan)))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "header", ["t,x,y,theta", "time,X,Y,Yaw", "timestamp, x, y, theta", "# t,x,y,theta", "stamp,map_x,map_y,map_theta"]
)
@pytest.mark.parametrize("name", ["poses.csv", "poses.csv.gz"])
def test_csv_columns_are_found_by_name(tmp_path, header, name):
    track = read_trajectory(write(tmp_path, f"{header}\n1,2,3,7\n2,3,4,0.5\n", name))
    assert not isinstance(track, IndexedTrack)
    np.testing.assert_array_equal(track.stamps, [1, 2])
    np.testing.assert_allclose(track.poses, [[2, 3, 7 - 2 * np.pi], [3, 4, 0.5]])


def test_particles_are_no_path_but_a_few_rounded_stamps_are(tmp_path):
    def poses(at_once):
        rows = "".join(f"{i // at_once},{i},0,0\n" for i in range(60))
        return write(tmp_path, f"t,x,y,theta\n{rows}", "particles.csv.gz")

    assert len(read_trajectory(poses(5))) == 60
    with pytest.raises(FormatError, match=r"6 poses at each time: a filter's particles.*give .* \(trajectory.tum"):
        read_trajectory(poses(6))


def test_csv_with_a_quaternion(tmp_path):
    track = read_trajectory(write(tmp_path, "timestamp,x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,1,0\n"))
    np.testing.assert_allclose(track.poses, [[2, 3, np.pi]])


def test_csv_columns_of_the_map_go_together_and_plain_names_before_them(tmp_path):
    both = "t,x,y,theta,map_x,map_y,map_theta\n1,2,3,0.5,7,8,0.9\n"
    np.testing.assert_allclose(read_trajectory(write(tmp_path, both)).poses, [[2, 3, 0.5]])
    mapped = "t,theta,map_x,map_y,map_theta\n1,0.5,7,8,0.9\n"
    np.testing.assert_allclose(read_trajectory(write(tmp_path, mapped)).poses, [[7, 8, 0.9]])


@pytest.mark.parametrize("axis", [0, 1])
def test_a_pose_may_be_tilted_by_twenty_degrees_about_either_axis(tmp_path, axis):
    for degrees, is_tilted in ((19.9, False), (20.1, True)):
        half, q = np.radians(degrees) / 2.0, np.zeros(4)
        q[axis], q[3] = np.sin(half), np.cos(half)
        path = write(tmp_path, "1 2 3 0 " + " ".join(map(str, q)) + "\n")
        if is_tilted:
            with pytest.raises(FormatError, match=r"the pose is tilted by 20\.1 degrees"):
                read_trajectory(path)
        else:
            np.testing.assert_allclose(read_trajectory(path).poses, [[2, 3, 0]], atol=1e-12)


def test_only_good_rows_are_used_and_scan_indices_are_kept(tmp_path):
    text = "scan_index,t,x,y,theta,good\n0,10.0,1,1,0,1\n1,10.5,9,9,9,0\n3,11.5,2,1,0,1\n"
    track = read_trajectory(write(tmp_path, text))
    assert isinstance(track, IndexedTrack)
    assert track.scan_indices.tolist() == [0, 3]
    np.testing.assert_array_equal(track.poses[:, 0], [1, 2])


def test_a_corrected_log_is_a_trajectory(tmp_path):
    text = "".join(f"FLASER 3 1 2 3 {i} 0 0.5 {i} 0 0.5 {i} host {i}\n" for i in range(4))
    track = read_trajectory(write(tmp_path, text))
    np.testing.assert_array_equal(track.stamps, np.arange(4))
    np.testing.assert_allclose(track.poses, [[i, 0, 0.5] for i in range(4)])


BAD = {
    "empty": ("", "no poses: the file is empty"),
    "no poses": ("t,x,y,theta\n", "no poses: no row after the header"),
    "no good rows": ("t,x,y,theta,good\n1,2,3,4,0\n", "no row after the header with good = 1"),
    "missing column": ("t,x,theta\n1,2,3\n", r":1: expected columns for the time, x, y and theta"),
    "one long line": ("t,x,theta\r" * 90, r":1: expected columns .*, got 't, x.{0,90}'$"),
    "decimal comma": ("t;x;y;theta\n1,5;2;3;4\n", r":2: expected 4 fields, got 2: write a point for the decimal comma"),
    "fields": ("t,x,y,theta\n1,2,3,4\n1,2,3\n", r":3: expected 4 fields, got 3"),
    "number": ("t,x,y,theta\n1,2,3,north\n", r":2: pose: expected a number, got 'north'"),
    "nan": ("t,x,y,theta\n1,2,nan,0\n", r":2: pose: expected a finite number, got 'nan'"),
    "backwards": ("t,x,y,theta\n1,2,3,0\n2,2,3,0\n1.5,2,3,0\n", r":4: the stamps run backwards: 1\.5.* after 2\.0"),
    "index": ("scan_index,t,x,y,theta\n-1,1,2,3,4\n", r":2: scan_index: expected an index, got '-1'"),
    "index order": ("scan_index,t,x,y,theta\n3,1,2,3,4\n3,2,2,3,4\n", r":3: scan_index: the indices do not increase"),
    "tum words": ("1 2 3 0 0 0 0 1\n2 2 3 0 0 0 0\n", r":2: expected 8 numbers .* got 7"),
    "tum nan": ("1 2 3 0 0 0 0 1\n2 nan 3 0 0 0 0 1\n", r":2: pose: expected a finite number, got 'nan'"),
    "quaternion": ("1 2 3 0 0 0 0 1\n2 2 3 0 0 0 0 0.5\n", r":2: expected a unit quaternion.*norm 0\.5"),
    "tilted": ("1 2 3 0 0.7071 0 0 0.7071\n", r":1: the pose is tilted by 90 degrees"),
    "overflow": ("1 2 3 0 0 0 0 1e300\n", r":1: pose: expected a finite number, up to 1e\+100, got '1e300'"),
    "unknown": ("hello\n", r"expected poses \(TUM lines, or CSV.*got 'hello'"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_files_name_line_and_value(tmp_path, case):
    text, message = BAD[case]
    with pytest.raises(FormatError, match=message):
        read_trajectory(write(tmp_path, text))


def test_poses_are_interpolated_at_the_stamps_of_the_scans(log):
    track = Track(np.array([10.0, 11.0, 20.0]), np.array([[0, 0, 3.0], [1, 0, -3.0], [2, 0, 0.0]]))
    attached = attach_poses(log, track)
    poses = attached.only_sensor().poses
    np.testing.assert_allclose(poses[:3, 0], [0.0, 0.5, 1.0])
    assert abs(poses[1, 2]) == pytest.approx(np.pi, abs=1e-9)
    # From 11 to 20 s nothing is known.
    assert np.isnan(poses[3:]).all()
    assert attached.notes[-1] == (
        "scan: 3 of 8 scans have a reference pose from the given trajectory, interpolated at their stamps"
    )
    assert np.isfinite(attach_poses(log, track, max_gap=10.0).only_sensor().poses).all()
    assert not log.only_sensor().has_poses


def test_indexed_poses_go_to_their_scans_even_if_the_clock_has_another_zero(log):
    poses = np.array([[1.0, 0, 0], [2.0, 0, 0]])
    track = IndexedTrack(np.array([0.5, 3.0]), poses, np.array([1, 6]))
    attached = attach_poses(log, track).only_sensor().poses
    np.testing.assert_array_equal(attached[[1, 6]], poses)
    assert np.isnan(attached[[0, 2, 3, 4, 5, 7]]).all()


def test_indexed_poses_of_another_log_are_refused(log):
    with pytest.raises(InvalidInputError, match="a pose for scan 8, but the log has 8 scans"):
        attach_poses(log, IndexedTrack(np.array([14.0]), np.zeros((1, 3)), np.array([8])))
    with pytest.raises(InvalidInputError, match=r"do not match the stamps of the log \(up to 0\.5 s"):
        attach_poses(log, IndexedTrack(np.array([10.0, 11.0, 11.5]), np.zeros((3, 3)), np.array([0, 1, 2])))


def test_indexed_poses_go_to_scans_that_are_only_numbered(log):
    sensor = log.only_sensor()
    numbered = ScanLog({"scan": replace(sensor, stamps=np.arange(8.0))}, source="run.log")
    track = IndexedTrack(np.array([50.0, 57.3]), np.array([[1.0, 0, 0], [2.0, 0, 0]]), np.array([2, 3]))
    assert attach_poses(numbered, track).only_sensor().poses[2:4, 0].tolist() == [1.0, 2.0]


def test_indexed_poses_on_a_log_of_several_sensors_are_interpolated(log):
    two = ScanLog({"front": log.only_sensor(), "rear": log.only_sensor()}, source="run.bag")
    track = IndexedTrack(np.array([10.0, 11.0]), np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([0, 1]))
    poses = attach_poses(two, track).sensors["rear"].poses
    np.testing.assert_allclose(poses[:3, 0], [0.0, 0.5, 1.0])


def test_a_trajectory_of_another_time_is_refused_with_both_times(log):
    with pytest.raises(InvalidInputError, match=r"scans are from 10\.000 to 13\.500 s, the trajectory from 0\.000"):
        attach_poses(log, Track(np.array([0.0, 1.0]), np.zeros((2, 3))))
    with pytest.raises(InvalidInputError, match="max_gap: expected seconds > 0"):
        attach_poses(log, Track(np.array([10.0]), np.zeros((1, 3))), max_gap=0.0)
