"""Walls of real scans against the walls of their map: Wean Hall."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.features.lines import find_lines
from beamfield.features.map_features import map_features
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import compose
from beamfield.io.read_map import read_map
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from tests.real.posed_logs import wean_log

pytestmark = pytest.mark.real


def test_walls_of_scans_tell_where_across_them_the_robot_is(data, rng):
    sensor = wean_log(data, 1)
    walls = map_features(read_map(data / "wean_hall/derived_wean.yaml"), spacing=2.0).lines
    noise = LineParameters(0.1, 0.03, spurious_rate=0.1, max_range=20.0)
    model = LineModel(walls, noise, correspondence="sum", min_overlap=0.5)
    away = rng.normal(0.0, [0.7, 0.7, 0.2], (300, 3))
    scores = np.zeros(301)
    for index in range(20, len(sensor), 40):
        if np.isfinite(sensor.poses[index]).all():
            lines = LineDetections.from_lines(find_lines(sensor.scan(index), RangeNoise(0.05)))
            pose = sensor.poses[index]
            scores += model.log_likelihood(lines, np.vstack([pose, compose(pose, away)]))
    # No displacement suits all scans together better than the reference, but for a few centimetres.
    far = np.hypot(away[:, 0], away[:, 1]) > 0.2
    assert scores[0] > scores[1:][far].max()
    assert scores[0] - np.median(scores[1:]) > 50.0
