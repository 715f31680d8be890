"""Unknown space: what is wrong with the constant of 6.4.2, and that distances continued through it are not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan

PARAMETERS = LikelihoodFieldParameters(z_hit=0.7, z_rand=0.2, sigma_hit=0.2)
MAX_RANGE = 10.0
RESOLUTION = 0.05


def corridor(behind):
    """A corridor along y, 4 m wide, 10 m long; its walls are one cell thick. Behind the right wall lies `behind`."""
    data = np.zeros((200, 300))
    data[:, [20, 101]] = 100
    data[:, 102:] = behind
    return OccupancyGrid.from_ros(data, RESOLUTION)


def best_offset(model):
    """Where along x the scan of the right wall fits best, relative to the truth: 2 m before the wall's centre.

    The noise is that of the model, by its quantiles, so that the answer is no matter of chance.
    """
    noise = stats.norm.ppf((np.arange(400) + 0.5) / 400, scale=PARAMETERS.sigma_hit)
    scan = Scan(2.0 + noise, RangeFinder.from_bearings(np.zeros(400), MAX_RANGE))
    wall = 101.5 * RESOLUTION
    offsets = np.linspace(-0.4, 0.4, 161)
    poses = np.column_stack([wall - 2.0 + offsets, np.full(161, 5.0), np.zeros(161)])
    return offsets[np.argmax(model.log_likelihood(scan, poses))]


@pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
def test_the_books_constant_moves_poses_off_a_wall_before_the_unknown(interpolation):
    model = LikelihoodFieldModel(corridor(-1), PARAMETERS, unknown="uniform", interpolation=interpolation)
    assert best_offset(model) < -0.5 * PARAMETERS.sigma_hit


@pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
def test_continued_distances_leave_poses_where_they_are(interpolation):
    model = LikelihoodFieldModel(corridor(-1), PARAMETERS, interpolation=interpolation)
    assert abs(best_offset(model)) <= 0.5 * RESOLUTION
    known = LikelihoodFieldModel(corridor(0), PARAMETERS, interpolation=interpolation)
    assert best_offset(model) == best_offset(known)


def test_the_same_holds_for_a_wall_on_the_edge_of_the_map():
    data = np.zeros((200, 102))
    data[:, 101] = 100
    grid = OccupancyGrid.from_ros(data, RESOLUTION)
    continued = LikelihoodFieldModel(grid, PARAMETERS)
    assert abs(best_offset(continued)) <= 0.5 * RESOLUTION
    assert best_offset(LikelihoodFieldModel(grid, PARAMETERS, off_map="far")) < -0.5 * PARAMETERS.sigma_hit
    assert best_offset(LikelihoodFieldModel(grid, PARAMETERS, unknown="uniform")) < -0.5 * PARAMETERS.sigma_hit


def scores_without_information(model):
    """Score of a scan far from every obstacle: in free space, and in unknown space."""
    scan = Scan([1.0, 1.0, 1.0], RangeFinder.from_bearings([0.0, 2.0, 4.0], MAX_RANGE))
    return model.log_likelihood(scan, [[2.5, 5.0, 0.0], [12.0, 5.0, 0.0]])


def test_the_books_constant_draws_poses_into_the_unknown():
    """In both places nothing of the map is near the readings; the unknown one wins by log(1 / z_rand) a beam."""
    wide = LikelihoodFieldParameters(z_hit=0.7, z_rand=0.2, sigma_hit=0.05)
    in_free, in_unknown = scores_without_information(LikelihoodFieldModel(corridor(-1), wide, unknown="uniform"))
    assert in_unknown - in_free == pytest.approx(3 * math.log(1 / 0.2), abs=1e-6)


def test_continued_distances_draw_poses_nowhere():
    in_free, in_unknown = scores_without_information(
        LikelihoodFieldModel(corridor(-1), LikelihoodFieldParameters(z_hit=0.7, z_rand=0.2, sigma_hit=0.05))
    )
    assert in_unknown == in_free


def test_a_scan_of_the_right_wall_fits_no_better_through_it():
    """A scan that sees the wall 2 m ahead scores highest where it does, not 1 m on with its end points in the unknown.

    With z_hit small, the book's constant prefers the unknown even to the truth.
    """
    timid = LikelihoodFieldParameters(z_hit=0.05, z_rand=0.2, sigma_hit=0.3)
    noise = stats.norm.ppf((np.arange(50) + 0.5) / 50, scale=0.3)
    scan = Scan(2.0 + noise, RangeFinder.from_bearings(np.zeros(50), MAX_RANGE))
    wall = 101.5 * RESOLUTION
    poses = [[wall - 2.0, 5.0, 0.0], [wall + 1.0, 5.0, 0.0]]
    book = LikelihoodFieldModel(corridor(-1), timid, unknown="uniform").log_likelihood(scan, poses)
    ours = LikelihoodFieldModel(corridor(-1), timid).log_likelihood(scan, poses)
    assert book[1] > book[0]
    assert ours[0] > ours[1]
