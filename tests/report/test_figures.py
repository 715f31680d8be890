"""What the figures are computed from."""

from __future__ import annotations

import base64
import io
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from beamfield.calibration.opposite_beams import opposite_pairs
from beamfield.calibration.time_split import time_blocks
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.check_figures import noise_points
from beamfield.report.colours import CAUSE_COLOURS, THROUGH
from beamfield.report.density_figures import averaged_cdf
from beamfield.report.map_figures import beam_ends
from beamfield.report.panel import png_panel
from beamfield.report.pit_figure import PIT_BINS, pit_band
from beamfield.report.range_bins import range_step, telling_bin, thinned, typical_bins


def test_bins_hold_exactly_the_beams_near_their_centre(case):
    table = case.calibration.table
    bins = typical_bins(table)
    assert len(bins) >= 3
    for group in bins:
        near = np.abs(table.expected_ranges - group.centre) <= group.half_width
        assert np.array_equal(group.rows, np.flatnonzero(near & ~table.hits_nothing))
    for near_bin, far_bin in pairwise(bins):
        assert near_bin.centre + near_bin.half_width <= far_bin.centre - far_bin.half_width
    assert telling_bin(bins) in bins


def test_a_rare_cause_keeps_its_colour_in_a_busy_picture():
    figure = Figure(figsize=(4.7, 4.6), facecolor="white")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(np.random.default_rng(0).random((120, 120, 3)), extent=(0, 1, 0, 0.7), aspect="auto")
    colours = (*CAUSE_COLOURS, THROUGH)
    axes.set(xlim=(0, 1), ylim=(0, 1))
    for number, colour in enumerate(colours):
        axes.scatter([0.1 + 0.2 * number], [0.9], s=7, color=colour, linewidths=0)
    data = png_panel(figure, "dots", dpi=120).markup.split("base64,")[1].split('"')[0]
    pixels = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))
    for number, colour in enumerate(colours):
        row, col = 0.1 * pixels.shape[0], (0.1 + 0.2 * number) * pixels.shape[1]
        wanted = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
        np.testing.assert_array_equal(pixels[int(row), int(col)], wanted)
    np.testing.assert_array_equal(pixels[2, 2], 255)


def test_thinning_keeps_the_order_and_is_the_same_every_time():
    rows = np.arange(1000) * 3
    kept = thinned(rows, 100)
    assert len(kept) == 100
    assert np.all(np.diff(kept) > 0)
    assert set(kept) <= set(rows)
    assert np.array_equal(kept, thinned(rows, 100))
    assert thinned(rows, 5000) is rows


@pytest.mark.parametrize("step", [0.01, 0.05])
def test_the_sensors_step_is_found(rng, step):
    ranges = np.round(rng.uniform(0.5, 8.0, 5000) / step) * step
    assert range_step(ranges) == pytest.approx(step, rel=1e-6)


def test_continuous_ranges_have_no_step(rng):
    assert range_step(rng.uniform(0.5, 8.0, 5000)) == 0.0
    assert range_step(np.array([1.0])) == 0.0


def test_the_averaged_model_matches_the_shares_of_drawn_readings(case):
    table, truth = case.calibration.table, case.calibration.parameters
    group = telling_bin(typical_bins(table))
    edges = np.array([0.0, 1.0, group.centre - 0.05, group.centre + 0.05, 8.0])
    model = averaged_cdf(edges, table.expected_ranges[group.rows], truth, table.max_range)
    ranges = table.ranges[group.rows]
    measured = [(ranges < edge).mean() for edge in edges]
    noise = np.sqrt(0.25 / len(ranges))
    assert np.abs(model - measured).max() < 4 * noise
    assert model[0] == 0.0
    all_but_max = averaged_cdf(np.array([table.max_range]), table.expected_ranges[group.rows], truth, table.max_range)
    assert all_but_max[0] == pytest.approx(1 - truth.z_max, abs=1e-9)


def test_the_averaged_model_starts_at_min_range(case):
    truth, expected = case.calibration.parameters, np.array([0.1, 2.0, 2.1])
    model = averaged_cdf(np.array([0.0, 0.3, 0.4, 10.0]), expected, truth, 10.0, min_range=0.3)
    assert model[:2].tolist() == [0.0, 0.0]
    assert model[2] > 0.0
    assert model[3] == pytest.approx(1 - truth.z_max, abs=1e-9)


def test_hits_end_on_the_walls_and_missing_returns_where_the_map_expects_them(case):
    calibration = case.calibration
    rows = np.flatnonzero((calibration.causes == 2) & ~calibration.table.hits_nothing)
    x, y = beam_ends(calibration, case.log, rows).T
    on_wall = np.minimum(np.minimum(np.abs(x), np.abs(x - 12)), np.minimum(np.abs(y), np.abs(y - 6)))
    assert len(rows) > 100
    assert on_wall.max() < 1e-9
    hits = np.flatnonzero(calibration.causes == 0)
    x, y = beam_ends(calibration, case.log, hits).T
    on_wall = np.minimum(np.minimum(np.abs(x), np.abs(x - 12)), np.minimum(np.abs(y), np.abs(y - 6)))
    assert np.quantile(on_wall, 0.95) < 0.15


def test_pairs_of_opposite_beams_are_those_that_were_summarised(case):
    table = case.calibration.table
    first, second = opposite_pairs(case.log, table)
    assert len(first) == case.calibration.opposite.n_pairs
    difference = (
        table.ranges[first] + table.ranges[second] - table.expected_ranges[first] - table.expected_ranges[second]
    )
    assert np.median(difference) == pytest.approx(case.calibration.opposite.median_difference, abs=0.01)


def test_the_noise_by_range_is_the_one_that_was_drawn(make_case):
    truth = BeamParameters(0.8, 0.1, 0.05, 0.05, 0.03, 0.3, 0.1, 0.02)
    points = noise_points(make_case(truth=truth, n_scans=600).calibration)
    expected, mean, mean_error, spread, spread_error = points.T
    assert len(points) >= 8
    assert np.abs((mean - 0.1) / mean_error).max() < 5
    assert np.abs((spread - np.hypot(0.03, 0.02 * expected)) / spread_error).max() < 5


def test_the_pit_band_covers_independent_beams_of_a_right_model(case):
    band, from_blocks = pit_band(case.calibration)
    n = len(case.calibration.pit)
    assert from_blocks
    assert band >= 1.96 * np.sqrt((PIT_BINS - 1) / n) * 0.999
    density = np.histogram(case.calibration.pit, np.linspace(0, 1, PIT_BINS + 1))[0] / n * PIT_BINS
    assert (np.abs(density - 1) > band).sum() <= 4


def test_the_pit_band_is_wider_where_beams_of_a_block_depend_on_each_other(case):
    calibration = case.calibration
    rows = calibration.held_out & ~calibration.table.hits_nothing
    block = time_blocks(calibration.table.stamps)[rows]
    same = np.random.default_rng(3).random(block.max() + 1)[block]
    alike, _ = pit_band(replace(calibration, pit=np.where(np.arange(len(same)) % 2, same, calibration.pit)))
    assert alike > 3 * pit_band(calibration)[0]
