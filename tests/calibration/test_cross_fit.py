from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration.beam_table import build_beam_table
from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.cross_fit import build_cross_fit_maps, cross_fit_table
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.mapping import build_map


@pytest.fixture(scope="module")
def maps(drive):
    return build_cross_fit_maps(drive)


def test_each_half_is_drawn_from_its_own_scans_alone(drive, maps):
    first = build_map(drive, scans=maps.half == 0)
    np.testing.assert_array_equal(maps.halves[0].probability, first.probability)
    assert maps.half.mean() == pytest.approx(0.5, abs=0.02)
    np.testing.assert_array_equal(maps.half[:12], [0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 0, 0])


def test_no_beam_is_judged_by_the_map_it_drew(drive, maps):
    scans = np.ones(len(drive), bool)
    table = cross_fit_table(drive, maps, scans)
    assert (np.diff(table.scan) >= 0).all()
    other = build_beam_table(drive, maps.halves[1], maps.half == 0)
    rows = maps.half[table.scan] == 0
    np.testing.assert_array_equal(table.expected_ranges[rows], other.expected_ranges)
    np.testing.assert_array_equal(table.beam[rows], other.beam)
    own = build_beam_table(drive, maps.halves[0], maps.half == 0)
    error = [np.median(np.abs(t.ranges - t.expected_ranges)) for t in (table, own)]
    assert error[1] < error[0]  # what a beam drew itself flatters it


def test_a_log_without_a_map_gives_the_sensors_noise(drive, maps, truth):
    result = calibrate(drive, maps, CalibrationOptions(n_bootstrap=40))
    (finding,) = [f for f in result.findings if f.name == "cross-fitted-map"]
    # Beams are 3 degrees apart here: many pass between the cells that the other half has seen.
    assert 0.1 < finding.values["share_known"] < 1.0
    # Drawn walls are blurred by the sensor's own noise and stand at cells of 5 cm.
    assert truth.sigma_hit < result.parameters.sigma_hit < 2.0 * truth.sigma_hit
    assert result.parameters.z_max == pytest.approx(truth.z_max, abs=0.01)
    assert all(score.behind_fit > 0 for score in result.scores[1:])


def test_a_log_without_poses_cannot_draw_a_map(drive):
    blind = replace(drive, poses=np.full((len(drive), 3), np.nan))
    with pytest.raises(InvalidInputError, match="no map can be drawn"):
        build_cross_fit_maps(blind)


def test_too_few_scans_for_two_maps(drive):
    with pytest.raises(TooLittleDataError, match="9 scans; two maps need at least 10"):
        build_cross_fit_maps(drive.select(np.arange(9)))
    with pytest.raises(InvalidInputError, match="group_scans"):
        build_cross_fit_maps(drive, group_scans=0)
