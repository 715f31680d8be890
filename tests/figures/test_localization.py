"""The picture of a localization."""

import numpy as np
import pytest

from beamfield.figures.localization import localization_figure
from beamfield.localization.replay import Replay
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog

GRID = OccupancyGrid(np.zeros((50, 100)), 0.1)


@pytest.mark.parametrize(("sure_after", "n_guesses"), [(0.0, 0), (2.0, 2), (None, 4)])
def test_poses_from_before_the_filter_was_sure_are_points_beside_the_path(sure_after, n_guesses):
    way = np.column_stack([[1.0, 8.0, 3.0, 4.0], np.full(4, 2.0), np.zeros(4)])
    finder = RangeFinder.from_bearings([0.0], max_range=5.0)
    log = SensorLog(finder, np.arange(4.0), np.ones((4, 1)), np.full((4, 3), np.nan), way)
    found = Replay(way, np.arange(4), way, np.tile(np.eye(3), (4, 1, 1)), np.full(4, 100), np.empty(0))
    path = localization_figure(found, log, GRID, sure_after=sure_after).axes[0]
    drawn = {line.get_label(): line.get_xdata() for line in path.lines}
    assert len(drawn.get("guess, or an earlier place", ())) == n_guesses
    np.testing.assert_array_equal(drawn.get("estimate", np.empty(0)), way[n_guesses:, 0])


@pytest.mark.parametrize("with_reference", [False, True])
def test_axes_say_whether_they_show_errors_or_spreads_alone(with_reference):
    way = np.column_stack([np.arange(4.0), np.full(4, 2.0), np.zeros(4)])
    log = SensorLog(
        RangeFinder.from_bearings([0.0], max_range=5.0),
        np.arange(4.0),
        np.ones((4, 1)),
        way if with_reference else np.full((4, 3), np.nan),
        way,
    )
    wide = np.tile(np.diag([1.0, 1.0, 4.0]), (4, 1, 1))
    found = Replay(way, np.arange(4), way, wide, np.full(4, 100), np.empty(0))
    _, position, heading = localization_figure(found, log, GRID).axes
    titles = ["Error of the position", "Error of the heading"]
    spreads = ["How sure of the position", "How sure of the heading"]
    assert [ax.get_title("left") for ax in (position, heading)] == (titles if with_reference else spreads)
    assert position.get_ylabel() == ("error [m]" if with_reference else "95% of the particles within [m]")
    assert heading.lines[0].get_ydata().max() == 180.0  # no heading is further off
