"""Logs of landmark sightings in hand-written mini files: read, written, and refused."""

from __future__ import annotations

import gzip
import math

import numpy as np
import pytest
from scipy.io import savemat

from beamfield.detections import SPURIOUS, UNKNOWN
from beamfield.errors import FormatError
from beamfield.io.landmarks.mrclam_instant import read_mrclam_instant
from beamfield.io.landmarks.mrclam_raw import (
    read_mrclam_barcodes,
    read_mrclam_groundtruth,
    read_mrclam_measurements,
    read_mrclam_odometry,
)
from beamfield.io.landmarks.plaza import read_plaza
from beamfield.io.landmarks.roh_bearings import read_roh_bearings
from beamfield.io.landmarks.sightings import read_sightings, write_sightings
from beamfield.maps.landmarks import LandmarkMap

INSTANT = {
    "landmark": [[1, 0.5, 1.5], [4, 2.0, 3.0]],
    "groundtruth": [[10, 0.0, 1.0, 0.1], [12, 0.5, 1.0, 0.2]],
    "measurement": [[12, 4, 2.5, 0.3], [12, 1, 1.5, -0.3], [10, 4, 2.2, 0.1]],
}
PLAZA = {
    "TL": [[0, 5.0, 0.0], [6, 0.0, 5.0]],
    "GT": [[0.0, 0.0, 0.0, 3.0], [0.5, 1.0, 0.0, -3.0], [4.0, 2.0, 0.0, -3.0]],
    "TD": [[0.25, 2, 6, 7.0], [0.1, 2, 0, 8.0], [2.0, 2, 0, 9.0]],
}


def mat(path, content, **changes):
    savemat(path, {name: np.array(rows, dtype=np.float64) for name, rows in {**content, **changes}.items()})
    return path


def test_mrclam_moments_are_read(tmp_path):
    landmarks, log = read_mrclam_instant(mat(tmp_path / "a.mat", INSTANT))
    assert landmarks.ids.tolist() == [1, 4]
    assert log.poses.tolist() == [[0.0, 1.0, 0.1], [0.5, 1.0, 0.2]]
    assert log.stamps.tolist() == [10.0, 12.0]
    assert [z.ids.tolist() for z in log.detections] == [[4], [4, 1]]
    assert log.detections[1].ranges.tolist() == [2.5, 1.5]
    assert "no times" in log.notes[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"landmark": [[1, 0.5, 1.5], [1, 2.0, 3.0]]}, "landmark: ids: expected each id once, got 1 2 times"),
        (
            {"groundtruth": [[12, 0, 1, 0], [10, 0, 1, 0]]},
            "groundtruth: row 2: expected moments that rise, got 10 after 12",
        ),
        ({"measurement": [[11, 4, 2.5, 0.3]]}, "measurement: row 1: expected a moment of the file, got 11"),
        ({"measurement": [[10, 3, 2.5, 0.3]]}, "measurement: row 1: expected a landmark of the file, got 3"),
        ({"measurement": [[10, 1.5, 2.5, 0.3]]}, "measurement: row 1: expected a whole number >= 0 as id, got '1.5'"),
        ({"measurement": [[10, 1, np.inf, 0.3]]}, "measurement: row 1: expected a finite range, got 'inf'"),
    ],
    ids=["twice", "moments fall", "no moment", "no landmark", "half an id", "infinite"],
)
def test_what_is_no_mrclam_set_is_refused(changes, message, tmp_path):
    with pytest.raises(FormatError, match=message):
        read_mrclam_instant(mat(tmp_path / "a.mat", INSTANT, **changes))


def test_plaza_ranges_get_the_pose_of_their_time(tmp_path):
    landmarks, log = read_plaza(mat(tmp_path / "a.mat", PLAZA))
    assert landmarks.ids.tolist() == [0, 6]
    assert log.stamps.tolist() == [0.1, 0.25, 2.0]
    assert [z.ids.tolist() for z in log.detections] == [[0], [6], [0]]
    assert all(np.isnan(z.bearings).all() for z in log.detections)
    np.testing.assert_allclose(log.poses[1, :2], [0.5, 0.0])
    assert abs(log.poses[1, 2]) == pytest.approx(math.pi)  # half way between 3 and -3, the short way
    assert np.isnan(log.poses[2]).all()
    assert log.notes[0].startswith("Ranges are sorted by time: their times step back 1 times")
    assert log.notes[1].startswith("1 ranges have no pose")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"TL": [[6, 5.0, 0.0], [6, 0.0, 5.0]]}, "TL: ids: expected each id once, got 6 2 times"),
        ({"GT": [[0.5, 0, 0, 0], [0.5, 1, 0, 0]]}, "GT: row 2: expected times that rise, got 0.5 after 0.5"),
        ({"TD": [[0.1, 2, 3, 8.0]]}, "TD: row 1: expected a beacon of TL, got 3"),
        ({"TD": [[0.1, 2, 6, 8.0], [0.2, 3, 6, 8.0]]}, "TD: row 2: expected one sender, the robot, got 3 after 2"),
        ({"TD": [[0.1, 2, 6]]}, r"TD: expected rows of time, sender, receiver, range, got shape \(1, 3\)"),
    ],
    ids=["twice", "times", "beacon", "senders", "columns"],
)
def test_what_is_no_plaza_set_is_refused(changes, message, tmp_path):
    with pytest.raises(FormatError, match=message):
        read_plaza(mat(tmp_path / "a.mat", PLAZA, **changes))


@pytest.fixture
def places(tmp_path):
    (tmp_path / "landmark.csv").write_text("0, 0\r\n6, 0\r\n")
    (tmp_path / "(X1.5,Y3.0).csv").write_text("90.0,-45.0\r\n91.0,-44.0\r\n\r\n")
    (tmp_path / "(X1.5,Y-2).csv").write_text("10,20\n")
    (tmp_path / "README.txt").write_text("not a place")
    return tmp_path


def test_bearings_from_places_are_read(places):
    landmarks, log = read_roh_bearings(places)
    assert landmarks.ids.tolist() == [1, 2]
    assert log.poses.tolist() == [[1.5, -2.0, math.pi / 2.0], [1.5, 3.0, math.pi / 2.0], [1.5, 3.0, math.pi / 2.0]]
    assert log.places.tolist() == [0, 1, 1]
    assert log.stamps.tolist() == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(log.detections[1].bearings, [math.pi / 2.0, -math.pi / 4.0])
    assert np.isnan(log.detections[1].ranges).all()
    assert log.detections[2].ids.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("landmark.csv", "0,0,0\n", r"landmark.csv:1: expected 2 values, got 3"),
        ("landmark.csv", "\n", "landmark.csv: no rows"),
        ("(X1.5,Y3.0).csv", "1,2\n1\n", r"csv:2: expected 2 values, got 1"),
        ("(X1.5,Y3.0).csv", "1,x\n", r"csv:1: bearing: expected a number, got 'x'"),
        ("(X1.5,Y3.0).csv", "1,inf\n", r"csv:1: bearing: expected a finite number, got 'inf'"),
        ("(X1.5,Y3.0).csv", "", r"csv: no rows"),
    ],
    ids=["beacon", "no beacon", "one bearing", "a word", "infinite", "empty"],
)
def test_what_are_no_bearings_is_refused(name, text, message, places):
    (places / name).write_text(text)
    with pytest.raises(FormatError, match=message):
        read_roh_bearings(places)


def test_a_folder_without_places_is_refused(places):
    for path in places.glob("(*"):
        path.unlink()
    with pytest.raises(FormatError, match="expected files with names like"):
        read_roh_bearings(places)


MAP = LandmarkMap([[0.0, 0.0], [1.0, 2.0]], ids=[6, 7])


@pytest.fixture
def mrclam(tmp_path):
    (tmp_path / "Barcodes.dat").write_text("# Subject Barcode\n 1 \t 5 \n 6 \t 72\n7 27\n")
    rows = "# Time\n10.0 72 2.5 0.1\n10.0 5 1.0 -0.2\n10.5 99 3.0 0.0\n12.0 27 4.0 0.3\n"
    (tmp_path / "Robot1_Measurement.dat.gz").write_bytes(gzip.compress(rows.encode()))
    (tmp_path / "Robot1_Groundtruth.dat").write_text("9.9 0 0 0\n10.1 1 0 0.2\n10.5 2 0 0.2\n")
    (tmp_path / "Robot1_Odometry.dat").write_text("9.9 0.1 0.2\n10.0 0.1 -0.2\n")
    return tmp_path


def test_raw_mrclam_barcodes_become_ids(mrclam):
    barcodes = read_mrclam_barcodes(mrclam / "Barcodes.dat")
    assert barcodes == {5: 1, 72: 6, 27: 7}
    log = read_mrclam_measurements(mrclam / "Robot1_Measurement.dat.gz", barcodes, MAP)
    assert [z.ids.tolist() for z in log.detections] == [[6, SPURIOUS], [UNKNOWN], [7]]
    assert log.stamps.tolist() == [10.0, 10.5, 12.0]
    assert np.isnan(log.poses).all()
    assert log.notes == ("Of 4 barcodes 1 are of subjects that the map has not, 1 of nobody.",)


def test_raw_mrclam_poses_come_from_motion_capture(mrclam):
    barcodes = read_mrclam_barcodes(mrclam / "Barcodes.dat")
    truth = mrclam / "Robot1_Groundtruth.dat"
    log = read_mrclam_measurements(mrclam / "Robot1_Measurement.dat.gz", barcodes, MAP, groundtruth=truth)
    np.testing.assert_allclose(log.poses[:2], [[0.5, 0.0, 0.1], [2.0, 0.0, 0.2]])
    assert np.isnan(log.poses[2]).all()
    assert log.notes[1].startswith("1 of 3 observations have no pose")
    stamps, velocities = read_mrclam_odometry(mrclam / "Robot1_Odometry.dat")
    assert (stamps.tolist(), velocities.tolist()) == ([9.9, 10.0], [[0.1, 0.2], [0.1, -0.2]])


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (read_mrclam_barcodes, "1 5\n2 5\n", "a.dat:2: expected each subject and barcode once, got 2 5 again"),
        (read_mrclam_barcodes, "1 5\n1 6\n", "a.dat:2: expected each subject and barcode once, got 1 6 again"),
        (read_mrclam_barcodes, "1.5 5\n", "a.dat:1: barcodes: expected a whole number >= 0, got 1.5"),
        (read_mrclam_barcodes, "# none\n", "a.dat: no rows of subject, barcode"),
        (read_mrclam_groundtruth, "1 0 0 0\n0.5 0 0 0\n", "a.dat:2: time: expected times that rise, got 0.5 after 1.0"),
        (read_mrclam_groundtruth, "1 0 0\n", "a.dat:1: expected time, x, y, theta, got 3 values"),
        (read_mrclam_odometry, "\n1 nan 0\n", "a.dat:2: v: expected a finite number, got 'nan'"),
        (read_mrclam_odometry, "1 fast 0\n", "a.dat:1: row: expected a number, got 'fast'"),
        (read_mrclam_odometry, "2 0 0\n1 0 0\n", "a.dat:2: time: expected times that rise"),
        (lambda path: read_mrclam_measurements(path, {}, MAP), "1 -5 1 0\n", "a.dat:1: barcode: expected .* got -5.0"),
        (lambda path: read_mrclam_measurements(path, {}, MAP), "2 5 1 0\n1 5 1 0\n", "a.dat:2: time: expected times"),
    ],
    ids=[
        "barcode twice",
        "subject twice",
        "half",
        "empty",
        "truth",
        "3 values",
        "nan",
        "word",
        "odometry",
        "code",
        "time",
    ],
)
def test_what_is_no_raw_mrclam_file_is_refused(read, text, message, tmp_path):
    (tmp_path / "a.dat").write_text(text)
    with pytest.raises(FormatError, match=message):
        read(tmp_path / "a.dat")


HEADER = "stamp,x,y,theta,id,range,bearing\n"


def test_sightings_are_written_and_read_to_the_last_bit(tmp_path):
    text = "# made by hand\nStamp, x, y, theta, id, range, bearing\n\n1.5,0.1,0.2,0.3,7,2.5,-0.1\n1.5,0.1,0.2,0.3,,,4\n"
    text += "1.75,1e-17,0,0.3333333333333333,-1,-0.2,\n"
    (tmp_path / "a.csv").write_text(text)
    log = read_sightings(tmp_path / "a.csv")
    assert [z.ids.tolist() for z in log.detections] == [[7, UNKNOWN], [SPURIOUS]]
    np.testing.assert_array_equal(log.detections[0].ranges, [2.5, np.nan])
    np.testing.assert_array_equal(log.detections[1].bearings, [np.nan])
    assert log.poses[0].tolist() == [0.1, 0.2, 0.3]
    write_sightings(tmp_path / "b.csv", log)
    back = read_sightings(tmp_path / "b.csv")
    assert back.poses.tolist() == log.poses.tolist()
    for first, second in zip(log.detections, back.detections, strict=True):
        for name in ("ranges", "bearings", "ids"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert (tmp_path / "b.csv").read_text().splitlines()[2] == "1.5,0.1,0.2,0.3,,,4.0"


def test_moments_without_pose_are_not_written(tmp_path):
    _, log = read_plaza(mat(tmp_path / "a.mat", PLAZA))
    write_sightings(tmp_path / "b.csv", log)
    assert read_sightings(tmp_path / "b.csv").stamps.tolist() == [0.1, 0.25]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n", "a.csv:1: expected the header stamp,x,y,theta,id,range,bearing, got 'a,b'"),
        (HEADER, "a.csv: no sightings: the file has no rows"),
        (HEADER + "1,0,0,0,7,1\n", "a.csv:2: expected 7 values, got 6"),
        (HEADER + "1,0,0,0,7,x,0\n", "a.csv:2: sighting: expected a number, got 'x'"),
        (HEADER + "1,0,nan,0,7,1,0\n", "a.csv:2: y: expected a finite number, got 'nan'"),
        (HEADER + "1,0,,0,7,1,0\n", "a.csv:2: y: expected a finite number, got ''"),
        (HEADER + "1,0,0,0,7,inf,0\n", "a.csv:2: range: expected a finite number, got 'inf'"),
        (HEADER + "1,0,0,0,7,nan,0\n", "a.csv:2: range: expected a finite number, got 'nan'"),
        (HEADER + "1,0,0,0,-2,1,0\n", "a.csv:2: id: expected a whole number >= 0, -1 or nothing, got '-2'"),
        (HEADER + "1,0,0,0,7.5,1,0\n", "a.csv:2: id: .* got '7.5'"),
        (HEADER + "1,0,0,0,7,,\n", "a.csv:2: expected a range, a bearing or both, got neither"),
        (HEADER + "2,0,0,0,7,1,0\n1,0,0,0,7,1,0\n", "a.csv:3: stamp: .* not fall, got 1.0 after 2.0"),
        (HEADER + "1,0,0,0,7,1,0\n1,0,5,0,7,1,0\n", r"a.csv:3: .* one pose per stamp, got \[0.0, 5.0, 0.0\]"),
    ],
    ids=["header", "empty", "6 values", "word", "nan pose", "no y", "inf", "nan", "id -2", "half id", "nothing",
         "stamps", "poses"],
)  # fmt: skip
def test_what_are_no_sightings_is_refused(text, message, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_sightings(tmp_path / "a.csv")
