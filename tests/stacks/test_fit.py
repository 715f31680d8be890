"""Fitting a stack's parameters: proper scores, honest windows, and better posteriors on drives it has not seen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from scipy.stats import norm

from beamfield.calibration.context.posterior_judge import PosteriorScores, judge_weights
from beamfield.calibration.pose_windows import HELD_OUT, WindowOptions, cut_windows, draw_rivals
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import as_poses, between, compose
from beamfield.sensors import RangeFinder
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.coordinates import FitInputs
from beamfield.stacks.emulation.emulator import Evidence, StackModel
from beamfield.stacks.fit.fit import fit_stack, net_score
from beamfield.stacks.fit.fit_space import fit_space
from beamfield.stacks.fit.particle_update import update_particles
from beamfield.stacks.fit.window_evidence import gather_evidence, score_windows
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.registry import STACKS, build_model, model_named, parameter_class
from tests.conftest import TRUTH

# The simulated reference is exact.
EXACT = WindowOptions(windows=45, near=150, far=40, reference_error=0.01)


@dataclass(frozen=True, eq=False)
class Gaussian(StackModel):
    """Log weights that are those of a position fix: normal around a pose for each scan."""

    stack: ClassVar[str] = "toy"
    model: ClassVar[str] = "gaussian"
    evidence_settings: ClassVar[tuple[str, ...]] = ()
    parameters: float
    centres: dict

    def with_parameters(self, parameters):
        return replace(self, parameters=parameters)

    def evidence(self, z, poses):
        robot = as_poses(poses).reshape(-1, 3)
        fix = self.centres[z.stamp]
        return _Squares(np.arange(1), 1.0, np.square(between(fix, robot) / (1.0, 1.0, 0.25)).sum(axis=1))

    def log_weights(self, evidence, parameters=None):
        sigma = self.parameters if parameters is None else parameters
        return np.full(len(evidence.squares), -np.inf) if sigma == 0.0 else -0.5 * evidence.squares / sigma**2


@dataclass(frozen=True, eq=False)
class _Squares(Evidence):
    squares: np.ndarray


def fixes(drive, errors):
    return dict(zip(drive.stamps.tolist(), compose(drive.poses, errors), strict=True))


def test_the_score_is_best_and_coverage_right_for_a_calibrated_posterior(drive, office):
    options = WindowOptions(scans=1, windows=400, travel=0.0, near=800, far=40, reference_error=0.005)
    rivals = draw_rivals(options, office)
    windows = cut_windows(drive, office, rivals, options)
    rng = np.random.default_rng(8)
    truth = 0.06
    model = Gaussian(truth, fixes(drive, rng.normal(0.0, (truth, truth, 0.25 * truth), (len(drive), 3))))
    evidence = gather_evidence(model, drive, windows)
    sigmas = (0.02, 0.04, 0.06, 0.09, 0.2)
    scores = dict(zip(sigmas, score_windows(model, evidence, sigmas, rivals), strict=True))
    means = {sigma: score.mean for sigma, score in scores.items()}
    assert max(means, key=means.get) == truth
    assert means[truth] - means[0.02] > 2.0
    # 400 windows: a standard error of 0.011.
    assert scores[truth].coverage == pytest.approx(0.95, abs=0.03)
    assert scores[0.02].coverage < 0.5
    assert scores[0.2].coverage > 0.99


def test_a_posterior_need_not_be_surer_than_the_reference_is(drive, office):
    # The reference comes from the same scans, so that they agree with it better than with the truth.
    options = WindowOptions(scans=1, windows=100, travel=0.0, near=800, far=0)
    rivals = draw_rivals(options, office)
    windows = cut_windows(drive, office, rivals, options)
    model = Gaussian(0.04, fixes(drive, np.zeros((len(drive), 3))))
    sure, right, flat = score_windows(model, gather_evidence(model, drive, windows), [0.01, 0.04, 0.15], rivals)
    assert right.mean > max(sure.mean, flat.mean) + 1.0
    assert right.coverage == pytest.approx(0.95, abs=0.051)
    assert sure.coverage < 0.2


def test_scores_are_those_of_normal_distributions(drive, office):
    options = WindowOptions(scans=1, windows=20, near=4000, far=0)
    rivals = draw_rivals(options, office)
    windows = cut_windows(drive, office, rivals, options)
    fix, widths = np.array([0.05, -0.08, 0.02]), np.array([0.1, 0.1, 0.025])
    model = Gaussian(0.1, fixes(drive, np.tile(fix, (len(drive), 1))))
    (scores,) = score_windows(model, gather_evidence(model, drive, windows), [0.1], rivals)
    at_truth = norm.logpdf(rivals.offsets[:20], fix, widths).sum(axis=1)
    mean = norm.logpdf(fix, rivals.centres, np.hypot(widths, [0.25, 0.25, 0.1])).sum(axis=1)
    np.testing.assert_allclose(scores.log_score, (at_truth - mean).mean(), atol=0.05)


def test_weights_that_say_nothing_score_nothing(drive, office):
    options = WindowOptions(scans=2, windows=20, far=0)
    rivals = draw_rivals(options, office)
    windows = cut_windows(drive, office, rivals, options)
    model = Gaussian(1e9, fixes(drive, np.zeros((len(drive), 3))))
    evidence = gather_evidence(model, drive, windows)
    # Without any weight nav2 makes all equal.
    for scores in score_windows(model, evidence, [1e9, 0.0], rivals):
        np.testing.assert_allclose(scores.log_score, 0.0, atol=1e-9)
        # The prior's own region misses the truth as often as it says.
        assert scores.coverage == pytest.approx(0.95, abs=0.051)


def test_being_sure_of_another_place_is_no_coverage(office):
    options = WindowOptions(near=50, far=10)
    rivals = draw_rivals(options, office)
    log_weights = np.zeros((1, 2, 60))
    log_weights[0, 0, 55] = 40.0
    sure, calm = judge_weights(log_weights, 50, rivals)
    assert (sure.coverage, calm.coverage) == (0.0, 1.0)
    # All but nothing of the posterior lies at one of ten far poses, half the prior.
    assert sure.log_score[0] == pytest.approx(np.log(20.0) - 40.0, abs=1e-6)


def test_a_factor_of_all_weights_changes_no_score(office):
    """Weights of scans are 1e-1000 and less: only their ratios may count."""
    options = WindowOptions(near=50, far=10)
    rivals = draw_rivals(options, office)
    log_weights = np.random.default_rng(4).normal(0.0, 2.0, (2, 3, 60))
    for as_it_is, shifted in zip(*(judge_weights(log_weights + by, 50, rivals) for by in (0.0, -3000.0)), strict=True):
        np.testing.assert_allclose(shifted.log_score, as_it_is.log_score, rtol=1e-9)
        np.testing.assert_allclose(shifted.denser, as_it_is.denser, rtol=1e-9)
        assert np.ptp(as_it_is.log_score) > 0.1


def test_rivals_make_sums_integrals(office):
    options = WindowOptions(near=4000)
    rivals = draw_rivals(options, office)
    np.testing.assert_allclose((rivals.density * rivals.volumes).sum(axis=1), 1.0, atol=0.25)
    np.testing.assert_allclose(rivals.mass.sum(axis=1), 1.0, rtol=1e-12)
    # Moments of the priors come out of the weighted rivals.
    np.testing.assert_allclose(rivals.mass @ rivals.offsets, rivals.centres, atol=0.08)
    # Truths are off from the reference, and priors from truths, as far as said: the mean of chi with 3 degrees, 1.6.
    truths = rivals.offsets[:20]
    np.testing.assert_allclose(np.linalg.norm(truths / (0.04, 0.04, 0.01), axis=1).mean(), 1.6, atol=0.02)
    off = (rivals.centres - truths) / (0.25, 0.25, 0.1)
    np.testing.assert_allclose(np.linalg.norm(off, axis=1).mean(), 1.6, atol=0.02)
    assert (np.linalg.norm(off, axis=1) > np.sqrt(7.815)).sum() == 1


@pytest.mark.parametrize(("stack", "model"), [(stack, model) for stack in STACKS for model in STACKS[stack].models])
def test_gathered_evidence_weighs_as_the_emulator_does(drive, office, stack, model):
    options = WindowOptions(scans=2, windows=15, near=50, far=20)
    windows = cut_windows(drive, office, draw_rivals(options, office), options)[:3]
    kind = parameter_class(stack, model)
    start = kind(**({"laser_model_type": model} if "laser_model_type" in kind.__dataclass_fields__ else {}))
    emulator = build_model(stack, model, office, start)
    rng = np.random.default_rng(4)
    candidates = [
        replace(start, **{name: getattr(start, name) * rng.uniform(0.2, 2.0) for name in emulator.fitted_parameters})
        for _ in range(11)
    ]
    got = gather_evidence(emulator, drive, windows).log_weights(emulator, candidates)
    assert got.shape == (3, 11, 70)
    for c, parameters in enumerate(candidates):
        one = emulator.with_parameters(parameters)
        for w, window in enumerate(windows):
            poses = np.concatenate([window.near, window.far], axis=1)
            expected = sum(one.log_likelihood(drive.scan(int(i)), p) for i, p in zip(window.scans, poses, strict=True))
            np.testing.assert_allclose(got[w, c], expected, rtol=0.0, atol=1e-9)


def test_beam_skipping_weighs_all_rivals_of_a_window_at_once(drive, office):
    options = WindowOptions(scans=2, windows=15, near=50, far=20)
    windows = cut_windows(drive, office, draw_rivals(options, office), options)[:2]
    start = Nav2Parameters(laser_model_type="likelihood_field_prob", do_beamskip=True, beam_skip_distance=0.1)
    model = build_model("nav2", "likelihood_field_prob", office, start)
    got = gather_evidence(model, drive, windows).log_weights(model, [start])[1, 0]
    scans = zip(windows[1].scans, windows[1].near, windows[1].far, strict=True)
    expected = sum(model.log_likelihood(drive.scan(int(i)), np.concatenate([near, far])) for i, near, far in scans)
    np.testing.assert_allclose(got, expected, atol=1e-9)


def test_windows_move_their_rivals_with_the_reference_and_keep_to_one_block(drive, office):
    options = WindowOptions(scans=3, windows=30)
    rivals = draw_rivals(options, office)
    windows = cut_windows(drive, office, rivals, options)
    assert {window.fold for window in windows} == {0, 1, HELD_OUT}
    for window in windows[::7]:
        reference = drive.poses[window.scans]
        np.testing.assert_allclose(window.near[0], compose(reference[0], rivals.offsets), atol=1e-12)
        steps = between(window.near[0], window.near[2])
        np.testing.assert_allclose(steps, np.broadcast_to(between(reference[0], reference[2]), steps.shape), atol=1e-9)
        travel = np.hypot(*np.diff(reference[:, :2], axis=0).T)
        turn = np.abs(between(reference[:-1], reference[1:])[:, 2])
        assert ((travel >= options.travel) | (turn >= options.turn)).all()
        assert office.look_up(office.free, window.far[0, :, :2]).all()


def test_missing_coverage_has_its_price():
    sure = PosteriorScores(np.full(10, 3.0), np.array([0.5] * 5 + [0.96] * 5)[:, None])
    calm = PosteriorScores(np.full(10, 2.5), np.full((10, 1), 0.5))
    assert (sure.coverage, calm.coverage) == (0.5, 1.0)
    assert sure.mean > calm.mean
    assert net_score(calm) > net_score(sure)


@pytest.fixture(scope="module")
def prob_fit(drive, office):
    return fit_stack(
        "nav2", "likelihood_field_prob", drive, office, options=EXACT,
        start=Nav2Parameters(laser_model_type="likelihood_field_prob", sigma_hit=0.5, max_beams=60),
    )  # fmt: skip


def test_a_fit_improves_the_posterior_on_windows_it_has_not_seen(prob_fit, drive, office):
    windows = cut_windows(drive, office, draw_rivals(EXACT, office), EXACT)
    held_out = sum(window.fold == HELD_OUT for window in windows)
    for trial in (prob_fit.before, prob_fit.chosen, prob_fit.trials[0]):
        assert (len(trial.held_out.log_score), len(trial.crossed.log_score)) == (held_out, len(windows) - held_out)
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
        "beluga", "beam", drive, office, start=BelugaParameters(laser_model_type="beam"), beam_parameters=TRUTH,
        options=replace(EXACT, near=100, far=25),
    )  # fmt: skip
    assert fit.how == "maximum likelihood"
    values = fit.parameters
    assert (values.z_hit, values.z_short, values.z_max, values.z_rand) == (0.80, 0.10, 0.03, 0.07)
    assert (values.sigma_hit, values.lambda_short) == (0.05, 0.6)
    assert net_score(fit.chosen.held_out) > net_score(fit.before.held_out)


def test_nav2s_beam_values_are_the_learned_density_up_to_a_factor(office):
    finder = RangeFinder.from_bearings([0.0], 10.0)
    inputs = FitInputs(Nav2Parameters(laser_model_type="beam"), finder, office, [60], TRUTH)
    values, learned = model_named("nav2", "beam").with_learned(inputs.start, inputs)
    assert learned
    model = build_model("nav2", "beam", office, values)
    z = np.array([3.98, 4.0, 4.1, 5.0])  # not short of z* = 4: the short term has no normaliser in nav2
    from beamfield.models.beam_density import beam_log_density
    from beamfield.stacks.emulation.emulator import RayEvidence

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


@pytest.mark.parametrize(("n_beams", "counts"), [(4, [4]), (3, [3]), (1, [2])])
def test_sensors_of_few_beams_have_something_to_try(office, n_beams, counts):
    finder = RangeFinder.from_bearings(np.linspace(0.0, 3.0, n_beams), 4.0)
    for stack, name in (("nav2", "max_beams"), ("ros1", "laser_max_beams"), ("beluga", "max_beams")):
        start = parameter_class(stack, "likelihood_field")()
        space = fit_space(stack, "likelihood_field", start, finder, office, None)
        assert [setting[name] for setting in space.settings] == counts
    for stack, model in (("mrpt", "LF_Thrun"), ("mrpt", "rayTracing"), ("f1tenth", "table")):
        space = fit_space(stack, model, parameter_class(stack, model)(), finder, office, None)
        assert [next(iter(setting.values())) for setting in space.settings] == [1]


def test_a_start_that_nothing_beats_is_kept(drive, office, prob_fit):
    again = fit_stack(
        "nav2", "likelihood_field_prob", drive, office, start=prob_fit.parameters, options=replace(EXACT, seed=1)
    )
    assert net_score(again.chosen.crossed) >= net_score(again.before.crossed)


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
        ({"near": 3}, "near: expected at least 40"),
        ({"spread": 0.0}, "spread: expected a positive number"),
        ({"travel": -1.0}, "travel: expected a number >= 0"),
        ({"windows": 2.5}, "windows: expected a whole number"),
        ({"seed": -1}, "seed: expected at least 0, got -1"),
        ({"reference_error": 1e-170}, "reference_error: expected a positive number from"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_options_that_make_no_sense_are_refused(values, message):
    with pytest.raises(InvalidInputError, match=message):
        WindowOptions(**values)
