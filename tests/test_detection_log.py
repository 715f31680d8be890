"""Logs of landmark sightings: what they hold and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.detection_log import DetectionLog, group_detections
from beamfield.detections import Detections
from beamfield.errors import InvalidInputError

POSES = [[0.0, 1.0, 2.0], [np.nan] * 3, [3.0, 4.0, 5.0]]


def detections(*stamps: float) -> list[Detections]:
    return [Detections([1.0], [0.0], stamp=stamp) for stamp in stamps]


def test_a_log_counts_and_selects_in_its_own_order():
    log = DetectionLog(POSES, detections(1.0, 1.0, 2.5), places=[4, 4, 2], notes=("seen",))
    assert (len(log), log.stamps.tolist()) == (3, [1.0, 1.0, 2.5])
    part = log.subset([2, 0])
    assert part.stamps.tolist() == [1.0, 2.5]
    assert part.places.tolist() == [4, 2]
    assert part.poses[1].tolist() == [3.0, 4.0, 5.0]
    assert log.subset([True, False, False]).stamps.tolist() == [1.0]


def test_a_log_keeps_its_own_copy_of_poses():
    poses = np.array(POSES)
    log = DetectionLog(poses, detections(1.0, 1.0, 2.5))
    poses[0] = 9.0
    assert log.poses[0].tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        log.poses[0] = 0.0


def test_columns_become_observations_and_features_keep_their_order():
    seen = group_detections([2, 0, 2], [0.5, 0.6, 0.7], [1.0, 2.0, 3.0], [0.1, np.nan, 0.3], [5, 6, 7])
    assert [z.ids.tolist() for z in seen] == [[6], [], [5, 7]]
    assert [z.stamp for z in seen] == [0.5, 0.6, 0.7]
    assert seen[2].ranges.tolist() == [1.0, 3.0]
    assert np.isnan(seen[0].bearings).all()


@pytest.mark.parametrize(
    ("poses", "stamps", "options", "message"),
    [
        (POSES[:2], (1.0,), {}, r"poses: expected shape \(1, 3\), got \(2, 3\)"),
        (
            [[0.0, np.nan, 0.0]],
            (1.0,),
            {},
            r"poses: expected numbers or a row of NaN, got \[0.0, nan, 0.0\] at index 0",
        ),
        ([[0.0, np.inf, 0.0]], (1.0,), {}, "poses: expected finite numbers or NaN, got inf"),
        (POSES[:2], (1.0, 0.5), {}, "stamps: expected numbers that do not decrease, got 0.5 after 1.0"),
        (POSES[:1], (np.nan,), {}, "stamps: expected finite numbers, got nan"),
        (POSES[:1], (1.0,), {"places": [-1]}, "ids: expected at least 0, got -1"),
    ],
    ids=["number of poses", "half a pose", "infinite pose", "stamps", "stamp", "places"],
)
def test_what_is_no_log_is_refused(poses, stamps, options, message):
    with pytest.raises(InvalidInputError, match=message):
        DetectionLog(poses, detections(*stamps), **options)


def test_features_of_no_observation_are_refused():
    with pytest.raises(InvalidInputError, match="observation: expected indices 0 to 1, got 0 to 2"):
        group_detections([0, 2], [0.5, 0.6], [1.0, 2.0], [0.1, 0.2], [5, 6])
