"""Fitting a stack's parameters: proper scores, honest windows, and better posteriors on drives it has not seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import as_poses, between, compose
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.stacks.emulator import Evidence, StackModel
from beamfield.stacks.fit import fit_stack, net_score
from beamfield.stacks.fit_space import fit_space
from beamfield.stacks.likelihood_values import from_likelihood
from beamfield.stacks.nav2_parameters import Nav2Parameters
from beamfield.stacks.particle_update import update_particles
from beamfield.stacks.posterior_score import PosteriorScores, gather_evidence, score_windows
from beamfield.stacks.registry import build_model
from beamfield.stacks.windows import HELD_OUT, WindowOptions, cut_windows, draw_rivals

# The simulated reference is exact.
EXACT = WindowOptions(windows=45, near=250, far=50, reference_error=0.01, reference_turn_error=0.003)
TRUTH = BeamParameters(0.80, 0.10, 0.03, 0.07, 0.05, 0.6)


@pytest.fixture(scope="module")
def office():
    return draw_floor_plan(seed=3)


@pytest.fixture(scope="module")
def drive(office) -> SensorLog:
    finder = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 61), 10.0, name="laser")
    return simulate_log(office, finder, TRUTH, duration=120.0, scan_rate=4.0, seed=5).only_sensor()


@dataclass(frozen=True, eq=False)
class Gaussian(StackModel):
    """Log weights that are those of a position fix: normal around a centre that errs by `error` from the reference."""

    stack: ClassVar[str] = "toy"
    model: ClassVar[str] = "gaussian"
    evidence_settings: ClassVar[tuple[str, ...]] = ()
    parameters: float
    centres: dict

    def with_parameters(self, parameters):
        return replace(self, parameters=parameters)

    def evidence(self, z, poses):
        robot = as_poses(poses).reshape(-1, 3)
        fix = compose(robot[0], self.centres[z.stamp])  # the first near pose is the reference
        return _Squares(np.arange(1), 1.0, np.square(between(fix, robot) / (1.0, 1.0, 0.4)).sum(axis=1))

    def log_weights(self, evidence, parameters=None):
        sigma = self.parameters if parameters is None else parameters
        return -0.5 * evidence.squares / sigma**2


@dataclass(frozen=True, eq=False)
class _Squares(Evidence):
    squares: np.ndarray


def test_the_score_is_best_and_coverage_right_for_a_calibrated_posterior(drive, office):
    options = WindowOptions(scans=1, windows=400, travel=0.0, near=800, far=40, reference_error=0.005,
                            reference_turn_error=0.002)  # fmt: skip
    rivals = draw_rivals(options)
    windows = cut_windows(drive, office, rivals, options)
    rng = np.random.default_rng(8)
    truth = 0.06
    centres = {float(t): rng.normal(0.0, (truth, truth, 0.4 * truth)) for t in drive.stamps}
    model = Gaussian(truth, centres)
    evidence = gather_evidence(model, drive, windows)
    scores = {sigma: score_windows(model, evidence, sigma, rivals, options) for sigma in (0.02, 0.04, 0.06, 0.09, 0.2)}
    means = {sigma: score.mean for sigma, score in scores.items()}
    assert max(means, key=means.get) == truth
    assert means[truth] - means[0.02] > 2.0
    # 400 windows: a standard error of 0.011.
    assert scores[truth].coverage == pytest.approx(0.95, abs=0.04)
    assert scores[0.02].coverage < 0.5
    assert scores[0.2].coverage > 0.99


def test_weights_that_say_nothing_score_nothing(drive, office):
    options = WindowOptions(scans=2, windows=20)
    rivals = draw_rivals(options)
    windows = cut_windows(drive, office, rivals, options)
    model = Gaussian(1e9, {float(t): np.zeros(3) for t in drive.stamps})
    scores = score_windows(model, gather_evidence(model, drive, windows), 1e9, rivals, options)
    np.testing.assert_allclose(scores.log_score, 0.0, atol=1e-9)
    np.testing.assert_array_equal(scores.covered, 1.0)


def test_rivals_make_sums_integrals():
    options = WindowOptions(near=4000)
    rivals = draw_rivals(options)
    assert rivals.prior.sum() == pytest.approx(1.0, abs=0.05)
    assert rivals.reference.sum() == pytest.approx(1.0, abs=0.05)
    # Second moments of the prior come out of the weighted rivals.
    variance = (rivals.prior[:, None] * rivals.offsets**2).sum(axis=0)
    np.testing.assert_allclose(np.sqrt(variance), (0.25, 0.25, 0.1), rtol=0.06)
    np.testing.assert_array_equal(rivals.offsets[0], 0.0)


def test_windows_move_their_rivals_with_the_reference_and_keep_to_one_block(drive, office):
    options = WindowOptions(scans=3, windows=30)
    rivals = draw_rivals(options)
    windows = cut_windows(drive, office, rivals, options)
    assert {window.fold for window in windows} == {0, 1, HELD_OUT}
    for window in windows[::7]:
        reference = drive.poses[window.scans]
        np.testing.assert_allclose(window.near[:, 0], reference, atol=1e-12)
        steps = between(window.near[0], window.near[2])
        np.testing.assert_allclose(steps, np.broadcast_to(between(reference[0], reference[2]), steps.shape), atol=1e-9)
        travel = np.hypot(*np.diff(reference[:, :2], axis=0).T)
        turn = np.abs(between(reference[:-1], reference[1:])[:, 2])
        assert ((travel >= options.travel) | (turn >= options.turn)).all()
        assert office.look_up(office.free, window.far[0, :, :2]).all()


def test_missing_coverage_has_its_price():
    sure = PosteriorScores(np.full(10, 3.0), np.array([1.0] * 5 + [0.0] * 5))
    calm = PosteriorScores(np.full(10, 2.5), np.ones(10))
    assert sure.mean > calm.mean
    assert net_score(calm) > net_score(sure)


@pytest.fixture(scope="module")
def prob_fit(drive, office):
    return fit_stack(
        "nav2", "likelihood_field_prob", drive, office, options=EXACT,
        start=Nav2Parameters(laser_model_type="likelihood_field_prob", sigma_hit=0.5, max_beams=60),
    )  # fmt: skip


def test_a_fit_improves_the_posterior_on_windows_it_has_not_seen(prob_fit):
    assert prob_fit.chosen.held_out.mean > prob_fit.before.held_out.mean
    assert net_score(prob_fit.chosen.held_out) > net_score(prob_fit.before.held_out)
    assert prob_fit.covers
    assert prob_fit.update.error_after.mean() < 0.8 * prob_fit.update.error_before.mean()
    assert prob_fit.parameters.z_hit + prob_fit.parameters.z_rand == pytest.approx(1.0)
    assert prob_fit.parameters.sigma_hit >= 0.5 * 0.05
    assert prob_fit.parameters.laser_max_range == 100.0
    assert [trial.setting["max_beams"] for trial in prob_fit.trials] == [4, 6, 9, 13, 20, 30, 60]


def test_a_beam_model_takes_the_learned_densities(drive, office):
    fit = fit_stack(
        "beluga", "beam", drive, office, start=build_defaults("beluga", "beam"), beam_parameters=TRUTH,
        options=EXACT,
    )  # fmt: skip
    assert fit.how == "maximum likelihood"
    values = fit.parameters
    assert (values.z_hit, values.z_short, values.z_max, values.z_rand) == (0.80, 0.10, 0.03, 0.07)
    assert (values.sigma_hit, values.lambda_short) == (0.05, 0.6)
    assert net_score(fit.chosen.held_out) > net_score(fit.before.held_out)


def build_defaults(stack, model):
    from beamfield.stacks.registry import parameter_class

    return parameter_class(stack, model)(laser_model_type=model)


def test_nav2s_beam_values_are_the_learned_density_up_to_a_factor(office):
    finder = RangeFinder.from_bearings([0.0], 10.0)
    values, learned = from_likelihood("nav2", Nav2Parameters(laser_model_type="beam"), TRUTH, finder, office)
    assert learned
    model = build_model("nav2", "beam", office, values)
    z = np.array([3.98, 4.0, 4.1, 5.0])  # not short of z* = 4: the short term has no normaliser in nav2
    from beamfield.models.beam import beam_log_density
    from beamfield.stacks.emulator import RayEvidence

    settings = {name: getattr(values, name) for name in model.evidence_settings}
    p = model.beam_values(RayEvidence(np.arange(4), 10.0, z, np.full((1, 4), 3.97), settings=settings))[0]
    density = np.exp(beam_log_density(z, np.full(4, 3.97), 10.0, TRUTH))
    np.testing.assert_allclose(p / p[0], density / density[0], rtol=1e-9)


def test_particles_start_as_far_off_as_said(drive, office):
    model = build_model("nav2", "likelihood_field", office, Nav2Parameters())
    update = update_particles(model, drive, [10, 200], n_particles=4000)
    np.testing.assert_allclose(update.error_before, 0.25, atol=0.01)
    assert (update.error_after < update.error_before).all()
    assert ((update.effective > 1.0) & (update.effective <= 4000.0)).all()
    with pytest.raises(InvalidInputError, match="expected scans"):
        update_particles(model, drive, [])


def test_a_start_that_nav2_would_hang_on_is_made_usable(drive, office):
    space = fit_space("nav2", "likelihood_field", Nav2Parameters(max_beams=400), drive.finder, office, None)
    assert space.usable_start.max_beams == 61
    assert max(setting["max_beams"] for setting in space.settings) <= 61


def test_coordinates_go_there_and_back(drive, office):
    start = Nav2Parameters(z_hit=0.6, z_rand=0.6, sigma_hit=0.1)
    space = fit_space("nav2", "likelihood_field_prob", start, drive.finder, office, None)
    point = space.point(start)
    again = space.parameters(start, point)
    np.testing.assert_allclose(space.point(again), point, atol=1e-12)
    assert again.z_hit == pytest.approx(0.5)
    assert again.sigma_hit == pytest.approx(0.1)
    assert again.laser_likelihood_max_dist == pytest.approx(2.0)


def test_a_log_that_is_too_short_is_too_little(drive, office):
    with pytest.raises(TooLittleDataError, match=r"windows of 4 scans, 0\.25 m or 0\.2 rad apart"):
        fit_stack("nav2", "likelihood_field", drive.select(np.arange(60)), office, start=Nav2Parameters())


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"scans": 0}, "scans: expected at least 1, got 0"),
        ({"near": 3}, "near: expected at least 20"),
        ({"spread": 0.0}, "spread: expected a positive number"),
        ({"travel": -1.0}, "travel: expected a number >= 0"),
        ({"far_share": 1.0}, r"far_share: expected a number in \[0, 1\)"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_options_that_make_no_sense_are_refused(values, message):
    with pytest.raises(InvalidInputError, match=message):
        WindowOptions(**values)
