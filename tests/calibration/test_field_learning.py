"""Learning a likelihood field from a drive: parameters, exponent, scores and findings."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration.block_errors import block_interval
from beamfield.calibration.context.exponent import EXPONENTS, score_exponents, suited_exponent
from beamfield.calibration.field.findings import exponent_findings
from beamfield.calibration.field.learning import FieldLearning, learn_field_parameters
from beamfield.calibration.pose_windows import WindowOptions, draw_rivals
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import SensorLog

TRUTH = BeamParameters(0.80, 0.10, 0.03, 0.07, 0.05, 0.6, range_offset=0.02)


@pytest.fixture(scope="module")
def learned(drive: SensorLog, office: OccupancyGrid) -> FieldLearning:
    return learn_field_parameters(drive, office, beam_parameters=TRUTH, n_beams=30)


def test_hits_and_random_readings_are_about_the_simulated_ones(learned, truth):
    """Shorts are random readings to a field, and some of them end near obstacles."""
    p = learned.parameters
    assert p.z_hit == pytest.approx(truth.z_hit, abs=0.06)
    assert p.z_rand == pytest.approx(truth.z_rand + truth.z_short, abs=0.06)
    assert p.z_hit + p.z_rand == pytest.approx(1.0 - truth.z_max, abs=0.02)
    # Along the axis a wall hit at an angle is deeper than it is thick, and the distance is that across it.
    assert 0.5 * truth.sigma_hit < learned.density_sigma < 1.2 * truth.sigma_hit
    assert p.sigma_hit == pytest.approx(math.hypot(learned.density_sigma, 0.04), rel=1e-12)


def test_the_trace_never_falls(learned):
    assert learned.converged
    assert (np.diff(learned.trace) >= -1e-9 * np.abs(learned.trace[:-1])).all()
    assert learned.log_likelihood == learned.trace[-1]


def test_intervals_hold_what_was_learned(learned):
    assert set(learned.intervals) == {"z_hit", "z_rand", "sigma_hit", "exponent", "single_scan_exponent"}
    single = learned.exponents.single.value
    values = {**vars(learned.parameters), "exponent": learned.exponent, "single_scan_exponent": single}
    for name, (low, high) in learned.intervals.items():
        assert 0.0 < low < values[name] < high < 1.0, name


def test_the_exponent_makes_posteriors_that_hold_the_reference(learned):
    fit, independent, of_beam, uniform = learned.scores
    assert [s.name for s in learned.scores] == [
        "learned", "learned, exponent 1", "beam model's, exponent 1", "uniform"
    ]  # fmt: skip
    assert 0.0 < learned.exponent < 0.5
    assert fit.posterior > max(independent.posterior, of_beam.posterior) + 1.0
    assert fit.posterior > 2.0
    assert 0.85 < fit.coverage <= 1.0
    assert independent.coverage < fit.coverage
    assert (uniform.posterior, uniform.log_density) == (0.0, pytest.approx(-math.log(10.0)))
    assert fit.log_density > of_beam.log_density > uniform.log_density
    assert learned.findings == ()


def test_the_model_takes_what_was_learned(learned, drive, office):
    model = LikelihoodFieldModel(office, learned.parameters, exponent=learned.exponent, n_beams=learned.n_beams)
    pose = drive.poses[200]
    away = compose(pose, np.vstack([np.zeros(3), 0.5 * np.eye(3), -0.5 * np.eye(3)]))
    assert model.log_likelihood(drive.scan(200), away).argmax() == 0


@pytest.mark.parametrize("copies", [4, 30])
def test_beams_that_say_the_same_count_once(rng, copies):
    """Each window's likelihood is Gaussian around a place that is off by its own sigma, and counted several times."""
    options = WindowOptions(far=0, spread=0.5, turn_spread=0.2)
    rivals = draw_rivals(options, OccupancyGrid(np.zeros((5, 5)), 0.1))
    sigma = np.array([0.15, 0.15, 0.05])
    places = rng.normal(0.0, sigma, (300, 3))
    values = -0.5 * copies * np.square((rivals.offsets - places[:, None]) / sigma).sum(axis=-1)
    scores = score_exponents(values, EXPONENTS, rivals)
    # The reference's error of 0.04 m and 0.01 rad blurs it a little more.
    assert suited_exponent(np.array([s.coverage_at(0.9) for s in scores])) == pytest.approx(1.0 / copies, rel=0.25)
    assert EXPONENTS[np.argmax([score.mean for score in scores])] == pytest.approx(1.0 / copies, rel=0.35)
    assert scores[int(np.argmin(np.abs(EXPONENTS * copies - 1.0)))].coverage == pytest.approx(0.95, abs=0.03)


def test_a_wrong_map_is_told(drive, office):
    turned = OccupancyGrid(office.probability[::-1, ::-1], office.resolution, office.origin)
    result = learn_field_parameters(drive, turned, n_beams=30)
    assert "\n\nwarning (field-says-nothing): " in result.summary()
    assert [score.name for score in result.scores] == ["learned", "learned, exponent 1", "uniform"]


@pytest.mark.parametrize(("cones", "cause"), [(False, "map, the poses"), (True, "takes a sonar's cones for rays")])
def test_a_field_that_says_nothing_of_a_sonar_does_not_blame_the_map(cones, cause):
    (finding,) = exponent_findings("", 0.1, 0.2, cones=cones)
    assert finding.name == "field-says-nothing"
    assert cause in finding.why


def test_a_short_log_has_no_exponent(drive, office):
    part = drive.select(np.arange(200, 240))
    result = learn_field_parameters(part, office)
    assert (result.exponent, result.intervals["exponent"]) == (1.0, (0.0, np.inf))
    assert "field-exponent-not-learned" in [finding.name for finding in result.findings]
    assert [score.posterior for score in result.scores] == [None, None]
    assert result.n_beams == 60


def test_what_cannot_be_learned_from_is_refused(drive, office):
    with pytest.raises(InvalidInputError, match="n_beams: expected at least 1, got 0"):
        learn_field_parameters(drive, office, n_beams=0)
    with pytest.raises(InvalidInputError, match="no occupied cell"):
        learn_field_parameters(drive, OccupancyGrid(np.zeros(office.shape), office.resolution, office.origin))
    silent = replace(drive, ranges=np.full_like(drive.ranges, np.inf))
    with pytest.raises(TooLittleDataError, match="0 readings with an obstacle on their axis in the fit blocks"):
        learn_field_parameters(silent, office)


def test_intervals_stay_in_their_range():
    low, high = block_interval(1e-5, 1.0, 3, most=1.0)
    assert 0.0 <= low < 1e-5 < high <= 1.0
    low, high = block_interval(2.0, 1e9, 3)
    assert 0.0 <= low < 2.0 < high
