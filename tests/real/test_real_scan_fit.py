"""Scan fit on real logs: one log's reference judges another, wrong poses are found, expectations carry over."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.time_split import time_blocks
from beamfield.io.read_map import read_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.scan_fit.reference import ScanFitReference, calibrate_scan_fit
from beamfield.scan_fit.scan_fit import judge_log
from beamfield.scan_fit.wrong_poses import wrong_poses
from tests.real.posed_logs import turtlebot_log, wean_log

pytestmark = pytest.mark.real
OPTIONS = CalibrationOptions(refine=False)
MAX_RANGE = 81.83


@pytest.fixture(scope="module")
def wean(data: Path) -> tuple[OccupancyGrid, BeamModel, ScanFitReference]:
    grid = read_map(data / "wean_hall/derived_wean.yaml")
    log = wean_log(data, 1, max_range=MAX_RANGE)
    model = BeamModel(grid, calibrate(log, grid, OPTIONS).parameters)
    return grid, model, calibrate_scan_fit(model, log)


def test_another_run_fits_as_well_as_the_first(data: Path, wean):
    _, model, reference = wean
    fits = judge_log(model, wean_log(data, 3, max_range=MAX_RANGE), reference)
    assert fits.share_that_fits() > 0.93
    assert fits.longest_lost() is None


def test_wrong_poses_at_wean_hall_are_found(data: Path, wean):
    grid, model, reference = wean
    log = wean_log(data, 3, max_range=MAX_RANGE)
    poses = wrong_poses(log.poses, time_blocks(log.stamps, 10.0), grid, np.random.default_rng(1))
    fits = judge_log(model, log.with_poses(poses), reference)
    judged = ~np.isnan(fits.p_value)
    assert (fits.p_value[judged] <= 0.05).mean() > 0.75
    assert np.median(fits.lost[judged]) > 0.95


def test_the_lost_probability_is_reliable_at_wean_hall(wean):
    _, _, reference = wean
    assert sum(row.n for row in reference.reliability) > 3000
    for row in reference.reliability:
        if row.n >= 200:
            assert row.observed == pytest.approx(row.predicted, abs=0.2), row


def test_the_turtlebot_is_found_lost_only_when_it_is(data: Path):
    log = turtlebot_log(data)
    grid = read_map(data / "olin_mac_tb4/map/mac_1st_floor_final.yaml")
    first, second = log.select(np.arange(170)), log.select(np.arange(170, len(log)))
    model = BeamModel(grid, calibrate(first, grid, replace(OPTIONS, block_s=2.0)).parameters)
    reference = calibrate_scan_fit(model, first)
    assert judge_log(model, second, reference).longest_lost() is None
    poses = wrong_poses(second.poses, np.zeros(len(second), int), grid, np.random.default_rng(4))
    fits = judge_log(model, second.with_poses(poses), reference)
    assert (fits.p_value <= 0.05).all()
    assert fits.lost[-1] > 0.9
