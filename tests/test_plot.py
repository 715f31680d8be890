"""Drawing: what is drawn stands where the numbers say, with units on the axes."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from beamfield import plot
from beamfield.errors import InvalidInputError
from beamfield.features.corners import Corner
from beamfield.features.lines import find_lines
from beamfield.features.poles import Pole
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import compose
from beamfield.maps.end_points import end_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.plot import MAP_COLOURS, draw_features, draw_map, draw_ranges, draw_scan, draw_trajectory
from beamfield.sensors import RangeFinder, Scan

FINDER = RangeFinder.from_bearings([-np.pi / 2, 0.0, np.pi / 2], 10.0, mount=(0.2, 0.0, 0.0), min_range=0.1)


@pytest.fixture
def ax():
    return Figure(figsize=(4, 4), dpi=100).add_subplot()


def colour_at(ax, x: float, y: float) -> str:
    """Render and return the colour of the pixel at a point in data coordinates, as #RRGGBB."""
    ax.set_axis_off()
    canvas = FigureCanvasAgg(ax.figure)
    canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())
    col, row = ax.transData.transform((x, y))
    return "#{:02X}{:02X}{:02X}".format(*picture[picture.shape[0] - 1 - int(row), int(col), :3])


def test_importing_the_module_does_not_import_matplotlib():
    program = "import sys, beamfield.plot; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.parametrize("yaw", [0.0, 0.5, np.pi / 2, -2.0])
def test_every_cell_of_a_map_is_drawn_where_it_stands(ax, yaw):
    probability = np.array([[0.0, 1.0, np.nan], [1.0, 0.0, 0.0]])
    grid = OccupancyGrid(probability, 0.5, np.array([3.0, -2.0, yaw]))
    assert draw_map(grid, ax) is ax
    free, unknown, occupied = MAP_COLOURS
    for row in range(2):
        for col in range(3):
            p = probability[row, col]
            expected = unknown if np.isnan(p) else occupied if p else free
            # Away from the centre, so that a mirrored drawing would show.
            x, y = grid.to_map([col + 0.3, row + 0.6])
            assert colour_at(ax, x, y) == expected


def test_the_axes_of_a_map_show_all_of_it_in_metres_with_equal_scales(ax):
    draw_map(OccupancyGrid(np.zeros((2, 4)), 0.5, np.array([1.0, 2.0, np.pi / 2])), ax)
    np.testing.assert_allclose([*ax.get_xlim(), *ax.get_ylim()], [0.0, 1.0, 2.0, 4.0], atol=1e-12)
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_aspect()) == ("x [m]", "y [m]", 1.0)


def test_a_large_map_is_drawn_coarser_and_keeps_its_thin_walls_and_its_place(ax, monkeypatch):
    probability = np.zeros((101, 203))
    probability[:, 117] = 1.0
    monkeypatch.setattr(plot, "MOST_PIXELS", 40)
    draw_map(OccupancyGrid(probability, 0.1), ax)
    image = ax.images[0]
    drawn = np.asarray(image.get_array())
    assert max(drawn.shape) <= 40
    step = 6
    assert (drawn[:, 117 // step] == 2).all()
    assert (drawn == 2).sum() == drawn.shape[0]
    np.testing.assert_allclose(image.get_extent(), [0, drawn.shape[1] * step * 0.1, 0, drawn.shape[0] * step * 0.1])
    assert ax.get_xlim() == pytest.approx((0.0, 20.3))


def test_end_points_are_those_of_equation_6_32():
    pose = np.array([1.0, 2.0, np.pi / 2])
    points = end_points([3.0, np.inf, 0.05], FINDER, pose)
    # The first beam looks to the robot's right, which is +x of the map.
    np.testing.assert_allclose(points[0], [4.0, 2.2], atol=1e-12)
    assert np.isnan(points[1:]).all()


def test_end_points_of_many_scans_are_those_of_each_scan(rng):
    ranges = rng.uniform(0.0, 12.0, (5, 3))
    poses = rng.normal(size=(5, 3))
    poses[2] = np.nan
    many = end_points(ranges, FINDER, poses)
    for i in range(5):
        for k in range(3):
            x, y, theta = compose(poses[i], FINDER.mounts[k])
            z = ranges[i, k] if 0.1 <= ranges[i, k] < 10.0 else np.nan
            np.testing.assert_allclose(many[i, k], [x + z * np.cos(theta), y + z * np.sin(theta)], atol=1e-12)
    assert np.isnan(many[2]).all()


def test_a_scan_is_drawn_as_its_end_points(ax):
    scan = Scan(np.array([3.0, np.inf, 2.0]), FINDER)
    assert draw_scan(scan, [0.0, 0.0, 0.0], ax) is ax
    drawn = np.ma.filled(ax.collections[0].get_offsets(), np.nan)
    np.testing.assert_allclose(drawn[[0, 2]], [[0.2, -3.0], [0.2, 2.0]], atol=1e-12)
    assert np.isnan(drawn[1]).all()
    assert ax.get_xlabel() == "x [m]"


def test_rays_end_at_the_points_and_no_returns_are_stubs(ax):
    draw_scan(Scan(np.array([3.0, np.inf, np.nan]), FINDER), [0.0, 0.0, 0.0], ax, rays=True)
    measured, no_return, _ = ax.collections
    np.testing.assert_allclose(measured.get_segments(), [[[0.2, 0.0], [0.2, -3.0]]], atol=1e-12)
    np.testing.assert_allclose(no_return.get_segments(), [[[0.2, 0.0], [1.2, 0.0]]], atol=1e-12)


def test_a_scan_needs_one_finite_pose(ax):
    scan = Scan(np.array([3.0, 1.0, 2.0]), FINDER)
    for pose in ([0.0, 0.0], np.zeros((2, 3)), [0.0, np.nan, 0.0]):
        with pytest.raises(InvalidInputError, match="pose"):
            draw_scan(scan, pose, ax)


def test_a_trajectory_breaks_where_a_pose_is_missing_and_its_ends_are_marked(ax):
    poses = np.array([[np.nan] * 3, [0.0, 1.0, 0.0], [np.nan] * 3, [2.0, 3.0, 0.0], [4.0, 5.0, 0.0]])
    assert draw_trajectory(poses, ax, label="robot") is ax
    line, start, end = ax.lines
    np.testing.assert_array_equal(line.get_xydata(), poses[:, :2])
    assert start.get_xydata().tolist() == [[0.0, 1.0]]
    assert end.get_xydata().tolist() == [[4.0, 5.0]]
    assert [entry.get_label() for entry in ax.lines] == ["robot", "start", "end"]


def test_a_trajectory_without_any_pose_draws_no_ends_and_a_wrong_shape_is_refused(ax):
    draw_trajectory(np.full((3, 3), np.nan), ax)
    assert len(ax.lines) == 1
    with pytest.raises(InvalidInputError, match=r"expected shape \(t, 3\) or \(t, 2\), got \(3,\)"):
        draw_trajectory(np.zeros(3), ax)


def test_the_histogram_counts_measured_ranges_and_the_legend_names_the_rest(ax):
    ranges = np.array([[1.0, 2.0, 2.0], [np.inf, 10.0, 12.0], [np.nan, -np.inf, 0.05], [3.0, 4.0, 9.0]])
    assert draw_ranges(ranges, FINDER, ax) is ax
    assert sum(patch.get_height() for patch in ax.patches) == 6
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    assert texts == [
        "measured: 50.0%", "no return (10 m or more): 25.0%", "too close or no measurement: 25.0%",
    ]  # fmt: skip
    assert ax.get_xlabel() == "range [m]"


def test_a_histogram_without_measured_ranges_is_still_drawn_but_not_without_readings(ax):
    draw_ranges([[np.inf, np.nan]], FINDER, ax)
    assert "no return (10 m or more): 50.0%" in [text.get_text() for text in ax.get_legend().get_texts()]
    with pytest.raises(InvalidInputError, match="at least one reading"):
        draw_ranges(np.zeros((0, 3)), FINDER, ax)


def test_features_are_drawn_where_the_pose_puts_them(ax):
    finder = RangeFinder.from_bearings(np.linspace(-0.5, 0.5, 30), 10.0)
    [wall] = find_lines(Scan(2.0 / np.cos(finder.bearings), finder), RangeNoise(0.01))
    covariance = np.diag([0.01**2, 0.02**2, 0.01**2])
    pole = Pole(np.array([3.0, 0.0, 0.4]), covariance, np.arange(4), 1.0)
    corner = Corner(np.array([1.0, np.pi / 2, np.pi / 2]), covariance, np.arange(9))
    pose = np.array([1.0, 2.0, np.pi / 2])
    assert draw_features([wall, pole, corner], pose, ax) is ax
    drawn = {line.get_label(): np.column_stack(line.get_data()) for line in ax.lines if line.get_label()[0] != "_"}
    # The robot looks along +y: straight ahead is up, and left is towards -x.
    wide = 2.0 * np.tan(0.5)
    np.testing.assert_allclose(drawn["line (1)"], [[1.0 + wide, 4.0], [1.0 - wide, 4.0]], atol=1e-9)
    np.testing.assert_allclose(drawn["pole (1)"], [[1.0, 5.0]], atol=1e-12)
    np.testing.assert_allclose(drawn["corner (1)"], [[0.0, 2.0]], atol=1e-12)
    outlines = [np.column_stack(line.get_data()) for line in ax.lines if len(line.get_xdata()) > 4]
    reaches = sorted((np.ptp(o[:, 0]), np.ptp(o[:, 1])) for o in outlines)
    # The corner's and the pole's ellipse (along the beam and across it), and the pole's outline.
    sigmas = 2.0 * np.sqrt(5.991)
    expected = sorted([(0.01, 0.02), (3.0 * 0.02, 0.01)])
    np.testing.assert_allclose(reaches[:2], sigmas * np.array(expected), rtol=1e-2)
    np.testing.assert_allclose(reaches[2], [0.4, 0.4], rtol=1e-2)


def test_no_features_draw_nothing_and_two_poses_are_refused(ax):
    draw_features([], np.zeros(3), ax)
    assert not ax.lines
    with pytest.raises(InvalidInputError, match="pose"):
        draw_features([], np.zeros((2, 3)), ax)
