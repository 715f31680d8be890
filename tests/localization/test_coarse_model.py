"""What scans say of a robot that can be anywhere: a coarse field, less what beams through walls cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.localization import coarse_model
from beamfield.localization.coarse_model import CoarseModel
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan

# A wall of 4 cells all around, 1 m from the robot, in a field of free cells.
FINDER = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 10, endpoint=False), max_range=8.0)
CELLS = np.zeros((200, 200))
CELLS[75:79, 75:125] = CELLS[121:125, 75:125] = CELLS[75:125, 75:79] = CELLS[75:125, 121:125] = 1.0
GRID = OccupancyGrid(CELLS, 0.05, (-5.0, -5.0, 0.0))
MIDDLE = np.zeros(3)


def cost_of(n_through: int, *, n_beams: int = 10) -> float:
    """Return what a scan in the middle has less than by the field alone, the first beams through the wall."""
    model = CoarseModel(GRID, n_beams)
    ranges = np.where(np.arange(10) < n_through, 3.0, 0.5)
    scan = Scan(ranges, FINDER)
    exponent = min(1.0, coarse_model.WORTH / n_beams)
    ends = LikelihoodFieldModel(GRID, coarse_model.PARAMETERS, n_beams=n_beams, exponent=exponent)
    return float(ends.log_likelihood(scan, MIDDLE) - model.log_likelihood(scan, MIDDLE))


@pytest.mark.parametrize(("n_through", "cost"), [(0, 0.0), (4, 0.0), (5, 0.0), (6, 1.8), (10, 9.0)])
def test_more_than_half_of_the_beams_through_walls_cost_nats(n_through, cost):
    assert cost_of(n_through) == pytest.approx(cost, abs=1e-9)


def test_beams_that_the_model_leaves_out_do_not_count():
    # Of five, equally spaced, the first two pass the wall; of one, it does.
    assert cost_of(3, n_beams=5) == pytest.approx(0.0, abs=1e-9)
    assert cost_of(1, n_beams=1) == pytest.approx(9.0)
    with pytest.raises(InvalidInputError, match="n_beams"):
        CoarseModel(GRID, 0)


def test_readings_that_are_too_short_and_beams_without_measurement_cost_nothing():
    model = CoarseModel(GRID, 10)
    short, none = Scan(np.full(10, 0.3), FINDER), Scan(np.full(10, np.nan), FINDER)
    away = np.array([4.0, 4.0, 0.0])
    assert model.log_likelihood(none, MIDDLE) == 0.0
    ends = LikelihoodFieldModel(GRID, coarse_model.PARAMETERS, n_beams=10, exponent=coarse_model.WORTH / 10)
    for pose in (MIDDLE, away):
        assert model.log_likelihood(short, pose) == pytest.approx(float(ends.log_likelihood(short, pose)))


def test_a_scan_counts_as_much_however_few_its_beams_are():
    scan = Scan(np.full(10, 0.9), FINDER)
    assert CoarseModel(GRID).log_likelihood(scan, MIDDLE) == CoarseModel(GRID, 10).log_likelihood(scan, MIDDLE)


def test_cones_of_a_sonar_that_miss_walls_cost_nothing():
    sonar = replace(FINDER, opening_angle=0.3)
    missed = Scan(np.full(10, np.inf), sonar)
    assert CoarseModel(GRID).log_likelihood(missed, MIDDLE) == 0.0
    assert CoarseModel(GRID).log_likelihood(Scan(missed.ranges, FINDER), MIDDLE) == pytest.approx(-9.0)


def test_many_poses_are_weighed_in_batches_as_one_by_one(rng, monkeypatch):
    model = CoarseModel(GRID, 10)
    scan = Scan(np.where(np.arange(10) < 8, 3.0, 0.9), FINDER)
    poses = np.column_stack([rng.uniform(-4.0, 4.0, (50, 2)), rng.uniform(-3.0, 3.0, 50)]).reshape(5, 10, 3)
    whole = model.log_likelihood(scan, poses)
    monkeypatch.setattr(coarse_model, "BATCH", 7)
    assert model.log_likelihood(scan, poses).tolist() == whole.tolist()
