"""The picture of a fitted trajectory."""

import numpy as np
import pytest

from beamfield.localization.trajectory import TrajectoryFit
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report.trajectory_figure import MARGIN, draw_fit
from beamfield.sensors import RangeFinder, SensorLog


@pytest.mark.parametrize(("lost_at", "left"), [(5.0, 5.0 - MARGIN), (-1000.0, -MARGIN)])
def test_own_poses_that_leave_the_path_are_in_the_picture_as_far_as_the_map_goes(lost_at, left):
    way = np.column_stack([np.linspace(20.0, 24.0, 5), np.full(5, 2.0), np.zeros(5)])
    own = way.copy()
    own[1, 0], own[2] = lost_at, np.nan
    log = SensorLog(RangeFinder.from_bearings([0.0], max_range=5.0), np.arange(5.0), np.ones((5, 1)), own, way)
    covariances = np.tile(1e-4 * np.eye(3), (5, 1, 1))
    fit = TrajectoryFit(log.stamps, way, covariances, np.ones(5, bool), (), (), 0.05, 0.0, 0.0, 0.0, True)
    figure = draw_fit(fit, log, OccupancyGrid(np.zeros((50, 300)), 0.1), "a$^$b.carmen")
    figure.draw_without_rendering()  # no formula, which would be wrong
    path, distance = figure.axes
    assert path.get_xlim()[0] == pytest.approx(left)
    off = next(line for line in distance.lines if "own position" in line.get_label()).get_ydata()
    np.testing.assert_allclose(off, [0.0, 21.0 - lost_at, np.nan, 0.0, 0.0])
    assert distance.get_ylim()[1] > 21.0 - lost_at
    assert distance.get_ylabel() == "distance [m]"
