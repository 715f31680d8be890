"""Sample sightings from known noise, learn it again; and what the learner says when the data are not as modelled."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize, stats

from beamfield.detection_log import DetectionLog
from beamfield.detections import SPURIOUS, UNKNOWN, Detections
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import wrap_angle
from beamfield.io.parameters.landmark_model_file import read_landmark_model
from beamfield.landmark_noise.em import NoiseLikelihood, NoiseProblem, NoiseTheta, climb_noise, noise_starts
from beamfield.landmark_noise.learning import learn_landmark_parameters
from beamfield.landmark_noise.sighting_table import sighting_table
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from tests.threads import forced_threads

MAP = LandmarkMap([[0.0, 0.0], [9.0, 1.0], [8.0, 7.0], [1.0, 8.0], [4.0, 4.0]], ids=[4, 9, 2, 7, 30])
MOUNT = (0.2, -0.1, 0.7)
BOTH = LandmarkParameters(
    0.15, 0.03, spurious_rate=0.08, max_range=14.0, range_bias=0.25, bearing_bias=-0.05, range_scale=1.04
)
RANGE_ONLY = replace(BOTH, sigma_bearing=None, bearing_bias=0.0)
BEARING_ONLY = replace(BOTH, sigma_range=None, range_bias=0.0, range_scale=1.0, max_range=None, sigma_bearing=0.1)
KINDS = {"range and bearing": BOTH, "range only": RANGE_ONLY, "bearing only": BEARING_ONLY}
NAMES = ("range_bias", "range_scale", "sigma_range", "bearing_bias", "sigma_bearing", "spurious_rate")


def simulate(truth: LandmarkParameters, rng: np.random.Generator, n: int = 400, landmarks: LandmarkMap = MAP):
    """Return a log whose spurious features keep the id of the landmark they were taken for."""
    poses = rng.uniform([1.0, 1.0, -3.0], [8.0, 7.0, 3.0], (n, 3))
    model = LandmarkModel(landmarks, truth, correspondence="known", mount=MOUNT)
    detections = []
    for i, z in enumerate(model.sample(poses, rng)):
        wrong = rng.random(len(z)) < truth.spurious_rate
        ranges = np.where(wrong & ~np.isnan(z.ranges), rng.uniform(0.0, truth.max_range or 1.0, len(z)), z.ranges)
        bearings = np.where(wrong & ~np.isnan(z.bearings), rng.uniform(-math.pi, math.pi, len(z)), z.bearings)
        detections.append(Detections(ranges, bearings, ids=z.ids, stamp=0.1 * i))
    return DetectionLog(poses, tuple(detections))


def learn(log: DetectionLog, landmarks: LandmarkMap = MAP, **options):
    return learn_landmark_parameters(landmarks, log, mount=MOUNT, **{"n_replicates": 60, **options})


def names_of(result) -> set[str]:
    return {finding.name for finding in result.findings}


def finding(result, name: str):
    return next(item for item in result.findings if item.name == name)


def edited(log: DetectionLog, change) -> DetectionLog:
    return replace(log, detections=tuple(change(i, z) for i, z in enumerate(log.detections)))


def test_one_start_trusts_the_middle_half_of_the_residuals_and_one_all():
    """Ranges off by -0.1, 0.1, 0.3 and 4 m, bearings by -0.02, 0, 0.03 and 1 rad, seen from the origin."""
    off = np.array([[-0.1, -0.02], [0.1, 0.0], [0.1, 0.0], [0.3, 0.03], [4.0, 1.0]])
    z = Detections(9.0 + off[:, 0], off[:, 1], ids=[1] * 5, stamp=0.0)
    log = DetectionLog(np.zeros((1, 3)), (z,))
    table = sighting_table(LandmarkMap([[9.0, 0.0]], ids=[1]), log)
    robust, plain = noise_starts(NoiseLikelihood(table, NoiseProblem(14.0)))
    assert robust.range_bias == pytest.approx(0.1)
    # Median distances from the median: 0, 0, 0.2, 0.2, 3.9 and 0, 0, 0.02, 0.03, 1.
    assert robust.sigma_range == pytest.approx(1.4826 * 0.2)
    assert robust.bearing_bias == pytest.approx(0.0, abs=1e-12)
    assert robust.sigma_bearing == pytest.approx(1.4826 * 0.02)
    assert (plain.range_bias, plain.sigma_range) == pytest.approx((0.88, np.std(off[:, 0])))
    assert (plain.bearing_bias, plain.sigma_bearing) == pytest.approx((0.202, np.std(off[:, 1])))
    assert (robust.spurious_rate, plain.spurious_rate) == (0.1, 0.01)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_known_parameters_come_back_within_their_standard_errors(kind, seed):
    truth = KINDS[kind]
    result = learn(simulate(truth, np.random.default_rng(seed)), max_range=truth.max_range)
    assert result.converged
    learned = set(result.intervals)
    assert learned == {name for name in NAMES if getattr(truth, name) not in (None, 0.0, 1.0)}
    for name in learned:
        off = abs(getattr(result.parameters, name) - getattr(truth, name))
        assert off < 4.0 * result.standard_errors[name], name
        # Useful, too: not an error bar that holds everything.
        assert result.standard_errors[name] < 0.15 * abs(getattr(truth, name)) + 0.01, name
    for name in set(NAMES) - learned:
        assert getattr(result.parameters, name) == getattr(truth, name), name
    # 160 of 2000 sightings are spurious: none at all is excluded.
    low, high = result.intervals["spurious_rate"]
    assert 0.04 < low < high < 0.13


def test_intervals_hold_the_truth_as_often_as_they_say():
    held = []
    for seed in range(14):
        result = learn(simulate(BOTH, np.random.default_rng(100 + seed), n=200), max_range=14.0, fit_scale=True)
        held += [low <= getattr(BOTH, name) <= high for name, (low, high) in result.intervals.items()]
    # 84 intervals of 95%: fewer than 71 would be a chance of 1e-5.
    assert sum(held) >= 71


def test_intervals_allow_for_errors_that_last():
    landmarks, held, n_blocks = MAP, 0, 24
    for seed in range(8):
        rng = np.random.default_rng(seed)
        truth = replace(RANGE_ONLY, range_scale=1.0, spurious_rate=0.0, range_bias=0.0)
        log = simulate(truth, rng, n=480)
        lasting = np.repeat(rng.normal(0.0, 0.1, n_blocks), 480 // n_blocks)
        log = edited(log, lambda i, z, lasting=lasting: replace(z, ranges=z.ranges + lasting[i]))
        result = learn(log, landmarks, fit_spurious=False, fit_scale=False)
        low, high = result.intervals["range_bias"]
        held += low <= 0.0 <= high
        # The errors alone: 0.1 m / sqrt(24); as if independent: 0.18 m / sqrt(2400).
        assert 0.012 < result.standard_errors["range_bias"] < 0.03
    assert held >= 6


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("scale", [False, True], ids=["bias", "bias and scale"])
def test_em_never_falls(kind, scale, rng):
    log = simulate(replace(KINDS[kind], range_scale=1.0, range_bias=0.1), rng, n=150)
    table = sighting_table(MAP, log, mount=MOUNT)
    likelihood = NoiseLikelihood(table, NoiseProblem(14.0, fit_scale=scale))
    bad = NoiseTheta(-2.0, 1.0, 3.0, 2.0, 2.5, 0.9)
    for start in (*noise_starts(likelihood), bad):
        climb = climb_noise(likelihood, start, tolerance=1e-12, max_iterations=200)
        assert len(climb.trace) > 3
        assert np.diff(climb.trace).min() >= -1e-9


def test_the_end_is_the_maximum_that_a_general_optimiser_finds(rng):
    log = simulate(replace(BOTH, range_scale=1.0, range_bias=0.1), rng, n=150)
    table = sighting_table(MAP, log, mount=MOUNT)
    e, b = table.range_residuals, table.bearing_residuals
    log_none = np.where((table.ranges >= 0) & (table.ranges <= 14.0), -np.log(14.0 * 2.0 * np.pi), -np.inf)

    def log_likelihood(x: np.ndarray) -> float:
        bias, sigma, shift, spread = x[0], np.exp(x[1]), x[2], np.exp(x[3])
        rate = 1.0 / (1.0 + np.exp(-x[4]))
        first = stats.norm.logpdf(e, bias, sigma)
        second = stats.truncnorm.logpdf(wrap_angle(b - shift), -np.pi / spread, np.pi / spread, 0.0, spread)
        return float(np.logaddexp(np.log1p(-rate) + first + second, np.log(rate) + log_none).mean())

    found = optimize.minimize(
        lambda x: -log_likelihood(x), [0.0, -1.5, 0.0, -3.0, -2.0], method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-14, "maxiter": 4000, "maxfev": 6000, "adaptive": True},
    )  # fmt: skip
    likelihood = NoiseLikelihood(table, NoiseProblem(14.0))
    ends = [climb_noise(likelihood, start, tolerance=1e-13) for start in noise_starts(likelihood)]
    best = max(ends, key=lambda climb: climb.trace[-1])
    assert best.trace[-1] == pytest.approx(-found.fun, abs=1e-9)
    theta = best.theta
    got = [theta.range_bias, np.log(theta.sigma_range), theta.bearing_bias, np.log(theta.sigma_bearing)]
    np.testing.assert_allclose(got, found.x[:4], atol=2e-4)
    assert theta.spurious_rate == pytest.approx(1.0 / (1.0 + np.exp(-found.x[4])), abs=2e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_the_likelihood_is_the_landmark_models_own(kind, rng):
    log = simulate(KINDS[kind], rng, n=60)
    result = learn(log, max_range=KINDS[kind].max_range)
    p = result.parameters
    model = LandmarkModel(MAP, p, correspondence="known", mount=MOUNT)
    total = 0.0
    for pose, z in zip(log.poses, log.detections, strict=True):
        of_landmark = model.detection_log_likelihood(z, pose)
        of_none = model.detection_log_likelihood(replace(z, ids=np.full(len(z), SPURIOUS)), pose)
        total += np.logaddexp(np.log1p(-p.spurious_rate) + of_landmark, np.log(p.spurious_rate) + of_none).sum()
    assert result.log_likelihood == pytest.approx(total / sum(map(len, log.detections)), rel=1e-9)


def test_biases_are_reported_and_do_not_end_up_in_the_sigmas(rng):
    truth = replace(BOTH, range_scale=1.0, range_bias=2.8, spurious_rate=0.0)
    result = learn(simulate(truth, rng))
    assert result.parameters.sigma_range == pytest.approx(0.15, rel=0.1)
    text = finding(result, "range-bias").full_text
    assert text.startswith("Range bias +2.")
    assert "Remove it at the sensor (mount, clock) or keep range_bias." in text
    assert finding(result, "bearing-bias").values["bias"] == pytest.approx(-0.05, abs=0.01)
    assert "sigma_range would be 2.8" in text


def test_no_bias_is_reported_where_there_is_none(rng):
    truth = LandmarkParameters(0.15, 0.03)
    result = learn(simulate(truth, rng))
    assert names_of(result) <= {"no-spurious", "range-bias", "bearing-bias"}
    assert result.parameters.spurious_rate == 0.0
    low, high = result.intervals["spurious_rate"]
    # The rule of three, wider as few blocks are less sure of their own number.
    wider = stats.t.ppf(0.975, result.n_blocks - 1) / stats.norm.ppf(0.975)
    assert (low, high) == (0.0, pytest.approx(-np.log(0.05) * wider**2 / result.n_sightings))
    assert result.parameters.range_scale == 1.0


def test_intervals_of_few_blocks_are_those_of_students_t(rng):
    """The bias is a mean: its interval is that of the blocks' means, as textbooks have it."""
    landmarks = LandmarkMap([[0.0, 0.0], [6.0, 0.0], [3.0, 5.0]])
    n_blocks, n_places = 4, 30
    poses = rng.uniform([1.0, 1.0, -3.0], [5.0, 4.0, 3.0], (n_blocks * n_places, 3))
    shifts = np.repeat(rng.normal(0.0, 0.1, n_blocks), n_places)
    errors = shifts[:, None] + rng.normal(0.0, 0.05, (len(poses), 3))
    distances = np.hypot(*(landmarks.positions[None] - poses[:, None, :2]).transpose(2, 0, 1))
    seen = [
        Detections(r, np.full(3, np.nan), ids=landmarks.ids, stamp=float(i)) for i, r in enumerate(distances + errors)
    ]
    result = learn_landmark_parameters(
        landmarks, DetectionLog(poses, seen), fit_scale=False, fit_spurious=False, block_s=float(n_places)
    )
    assert result.n_blocks == n_blocks
    means = errors.reshape(n_blocks, -1).mean(axis=1)
    reach = stats.t.ppf(0.975, n_blocks - 1) * means.std(ddof=1) / np.sqrt(n_blocks)
    np.testing.assert_allclose(
        result.intervals["range_bias"], means.mean() + np.array([-reach, reach]), atol=0.15 * reach
    )
    low, high = result.intervals["sigma_range"]
    assert result.parameters.sigma_range**2 == pytest.approx(low * high)


def test_a_result_says_and_saves_what_was_learned(rng, tmp_path):
    result = learn(simulate(BOTH, rng, n=40), max_range=14.0)
    assert all(name in result.summary() for name in NAMES)
    result.save(tmp_path / "landmark_model.yaml")
    saved = read_landmark_model(tmp_path / "landmark_model.yaml")
    assert saved.sigma_range == pytest.approx(result.parameters.sigma_range, rel=1e-5)


def test_a_scale_is_learned_only_where_it_is_worth_it_or_asked_for(rng):
    scaled = simulate(BOTH, rng)
    assert learn(scaled, max_range=14.0).parameters.range_scale == pytest.approx(1.04, abs=0.01)
    without = learn(scaled, max_range=14.0, fit_scale=False)
    assert without.parameters.range_scale == 1.0
    assert "range-scale" not in names_of(without)
    assert "times the true ones" in finding(learn(scaled, max_range=14.0), "range-scale").text
    plain = simulate(replace(BOTH, range_scale=1.0), rng)
    assert learn(plain, max_range=14.0).parameters.range_scale == 1.0
    asked = learn(plain, max_range=14.0, fit_scale=True)
    assert asked.parameters.range_scale != 1.0
    assert asked.parameters.range_scale == pytest.approx(1.0, abs=0.01)
    # The sensor is only blamed for a scale that is surely wrong.
    low, high = asked.intervals["range_scale"]
    assert low < 1.0 < high
    assert "range-scale" not in names_of(asked)


def test_bearings_wrap_for_a_sensor_that_looks_backwards_and_for_wide_noise(rng):
    truth = LandmarkParameters(None, 0.9, bearing_bias=3.1)
    result = learn(simulate(truth, rng), fit_spurious=False)
    off = wrap_angle(result.parameters.bearing_bias - 3.1)
    assert abs(off) < 4.0 * result.standard_errors["bearing_bias"]
    assert result.standard_errors["bearing_bias"] < 0.1
    assert result.parameters.sigma_bearing == pytest.approx(0.9, abs=4.0 * result.standard_errors["sigma_bearing"])


def test_features_of_no_use_are_counted_and_known_spurious_ones_count_as_such(rng):
    log = simulate(replace(BOTH, spurious_rate=0.0), rng, n=100)

    def change(i, z):
        ids = z.ids.copy()
        ids[0] = UNKNOWN
        ids[1] = SPURIOUS
        return replace(z, ids=ids) if i else z.without_ids()

    poses = log.poses.copy()
    poses[5] = np.nan
    result = learn(replace(edited(log, change), poses=poses))
    # One observation without ids, one without pose; of the others one of five features is unknown.
    assert finding(result, "features-left-out").values == {"n_unknown": 99.0 + 5.0, "n_without_pose": 4.0}
    assert result.n_sightings == 98 * 4
    assert result.parameters.spurious_rate == pytest.approx(0.25, abs=0.005)
    without = learn(replace(edited(log, change), poses=poses), fit_spurious=False)
    assert (without.parameters.spurious_rate, without.n_sightings) == (0.0, 98 * 3)


def test_spurious_features_beyond_the_sensors_limit_are_refused(rng):
    log = simulate(RANGE_ONLY, rng, n=30)
    log = edited(log, lambda i, z: replace(z, ids=np.full(len(z), SPURIOUS), ranges=z.ranges + 20.0) if i == 3 else z)
    with pytest.raises(InvalidInputError, match=r"max_range: expected ranges of .* in \[0, 14\], got .* at stamp 0\.3"):
        learn(log, max_range=14.0)


def test_ranges_of_landmarks_beyond_the_sensors_limit_are_refused(rng):
    log = simulate(RANGE_ONLY, rng, n=30)
    log = edited(log, lambda i, z: replace(z, ranges=z.ranges + 1e8) if i == 3 else z)
    with pytest.raises(InvalidInputError, match=r"a range of 1e\+08 m at stamp 0\.3 is beyond .* limit of 14 m: leave"):
        learn(log, max_range=14.0)


def test_heavy_tails_are_found(rng):
    log = simulate(replace(RANGE_ONLY, spurious_rate=0.0), rng)
    log = edited(log, lambda _, z: replace(z, ranges=z.ranges + 0.1 * rng.standard_t(2.0, len(z))))
    result = learn(log, fit_spurious=False)
    tails = finding(result, "range-heavy-tails")
    assert tails.values["beyond"] > 0.02
    # Only features without ids have the larger spurious_rate that the finding advises.
    rates = [replace(result.parameters, spurious_rate=rate, max_range=14.0) for rate in (0.0, 0.3)]
    models = [LandmarkModel(MAP, noise, correspondence="sum", mount=MOUNT) for noise in rates]
    seen, pose = log.detections[0], log.poses[0]
    believed = [model.log_likelihood(seen, pose) for model in models]
    doubted = [model.log_likelihood(seen.without_ids(), pose) for model in models]
    assert believed[0] == believed[1]
    assert doubted[0] != doubted[1]
    assert tails.do.endswith("and features without ids: it believes the ids that they carry.")


def test_a_landmark_in_the_wrong_place_and_noise_that_grows_are_found(rng):
    log = simulate(LandmarkParameters(0.05, 0.02), rng)
    moved = LandmarkMap([*MAP.positions[:4], MAP.positions[4] + [0.3, 0.0]], ids=MAP.ids)
    grown = edited(log, lambda _, z: replace(z, ranges=z.ranges + 0.05 * z.ranges * rng.standard_normal(len(z))))
    assert finding(learn(grown), "range-sigma-by-distance").values["far"] > 0.25
    misplaced = LandmarkMap(moved.positions, ids=MAP.ids)
    poses = np.column_stack([np.full(len(log), 7.5), np.linspace(3.5, 4.5, len(log)), np.zeros(len(log))])
    model = LandmarkModel(MAP, LandmarkParameters(0.05, 0.02), correspondence="known", mount=MOUNT)
    seen = [replace(z, stamp=float(i)) for i, z in enumerate(model.sample(poses, rng))]
    result = learn(DetectionLog(poses, tuple(seen)), misplaced)
    by_landmark = finding(result, "range-bias-by-landmark")
    assert by_landmark.values["id"] == 30.0
    assert by_landmark.values["worst"] > 0.1


def test_a_landmark_that_its_sightings_do_not_fit_is_named(rng):
    log = simulate(BOTH, rng)
    far_off = LandmarkMap([*MAP.positions[:4], MAP.positions[4] + [4.0, 0.0]], ids=MAP.ids)
    misplaced = finding(learn(log, far_off), "landmark-misplaced")
    assert misplaced.values["id"] == 30.0
    assert misplaced.values["worst"] > 0.9
    assert misplaced.text.endswith("of the sightings of landmark 30 do not fit it.")
    far_off = LandmarkMap(far_off.positions + np.where(MAP.ids == 7, 4.0, 0.0)[:, None], ids=MAP.ids)
    text = finding(learn(log, far_off), "landmark-misplaced").text
    assert re.search(r"landmark (7 .* nor do most of 30|30 .* nor do most of 7)\.", text)
    assert "landmark-misplaced" not in names_of(learn(log))
    # Not where most do not fit.
    assert "landmark-misplaced" not in names_of(learn(replace(log, poses=log.poses * [1000.0, 1000.0, 1.0])))


def test_lengths_in_other_units_and_places_of_another_frame_are_not_to_be_used(rng):
    log = simulate(BOTH, rng)
    assert not {"many-spurious", "bearing-unrelated"} & names_of(learn(log))
    in_cm = edited(log, lambda _, z: replace(z, ranges=100.0 * z.ranges))
    scale = finding(learn(in_cm), "range-scale")
    assert scale.severity == "error"
    assert scale.do == "Check that ranges, poses and landmarks are all in metres and of one frame."
    in_mm = finding(learn(replace(log, poses=log.poses * [1000.0, 1000.0, 1.0])), "many-spurious")
    assert in_mm.severity == "error"
    assert in_mm.text == f"{in_mm.values['rate']:.0%} of the sightings do not fit the landmark that they name."
    swapped = finding(learn(replace(log, poses=log.poses[:, [1, 0, 2]])), "many-spurious")
    assert swapped.severity == "warning"
    assert "that x and y are not swapped" in swapped.do


def test_spurious_features_of_no_landmark_name_none(rng):
    named_none = edited(simulate(BOTH, rng), lambda i, z: replace(z, ids=z.ids if i % 3 else np.full(len(z), SPURIOUS)))
    assert "many-spurious" not in names_of(learn(named_none))


def test_bearings_of_a_narrow_camera_that_count_clockwise_are_unrelated(rng):
    """Turned the wrong way round they are off by less than a radian, but by more than they spread."""

    def ahead(_, z, turn=1.0):
        seen = np.abs(z.bearings) < 0.5
        return Detections(z.ranges[seen], turn * z.bearings[seen], ids=z.ids[seen], stamp=z.stamp)

    log = simulate(replace(BOTH, spurious_rate=0.0, sigma_bearing=0.1), rng)
    assert "bearing-unrelated" not in names_of(learn(edited(log, ahead)))
    turned = learn(edited(log, lambda i, z: ahead(i, z, -1.0)))
    assert 0.4 < turned.parameters.sigma_bearing < 0.9
    assert finding(turned, "bearing-unrelated").severity == "error"


def test_errors_longer_than_a_block_are_found(rng):
    log = simulate(LandmarkParameters(0.05, None), rng, n=480)
    drift = np.sin(np.arange(480) / 480 * 4.0 * np.pi)
    log = edited(log, lambda i, z: replace(z, ranges=z.ranges + 0.3 * drift[i]))
    assert finding(learn(log), "range-blocks-depend").values["correlation"] > 0.5


def test_places_are_the_blocks_where_a_log_has_them(rng):
    log = simulate(BOTH, rng, n=120)
    places = np.repeat([5, 3, 9], 40)
    result = learn(replace(log, places=places), max_range=14.0)
    assert result.n_blocks == 3
    assert finding(result, "few-blocks").values == {"n_blocks": 3.0}
    assert learn(replace(log, places=places), max_range=14.0, block_s=1.0).n_blocks == 12


def test_one_block_has_neither_intervals_nor_scores(rng):
    log = edited(simulate(BOTH, rng, n=60), lambda _, z: replace(z, stamp=0.0))
    result = learn(log, max_range=14.0)
    assert (result.intervals, result.n_blocks) == ({}, 1)
    assert "no-intervals" in names_of(result)


def test_exact_measurements_stop_at_a_floor_and_say_so(rng):
    log = simulate(LandmarkParameters(1e-12, 1e-12), rng, n=50)
    result = learn(log)
    assert result.parameters.sigma_range == 1e-6
    assert {"range-exact", "bearing-exact"} <= names_of(result)


def test_too_few_iterations_are_reported(rng):
    result = learn(simulate(BOTH, rng, n=60), max_range=14.0, max_iterations=1)
    assert not result.converged
    assert "not-converged" in names_of(result)


def test_threads_and_seed_decide_no_bit_but_the_draws(rng):
    log = simulate(BOTH, rng, n=100)
    with forced_threads(1):
        first = learn(log, max_range=14.0)
    with forced_threads(2):
        second = learn(log, max_range=14.0)
    assert first.intervals == second.intervals
    assert learn(log, max_range=14.0, seed=1).intervals != first.intervals


def test_progress_counts_replicates(rng):
    seen = []
    learn(simulate(BOTH, rng, n=30), n_replicates=5, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(i + 1, 5) for i in range(5)]


def test_too_little_data_is_an_error_that_says_where_the_rest_went(rng):
    log = simulate(BOTH, rng, n=30)
    poses = log.poses.copy()
    poses[2:] = np.nan
    with pytest.raises(
        TooLittleDataError, match=r"10 sightings .* need 20: 0 more are of unknown .*, 140 have no pose"
    ):
        learn(replace(log, poses=poses))


def test_ranges_that_shrink_with_distance_have_no_scale(rng):
    log = simulate(RANGE_ONLY, rng, n=60)
    log = edited(log, lambda _, z: replace(z, ranges=20.0 - 1.5 * z.ranges))
    with pytest.raises(TooLittleDataError, match="do not grow with the distance"):
        learn(log, fit_scale=True, fit_spurious=False)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_iterations": 0}, "max_iterations: expected at least 1, got 0"),
        ({"max_range": np.inf}, "max_range: expected a positive, finite number of metres, got inf"),
        ({"n_replicates": 1}, "n_replicates: expected at least 2, got 1"),
        ({"block_s": 0.0}, "block_s: expected a positive number of seconds, got 0.0"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, dict) else "",
)
def test_impossible_options_are_refused(options, message, rng):
    with pytest.raises(InvalidInputError, match=message):
        learn(simulate(BOTH, rng, n=20), **options)


def test_a_mount_that_is_no_pose_and_an_unknown_id_are_refused(rng):
    log = simulate(BOTH, rng, n=20)
    with pytest.raises(InvalidInputError, match=r"mount: expected shape \(3,\), got \(2, 3\)"):
        learn_landmark_parameters(MAP, log, mount=np.zeros((2, 3)))
    with pytest.raises(InvalidInputError, match="ids: expected ids of the map, got 30"):
        learn_landmark_parameters(LandmarkMap(MAP.positions[:4], ids=[4, 9, 2, 7]), log)


def test_the_table_expects_what_the_model_expects(rng):
    log = simulate(BOTH, rng, n=20)
    table = sighting_table(MAP, log, mount=MOUNT)
    model = LandmarkModel(MAP, LandmarkParameters(1.0, 1.0), correspondence="known", mount=MOUNT)
    expected = model.expected(log.poses).reshape(-1, 2)
    np.testing.assert_allclose(table.expected_ranges, expected[:, 0], rtol=1e-14)
    np.testing.assert_allclose(wrap_angle(table.expected_bearings - expected[:, 1]), 0.0, atol=1e-13)
