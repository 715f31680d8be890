from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration import cross_fit
from beamfield.calibration.beam_table import BeamTable, build_beam_table
from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.cross_fit import build_cross_fit_maps, cross_fit_table
from beamfield.calibration.cross_fit_result import (
    cross_fit_findings,
    wall_variance,
    with_clutter,
    without_wall_error,
)
from beamfield.calibration.intrinsic.block_intervals import IntervalResult
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.drawn_walls import ranges_to_walls
from beamfield.maps.hit_counts import count_hits
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.log import simulate_log

TRUTH = BeamParameters(0.80, 0.10, 0.03, 0.07, 0.05, 0.6)
NONE = IntervalResult({}, {}, 0.95, 12, ())


@pytest.fixture(scope="module")
def maps(drive):
    return build_cross_fit_maps(drive)


@pytest.fixture(scope="module")
def tables(drive, maps):
    """The beams of all scans that meet walls, and those in clutter."""
    return cross_fit_table(drive, maps, np.ones(len(drive), bool))


def test_each_half_is_drawn_from_its_own_scans_alone(drive, maps):
    alone = count_hits(drive.select(maps.half == 0), np.ones(int((maps.half == 0).sum()), bool), 0.05).to_grid()
    np.testing.assert_array_equal(maps.halves[0].probability, alone.probability)
    np.testing.assert_array_equal(maps.halves[0].origin, alone.origin)
    assert maps.half.mean() == pytest.approx(0.5, abs=0.02)
    np.testing.assert_array_equal(maps.half[:12], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 0, 0])


def test_the_whole_map_is_drawn_from_all_scans(drive, maps):
    together = count_hits(drive, np.ones(len(drive), bool), 0.05).to_grid()
    np.testing.assert_array_equal(maps.whole.probability, together.probability)


def test_no_beam_is_judged_by_the_map_it_drew(drive, maps, tables):
    table, clutter = tables
    assert clutter is not None
    seen = {
        (half, drawn): ranges_to_walls(maps.counts[drawn], drive.poses[maps.half == half], drive.finder).expected
        for half in (0, 1)
        for drawn in (0, 1)
    }
    for part in (table, clutter):
        assert len(part) > 1000
        assert (np.diff(part.scan) >= 0).all()
        for half in (0, 1):
            mine = np.flatnonzero(maps.half == half)
            rows = maps.half[part.scan] == half
            scan, beam = np.searchsorted(mine, part.scan[rows]), part.beam[rows]
            other, own = seen[half, 1 - half][scan, beam], seen[half, half][scan, beam]
            np.testing.assert_array_equal(part.expected_ranges[rows], other)
            assert (own != other).mean() > 0.5


def test_which_beams_are_used_does_not_depend_on_what_they_read(drive, maps):
    """Readings of one half decide about beams of the other alone."""
    changed = drive.ranges.copy()
    changed[maps.half == 0] = np.random.default_rng(1).uniform(0.5, 9.0, changed[maps.half == 0].shape)
    scans = maps.half == 0
    before, after = (cross_fit_table(log, maps, scans)[0] for log in (drive, replace(drive, ranges=changed)))
    used = [set(zip(table.scan.tolist(), table.beam.tolist(), strict=True)) for table in (before, after)]
    measured = np.isfinite(drive.ranges) | np.isinf(drive.ranges)
    assert {(s, b) for s, b in used[1] if measured[s, b]} == used[0]


def test_beams_are_counted_once(drive, maps, tables):
    table, clutter = tables
    assert len(table) + table.n_no_measurement + table.n_unknown + table.n_unsure == drive.ranges.size
    assert 0 < len(clutter) < table.n_unsure
    (note,) = (f for f in cross_fit_findings(maps, table, len(clutter), TRUTH, NONE) if f.name == "cross-fitted-map")
    measured = drive.ranges.size - table.n_no_measurement
    assert note.values["share_known"] == pytest.approx(1.0 - table.n_unknown / measured)
    assert note.values["share_used"] == pytest.approx((len(table) + len(clutter)) / measured)
    assert f"{note.values['share_known']:.0%} of the beams stay within what the other half has seen" in note.text


def test_too_close_readings_are_not_counted_as_nan(drive):
    ranges = drive.ranges.copy()
    ranges[::7, ::5] = np.nan
    log = replace(drive, ranges=ranges, finder=replace(drive.finder, min_range=0.6))
    table, _ = cross_fit_table(log, build_cross_fit_maps(log), np.ones(len(log), bool))
    assert table.n_too_close == (ranges < 0.6).sum() > 0
    assert table.n_nan == np.isnan(ranges).sum()
    assert table.n_readings == ranges.size


def test_a_cell_seen_once_by_the_other_half_is_seen(monkeypatch):
    """A robot that turns in a square room: the second half has one scan, whose beams cross each cell hardly twice."""
    finder = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0)), 8.0)
    headings = np.radians(np.arange(0.0, 18.0))
    theta = headings[:, None] + finder.bearings
    with np.errstate(divide="ignore"):
        ranges = np.minimum(np.abs(2.0 / np.cos(theta)), np.abs(2.0 / np.sin(theta)))
    poses = np.column_stack([np.zeros(18), np.zeros(18), headings])
    poses[10:] = np.nan
    log = SensorLog(finder, np.arange(18.0), ranges, poses, np.full((18, 3), np.nan))
    monkeypatch.setattr(cross_fit, "GROUP_SCANS", 9)
    maps = build_cross_fit_maps(log)
    alone = np.arange(18) == 9
    np.testing.assert_array_equal(maps.counts[1].passes, count_hits(log, alone, 0.05).passes)
    assert maps.counts[1].passes.max() == 1.0
    first = np.arange(18) < 9
    for unknown_share in (
        cross_fit_table(log, maps, first)[0].n_unknown / ranges[first].size,
        build_beam_table(log, maps.halves[1], first).n_unknown / ranges[first].size,
    ):
        assert unknown_share < 0.02


def test_the_truth_lies_in_the_intervals_without_a_map(office, drive, truth):
    log = simulate_log(office, drive.finder, truth, duration=120.0, scan_rate=4.0, seed=6).only_sensor()
    result = calibrate(log, build_cross_fit_maps(log), CalibrationOptions(refine=False))
    for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short"):
        low, high = result.intervals.intervals[name]
        assert low <= getattr(truth, name) <= high, name
        assert low <= getattr(result.parameters, name) <= high, name
    assert result.parameters.sigma_hit == pytest.approx(truth.sigma_hit, rel=0.1)
    assert result.parameters.z_rand == pytest.approx(truth.z_rand, abs=0.015)
    assert result.parameters.weights == pytest.approx(truth.weights, abs=0.025)
    assert "cross-fitted-map" in [finding.name for finding in result.findings]
    assert all(score.behind_fit > 0 for score in result.scores[1:])


def test_weights_are_averaged_over_walls_and_clutter(rng):
    """Half as many beams in clutter, with other weights and three times the noise."""
    expected = rng.uniform(1.0, 6.0, 6000)
    there = BeamParameters(0.5, 0.2, 0.2, 0.1, 0.15, 0.6)
    stamps = np.repeat(np.arange(60.0), 100)
    zeros = np.zeros(6000, np.int32)
    clutter = BeamTable(sample_beams(expected, 10.0, there, rng), expected, zeros, zeros, stamps, 10.0)
    ends = {name: (value - 0.01, value + 0.01) for name, value in vars(TRUTH).items() if name.startswith("z_")}
    rate = {"lambda_short": (0.79, 0.81)}  # clutter's is near 0.6
    walls = replace(NONE, intervals={**ends, **rate}, standard_errors=dict.fromkeys(ends, 0.005))
    fit, intervals = with_clutter(TRUTH, walls, 12_000, clutter, CalibrationOptions())
    for name, (low, high) in ends.items():
        average = (2.0 * getattr(TRUTH, name) + getattr(there, name)) / 3.0
        assert getattr(fit, name) == pytest.approx(average, abs=0.01)
        assert intervals.intervals[name][0] <= min(low, average)
        assert intervals.intervals[name][1] >= max(high, average)
    assert (fit.sigma_hit, fit.lambda_short) == (TRUTH.sigma_hit, TRUTH.lambda_short)
    assert intervals.intervals["lambda_short"] == (pytest.approx(there.lambda_short, abs=0.15), 0.81)
    assert sum(fit.weights) == pytest.approx(1.0, abs=1e-12)
    few = with_clutter(TRUTH, walls, 12_000, clutter.select(np.arange(400)), CalibrationOptions())
    assert few == (TRUTH, walls)


def test_what_the_halves_walls_differ_by_is_taken_out_of_sigma():
    learned = replace(NONE, intervals={"sigma_hit": (0.045, 0.055)}, standard_errors={"sigma_hit": 0.003})
    fit, intervals = without_wall_error(TRUTH, learned, 0.0003)
    assert fit.sigma_hit == pytest.approx(np.sqrt(0.05**2 - 0.0003))
    assert intervals.intervals["sigma_hit"] == pytest.approx((np.sqrt(0.045**2 - 4.0 * 0.0003), 0.055))
    assert without_wall_error(TRUTH, NONE, 0.0003) == (TRUTH, NONE)  # held
    assert without_wall_error(TRUTH, learned, 1.0)[0].sigma_hit == pytest.approx(0.05 * np.sqrt(0.1))


def test_the_error_of_drawn_walls_grows_as_scans_get_fewer(drive, maps, tables):
    few = drive.select(np.arange(0, len(drive), 3))
    drawn = build_cross_fit_maps(few)
    table, _ = cross_fit_table(few, drawn, np.ones(len(few), bool))
    variances = [
        wall_variance(drive, maps, tables[0], TRUTH.sigma_hit),
        wall_variance(few, drawn, table, TRUTH.sigma_hit),
    ]
    assert 0.0 < variances[0] < variances[1] < 0.2 * TRUTH.sigma_hit**2


def test_much_uncertainty_is_a_warning(maps, tables):
    table, _ = tables
    wide = replace(NONE, intervals={"sigma_hit": (0.03, 0.055)})
    thin = replace(table, n_unknown=20 * len(table))
    names = [finding.name for finding in cross_fit_findings(maps, thin, 0, TRUTH, wide)]
    assert names == ["cross-fitted-map", "few-walls-drawn", "sigma-includes-map-error"]
    narrow = replace(NONE, intervals={"sigma_hit": (0.049, 0.051)})
    assert len(list(cross_fit_findings(maps, table, table.n_unsure, TRUTH, narrow))) == 1


def test_too_few_walls_do_not_raise_the_question_of_the_map(drive):
    few = drive.select(np.arange(40))
    with pytest.raises(TooLittleDataError, match="has not drawn exactly; give a map") as error:
        calibrate(few, build_cross_fit_maps(few), CalibrationOptions(refine=False))
    assert "is it the map of this place" not in str(error.value)


def test_a_log_without_poses_cannot_draw_a_map(drive):
    blind = replace(drive, poses=np.full((len(drive), 3), np.nan))
    with pytest.raises(InvalidInputError, match="no map can be drawn"):
        build_cross_fit_maps(blind)


def test_too_few_scans_for_two_maps(drive):
    with pytest.raises(TooLittleDataError, match="9 scans; two maps need at least 10"):
        build_cross_fit_maps(drive.select(np.arange(9)))
