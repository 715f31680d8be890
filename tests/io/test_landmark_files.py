"""Files of landmarks: read, written, and refused."""

from __future__ import annotations

import gzip

import pytest

from beamfield.errors import FormatError
from beamfield.io.landmarks.landmark_files import (
    read_landmarks,
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


BAD_CSV = {
    "empty": ("", "expected the header id,x,y .* got ''"),
    "other header": ("id,lat,lon\n", ":1: expected the header id,x,y .* got 'id,lat,lon'"),
    "other signature": ("id,x,y,colour\n", ":1: expected the header .* got 'id,x,y,colour'"),
    "no rows": ("id,x,y\n", "no landmarks: the file has no rows"),
    "short row": ("id,x,y\n1,2\n", ":2: expected 3 values, got 2"),
    "no number": ("id,x,y\n1,2,abc\n", ":2: landmark: expected a number, got 'abc'"),
    "nan position": ("id,x,y\n1,nan,3\n", ":2: landmark: expected a finite number, got 'nan'"),
    "infinite position": ("id,x,y\n1,2,-inf\n", ":2: landmark: expected a finite number, got '-inf'"),
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
