"""Logs of landmark sightings in hand-written mini files: read, written, and refused."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.detection_log import DetectionLog
from beamfield.detections import SPURIOUS, UNKNOWN, Detections
from beamfield.errors import FormatError
from beamfield.io.landmarks.sightings import read_sightings
from tests.sightings_file import write_sightings

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
    seen = tuple(Detections([1.0], [0.1], ids=[7], stamp=stamp) for stamp in (0.1, 0.25, 2.0))
    write_sightings(tmp_path / "b.csv", DetectionLog([[0.0] * 3, [1.0] * 3, [np.nan] * 3], seen))
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
        (HEADER + "1,0,0,0,7,1e200,0\n", r"a.csv:2: range: expected a number up to 1e\+09, got '1e200'"),
        (HEADER + "1,0,0,0,-2,1,0\n", "a.csv:2: id: expected a whole number >= 0, -1 or nothing, got '-2'"),
        (HEADER + "1,0,0,0,7.5,1,0\n", "a.csv:2: id: .* got '7.5'"),
        (HEADER + "1,0,0,0,7,,\n", "a.csv:2: expected a range, a bearing or both, got neither"),
        (HEADER + "1,0,0,0,7,1,90\n", "a.csv:2: bearing: expected radians, at most a full turn, got '90': degrees?"),
        (HEADER + "2,0,0,0,7,1,0\n1,0,0,0,7,1,0\n", "a.csv:3: stamp: .* not fall, got 1.0 after 2.0"),
        (HEADER + "1,0,0,0,7,1,0\n1,0,5,0,7,1,0\n", r"a.csv:3: .* one pose per stamp, got \[0.0, 5.0, 0.0\]"),
    ],
    ids=["header", "empty", "6 values", "word", "nan pose", "no y", "inf", "nan", "1e200", "id -2", "half id",
         "nothing", "degrees", "stamps", "poses"],
)  # fmt: skip
def test_what_are_no_sightings_is_refused(text, message, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_sightings(tmp_path / "a.csv")
