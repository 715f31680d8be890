"""Tables of the mixture over z*, which very many poses look up: against the formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beamfield.kernels.beam import BeamView
from beamfield.kernels.many_beams import fill_log_density
from beamfield.kernels.mixture_table import DEGREE, PIECES, fill_looked_up
from beamfield.kernels.threads import set_threads
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models import range_mixture
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import read_only
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.mixture_table import POSES_WITH_TABLE, mixture_table
from beamfield.sensors import RangeFinder, Scan

MAX_RANGE = 8.0
THETA = BeamView(0.6, 0.15, 0.05, 0.2, 0.1, 0.7, 0.0, 0.0, MAX_RANGE)
VARIANTS = {
    "plain": THETA,
    "short far out": THETA._replace(max_range=80.0, sigma_hit=0.02),
    "uniform short": THETA._replace(lambda_short=0.0),
    "steep short": THETA._replace(lambda_short=300.0),
    "wide hit": THETA._replace(sigma_hit=20.0),
    "sharp hit": THETA._replace(sigma_hit=1e-4),
    "offset": THETA._replace(range_offset=0.17),
    "negative offset": THETA._replace(range_offset=-0.17),
    "slope": THETA._replace(sigma_slope=0.05),
    "steep slope": THETA._replace(sigma_slope=1.0, sigma_hit=0.01),
    "blind zone": THETA._replace(sigma_slope=0.1, min_range=2.0),
    "no hits": THETA._replace(z_hit=0.0, z_rand=0.8),
    "no shorts": THETA._replace(z_short=0.0),
    "no returns missing": THETA._replace(z_max=0.0),
    "hardly any random": THETA._replace(z_hit=0.8, z_rand=1e-5),
    "only shorts and random": THETA._replace(z_hit=0.0, z_short=0.9, z_max=0.0, z_rand=0.1),
    "only returns missing": THETA._replace(z_hit=0.0, z_short=0.0, z_max=1.0, z_rand=0.0),
}
BOUND = 1e-4


def looked_up_and_computed(z, z_star, view):
    """Return the log density of one reading at each expected range, twice, and its table."""
    reading, expected = read_only(np.array([z])), read_only(z_star[:, None].copy())
    table = mixture_table(reading, view)
    looked_up, computed = np.empty(z_star.size), np.empty(z_star.size)
    fill_looked_up(reading, expected, view, table, looked_up)
    fill_log_density(read_only(np.full(z_star.size, z)), read_only(z_star), view, computed)
    return looked_up, computed, table


def test_nothing_is_compiled_for_one_reading_that_is_not_for_many(rng):
    compiled = []
    for n in (3, 1):
        reading = read_only(rng.uniform(1.0, 7.0, n))
        fill_looked_up(reading, read_only(np.ones((5, n))), THETA, mixture_table(reading, THETA), np.empty(5))
        compiled.append((fill_looked_up.signatures, fill_log_density.signatures))
    assert compiled[0] == compiled[1]


def special(z, view):
    """Return expected ranges at and beside what the table is cut at, and impossible ones."""
    cuts = mixture_table(read_only(np.array([z])), view).starts[0]
    at = np.concatenate([cuts, [min(z, view.max_range), view.max_range, 1e-6]])
    beside = [
        np.nextafter(at, -1.0)[at > 0.0],
        at,
        np.nextafter(at, np.inf),
        [2.0 * view.max_range, np.inf, np.nan, -1.0],
    ]
    return np.concatenate(beside)


def assert_close(looked_up, computed):
    impossible = computed == -np.inf
    assert ((looked_up == -np.inf) == impossible).all()
    np.testing.assert_allclose(looked_up[~impossible], computed[~impossible], rtol=0.0, atol=BOUND)


@pytest.mark.parametrize("variant", VARIANTS)
def test_within_the_bound_for_every_reading_and_expected_range(variant, rng):
    view = VARIANTS[variant]
    longest = view.max_range
    readings = [0.0, 1e-7, 2e-6, 0.01, 0.3, longest / 2, longest - 1e-3, math.nextafter(longest, 0.0), longest, np.inf]
    for z in [*readings, *rng.uniform(0.0, longest, 20)]:
        near = min(z, longest) + view.sigma_hit * rng.normal(0.0, 4.0, 300)
        anywhere = np.append(rng.uniform(0.0, longest, 300), longest * 10.0 ** rng.uniform(-7.0, 0.0, 100))
        looked_up, computed, _ = looked_up_and_computed(
            z, np.concatenate([np.abs(near), anywhere, special(z, view)]), view
        )
        assert_close(looked_up, computed)


def test_within_the_bound_for_any_parameters(rng):
    for _ in range(300):
        weights = rng.dirichlet(np.full(4, 0.5))
        longest, sigma = 10.0 ** rng.uniform(-1.0, 2.0), 10.0 ** rng.uniform(-3.0, 1.0)
        lambda_short, offset, slope = 10.0 ** rng.uniform(-4.0, 4.0), rng.uniform(-2.0, 2.0), 10.0 ** rng.uniform(-4, 0)
        view = BeamView(*weights, sigma, lambda_short, sigma * offset, slope, longest, rng.uniform(0.0, 1.0))
        z = longest * rng.uniform() ** 2
        z_star = np.concatenate([rng.uniform(0.0, longest, 300), np.abs(z + sigma * rng.normal(0.0, 4.0, 300))])
        looked_up, computed, _ = looked_up_and_computed(z, z_star, view)
        assert_close(looked_up, computed)


@pytest.mark.parametrize("variant", ["plain", "short far out", "offset", "slope", "blind zone", "no hits", "no shorts"])
def test_hardly_any_piece_needs_the_formulas(variant, rng):
    """Or the bound would hold because nothing is looked up."""
    view = VARIANTS[variant]
    table = mixture_table(read_only(rng.uniform(0.3, view.max_range, 200)), view)
    pieces = table.coefficients.reshape(200, sum(PIECES), DEGREE + 1)
    assert np.isnan(pieces).mean() < 0.01


def test_where_a_reading_can_be_short_from_on(rng):
    """The density jumps at z* = z, where the formulas do to the last bit."""
    view = THETA._replace(z_hit=0.0, z_short=0.75)
    for z in rng.uniform(0.1, 4.0, 200):
        beside = np.array([np.nextafter(z, 0.0), z, np.nextafter(z, np.inf)])
        looked_up, computed, _ = looked_up_and_computed(z, beside, view)
        assert computed[1] - computed[0] > 0.1
        np.testing.assert_allclose(looked_up, computed, rtol=0.0, atol=BOUND)


def test_a_reading_that_says_nothing_of_the_pose_is_constant(rng):
    looked_up, computed, _ = looked_up_and_computed(MAX_RANGE, rng.uniform(0.0, MAX_RANGE, 1000), THETA)
    assert (looked_up == math.log(THETA.z_max)).all()
    assert (looked_up == computed).all()


@pytest.mark.parametrize(
    "change", [{"z_rand": 0.0}, {"range_offset": 0.21}, {"range_offset": -0.21}, {"sigma_slope": 1.1}]
)
def test_no_table_for_parameters_that_it_would_not_fit(change):
    assert mixture_table(read_only(np.array([3.0])), THETA._replace(**change)) is None


# A room of 5 m with a pillar, off the middle.
ROOM = np.zeros((50, 50))
ROOM[[0, -1]] = ROOM[:, [0, -1]] = 100
ROOM[10:14, 30:33] = 100
N = POSES_WITH_TABLE


@pytest.fixture(scope="module")
def model():
    finder = RangeFinder.from_bearings(np.linspace(-3.0, 3.0, 61), MAX_RANGE, min_range=0.2)
    parameters = BeamParameters(0.7, 0.15, 0.05, 0.1, 0.1, 0.5, range_offset=0.02, sigma_slope=0.01)
    return BeamModel(OccupancyGrid.from_ros(ROOM, 0.1), parameters, finder=finder, exponent=0.5)


@pytest.fixture(scope="module")
def scan(model):
    ranges = model.sample([[2.0, 3.0, 0.4]], rng=4)[0].ranges.copy()
    ranges[[3, 17]] = np.nan, 0.1
    return Scan(ranges, model.finder)


@pytest.fixture(scope="module")
def poses():
    """Poses all over the room, in its walls and outside, and around one of them."""
    rng = np.random.default_rng(6)
    anywhere = rng.uniform([-0.5, -0.5, -np.pi], [5.5, 5.5, np.pi], (N // 2, 3))
    near = rng.normal([2.0, 3.0, 0.4], [0.1, 0.1, 0.05], (N - N // 2, 3))
    return np.concatenate([anywhere, near])


def test_many_poses_score_as_few_do(model, scan, poses):
    many = model.log_likelihood(scan, poses)
    few = np.concatenate([model.log_likelihood(scan, part) for part in np.split(poses, 2)])
    apart = np.abs(many - few)
    assert 0.0 < apart.max() < 0.5 * 61 * BOUND
    assert apart.max() < 1e-4
    # The same order, where two poses are further apart than that.
    order = np.argsort(few)
    assert (np.diff(many[order])[np.diff(few[order]) > 2e-4] > 0.0).all()
    assert np.argmax(many) == np.argmax(few)


def test_one_pose_fewer_is_computed(model, scan, poses):
    without = model.log_likelihood(scan, poses[1:])
    one_by_one = [float(model.log_likelihood(scan, pose)) for pose in poses[-20:]]
    assert without[-20:].tolist() == one_by_one
    assert model.log_likelihood(scan, poses)[-20:].tolist() != one_by_one


def test_neither_threads_nor_chunks_change_a_bit(model, scan, poses, monkeypatch):
    with set_threads(1):
        one = model.log_likelihood(scan, poses)
    with set_threads(3):
        assert (model.log_likelihood(scan, poses) == one).all()
    monkeypatch.setattr(range_mixture, "RAYS_PER_CHUNK", 61 * 777)
    assert (model.log_likelihood(scan, poses) == one).all()


def test_many_poses_of_parameters_without_a_table_are_computed(model, scan, poses):
    certain = model.with_parameters(BeamParameters(0.8, 0.15, 0.05, 0.0, 0.1, 0.5))
    few = np.concatenate([certain.log_likelihood(scan, part) for part in np.split(poses, 2)])
    assert (certain.log_likelihood(scan, poses) == few).all()
