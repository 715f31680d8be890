"""Choosing by index or mask: what is meant, what is refused, and that everything that can be chosen from agrees."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.beam_table import BeamTable
from beamfield.detection_log import DetectionLog
from beamfield.detections import Detections
from beamfield.errors import InvalidInputError
from beamfield.indices import as_indices
from beamfield.landmark_noise.sighting_table import SightingTable
from beamfield.maps.mapping import local_map
from beamfield.models.line_detections import LineDetections
from beamfield.scan_fit.statistics import FitStatistics
from beamfield.sensors import RangeFinder, Scan, SensorLog

N = 4
FINDER = RangeFinder.from_bearings(np.arange(float(N)), max_range=8.0)
VALUES = np.arange(1.0, N + 1.0)
DETECTIONS = Detections(VALUES, np.zeros(N))
# Everything that offers a choice, as a function of the choice that returns VALUES of what was chosen.
CHOOSERS = {
    "beams of a finder": lambda choice: FINDER.subset(choice).bearings + 1.0,
    "beams of a scan": lambda choice: Scan(VALUES, FINDER).subset(choice).ranges,
    "scans": lambda choice: (
        SensorLog(FINDER, VALUES, np.ones((N, N)), poses=np.zeros((N, 3)), odometry=np.zeros((N, 3)))
        .select(choice)
        .stamps
    ),
    "features": lambda choice: DETECTIONS.subset(choice).ranges,
    "lines": lambda choice: LineDetections(np.column_stack([VALUES, np.zeros(N)])).subset(choice).lines[:, 0],
    "observations": lambda choice: (
        DetectionLog(np.column_stack([VALUES, np.zeros((N, 2))]), (DETECTIONS,) * N).subset(choice).poses[:, 0]
    ),
    "rows of beams": lambda choice: (
        BeamTable(VALUES, VALUES, np.zeros(N, np.int32), np.zeros(N, np.int32), np.zeros(N), 8.0).select(choice).ranges
    ),
    "rows of sightings": lambda choice: (
        SightingTable(VALUES, VALUES, VALUES, VALUES, np.zeros(N, int), VALUES, np.zeros(N, int)).subset(choice).ranges
    ),
    "statistics of scans": lambda choice: (
        FitStatistics(VALUES, VALUES, VALUES, VALUES, np.ones(N, int)).select(choice).surprise
    ),
}


@pytest.fixture(params=CHOOSERS)
def choose(request):
    return CHOOSERS[request.param]


@pytest.mark.parametrize(
    ("choice", "expected"),
    [
        ([0, 2], [1.0, 3.0]),
        ([1, -1], [2.0, 4.0]),
        ([True, False, False, True], [1.0, 4.0]),
        (np.array([3], np.uint8), [4.0]),
    ],
)
def test_indices_and_masks_choose(choose, choice, expected):
    assert choose(choice).tolist() == expected


@pytest.mark.parametrize("choice", [[], np.empty(0), np.empty(0, int), [False] * N])
def test_nothing_can_be_chosen(choose, choice):
    assert choose(choice).size == 0


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ([4], "expected indices from -4 to 3, got 4"),
        ([0, -5], "expected indices from -4 to 3, got -5"),
        ([True, False], "expected a mask of length 4, got 2"),
        ([0.0, 1.0], r"expected indices \(m,\) or a mask \(4,\), got float64 \(2,\)"),
        (2, r"expected indices \(m,\) or a mask \(4,\), got int64 \(\)"),
        (["a"], r"expected indices \(m,\) or a mask \(4,\), got <U1 \(1,\)"),
        ([[0, 1]], r"expected indices \(m,\) or a mask \(4,\), got int64 \(1, 2\)"),
    ],
)
def test_what_is_no_choice_is_refused_by_name(choose, choice, message):
    with pytest.raises(InvalidInputError, match=rf"^\w+: {message}$"):
        choose(choice)


def test_repeated_indices_repeat():
    assert as_indices([1, 1, 0], 2, "beams").tolist() == [1, 1, 0]


def test_of_what_is_empty_nothing_can_be_chosen_and_the_error_says_so():
    nothing = SensorLog(FINDER, [], np.empty((0, N)), np.empty((0, 3)), np.empty((0, 3)))
    with pytest.raises(InvalidInputError, match="beams: expected none, as there is none to choose, got 0"):
        as_indices([0], 0, "beams")
    with pytest.raises(IndexError, match="index: the log has no scan, got 0"):
        nothing.scan(0)
    with pytest.raises(InvalidInputError, match="log: expected at least one scan, got 0"):
        local_map(nothing, 0)
