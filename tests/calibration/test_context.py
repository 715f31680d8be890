"""How much beams may count, and parameters learned in context: known dependence comes back, gradients are exact."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration.context.evidence import BeamEvidence, FieldEvidence
from beamfield.calibration.context.exponent import EXPONENTS, learn_exponent, scan_log_likelihoods, score_exponents
from beamfield.calibration.context.learning import learn_in_context, score_and_weights
from beamfield.calibration.pose_windows import WindowOptions, cut_windows, draw_rivals, draw_rivals_of_each
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.log import simulate_log

# A poor sensor of few beams: its posteriors are wider than the poses that compete are apart.
POOR = BeamParameters(0.75, 0.05, 0.05, 0.15, 0.5, 0.4)
N_BEAMS, COPIES = 9, 4
EXACT = 0.002


@pytest.fixture(scope="module")
def poor_drive(office: OccupancyGrid) -> SensorLog:
    finder = RangeFinder.from_bearings(np.linspace(-2.5, 2.5, N_BEAMS), 10.0)
    return simulate_log(office, finder, POOR, duration=240.0, scan_rate=2.0, seed=8).only_sensor()


@pytest.fixture(scope="module")
def copied_drive(poor_drive: SensorLog) -> SensorLog:
    """The same with every reading four times."""
    finder = RangeFinder(np.repeat(poor_drive.finder.mounts, COPIES, axis=0), poor_drive.finder.max_range)
    return replace(poor_drive, ranges=np.repeat(poor_drive.ranges, COPIES, axis=1), finder=finder)


@pytest.fixture(scope="module")
def windows(drive: SensorLog, office: OccupancyGrid):
    options = WindowOptions(scans=2, windows=20, near=80, far=20, seed=1)
    rivals = draw_rivals(options, office)
    return rivals, cut_windows(drive, office, rivals, options)[:4]


@pytest.fixture(scope="module")
def once(poor_drive, office):
    return learn_exponent(BeamModel(office, POOR), poor_drive, office, reference_error=EXACT)


def test_independent_beams_count_whole(once):
    assert (once.n_beams, once.beams_of_scan, once.n_scans) == (N_BEAMS, N_BEAMS, 4)
    for exponent in (once.single, once.drive):
        assert exponent.value > 0.75
        assert exponent.interval[1] == 1.0
        assert exponent.coverage == pytest.approx(0.9, abs=0.08)


def test_beams_that_come_four_times_count_a_quarter(copied_drive, once, office):
    learned = learn_exponent(BeamModel(office, POOR), copied_drive, office, reference_error=EXACT)
    for exponent, whole in ((learned.single, once.single), (learned.drive, once.drive)):
        low, high = exponent.interval
        assert low < 1.0 / COPIES < high
        assert exponent.value == pytest.approx(whole.value / COPIES, rel=0.2)
        assert exponent.score > exponent.score_independent + 0.2
    assert learned.independent_beams == learned.single.value * N_BEAMS * COPIES


def test_an_error_of_the_reference_poses_limits_the_exponent(copied_drive, office):
    """And it is told how much."""
    model = BeamModel(office, POOR)
    unsure = learn_exponent(model, copied_drive, office, reference_error=0.2).drive
    assert unsure.value < 0.6 / COPIES
    assert unsure.if_reference_exact > 1.3 * unsure.value


def test_the_seed_matters_less_than_the_log(poor_drive, office):
    """Guesses at the truth that all windows shared did not average out, and the interval knew nothing of it."""
    model = BeamModel(office, POOR)
    learned = [learn_exponent(model, poor_drive, office, reference_error=0.2, seed=seed).drive for seed in range(4)]
    logs = np.log([[one.value, *one.interval] for one in learned])
    assert logs[:, 0].std(ddof=1) < 0.05
    assert (logs[:, 1] < logs[:, 0].mean()).all()
    assert (logs[:, 0].mean() < logs[:, 2]).all()


def test_each_window_is_judged_by_its_own_guesses(drive, office):
    options = WindowOptions(scans=2, windows=20, near=80, far=20, seed=1)
    cut = cut_windows(drive, office, draw_rivals_of_each(options, office), options)
    assert len({window.rivals.offsets.tobytes() for window in cut}) == len(cut)
    values = scan_log_likelihoods(BeamModel(office, POOR), drive, cut).sum(axis=1)
    powers = np.array([0.02, 0.3])
    together = score_exponents(values, powers, [window.rivals for window in cut])
    for i, window in enumerate(cut):
        for scores, alone in zip(together, score_exponents(values[i : i + 1], powers, window.rivals), strict=True):
            np.testing.assert_allclose(scores.log_score[i], alone.log_score[0], rtol=1e-12)
            np.testing.assert_allclose(scores.denser[i], alone.denser[0], rtol=1e-12)


def test_the_models_own_exponent_does_not_matter(drive, office, windows):
    _, cut = windows
    model = LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.1, 0.1), n_beams=20)
    tempered = LikelihoodFieldModel(office, model.parameters, n_beams=20, exponent=0.25)
    np.testing.assert_allclose(
        scan_log_likelihoods(tempered, drive, cut), scan_log_likelihoods(model, drive, cut), rtol=1e-12
    )


def test_a_short_log_is_refused(drive, office):
    with pytest.raises(TooLittleDataError, match="windows of 4 scans"):
        learn_exponent(BeamModel(office, POOR), drive.select(np.arange(200, 240)), office)


def _evidence(office, drive, cut, kind):
    if kind == "field":
        model = LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.1, 0.1), n_beams=20)
        return model, FieldEvidence(model, drive, cut)
    model = BeamModel(office, BeamParameters(0.8, 0.1, 0.03, 0.07, 0.08, 0.6, 0.02, 0.01), n_beams=10)
    return model, BeamEvidence(model, drive, cut)


@pytest.mark.parametrize("kind", ["beam", "field"])
def test_evidence_is_the_models_likelihood(drive, office, windows, kind):
    _, cut = windows
    model, evidence = _evidence(office, drive, cut, kind)
    expected = scan_log_likelihoods(model, drive, cut).sum(axis=1)
    np.testing.assert_allclose(evidence.log_likelihood(evidence.start), expected, atol=1e-6)
    for name, value in vars(model.parameters).items():
        assert getattr(evidence.parameters(evidence.start), name) == pytest.approx(value)


@pytest.mark.parametrize("kind", ["beam", "field"])
def test_the_scores_gradient_is_that_of_finite_differences(drive, office, windows, kind):
    rivals, cut = windows
    _, evidence = _evidence(office, drive, cut, kind)
    power = 0.1

    def score(point):
        return score_and_weights(power * evidence.log_likelihood(point), rivals)[0].sum()

    scores, weights = score_and_weights(power * evidence.log_likelihood(evidence.start), rivals)
    (judged,) = score_exponents(evidence.log_likelihood(evidence.start), np.array([power]), rivals)
    np.testing.assert_allclose(scores, judged.log_score, rtol=1e-12)
    np.testing.assert_allclose(weights.sum(axis=1), 0.0, atol=1e-12)
    steps = 1e-5 * np.eye(len(evidence.start))
    slopes = [(score(evidence.start + step) - score(evidence.start - step)) / 2e-5 for step in steps]
    np.testing.assert_allclose(power * evidence.gradient(evidence.start, weights), slopes, rtol=1e-5, atol=1e-6)


def test_a_window_that_no_pose_explains_has_no_gradient(windows):
    rivals, _ = windows
    values = np.vstack([np.full((1, 100), -np.inf), np.linspace(-3.0, 0.0, 100)[None]])
    scores, weights = score_and_weights(values, rivals)
    assert scores[0] == pytest.approx(0.0, abs=1e-12)
    assert not weights[0].any()
    assert weights[1].any()


def test_a_wrong_sigma_is_mended_in_context(drive, office):
    """The start is four times too wide; the steps that are kept do better where nothing was learned."""
    start = LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.15, 0.4), n_beams=20)
    options = WindowOptions(reference_error=0.02, near=200, far=50)
    learned = learn_in_context(start, drive, office, options=options)
    independent, exponent_only, in_context = learned.held_out
    assert learned.steps > 0
    assert (np.diff(learned.fitted) >= 0.0).all()
    assert learned.stopping[learned.steps] == max(learned.stopping)
    assert learned.parameters.sigma_hit < 0.25
    assert in_context.scores.mean > exponent_only.scores.mean + 0.1 > independent.scores.mean
    assert EXPONENTS[0] < learned.exponent <= 1.0
    assert in_context.parameters == learned.parameters


@pytest.mark.parametrize(("z_hit", "z_rand"), [(0.0, 1.0), (0.9, 0.0)])
def test_a_field_without_one_of_its_causes_starts_with_next_to_nothing_of_it(windows, drive, office, z_hit, z_rand):
    field = LikelihoodFieldModel(office, LikelihoodFieldParameters(z_hit, z_rand, 0.2), n_beams=5)
    evidence = FieldEvidence(field, drive, windows[1])
    start = evidence.parameters(evidence.start)
    assert start.z_hit + start.z_rand == pytest.approx(z_hit + z_rand, abs=1e-15)
    assert 0.0 < min(start.z_hit, start.z_rand) < 2e-4


def test_a_field_that_has_its_own_unknown_is_refused(drive, office):
    field = LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.1, 0.1), unknown="uniform")
    with pytest.raises(InvalidInputError, match="expected a field with 'free'"):
        learn_in_context(field, drive, office)
