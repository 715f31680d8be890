"""The pictures of logs that inspect draws."""

from __future__ import annotations

import json

import numpy as np

from beamfield.cli.inspect_picture import log_picture
from beamfield.cli.inspect_summary import log_facts, log_text
from beamfield.sensors import ScanLog
from tests.cli.wall_drive import make_sensor


def test_an_empty_log_and_one_without_poses_are_described_and_drawn():
    for n, ranges in ((0, np.zeros((0, 19))), (1, np.full((1, 19), np.nan)), (2, np.full((2, 19), np.inf))):
        nowhere = np.full((n, 3), np.nan)
        sensor = make_sensor(n, ranges=ranges, poses=nowhere, odometry=nowhere)
        log = ScanLog({"a": sensor}, notes=("a note",))
        facts = log_facts(log)
        json.dumps(facts, allow_nan=False)
        text = log_text(facts)
        assert "reference poses   none" in text
        assert "  - a note" in text
        log_picture(log, "empty").canvas.draw()


def test_end_points_are_drawn_on_the_wall_they_hit():
    figure = log_picture(ScanLog({"a": make_sensor()}), "a")
    path_panel = next(ax for ax in figure.axes if "reference poses" in ax.get_title())
    points = np.ma.filled(path_panel.collections[0].get_offsets(), np.nan)
    # The wall is 1.5 m to the left of a path at y = 2; the robot's own places are drawn too.
    np.testing.assert_allclose(np.unique(points[:, 1].round(9)), [2.0, 3.5])


def test_several_sensors_have_a_row_each_and_more_than_four_are_counted():
    figure = log_picture(ScanLog({str(i): make_sensor() for i in range(6)}), "many")
    assert "the first 4 of 6 sensors" in figure.get_suptitle()
    assert len([ax for ax in figure.axes if "readings" in ax.get_title()]) == 4


def test_the_layout_follows_the_shape_of_the_path():
    turned = make_sensor()
    turned = turned.with_poses(np.column_stack([turned.poses[:, 1], 4 * turned.poses[:, 0], np.full(20, np.pi / 2)]))
    wide = make_sensor()
    wide = wide.with_poses(wide.poses * [6.0, 1.0, 1.0])
    sizes = [log_picture(ScanLog({"a": sensor}), "a") for sensor in (wide, turned)]
    places = []
    for figure in sizes:
        figure.canvas.draw()
        panel = {
            ("path" if "frame, from" in ax.get_title() else ax.get_title()): ax.get_position() for ax in figure.axes
        }
        places.append((panel["path"], panel["380 readings"]))
    (wide_path, wide_ranges), (tall_path, tall_ranges) = places
    assert wide_path.y0 > wide_ranges.y1  # above the histogram
    assert tall_path.x1 < tall_ranges.x0  # left of it
