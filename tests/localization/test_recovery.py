"""When poses are drawn anew, and from where."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import logsumexp

from beamfield.detections import SPURIOUS, Detections
from beamfield.errors import InvalidInputError
from beamfield.geometry import wrap_angle
from beamfield.localization.recovery import (
    FreePoses,
    LikelihoodAverages,
    PosesFromLandmarks,
    PosesFromScan,
    Recovery,
    reweigh,
)
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan


def test_the_share_is_that_of_the_table():
    """Table 8.3, transcribed: the averages start with the first measurement."""
    recovery = Recovery(alpha_slow=0.05, alpha_fast=0.3, readings=4.0, most=1.0)
    averages = LikelihoodAverages(recovery)
    slow = fast = None
    for log_likelihood in [-3.0, -2.0, -8.0, -30.0, -math.inf, -1.0, 5.0, 5.0]:
        w = math.exp(log_likelihood / 4.0)
        slow, fast = (w, w) if slow is None else (slow + 0.05 * (w - slow), fast + 0.3 * (w - fast))
        averages.add(log_likelihood)
        assert averages.share == pytest.approx(max(0.0, 1.0 - fast / slow), abs=1e-12)


def test_the_share_has_a_bound_and_takes_no_harm_from_extremes():
    averages = LikelihoodAverages(Recovery(most=0.25))
    for value in (-math.inf, -math.inf):
        averages.add(value)
        assert averages.share == 0.0
    averages.add(5000.0)
    assert averages.share == 0.0
    averages.add(-5000.0)
    assert averages.share == pytest.approx(1.0 - 0.9 / 0.995)
    for _ in range(20):
        averages.add(-math.inf)
    assert averages.share == 0.25
    # The fast average can be the last measurement alone.
    averages = LikelihoodAverages(Recovery(alpha_fast=1.0, most=0.25))
    for value in (-1.0, -5000.0, -math.inf):
        averages.add(value)
    assert averages.share == 0.25


@pytest.mark.parametrize(("scale", "least_share"), [(8.0, 0.5), (200.0, 0.1), (1e9, 0.1), (1.0, 0.5), (8.0, 0.0)])
def test_a_likelihood_is_flattened_until_a_share_of_the_effective_number_is_left(scale, least_share):
    rng = np.random.default_rng(1)
    before, log_likelihood = rng.dirichlet(np.full(500, 0.3)), scale * rng.normal(size=500)
    out, log_mean, effective, power = reweigh(before, log_likelihood, least_share)
    assert log_mean == pytest.approx(logsumexp(log_likelihood, b=before))
    wanted = before * np.exp(power * (log_likelihood - log_likelihood.max()))
    np.testing.assert_allclose(out, wanted / wanted.sum(), rtol=1e-9, atol=1e-300)
    assert effective == pytest.approx(1.0 / np.square(out).sum())
    share = effective * np.square(before).sum()
    assert share >= least_share
    assert power == 1.0 or (share == pytest.approx(least_share, rel=0.02) and power < 1.0)
    assert (power < 1.0) is (scale > 1.0 and least_share > 0.0)


def test_where_few_are_possible_these_are_told_apart():
    log_likelihood = np.full(2000, -np.inf)
    log_likelihood[:30] = np.linspace(0.0, 10.0, 30)
    out, _, _, power = reweigh(np.full(2000, 1.0 / 2000), log_likelihood, 0.02)
    assert power == 1.0
    assert out[29] / out[0] == pytest.approx(np.exp(10.0))


def test_where_only_particles_of_tiny_weight_are_possible_these_are_told_apart():
    out, *others = reweigh(np.array([1.0, 1e-200, 3e-200]), np.array([-np.inf, 0.0, 0.0]), 0.5)
    assert others == pytest.approx([math.log(4e-200), 1.6, 1.0])
    assert out == pytest.approx([0.0, 0.25, 0.75])


def test_weights_are_left_alone_by_what_is_impossible_everywhere():
    out, log_mean, _, _ = reweigh(np.array([0.25, 0.75]), np.full(2, -np.inf), 0.0)
    assert (out.tolist(), log_mean) == ([0.25, 0.75], -np.inf)


@pytest.fixture(scope="module")
def room() -> OccupancyGrid:
    cells = np.zeros((60, 90))
    cells[[0, -1]] = cells[:, [0, -1]] = cells[:30, 35] = cells[40, 50:80] = 1.0
    return OccupancyGrid(cells, 0.1, np.array([1.0, -2.0, 0.0]))


def test_poses_from_a_scan_lie_where_it_was_taken(room):
    finder = RangeFinder.from_bearings(np.linspace(-2.5, 2.5, 60), 12.0)
    truth = np.array([6.2, 0.4, 2.0])
    scan = Scan(RayCaster(room).expected_ranges(truth, finder), finder)
    model = LikelihoodFieldModel(room, LikelihoodFieldParameters(0.8, 0.1, 0.2), exponent=0.5)
    poses = PosesFromScan(room, model, n_candidates=20_000).draw(scan, 500, np.random.default_rng(0))
    assert poses.shape == (500, 3)
    assert room.look_up(room.free, poses[:, :2]).all()
    near = np.hypot(*(poses[:, :2] - truth[:2]).T) < 0.5
    # A grid of candidates 0.06 m^2 x 2 pi apart: some lie elsewhere, as all but one in 60 would by chance.
    assert near.mean() > 0.6
    assert len(np.unique(poses, axis=0)) > 10


def test_an_impossible_scan_says_nothing_of_the_pose(room):
    class Never:
        is_normalized = False

        def log_likelihood(self, z, poses):  # noqa: ARG002
            return np.full(len(poses), -np.inf)

    finder = RangeFinder.from_bearings([0.0], 12.0)
    poses = PosesFromScan(room, Never(), n_candidates=2000).draw(Scan([1.0], finder), 1000, np.random.default_rng(0))
    assert np.ptp(poses[:, 0]) > 7.0
    assert np.ptp(poses[:, 2]) > 6.0


def test_poses_from_landmarks_lie_on_the_ring_around_one_or_are_none(room):
    model = LandmarkModel(
        LandmarkMap([[5.0, 1.0]]), LandmarkParameters(sigma_range=0.05, sigma_bearing=0.02), correspondence="known"
    )
    source = PosesFromLandmarks(model, room)
    rng = np.random.default_rng(0)
    poses = source.draw(Detections([1.5], [0.2], ids=[1]), 200, rng)
    assert np.hypot(poses[:, 0] - 5.0, poses[:, 1] - 1.0) == pytest.approx(np.full(200, 1.5), abs=0.25)
    assert len(source.draw(Detections([], []), 10, rng)) == 0
    assert len(source.draw(Detections([500.0], [0.0], ids=[1]), 10, rng)) == 0


LANDMARKS = np.array([[5.0, 1.0], [0.0, 4.0], [-3.0, -2.0]])
TRUTH = np.array([1.0, 0.5, 0.7])
OFF = LANDMARKS - TRUTH[:2]
RANGES, BEARINGS = np.hypot(OFF[:, 0], OFF[:, 1]), wrap_angle(np.arctan2(OFF[:, 1], OFF[:, 0]) - TRUTH[2])


def test_a_few_poses_from_several_landmarks_fit_all_of_them():
    parameters = LandmarkParameters(sigma_range=0.1, sigma_bearing=0.05)
    source = PosesFromLandmarks(LandmarkModel(LandmarkMap(LANDMARKS), parameters, correspondence="known"))
    seen = Detections(RANGES, BEARINGS, ids=[1, 2, 3])
    rng = np.random.default_rng(0)
    poses = np.concatenate([source.draw(seen, 3, rng) for _ in range(20)])
    # The posterior's standard deviation is 0.08 m.
    assert np.hypot(*(poses[:, :2] - TRUTH[:2]).T).max() < 0.4


@pytest.mark.parametrize("max_range", [None, 10.0])
def test_features_that_do_not_bound_the_pose_are_left_out(max_range):
    parameters = LandmarkParameters(sigma_range=0.1, sigma_bearing=0.05, max_range=max_range)
    source = PosesFromLandmarks(LandmarkModel(LandmarkMap(LANDMARKS), parameters, correspondence="known"))
    ranges, bearings = [RANGES[0], 3.0, np.nan, np.nan], [BEARINGS[0], 0.0, np.nan, BEARINGS[1]]
    ids = [1, SPURIOUS, 2, 2]
    poses = source.draw(Detections(ranges, bearings, ids=ids), 50, np.random.default_rng(0))
    from_first = np.hypot(poses[:, 0] - 5.0, poses[:, 1] - 1.0)
    assert from_first == pytest.approx(np.full(50, RANGES[0]), abs=0.5)
    # With max_range, the bearing of the second tells where on the ring.
    assert bool(np.hypot(*(poses[:, :2] - TRUTH[:2]).T).max() < 1.0) is (max_range is not None)
    assert source.draw(Detections(ranges[1:3], bearings[1:3], ids=ids[1:3]), 5, np.random.default_rng(0)).shape == (
        0,
        3,
    )


@pytest.mark.parametrize(
    "numbers",
    [
        {"alpha_slow": 0.0},
        {"alpha_fast": 1.5},
        {"alpha_slow": 0.3, "alpha_fast": 0.2},
        {"alpha_slow": 0.2, "alpha_fast": 0.2},
        {"readings": 0.0},
        {"most": 0.0},
    ],
)
def test_shares_out_of_range_are_refused(numbers):
    with pytest.raises(InvalidInputError, match="|".join(numbers)):
        Recovery(**numbers)


def test_a_map_without_room_and_too_few_candidates_are_refused(room):
    solid = OccupancyGrid(np.ones((4, 4)), 0.1)
    model = LikelihoodFieldModel(room, LikelihoodFieldParameters(0.8, 0.1, 0.2))
    with pytest.raises(InvalidInputError, match="no free cell"):
        FreePoses(solid)
    with pytest.raises(InvalidInputError, match="no free cell"):
        PosesFromScan(solid, model)
    with pytest.raises(InvalidInputError, match="n_candidates"):
        PosesFromScan(room, model, n_candidates=10)
