"""The particle filter against exact filters in small worlds, and what it does when something is wrong."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.localization.particle_filter import FilterOptions, ParticleFilter
from beamfield.localization.recovery import FreePoses, PosesFromScan, Recovery
from beamfield.localization.resampling import KldSampling
from beamfield.localization.short_readings import ShortReadings
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan

ALWAYS = {"update_distance": 0.0, "update_turn": 0.0, "least_effective": 0.0}


class Shift:
    """Moves x and y as odometry does, with normal noise: a linear motion model."""

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma

    def sample(self, poses, odometry, rng):
        noise = np.column_stack([rng.normal(0, self.sigma, (len(poses), 2)), np.zeros(len(poses))])
        return poses + (odometry[1] - odometry[0]) * [1, 1, 0] + noise

    def log_density(self, after, before, odometry):
        raise NotImplementedError


class Position:
    """Measures x and y with normal noise."""

    is_normalized = True

    def __init__(self, sigma: float) -> None:
        self.sigma = sigma

    def log_likelihood(self, z, poses):
        return -0.5 * np.square((poses[:, :2] - z) / self.sigma).sum(axis=1)


class Given:
    """Has the log-likelihoods that it is given, whatever is measured."""

    is_normalized = False

    def __init__(self, values) -> None:
        self.values = values

    def log_likelihood(self, z, poses):  # noqa: ARG002
        return np.broadcast_to(self.values, len(poses)).astype(float)


@pytest.mark.parametrize(
    "options", [{"resample_below": 0.5}, {"resample_below": 1.0}, {"kld": KldSampling(least=15000)}]
)
def test_the_belief_is_that_of_a_kalman_filter(options):
    rng, n = np.random.default_rng(8), 20_000
    motion, sigma_z, variance, mean = 0.1, 0.4, np.array([1.0, 0.25]), np.array([2.0, -1.0])
    own = ParticleFilter(Position(sigma_z), Shift(motion), FilterOptions(n_particles=n, **ALWAYS, **options), rng=1)
    own.start(np.column_stack([rng.normal(mean, np.sqrt(variance), (n, 2)), np.zeros(n)]))
    odometry, truth = np.zeros(3), mean + np.array([0.6, -0.3])
    for t in range(12):
        if t:
            step = rng.normal(0, 0.5, 2)
            odometry[:2] += step
            truth = truth + step + rng.normal(0, motion, 2)
            mean, variance = mean + step, variance + motion**2
        z = truth + rng.normal(0, sigma_z, 2)
        gain = variance / (variance + sigma_z**2)
        mean, variance = mean + gain * (z - mean), (1 - gain) * variance
        update = own.update(z, odometry)
        error = 4.0 * np.sqrt(variance / update.effective)
        whole = update.belief.whole
        # Particles drawn from each other are dependent: some more than the error of independent ones.
        assert (np.abs(whole.pose[:2] - mean) < error).all()
        np.testing.assert_allclose(np.diag(whole.covariance)[:2], variance, rtol=0.1)
        assert own.pose == pytest.approx(update.belief.best_cluster.pose)


def test_the_evidence_is_that_of_the_kalman_filter():
    rng, n = np.random.default_rng(3), 200_000
    own = ParticleFilter(Position(0.5), Shift(0.1), FilterOptions(n_particles=n, **ALWAYS), rng=1)
    own.start(np.column_stack([rng.normal(0.0, 1.0, (n, 2)), np.zeros(n)]))
    z = np.array([0.7, -1.2])
    s = 1.0 + 0.25
    # Of exp(-r^2 / 2 sigma^2) without the normaliser.
    expected = math.log(0.25 / s) - 0.5 * (z @ z) / s
    assert own.update(z, np.zeros(3)).log_evidence == pytest.approx(expected, abs=0.01)


def test_the_belief_over_five_rooms_is_that_of_a_grid_filter():
    """A ring of rooms with doors: the robot goes on by one, or stays with probability 0.3."""
    doors = np.array([1.0, 0.0, 1.0, 1.0, 0.0])

    class Ring:
        def sample(self, poses, odometry, rng):  # noqa: ARG002
            stays = rng.random(len(poses)) < 0.3
            return np.column_stack([(poses[:, 0] + ~stays) % 5, np.zeros((len(poses), 2))])

        def log_density(self, after, before, odometry):
            raise NotImplementedError

    class Door:
        is_normalized = True

        def log_likelihood(self, z, poses):
            seen = np.where(doors == 1.0, 0.8, 0.1)[poses[:, 0].astype(int)]
            return np.log(seen if z else 1.0 - seen)

    n = 60_000
    own = ParticleFilter(Door(), Ring(), FilterOptions(n_particles=n, **ALWAYS), rng=5)
    own.start(np.column_stack([np.arange(n) % 5, np.zeros((n, 2))]))
    belief = np.full(5, 0.2)
    for t, z in enumerate([True, False, True, True, False, False, True]):
        if t:
            belief = 0.3 * belief + 0.7 * np.roll(belief, 1)
        belief = belief * np.where((doors == 1.0) == z, [0.8, 0.9][not z], [0.1, 0.2][not z])
        belief /= belief.sum()
        cloud = own.update(z, np.array([float(t), 0.0, 0.0])).belief
        np.testing.assert_allclose(np.bincount(cloud.poses[:, 0].astype(int), cloud.weights), belief, atol=0.012)


@pytest.mark.parametrize("is_coarse", [False, True])
def test_a_coarse_model_keeps_the_right_place_that_a_sharp_one_gives_up(is_coarse):
    """Two places 10 m apart: errors of the map speak for the wrong one, ten times over, before the right one shows."""

    class Places:
        is_normalized = False

        def __init__(self, power: float) -> None:
            self.power = power

        def log_likelihood(self, z, poses):
            return np.where(poses[:, 0] > 5.0, self.power * z, 0.0)

    options = FilterOptions(n_particles=500, resample_below=1.0, **ALWAYS)
    own = ParticleFilter(Places(1.0), Shift(0.01), options, rng=1)
    cloud = np.repeat([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]], 2000, axis=0)
    own.start(cloud, coarse=Places(0.1) if is_coarse else None)
    for t in range(20):
        own.update(2.0 if t < 10 else -10.0, np.zeros(3))
        if t == 12:
            assert own.is_found != is_coarse
    assert own.is_found
    assert own.pose[0] == pytest.approx(0.0 if is_coarse else 10.0, abs=0.2)


# A room that looks different from everywhere.
def make_room() -> OccupancyGrid:
    cells = np.zeros((80, 110))
    cells[[0, -1]] = cells[:, [0, -1]] = cells[:25, 40] = cells[60:, 70] = cells[45, 75:95] = cells[10:16, 80:84] = 1.0
    return OccupancyGrid(cells, 0.1, np.array([-2.0, 1.0, 0.3]))


FINDER = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 31), 12.0)


@pytest.fixture(scope="module")
def room() -> OccupancyGrid:
    return make_room()


@pytest.fixture(scope="module")
def field(room) -> LikelihoodFieldModel:
    return LikelihoodFieldModel(room, LikelihoodFieldParameters(0.8, 0.1, 0.15), exponent=0.2)


def drive(grid: OccupancyGrid, n: int, kidnapped_at: int = -1):
    """Yield odometry, truth and scan of a robot that goes round in circles, once carried elsewhere."""
    caster, place = RayCaster(grid), grid.to_map([[25.0, 55.0], [85.0, 27.0]])
    rng = np.random.default_rng(2)
    for t in range(n):
        angle = 0.2 * t
        circle = np.array([0.6 * np.cos(angle), 0.6 * np.sin(angle), angle + np.pi / 2])
        truth = circle + np.append(place[int(0 <= kidnapped_at <= t)], 0.0)
        ranges = caster.expected_ranges(truth, FINDER) + rng.normal(0, 0.03, FINDER.n_beams)
        yield circle, truth, Scan(ranges, FINDER, 0.5 * t)


def run(own: ParticleFilter, steps) -> list[float]:
    """Return the position error at each step."""
    errors = []
    for odometry, truth, scan in steps:
        own.update(scan, odometry, scan.stamp)
        errors.append(math.dist(own.pose[:2], truth[:2]))
    return errors


@pytest.mark.parametrize("seed", range(3))
def test_a_global_start_finds_the_robot(room, seed):
    # Of 31 beams by the same few walls.
    field = LikelihoodFieldModel(room, LikelihoodFieldParameters(0.8, 0.1, 0.15), exponent=0.05)
    options = FilterOptions(n_particles=10_000, kld=KldSampling(least=1000), update_distance=0.05)
    own = ParticleFilter(field, GaussianMotion(), options, rng=seed)
    own.start(FreePoses(room).draw(None, 20_000, np.random.default_rng(seed)))
    errors = run(own, drive(room, 40))
    assert max(errors[-5:]) < 0.15
    assert len(own.belief) < 3000


@pytest.mark.parametrize("source", ["free", "scan"])
def test_a_kidnapped_robot_is_found_again_by_drawing_poses_anew(room, field, source):
    sources = {"free": FreePoses(room), "scan": PosesFromScan(room, field, n_candidates=5000)}
    start = next(iter(drive(room, 1)))[1]
    cloud = np.random.default_rng(0).normal(start, [0.1, 0.1, 0.05], (3000, 3))
    errors = {}
    for recovery in (None, Recovery(readings=31 * 0.2)):
        options = FilterOptions(n_particles=3000, update_distance=0.05, recovery=recovery)
        own = ParticleFilter(field, GaussianMotion(), options, source=sources[source], rng=4)
        own.start(cloud)
        errors[recovery] = run(own, drive(room, 90, kidnapped_at=20))
        assert max(errors[recovery][:20]) < 0.15
    assert min(errors[None][21:]) > 1.0
    assert max(errors[recovery][-10:]) < 0.15


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(room, field):
    def poses(seed):
        options = FilterOptions(
            n_particles=500, kld=KldSampling(least=100), recovery=Recovery(readings=6.2), update_distance=0.05
        )
        own = ParticleFilter(
            field, GaussianMotion(), options, source=FreePoses(room), short_readings=ShortReadings(room), rng=seed
        )
        own.start(FreePoses(room).draw(None, 500, np.random.default_rng(0)))
        run(own, drive(room, 10))
        return own.belief.poses

    assert np.array_equal(poses(1), poses(1))
    assert not np.array_equal(poses(1)[:50], poses(2)[:50])


def test_measurements_are_used_once_the_robot_has_moved_and_the_pose_follows_odometry_between():
    options = FilterOptions(n_particles=50, update_distance=0.5, update_turn=0.3)
    own = ParticleFilter(Given(0.0), GaussianMotion(0, 0, 0, 0, 0), options, rng=0)
    own.start([[5.0, 5.0, np.pi / 2]])
    assert np.isnan(own.pose).all()
    assert own.update(None, [1.0, 1.0, 0.0]) is not None
    assert own.update(None, [1.4, 1.0, 0.0]) is None
    assert own.pose == pytest.approx([5.0, 5.4, np.pi / 2])
    assert own.update(None, [1.4, 1.0, 0.29]) is None
    assert own.update(None, [1.4, 1.0, 0.31]) is not None
    assert own.pose == pytest.approx([5.0, 5.4, np.pi / 2 + 0.31])
    assert own.update(None, [1.9, 1.0, 0.31]) is not None


def test_a_likelihood_is_flattened_until_enough_particles_count():
    values = -0.5 * np.square(np.linspace(-300, 300, 1000))
    options = FilterOptions(n_particles=1000, least_effective=0.1, resample_below=0.0)
    own = ParticleFilter(Given(values), GaussianMotion(), options, rng=0)
    own.start(np.zeros((1000, 3)))
    update = own.update(None, np.zeros(3))
    weights = np.exp(update.power * (values - values.max()))
    np.testing.assert_allclose(update.belief.weights, weights / weights.sum(), rtol=1e-9, atol=1e-300)
    assert 100 <= update.effective < 102
    # The evidence is that of the likelihood itself.
    assert update.log_evidence == pytest.approx(np.logaddexp.reduce(values) - math.log(1000))
    flat = ParticleFilter(Given(values), GaussianMotion(), FilterOptions(least_effective=0.0), rng=0)
    flat.start(np.zeros((1000, 3)))
    assert flat.update(None, np.zeros(3)).power == 1.0


@pytest.mark.parametrize("recovery", [None, Recovery()])
def test_an_impossible_measurement_changes_no_weight(room, recovery):
    model = Given(-np.inf)
    options = FilterOptions(n_particles=200, recovery=recovery, **ALWAYS)
    own = ParticleFilter(model, GaussianMotion(0, 0, 0, 0, 0), options, source=FreePoses(room), rng=0)
    own.start(np.tile([1.0, 2.0, 0.0], (200, 1)))
    update = own.update(None, np.zeros(3))
    assert update.is_impossible
    assert own.pose == pytest.approx([1.0, 2.0, 0.0])
    assert update.belief.weights == pytest.approx(np.full(200, 1 / 200))
    model.values = 0.0
    own.update(None, np.zeros(3))
    model.values = -np.inf
    # Fits worse than it did: now poses are drawn anew, if that is asked for.
    assert (own.update(None, np.zeros(3)).n_replaced > 0) == (recovery is not None)
    assert np.isfinite(own.belief.poses).all()


def test_how_well_scans_fit_by_the_coarse_model_is_no_measure_for_the_other(room):
    """The model's own likelihood is lower, but does not fall: nothing is drawn anew after a start from anywhere."""
    options = FilterOptions(n_particles=200, recovery=Recovery(), **ALWAYS)
    own = ParticleFilter(Given(-50.0), GaussianMotion(0, 0, 0, 0, 0), options, source=FreePoses(room), rng=0)
    own.start(np.random.default_rng(0).normal(0.0, [2.0, 2.0, 0.1], (6000, 3)), coarse=Position(0.1))
    used = [own.update(np.zeros(2), np.zeros(3)) for _ in range(10)]
    assert own.is_found
    assert [update.n_replaced for update in used] == [0] * 10


def test_a_filter_that_has_not_started_has_found_nothing():
    own = ParticleFilter(Given(0.0), GaussianMotion(), rng=0)
    assert (own.is_found, own.odometry_jumps) == (False, 0)
    assert np.isnan(own.pose).all()
    own.start(np.zeros((3, 3)))
    assert own.is_found


def test_weights_that_start_accepts_are_drawn_by_after_an_impossible_measurement():
    """A sum that misses 1 by what single precision leaves is no error, whenever the weights are looked at."""
    own = ParticleFilter(Given(-np.inf), GaussianMotion(), FilterOptions(n_particles=100, **ALWAYS), rng=0)
    own.start(np.zeros((100, 3)), np.full(100, (1.0 + 5e-7) / 100) * np.repeat([0.1, 1.9], 50))
    assert own.update(None, np.zeros(3)).is_impossible
    assert len(own.belief) == 100


def test_particles_of_no_weight_stay_so_however_likely():
    values = np.array([-1000.0, 500.0])
    own = ParticleFilter(Given(values), GaussianMotion(), FilterOptions(resample_below=0.0), rng=0)
    own.start(np.zeros((2, 3)), [1.0, 0.0])
    assert own.update(None, np.zeros(3)).belief.weights.tolist() == [1.0, 0.0]


def test_reset_odometry_is_not_followed_and_the_cloud_is_spread():
    own = ParticleFilter(Given(0.0), GaussianMotion(0, 0, 0, 0, 0), FilterOptions(n_particles=4000), rng=0)
    own.start(np.tile([10.0, 10.0, 0.0], (4000, 1)))
    own.update(None, [50.0, 0.0, 1.0], 0.0)
    own.update(None, [50.5, 0.0, 1.0], 0.1)
    before = own.pose
    update = own.update(None, [0.0, 0.0, 0.0], 0.2)
    assert own.odometry_jumps == 1
    assert own.pose == pytest.approx(before, abs=0.03)
    assert np.sqrt(np.diag(update.belief.whole.covariance)) == pytest.approx([0.3, 0.3, 0.3], rel=0.05)
    own.update(None, [1.0, 0.0, 0.0], 0.5)
    assert own.odometry_jumps == 1
    assert math.dist(own.pose[:2], before[:2]) == pytest.approx(1.0, abs=0.05)


def test_time_that_jumps_and_missing_odometry_do_not_stop_the_filter():
    own = ParticleFilter(Given(0.0), GaussianMotion(0, 0, 0, 0, 0), FilterOptions(n_particles=10), rng=0)
    own.start(np.zeros((10, 3)))
    assert own.update(None, [np.nan, 0.0, 0.0], 0.0) is None
    for i, stamp in enumerate([0.0, 0.0, 1e9, -5.0, np.nan, 7.0]):
        assert own.update(None, [0.5 * i, 0.0, 0.0], stamp) is not None
        assert own.update(None, np.full(3, np.nan), stamp) is None
        assert own.pose == pytest.approx([0.5 * i, 0.0, 0.0])
    assert own.odometry_jumps == 0


def test_what_models_must_not_return_is_refused():
    for values, what in ((np.nan, "NaN"), (np.inf, "below"), (np.zeros((5, 2)), "shape")):
        model = Given(0.0)
        model.log_likelihood = lambda _, poses, values=values: (
            values * np.ones(len(poses)) if np.ndim(values) == 0 else values
        )
        own = ParticleFilter(model, GaussianMotion(), rng=0)
        own.start(np.zeros((5, 3)))
        with pytest.raises(InvalidInputError, match=what):
            own.update(None, np.zeros(3))
    with pytest.raises(InvalidInputError, match="no belief yet"):
        ParticleFilter(Given(0.0), GaussianMotion()).update(None, np.zeros(3))
    with pytest.raises(InvalidInputError, match="source"):
        ParticleFilter(Given(0.0), GaussianMotion(), FilterOptions(recovery=Recovery()))
    own = ParticleFilter(Given(0.0), GaussianMotion())
    own.start(np.zeros((5, 3)))
    with pytest.raises(InvalidInputError, match="odometry"):
        own.update(None, np.zeros((2, 3)))


def test_the_motion_before_a_measurement_that_the_model_refuses_is_not_lost():
    model = Given(0.0)
    own = ParticleFilter(model, GaussianMotion(0, 0, 0, 0, 0), FilterOptions(n_particles=10), rng=0)
    own.start(np.zeros((10, 3)))
    own.update(None, np.zeros(3), 0.0)
    model.values = np.inf
    with pytest.raises(InvalidInputError, match="below"):
        own.update(None, [1.0, 0.0, 0.0], 1.0)
    assert own.pose == pytest.approx([1.0, 0.0, 0.0])
    model.values = 0.0
    assert own.update(None, [1.2, 0.0, 0.0], 1.2).belief.poses == pytest.approx(np.tile([1.2, 0.0, 0.0], (10, 1)))


@pytest.mark.parametrize(
    "options",
    [{"n_particles": 0}, {"update_distance": -1.0}, {"update_turn": np.inf}, {"resample_below": 1.5},
     {"least_effective": np.nan}, {"n_particles": 100, "kld": KldSampling(least=500)}],
)  # fmt: skip
def test_options_out_of_range_are_refused(options):
    with pytest.raises(InvalidInputError, match="|".join(options)):
        FilterOptions(**options)


def test_readings_of_people_are_left_out_while_the_cloud_is_small(room):
    """Half of the view is blocked by people at half the distance."""
    model = BeamModel(room, BeamParameters(0.9, 0.0, 0.0, 0.1, 0.05, 0.0))
    short = ShortReadings(room, sigma=0.05)
    rng = np.random.default_rng(0)
    _, truth, scan = next(iter(drive(room, 1)))
    blocked = np.where(np.arange(FINDER.n_beams) < 15, 0.5 * scan.ranges, scan.ranges)
    seen = Scan(blocked, FINDER)
    cloud = ParticleFilter(model, GaussianMotion(), rng=0)
    cloud.start(rng.normal(truth, [0.05, 0.05, 0.02], (500, 3)))
    left = short.leave_out(seen, cloud.belief, rng)
    assert np.isnan(left.ranges[:15]).sum() >= 13
    assert np.array_equal(left.ranges[15:], scan.ranges[15:])
    poses = cloud.belief.poses[:40]
    expected = RayCaster(room).expected_ranges(poses, FINDER)
    byhand = [np.mean([0.5 * math.erfc((z - e) / (0.05 * math.sqrt(2))) for e in column]) for z, column in zip(blocked, expected.T, strict=True)]  # noqa: E501  # fmt: skip
    np.testing.assert_allclose(short.probability_short(seen, poses), byhand, atol=1e-12)
    cones = Scan(blocked, replace(FINDER, opening_angle=0.5))
    with pytest.raises(InvalidInputError, match=r"short readings: expected a sensor of beams, got cones of 28\.6 deg"):
        short.leave_out(cones, cloud.belief, rng)
    cloud.start(rng.normal(truth, [1.0, 1.0, 0.02], (500, 3)))
    assert short.leave_out(seen, cloud.belief, rng) is seen


def test_a_filter_shows_its_parts_and_its_state():
    own = ParticleFilter(Position(0.5), Shift(0.1), rng=1)
    assert repr(own) == "ParticleFilter(Position, Shift, not started)"
    own.start(np.tile([1.0, 2.0, 0.0], (8, 1)))
    own.update(np.array([1.0, 2.0]), np.zeros(3))
    assert repr(own) == "ParticleFilter(Position, Shift, 8 particles, pose=[1.0, 2.0, 0.0])"


class MovedAs(Shift):
    """Returns what it draws in a form of its own."""

    def __init__(self, form) -> None:
        super().__init__(0.1)
        self.form = form

    def sample(self, poses, odometry, rng):
        return self.form(super().sample(poses, odometry, rng))


@pytest.mark.parametrize("form", [np.ndarray.tolist, np.asfortranarray, lambda poses: poses.astype(">f8")])
def test_a_motion_model_of_ones_own_may_return_any_numbers(form):
    beliefs = []
    for motion in (Shift(0.1), MovedAs(form)):
        own = ParticleFilter(Position(0.1), motion, FilterOptions(**ALWAYS), rng=0)
        own.start(np.zeros((50, 3)))
        for x in (0.0, 1.0, 2.0):
            own.update([x, 0.0], [x, 0.0, 0.0])
        beliefs.append(own.belief.poses)
    assert beliefs[1].dtype == np.float64
    assert beliefs[1].flags.c_contiguous
    np.testing.assert_array_equal(*beliefs)


@pytest.mark.parametrize("form", [lambda _: None, lambda poses: poses * np.nan])
def test_a_motion_model_that_returns_no_poses_is_named(form):
    own = ParticleFilter(Position(0.1), MovedAs(form), FilterOptions(**ALWAYS), rng=0)
    own.start(np.zeros((50, 3)))
    own.update([0.0, 0.0], [0.0, 0.0, 0.0])
    with pytest.raises(InvalidInputError, match=r"^motion: expected"):
        own.update([1.0, 0.0], [1.0, 0.0, 0.0])


class Source:
    """Draws the poses that it is given, however many are asked for."""

    def __init__(self, poses) -> None:
        self.poses = poses

    def draw(self, _z, _n, _rng):
        return self.poses


@pytest.mark.parametrize("poses", [None, np.zeros((5, 2)), np.zeros(3), np.zeros((5000, 3))])
def test_a_source_that_draws_something_else_is_named(poses):
    options = FilterOptions(**ALWAYS, recovery=Recovery(alpha_slow=0.001, alpha_fast=1.0, most=1.0))
    own = ParticleFilter(Position(0.1), Shift(0.1), options, source=Source(poses), rng=0)
    own.start(np.zeros((50, 3)))
    own.update([0.0, 0.0], [0.0, 0.0, 0.0])
    with pytest.raises(InvalidInputError, match=r"^source: expected"):
        own.update([9.0, 0.0], [0.0, 0.0, 0.0])


def test_a_cloud_that_the_caller_fills_again_stays_as_it_was():
    cloud = np.zeros((50, 3))
    own = ParticleFilter(Position(0.1), Shift(0.1), rng=0)
    own.start(cloud)
    cloud[:] = 9.0
    assert not own.belief.poses.any()
