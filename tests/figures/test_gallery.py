"""The gallery: complete, labelled with units, the same on every run, and drawn from any log."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from beamfield.errors import InvalidInputError
from beamfield.figures import scan_figures
from beamfield.figures.beam_model_figures import _groups_at_one_range
from beamfield.figures.field_figures import map_field_figure
from beamfield.figures.gallery import FIGURES, chosen_figures, gallery_page, save_figure
from beamfield.figures.likelihood_over_map import draw_likelihood_map, likelihood_figure
from beamfield.figures.sonar_figures import RIGHT, kinds_of, sonar_readings, telling_readings
from beamfield.figures.world import FigureWorld, simulated_world, world_of_log
from beamfield.localization.likelihood_map import LikelihoodMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan, ScanLog, SensorLog
from beamfield.simulation.sonar import sonar_ring


@pytest.fixture(scope="module")
def world() -> FigureWorld:
    return simulated_world(3, duration=40.0)


@pytest.fixture(scope="module")
def drawn(world) -> Callable[[str], Figure]:
    """A function that draws a figure of the world, once."""
    return cache(lambda number: FIGURES[number].draw(world))


def all_axes(figure: Figure) -> list:
    """Every axes of a figure, those of its subfigures included, without colour bars' and empty ones."""
    return [ax for ax in figure.findobj(match=lambda item: hasattr(item, "get_xlabel")) if ax.has_data()]


def test_the_registry_has_every_figure_in_order():
    assert list(FIGURES) == ["6.1", *(f"6.{i}" for i in range(3, 14))]
    assert len({figure.stem for figure in FIGURES.values()}) == len(FIGURES)
    assert all(figure.caption.endswith(".") and figure.title for figure in FIGURES.values())


@pytest.mark.parametrize("number", list(FIGURES))
def test_every_figure_names_its_units(drawn, number):
    check_units(all_axes(drawn(number)))


def check_units(axes: list) -> None:
    assert len(axes) >= 2
    for ax in axes:
        for label in (ax.get_xlabel(), ax.get_ylabel()):
            assert not label or re.search(r"\[.+\]|number of the reading", label), label
        assert ax.get_xlabel() or ax.get_ylabel()


@pytest.mark.parametrize("number", ["6.8", "6.9"])
def test_a_figure_is_the_same_on_every_run_and_small(world, drawn, tmp_path, number):
    save_figure(drawn(number), tmp_path / "one.svg")
    save_figure(FIGURES[number].draw(world), tmp_path / "two.svg")
    content = (tmp_path / "one.svg").read_bytes()
    assert content == (tmp_path / "two.svg").read_bytes()
    assert b"<dc:date>" not in content
    assert 10_000 < len(content) < 300_000


def test_other_endings_are_refused(tmp_path):
    with pytest.raises(InvalidInputError, match=r"\.svg, \.png or \.pdf, got 'a\.gif'"):
        save_figure(Figure(), tmp_path / "a.gif")


def test_figures_are_chosen_by_number_in_the_chapters_order():
    assert [figure.number for figure in chosen_figures(["6.10", "6.9"])] == ["6.9", "6.10"]
    assert len(chosen_figures()) == len(FIGURES)
    with pytest.raises(InvalidInputError, match=r"expected one of 6\.1, .*, got '7\.1'"):
        chosen_figures(["7.1"])


def test_the_page_shows_every_picture_with_its_caption():
    page = gallery_page(list(FIGURES.values()), "a test", folder="images", suffix="png")
    for figure in FIGURES.values():
        assert f"(images/{figure.stem}.png)" in page
        assert figure.caption.replace("*", r"\*") in page
    assert "z*" not in page


def test_figure_6_7_shows_the_first_scan_whose_maximum_is_at_its_pose(world, monkeypatch):
    poses = world.log.poses[[world.index, *world.others]]
    assert len(poses) > 2
    apart = np.hypot(*(poses[:, None, :2] - poses[None, :, :2]).transpose(2, 0, 1))
    assert apart[~np.eye(len(poses), dtype=bool)].min() > 1.5
    places = {"wrong, right": [poses[0] + 5.0, poses[1]], "all wrong": list(poses + 5.0)}
    for name, best in places.items():
        waiting, shown = iter(best), []
        monkeypatch.setattr(
            scan_figures, "likelihood_map", lambda *_, waiting=waiting, **__: SimpleNamespace(best_pose=next(waiting))
        )
        monkeypatch.setattr(scan_figures, "likelihood_figure", lambda *drawn, shown=shown, **_: shown.append(drawn[3]))
        scan_figures.likelihood_over_map_figure(world)
        np.testing.assert_array_equal(shown[0], poses[1] if name == "wrong, right" else poses[0])


def test_the_maximum_of_figure_6_7_is_at_the_reference_pose(world, drawn):
    ax = next(ax for ax in all_axes(drawn("6.7")) if ax.get_title(loc="left").startswith("(b)"))
    maximum = next(line for line in ax.lines if line.get_label() == "maximum")
    there = np.array([maximum.get_xdata()[0], maximum.get_ydata()[0]])
    assert np.hypot(*(world.log.poses[[world.index, *world.others], :2] - there).T).min() < 0.5


def test_the_sensors_of_figure_6_5_are_compared_at_one_expected_range(world):
    groups = _groups_at_one_range(list(world.calibrations.values()))
    assert [group.centre for group in groups] == [3.0, 3.0]
    for group, calibration in zip(groups, world.calibrations.values(), strict=True):
        assert np.abs(calibration.table.expected_ranges[group.rows] - 3.0).max() <= 0.1 + 1e-9
        assert len(group.rows) >= 30


@pytest.mark.parametrize("spread", [2.0, 300.0])
def test_a_map_of_likelihoods_shows_differences_however_small_they_are(spread):
    # Correlations of maps differ by two nats, scans of a laser by hundreds.
    values = -spread * np.linspace(0.0, 1.0, 400).reshape(20, 20)
    everywhere = np.ones((20, 20), np.bool_)
    result = LikelihoodMap(values, everywhere, np.zeros((20, 20), np.int16), np.zeros(1), 0.5, np.zeros(3))
    ax = Figure().add_subplot()
    draw_likelihood_map(result, OccupancyGrid(np.zeros((20, 20)), 0.5), ax)
    image = next(image for image in ax.get_images() if image.norm.vmax == 0.0 and image.norm.vmin < 0.0)
    assert image.norm.vmin == pytest.approx(-min(spread / 2.0, 30.0), rel=0.01)


@pytest.mark.parametrize("shape", [(90, 50), (79, 151)])
def test_no_text_leaves_the_picture_of_a_tall_or_a_wide_map(shape):
    corner = np.array([4.0, 31.0, 0.0])
    grid = OccupancyGrid(np.zeros(shape), 0.5, corner)
    values = -np.linspace(0.0, 300.0, grid.probability.size).reshape(shape)
    everywhere, headings = np.ones(shape, np.bool_), np.zeros(shape, np.int16)
    result = LikelihoodMap(values, everywhere, headings, np.zeros(1), 0.5, corner)
    scan = Scan([1.9, 16.0, 1.9], RangeFinder.from_bearings([-1.6, 0.0, 1.6], max_range=40.0))
    place = np.array([34.4, 40.4, 3.04])
    pictures = {
        "6.7": likelihood_figure(scan, grid, result, place, model_name="beam model, 12 beams"),
        "6.10": map_field_figure(SimpleNamespace(grid=grid, log=scan)),
    }
    for number, figure in pictures.items():
        figure.draw_without_rendering()
        low, high = figure.get_tightbbox().get_points()
        assert (low > -0.02).all(), number
        assert (high < figure.get_size_inches() + 0.02).all(), number


def test_the_beam_of_figure_6_9_passes_three_obstacles(drawn):
    left = all_axes(drawn("6.9"))[0]
    assert [text.get_text() for text in left.texts] == ["$o_1$", "$o_2$", "$o_3$"]
    curve = left.lines[0]
    z, hit = curve.get_xdata(), curve.get_ydata()
    assert np.sum(hit) * (z[1] - z[0]) == pytest.approx(1.0, abs=1e-6)


def test_every_pose_of_figure_6_13_sees_the_landmark_to_its_left(drawn):
    left, right = (ax for ax in all_axes(drawn("6.13")) if ax.get_title(loc="left"))
    starts, tips = np.array(right.collections[0].get_segments()).transpose(1, 0, 2)
    bearing = np.arctan2(-starts[:, 1], -starts[:, 0]) - np.arctan2(*(tips - starts).T[::-1])
    assert np.degrees(np.angle(np.exp(1j * bearing)).mean()) == pytest.approx(30.0, abs=2.0)
    assert np.hypot(*starts.T).mean() == pytest.approx(5.0, abs=0.1)
    assert left.images[0].get_array().sum() * 0.05**2 == pytest.approx(1.0)


def test_a_log_of_ones_own_is_shown_with_all_its_sensors(world):
    log = ScanLog(world.sensors, source="some/where/drive.log")
    own = world_of_log(log, world.grid, sensor="sonar")
    assert list(own.sensors) == ["laser", "sonar"]
    assert own.log is world.sensors["sonar"]
    assert own.name == "drive.log"
    ring = replace(own.log, finder=replace(own.log.finder, opening_angle=0.3))
    cones = world_of_log(ScanLog({"sonar": ring}), world.grid)
    assert "(c) 24 sonars" in [ax.get_title(loc="left") for ax in all_axes(FIGURES["6.1"].draw(cones))]
    chosen = world_of_log(log, world.grid, sensor="laser", index=7)
    assert chosen.index == chosen.open_index == 7
    for number in ("6.8", "6.9", "6.11"):
        assert all_axes(FIGURES[number].draw(chosen))
    poses = chosen.log.poses.copy()
    poses[3] = np.nan
    lost = replace(chosen, sensors={"laser": replace(chosen.log, poses=poses)})
    for shown, count in ((chosen, 8), (lost, 7)):
        assert f"(a) local map from {count} scans" in [
            ax.get_title(loc="left") for ax in all_axes(FIGURES["6.12"].draw(shown))
        ]


def test_the_cones_of_figure_6_1_end_at_the_nearest_thing_or_are_marked(world):
    ring = sonar_ring(24, max_range=5.0)
    readings = sonar_readings(world, ring, np.random.default_rng(2))
    kinds = kinds_of(readings, ring)
    near = np.abs(readings.ranges - readings.nearest) <= RIGHT
    np.testing.assert_array_equal(kinds == 0, near)
    lost = np.isposinf(readings.ranges) & (readings.nearest < 5.0)
    np.testing.assert_array_equal(kinds == 3, lost)


def test_figure_6_1_shows_every_kind_of_reading_that_it_names(world):
    ring = sonar_ring(24, max_range=5.0)
    kinds = kinds_of(telling_readings(world, ring), ring)
    assert {0, 1, 2, 3} <= set(np.unique(kinds).tolist())


def without(log: SensorLog, **changes) -> ScanLog:
    columns = {name: getattr(log, name) for name in ("finder", "stamps", "ranges", "poses", "odometry")}
    return ScanLog({"laser": SensorLog(**{**columns, **changes})}, source="x.log")


def test_a_scan_that_cannot_be_shown_is_refused(world):
    log = world.log
    poses, ranges = np.array(log.poses), np.array(log.ranges)
    poses[2], ranges[3] = np.nan, np.inf
    broken = without(log, poses=poses, ranges=ranges)
    for index, message in ((-1, "scans 0 to 199, got -1"), (2, "no reference pose"), (3, "no measured range")):
        with pytest.raises(InvalidInputError, match=message):
            world_of_log(broken, world.grid, index=index)
    with pytest.raises(InvalidInputError, match="no scan has a reference pose"):
        world_of_log(without(log, poses=np.full(poses.shape, np.nan)), world.grid)
    with pytest.raises(InvalidInputError, match="no scan has both"):
        world_of_log(without(log, ranges=np.full(ranges.shape, np.inf)), world.grid)
    with pytest.raises(InvalidInputError, match="at least one"):
        FigureWorld("x", world.grid, {}, 0, world.scene, 0)
