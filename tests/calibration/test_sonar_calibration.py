"""The main job with cones: rings of sonars drawn from SonarModel, with the map and without it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.sonar import TRUTH, drawn_log, ring, room

from beamfield.calibration.beam_table import build_beam_table
from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.calibration.cross_fit import build_cross_fit_maps
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog

LEARNED = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
OPTIONS = CalibrationOptions(refine=False)


def as_beams(log: SensorLog) -> SensorLog:
    return replace(log, finder=replace(log.finder, opening_angle=0.0))


def misses(result: Calibration) -> int:
    """Return how many true values lie outside the 95% intervals."""
    intervals = result.intervals.intervals
    return sum(not intervals[name][0] <= getattr(TRUTH, name) <= intervals[name][1] for name in LEARNED)


def test_the_truth_of_simulated_rings_is_recovered_within_the_intervals():
    grid, missed = room(), 0
    for n_sensors in (8, 16, 24):
        result = calibrate(drawn_log(grid, ring(n_sensors), 360, n_sensors), grid, OPTIONS)
        assert result.converged
        assert result.candidates[0].chosen  # the truth has neither offset nor slope
        assert result.parameters.z_hit == pytest.approx(TRUTH.z_hit, abs=0.03)
        assert result.parameters.sigma_hit == pytest.approx(TRUTH.sigma_hit, rel=0.06)
        missed += misses(result)
        assert "cones" in {finding.name for finding in result.findings}
    # One of 18 is expected.
    assert missed <= 3


def test_taken_as_beams_the_same_readings_look_like_noise():
    grid = room()
    log = drawn_log(grid, ring(16), 200, 1)
    cones, beams = (calibrate(z, grid, OPTIONS) for z in (log, as_beams(log)))
    assert beams.parameters.z_hit < 0.5
    assert cones.scores[0].log_likelihood > beams.scores[0].log_likelihood + 0.5
    assert "cones" not in {finding.name for finding in beams.findings}


def test_without_a_map_cones_beat_beams_too():
    log = drawn_log(room(), ring(16), 500, 2)
    cones, beams = (
        calibrate(z, build_cross_fit_maps(z, resolution=0.1), replace(OPTIONS, unknown="free"))
        for z in (log, as_beams(log))
    )
    assert cones.scores[0].log_likelihood > beams.scores[0].log_likelihood + 0.3
    assert cones.parameters.z_hit > 0.5
    uniform = next(score for score in cones.scores if score.name == "uniform")
    assert uniform.behind_fit > 0.4


def test_a_cone_is_left_out_where_its_axis_enters_unknown_space():
    # A wall ahead, unknown cells beside the axis of the first cone and across that of the second.
    probability = np.zeros((40, 60), np.float32)
    probability[:, 50:] = 1.0
    probability[22:24, 20:22] = np.nan
    grid = OccupancyGrid(probability, 0.1)
    finder = RangeFinder([[0.0, 0.0, 0.0], [0.0, 0.25, 0.0]], 8.0, opening_angle=0.5)
    log = SensorLog(finder, [0.0], [[4.0, 4.0]], [[1.0, 2.05, 0.0]], np.full((1, 3), np.nan))
    table = build_beam_table(log, grid, [0])
    assert table.beam.tolist() == [0]
    assert table.expected_ranges == pytest.approx([4.0])
    assert table.n_unknown == 1
    assert build_beam_table(log, grid, [0], unknown="free").expected_ranges == pytest.approx([4.0, 4.0])
    # Here any unknown cell of the cone ends it.
    ended = build_beam_table(log, grid, [0], unknown="occupied").expected_ranges
    assert ended == pytest.approx([np.hypot(1.0, 0.15), 1.0])


def test_refinement_of_poses_uses_cones():
    grid = room()
    log = drawn_log(grid, ring(24), 80, 3)
    shifted = log.with_poses(log.poses + np.random.default_rng(4).normal(0.0, [0.06, 0.06, 0.0], log.poses.shape))
    result = calibrate(shifted, grid, replace(OPTIONS, refine=True))
    assert result.refinement is not None
    assert result.refinement.sigma_after < 0.95 * result.refinement.sigma_before
