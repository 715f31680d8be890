"""Files of landmarks: read, written, and refused."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.io.landmarks.landmark_files import (
    read_course_log,
    read_course_world,
    read_landmarks,
    read_mrclam_landmarks,
    write_landmarks,
)
from beamfield.maps.landmarks import LandmarkMap

TWO = [[0.1, 1.0 / 3.0], [-2e-9, 3.0e5]]


@pytest.mark.parametrize(
    "landmarks",
    [
        LandmarkMap(TWO),
        LandmarkMap(TWO, ids=[9, 2], signatures=[0.1, 7.0]),
        LandmarkMap(TWO, ids=[9, 2], signatures=[3, 0], kind="type"),
        LandmarkMap(TWO, ids=[0, 2], signatures=[[0.1, 2.0, 3.0], [4.0, 5.0, 6.0]]),
        LandmarkMap(TWO, signatures=[[0.1], [4.0]]),
    ],
    ids=["none", "number", "type", "vector", "vector of one"],
)
def test_what_is_written_is_read_back_to_the_last_bit(landmarks, tmp_path):
    write_landmarks(tmp_path / "map.csv", landmarks)
    back = read_landmarks(tmp_path / "map.csv")
    assert back.kind == landmarks.kind
    assert back.ids.tolist() == landmarks.ids.tolist()
    assert back.positions.tolist() == landmarks.positions.tolist()
    assert (back.signatures is None) is (landmarks.signatures is None)
    if landmarks.signatures is not None:
        assert back.signatures.tolist() == landmarks.signatures.tolist()


def test_the_csv_is_what_a_person_would_write(tmp_path):
    write_landmarks(tmp_path / "map.csv", LandmarkMap([[1.5, -2.0]], ids=[4], signatures=[1], kind="type"))
    assert (tmp_path / "map.csv").read_text() == "id,x,y,type\n4,1.5,-2.0,1\n"


def test_csv_may_have_blanks_comments_and_gzip(tmp_path):
    text = "# surveyed in May\nID, X, Y\n\n4, 1.5, -2\n5, 0, 1\n"
    (tmp_path / "map.csv.gz").write_bytes(gzip.compress(text.encode()))
    landmarks = read_landmarks(tmp_path / "map.csv.gz")
    assert landmarks.ids.tolist() == [4, 5]
    assert landmarks.positions.tolist() == [[1.5, -2.0], [0.0, 1.0]]


def test_an_mrclam_map_is_read(tmp_path):
    (tmp_path / "l.dat").write_text("# Subject x y\n  6 \t 1.5 \t 2.5 \t 0.0001 \t 0.0002 \n 7 -1 0 0 0\n")
    landmarks = read_mrclam_landmarks(tmp_path / "l.dat")
    assert landmarks.ids.tolist() == [6, 7]
    assert landmarks.positions.tolist() == [[1.5, 2.5], [-1.0, 0.0]]


def test_a_course_world_is_read(tmp_path):
    (tmp_path / "world.dat").write_text("1 2 1\n2 0 4\n")
    landmarks = read_course_world(tmp_path / "world.dat")
    assert landmarks.ids.tolist() == [1, 2]
    assert landmarks.positions.tolist() == [[2.0, 1.0], [0.0, 4.0]]


def test_a_course_log_keeps_steps_without_features_and_odd_values(tmp_path):
    (tmp_path / "log.dat").write_text("ODOMETRY 0.1 0.2 0.3\nSENSOR 2 1.5 3.5\nSENSOR 1 -0.03 0.5\nODOMETRY 0 1 0\n")
    log = read_course_log(tmp_path / "log.dat")
    assert log.odometry.tolist() == [[0.1, 0.2, 0.3], [0.0, 1.0, 0.0]]
    assert [len(z) for z in log.detections] == [2, 0]
    assert log.detections[0].ids.tolist() == [2, 1]
    assert log.detections[0].ranges.tolist() == [1.5, -0.03]
    assert log.detections[0].bearings.tolist() == [3.5, 0.5]


@pytest.mark.real
def test_the_real_files_are_read(data):
    mrclam = read_mrclam_landmarks(data / "mrclam_raw_ds1" / "Landmark_Groundtruth.dat.gz")
    assert mrclam.ids.tolist() == list(range(6, 21))
    world = read_course_world(data / "freiburg_course" / "world.dat")
    assert len(world) == 9
    log = read_course_log(data / "freiburg_course" / "sensor_data.dat")
    assert (len(log), sum(len(z) for z in log.detections)) == (331, 1212)
    ranges, bearings = (np.concatenate([getattr(z, name) for z in log.detections]) for name in ("ranges", "bearings"))
    assert (ranges < 0.0).sum() == 1
    assert (bearings > np.pi).sum() > 0
    world.indices_of(np.concatenate([z.ids for z in log.detections]))


BAD_CSV = {
    "empty": ("", "expected the header id,x,y .* got ''"),
    "other header": ("id,lat,lon\n", ":1: expected the header id,x,y .* got 'id,lat,lon'"),
    "other signature": ("id,x,y,colour\n", ":1: expected the header .* got 'id,x,y,colour'"),
    "no rows": ("id,x,y\n", "no landmarks: the file has no rows"),
    "short row": ("id,x,y\n1,2\n", ":2: expected 3 values, got 2"),
    "no number": ("id,x,y\n1,2,abc\n", ":2: landmark: expected a number, got 'abc'"),
    "nan position": ("id,x,y\n1,nan,3\n", ":2: landmark: expected a finite number, got 'nan'"),
    "negative id": ("id,x,y\n-1,2,3\n", ":2: id: expected a whole number >= 0, got '-1'"),
    "huge id": ("id,x,y\n99999999999999999999,2,3\n", ":2: id: expected a whole number >= 0, got '9999"),
    "duplicate id": ("id,x,y\n4,2,3\n4,2,3\n", ":3: expected each id once, got 4 again after line 2"),
    "half a type": ("id,x,y,type\n4,2,3,0.5\n", "signatures: expected types 0, 1, 2, .* got 0.5"),
}


@pytest.mark.parametrize("name", BAD_CSV)
def test_bad_csv_is_refused(name, tmp_path):
    text, message = BAD_CSV[name]
    (tmp_path / "map.csv").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_landmarks(tmp_path / "map.csv")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("6 1 2 0\n", ":1: expected subject, x, y, x_std, y_std, got 4 values"),
        ("6 1 2 0 -1\n", ":1: expected standard deviations >= 0, got '0' and '-1'"),
        ("6 1 2 0 0\n6 1 2 0 0\n", ":2: expected each id once, got 6 again after line 1"),
        ("# nothing\n", "no landmarks"),
    ],
    ids=["short", "negative deviation", "duplicate id", "empty"],
)
def test_bad_mrclam_files_are_refused(text, message, tmp_path):
    (tmp_path / "l.dat").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_mrclam_landmarks(tmp_path / "l.dat")


def test_a_course_world_with_more_columns_is_refused(tmp_path):
    (tmp_path / "world.dat").write_text("1 2 3 4\n")
    with pytest.raises(FormatError, match=":1: expected id, x, y, got 4 values"):
        read_course_world(tmp_path / "world.dat")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no steps: the file has no ODOMETRY line"),
        ("LASER 1 2 3\n", ":1: expected ODOMETRY or SENSOR, got 'LASER'"),
        ("SENSOR 1 2 3\n", ":1: SENSOR: expected ODOMETRY before the first feature"),
        ("ODOMETRY 1 2\n", ":1: ODOMETRY: expected 3 values, got 2"),
        ("ODOMETRY 1 2 inf\n", ":1: ODOMETRY: expected a finite number, got 'inf'"),
        ("ODOMETRY 1 2 3\nSENSOR 1.5 2 3\n", ":2: id: expected a whole number >= 0, got '1.5'"),
        ("ODOMETRY 1 2 3\nSENSOR 1 nan 3\n", ":2: SENSOR: expected a finite number, got 'nan'"),
    ],
    ids=["empty", "other line", "feature first", "short", "infinite", "odd id", "nan range"],
)
def test_bad_course_logs_are_refused(text, message, tmp_path):
    (tmp_path / "log.dat").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_course_log(tmp_path / "log.dat")
