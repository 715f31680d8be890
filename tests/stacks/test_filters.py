"""The stacks' filters: bins, limits, draws and the loop, against slow transcriptions and by their consequences."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.stats import kstest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import compose, invert, wrap_angle
from beamfield.localization.replay import PoseBelief
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.stacks.beluga.models import BelugaField, BelugaFieldProb
from beamfield.stacks.emulation.emulator import FieldModel
from beamfield.stacks.filters import amcl_filter
from beamfield.stacks.filters.amcl_filter import BINS, AmclFilterParameters, as_wrapped_rotations
from beamfield.stacks.filters.histogram import Histogram, kld_limits
from beamfield.stacks.filters.particles import (
    at_points,
    draw_by_weight,
    particle_moments,
    reweighed,
    uniform_poses,
)
from beamfield.stacks.filters.recovery import WeightAverages
from beamfield.stacks.filters.scan_weights import ScanWeights
from beamfield.stacks.mrpt.field import MrptField
from beamfield.stacks.nav2.models import Nav2Field, Nav2FieldProb
from beamfield.stacks.nav2.motion import Nav2Motion
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.registry import build_filter
from beamfield.stacks.ros1.filter import Ros1FilterParameters
from beamfield.stacks.ros1.motion import Ros1Motion
from tests.stacks.small_room import small_room, small_scan
from tests.stacks.test_emulators_contract import BELUGA, MRPT_FIELD, NAV2

FIELDS = {
    "nav2": (Nav2Field, NAV2), "nav2 prob": (Nav2FieldProb, NAV2), "beluga": (BelugaField, BELUGA),
    "beluga prob": (BelugaFieldProb, BELUGA), "mrpt": (MrptField, MRPT_FIELD),
}  # fmt: skip
START = PoseBelief.around([1.0, 1.0, 0.3], sd_position=0.1, sd_heading=0.1)


def drive(n: int = 40, step: float = 0.1) -> SensorLog:
    """Return a log that drives straight on in odometry, with scans that are all the same."""
    scan = small_scan()
    odometry = np.column_stack([step * np.arange(n), np.zeros(n), np.zeros(n)])
    poses = compose(START.mean, odometry)
    return SensorLog(scan.finder, np.arange(float(n)), np.tile(scan.ranges, (n, 1)), poses, odometry)


def nav2_filter(**changes):
    return build_filter("nav2", Nav2Field(small_room(), NAV2), parameters=AmclFilterParameters(**changes))


def limit_by_hand(k: int, error: float, z: float) -> float:
    """Fox's formula, one number at a time."""
    b = 2.0 / (9.0 * (k - 1))
    return math.ceil((k - 1) / (2.0 * error) * (1.0 - b + math.sqrt(b) * z) ** 3)


def test_limits_are_those_of_foxs_formula():
    limits = kld_limits(50, 0.05, 0.99)
    assert limits[0] == np.inf
    assert limits[1:].tolist() == [limit_by_hand(k, 0.05, 0.99) for k in range(2, 51)]


# Maps may lie far from their frame's origin, as in UTM coordinates.
@pytest.mark.parametrize("centre", [(0.0, 0.0), (5e5, 5.4e6)])
@pytest.mark.parametrize("spread", [0.2, 2.0])
def test_particles_are_enough_where_a_loop_over_them_says_so(rng, spread, centre):
    poses = rng.normal((*centre, 0.0), spread, (1500, 3))
    limits = np.clip(kld_limits(1500, 0.05, 0.99), 100, 1500)
    bins: set[tuple[int, ...]] = set()
    enough = len(poses)
    for i, pose in enumerate(poses, 1):
        bins.add(tuple(math.floor(value / side) for value, side in zip(pose, BINS, strict=True)))
        if i > limits[len(bins) - 1]:
            enough = i
            break
    found = Histogram(poses, BINS, limits)
    assert (found.n_particles, found.n_bins, found.is_enough) == (enough, len(bins), enough < len(poses))


def test_clusters_are_the_connected_bins_of_an_image(rng):
    poses = np.concatenate([rng.normal(centre, 0.4, (80, 3)) for centre in ((0, 0, 0), (4, 0, 0), (0, 0, 2.5))])
    cells = np.floor(poses / np.array(BINS)).astype(int)
    image = np.zeros(np.ptp(cells, axis=0) + 1, bool)
    image[tuple((cells - cells.min(axis=0)).T)] = True
    labels, count = ndimage.label(image, np.ones((3, 3, 3)))
    expected = labels[tuple((cells - cells.min(axis=0)).T)]
    found = Histogram(poses, BINS).clusters()
    assert len(set(found)) == count > 2
    assert len(set(zip(found.tolist(), expected.tolist(), strict=True))) == count


def test_headings_that_differ_by_a_full_turn_are_of_different_clusters():
    poses = np.array([[0.1, 0.1, 0.01], [0.1, 0.1, 0.01 + 2.0 * np.pi]])
    assert Histogram(poses, BINS).clusters().tolist() == [0, 1]


def test_weights_beyond_the_largest_double_count_by_their_ratio():
    weights, total = reweighed(np.array([0.5, 0.25, 0.25]), np.log([1.0, 2.0, 4.0]) + 900.0)
    assert weights.tolist() == pytest.approx([0.25, 0.25, 0.5])
    assert total == np.inf
    assert reweighed(np.array([0.5, 0.5]), np.array([-np.inf, -np.inf]))[0].tolist() == [0.5, 0.5]


def test_draws_follow_the_weights(rng):
    weights = np.array([0.0, 0.5, 0.2, 0.3])
    counts = np.bincount(draw_by_weight(weights, 40_000, rng), minlength=4) / 40_000
    assert counts[0] == 0.0
    np.testing.assert_allclose(counts, weights, atol=0.01)


@pytest.mark.parametrize("weights", [np.ones(1), np.ones(7), np.r_[1.0, np.zeros(500)], np.r_[np.zeros(500), 1.0],
                                     np.exp(-np.arange(900.0))])  # fmt: skip
def test_points_are_found_as_bisection_finds_them(rng, weights):
    sums = np.cumsum(weights / weights.sum())
    points = np.r_[rng.random(2000), 0.0, np.nextafter(1.0, 0.0)]
    expected = np.minimum(np.searchsorted(sums, points * sums[-1], side="right"), len(weights) - 1)
    assert at_points(weights / weights.sum(), points).tolist() == expected.tolist()


def test_random_poses_are_on_free_cells_only(rng):
    grid = small_room()
    poses = uniform_poses(grid, 500, rng)
    assert grid.look_up(grid.free, poses[:, :2]).all()
    assert kstest(poses[:, 2], "uniform", args=(-np.pi, 2.0 * np.pi)).pvalue > 1e-3


def test_mean_and_covariance_are_those_of_a_sample_with_headings_across_pi(rng):
    poses = rng.normal([1.0, 2.0, 0.0], [0.5, 0.2, 0.3], (5000, 3))
    poses[:, 2] += 0.3 * poses[:, 0]
    weights = np.full(5000, 1.0 / 5000)
    turned = poses + np.array([0.0, 0.0, np.pi])
    mean, covariance = particle_moments(turned, weights)
    assert float(wrap_angle(mean[2] - np.pi - poses[:, 2].mean())) == pytest.approx(0.0, abs=0.01)
    np.testing.assert_allclose(covariance, np.cov(poses.T), atol=2e-3)


def test_random_poses_come_in_when_the_fast_average_falls_below_the_slow_one():
    averages = WeightAverages(0.01, 0.5)
    averages.add(1.0)
    assert averages.random_share() == 0.0
    averages.add(0.2)
    assert averages.random_share() == pytest.approx(1.0 - 0.6 / 0.992)
    averages.reset()
    assert averages.random_share() == 0.0


@pytest.mark.parametrize("name", FIELDS)
def test_weights_looked_up_by_cell_are_those_of_the_model(name, rng):
    kind, parameters = FIELDS[name]
    model = kind(small_room(), parameters)
    poses = np.array([0.5, 1.2, 0.0]) + rng.normal(0.0, [0.8, 0.7, 2.0], (200, 3))
    scan = small_scan(special=True)
    np.testing.assert_allclose(ScanWeights(model)(scan, poses), model.log_likelihood(scan, poses), rtol=1e-12)


def test_filters_share_what_the_cells_of_a_map_add(monkeypatch):
    made, model, scan, poses = [], Nav2Field(small_room(), Nav2Parameters()), small_scan(), np.array([[1.0, 1.0, 0.3]])
    of_cells = FieldModel._cell_terms
    monkeypatch.setattr(FieldModel, "_cell_terms", lambda self, most: made.append(self) or of_cells(self, most))
    before = ScanWeights(model)(scan, poses)
    assert ScanWeights(model)(scan, poses) == before
    assert made == [model]
    # Other parameters have terms of their own; other processes make theirs.
    other = model.with_parameters(replace(model.parameters, z_hit=0.9))
    assert ScanWeights(other)(scan, poses) == other.log_likelihood(scan, poses) != before
    assert len(pickle.dumps(model)) == len(pickle.dumps(Nav2Field(small_room(), Nav2Parameters())))


def test_beams_are_skipped_only_once_the_filter_has_converged(rng):
    parameters = Nav2Parameters(laser_model_type="likelihood_field_prob", do_beamskip=True, beam_skip_threshold=0.9,
                                beam_skip_distance=0.05, max_beams=30)  # fmt: skip
    model = Nav2FieldProb(small_room(), parameters)
    poses = np.array([1.0, 1.0, 0.0]) + rng.normal(0.0, 0.1, (50, 3))
    weights, scan = ScanWeights(model), small_scan()
    assert (weights(scan, poses, converged=True) == model.log_likelihood(scan, poses)).all()
    assert (weights(scan, poses, converged=False) != model.log_likelihood(scan, poses)).any()


def test_the_filter_updates_at_the_first_scan_and_after_enough_motion_in_x_or_y_or_heading():
    replay = nav2_filter(update_min_d=0.25).run(drive(), START, np.random.default_rng(1))
    assert replay.updates.tolist() == list(range(0, 40, 3))  # at 0.3 m, which is more than 0.25
    diagonal = drive(40, 0.1)
    turned = compose([0.0, 0.0, np.pi / 4], diagonal.odometry)  # 0.07 m in x and in y
    log = SensorLog(diagonal.finder, diagonal.stamps, diagonal.ranges, diagonal.poses, turned)
    replay = nav2_filter(update_min_d=0.25).run(log, START, np.random.default_rng(1))
    assert replay.updates.tolist() == list(range(0, 40, 4))


def test_between_updates_the_answer_goes_on_with_the_odometry():
    log = drive()
    replay = nav2_filter().run(log, START, np.random.default_rng(1))
    assert np.isfinite(replay.poses).all()
    for first, last in zip(replay.updates, [*replay.updates[1:], len(log)], strict=True):
        anchors = compose(replay.poses[first:last], invert(log.odometry[first:last]))
        np.testing.assert_allclose(anchors - anchors[0], 0.0, atol=1e-9)


def test_the_same_seed_gives_the_same_run_and_another_seed_another():
    runs = [nav2_filter().run(drive(10), START, np.random.default_rng(seed)) for seed in (3, 3, 4)]
    assert (runs[0].poses == runs[1].poses).all()
    assert (runs[0].poses != runs[2].poses).any()


def test_looking_up_few_particles_first_changes_nothing(monkeypatch):
    start = PoseBelief.around(START.mean, sd_position=0.01, sd_heading=0.01)
    run = nav2_filter(min_particles=20, max_particles=1000).run
    first = run(drive(), start, np.random.default_rng(0))
    assert max(np.diff(first.particles)) > amcl_filter.MARGIN  # so that few were not enough
    monkeypatch.setattr(amcl_filter, "MARGIN", 1000)
    np.testing.assert_array_equal(first.means, run(drive(), start, np.random.default_rng(0)).means)


def test_the_particles_number_one_more_than_kld_sampling_asks_for():
    replay = nav2_filter(min_particles=300, max_particles=900).run(drive(4), START, np.random.default_rng(1))
    assert replay.particles.tolist() == [301, 301]
    replay = nav2_filter(min_particles=700, max_particles=100).run(drive(4), START, np.random.default_rng(1))
    assert replay.particles.tolist() == [700, 700]  # the maximum is raised


def test_without_resampling_the_answer_waits():
    log = drive()
    replay = nav2_filter(resample_interval=2).run(log, START, np.random.default_rng(1))
    anchors = compose(replay.poses, invert(log.odometry))
    assert len(np.unique(anchors.round(9), axis=0)) == 1 + len(replay.updates) // 2
    assert replay.particles[0] == 2000


def test_ros_1_keeps_particles_that_are_worth_more_than_half_their_number():
    flat = Nav2Parameters(z_hit=1e-9, z_rand=1.0)  # all weights alike
    kept = Ros1FilterParameters(selective_resampling=True, resample_interval=1, max_particles=600)
    model = Nav2Field(small_room(), flat)
    replay = build_filter("ros1", model, parameters=kept).run(drive(8), START, np.random.default_rng(1))
    assert (replay.particles == 600).all()
    drawn = Ros1FilterParameters(resample_interval=1, max_particles=600, kld_err=0.5)
    replay = build_filter("ros1", model, parameters=drawn).run(drive(8), START, np.random.default_rng(1))
    assert (replay.particles < 600).all()


def test_weights_that_are_all_zero_make_particles_equal():
    model = Nav2FieldProb(small_room(), Nav2Parameters(laser_model_type="likelihood_field_prob", z_hit=0.0, z_rand=0.0))
    replay = build_filter("nav2", model).run(drive(8), START, np.random.default_rng(1))
    assert np.isfinite(replay.poses).all()
    np.testing.assert_allclose(replay.means[0], START.mean, atol=0.02)


def test_a_filter_without_information_spreads_as_its_motion_model_does():
    model = Nav2FieldProb(small_room(), Nav2Parameters(laser_model_type="likelihood_field_prob", z_hit=0.0, z_rand=1.0))
    motion = Nav2Motion(alpha1=0.0, alpha2=0.0, alpha3=0.04, alpha4=0.0)
    fixed = AmclFilterParameters(min_particles=4000, max_particles=4000)
    start = PoseBelief(np.array([1.0, 1.0, 0.0]), np.zeros((3, 3)))
    replay = build_filter("nav2", model, motion, fixed).run(drive(4), start, np.random.default_rng(1))
    assert replay.covariances[0, 0, 0] == pytest.approx(0.0, abs=1e-12)
    assert np.sqrt(replay.covariances[1, 0, 0]) == pytest.approx(0.2 * 0.3, rel=0.05)


def test_a_global_start_is_spread_over_the_free_cells():
    grid = small_room()
    model = Nav2Field(grid, Nav2Parameters(z_hit=0.0, z_rand=1.0))
    replay = build_filter("nav2", model).run(drive(2), None, np.random.default_rng(1))
    _, cols = np.nonzero(grid.free)
    spread = np.var(cols * grid.resolution)
    assert replay.covariances[0, 0, 0] == pytest.approx(spread, rel=0.15)


@pytest.mark.parametrize(
    ("end", "splits"),
    [((0.5, 0.1, 0.2), False), ((-0.5, 0.01, 0.1), True), ((0.0, 0.0, 3.0), True), ((-0.3, -0.2, -2.9), False)],
)
def test_headings_are_sums_of_wrapped_rotations_as_the_program_has_them(rng, end, splits):
    odometry = np.array([[1.0, 2.0, 0.7], compose([1.0, 2.0, 0.7], end)])
    before = rng.normal([3.0, 1.0, 2.5], 0.3, (400, 3))
    # A transcription with noise of its own, which says what each rotation was.
    d, r1 = math.hypot(end[0], end[1]), math.atan2(end[1], end[0]) if math.hypot(end[0], end[1]) >= 0.01 else 0.0
    r2 = end[2] - r1
    first, second = r1 + rng.normal(0.0, 0.3 * d, 400), r2 + rng.normal(0.0, 0.3, 400)
    along = d + rng.normal(0.0, 0.2, 400)
    x = before[:, 0] + along * np.cos(before[:, 2] + first)
    y = before[:, 1] + along * np.sin(before[:, 2] + first)
    drawn = np.column_stack([x, y, before[:, 2] + first + second])
    heading = before[:, 2] + wrap_angle(first) + wrap_angle(second)
    np.testing.assert_allclose(as_wrapped_rotations(before, drawn, odometry)[:, 2], heading, atol=1e-9)
    assert (np.ptp(heading) > 6.0) == splits


def test_ros1_never_has_more_particles_than_the_maximum():
    reversed_counts = Ros1FilterParameters(min_particles=200, max_particles=50, resample_interval=1)
    emulated = build_filter("ros1", Nav2Field(small_room(), NAV2), parameters=reversed_counts)
    assert emulated.run(drive(4), START, np.random.default_rng(1)).particles.tolist() == [50, 50]


def test_only_differential_models_wrap_rotations():
    model = Nav2Field(small_room(), NAV2)
    assert build_filter("nav2", model, Nav2Motion()).wraps_rotations
    assert not build_filter("nav2", model, Nav2Motion("nav2_amcl::OmniMotionModel")).wraps_rotations
    assert build_filter("ros1", model, Ros1Motion("diff-corrected")).wraps_rotations
    assert not build_filter("ros1", model, Ros1Motion("omni")).wraps_rotations


def test_scans_without_odometry_are_left_out():
    log = drive(8)
    odometry = np.array(log.odometry)
    odometry[[0, 3]] = np.nan
    log = SensorLog(log.finder, log.stamps, log.ranges, log.poses, odometry)
    replay = nav2_filter().run(log, START, np.random.default_rng(1))
    assert replay.updates.tolist() == [1, 4, 7]
    assert np.isnan(replay.poses[[0, 3]]).all()
    assert np.isfinite(replay.poses[[1, 2, 4]]).all()
    with pytest.raises(TooLittleDataError, match="odometry"):
        nav2_filter().run(log.select([0]), START, np.random.default_rng(1))


def test_what_cannot_be_run_is_refused():
    walls = OccupancyGrid.from_ros(np.full((3, 3), 100), resolution=1.0)
    with pytest.raises(InvalidInputError, match="no free cell"):
        build_filter("nav2", Nav2Field(walls, NAV2))
    with pytest.raises(InvalidInputError, match="start: expected a PoseBelief"):
        nav2_filter().run(drive(2), [1.0, 1.0, 0.3], np.random.default_rng(1))
    for values in (
        {"min_particles": 0}, {"max_particles": 10**9}, {"pf_err": 0.0}, {"update_min_d": -1.0},
        {"resample_interval": 0},
    ):  # fmt: skip
        with pytest.raises(InvalidInputError, match=next(iter(values))):
            AmclFilterParameters(**values)


def test_the_mean_of_a_cluster_across_pi_lies_at_pi():
    finder = RangeFinder.from_bearings([0.0], 5.0)
    log = SensorLog(finder, [0.0], [[np.inf]], np.zeros((1, 3)), np.zeros((1, 3)))
    start = PoseBelief.around([1.0, 1.0, np.pi], sd_position=0.05, sd_heading=0.1)
    replay = nav2_filter().run(log, start, np.random.default_rng(1))
    assert float(wrap_angle(replay.poses[0, 2] - np.pi)) == pytest.approx(0.0, abs=0.03)
