"""What holds for every measurement model; a new model joins by an entry in conftest.CASES."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy import stats

from beamfield.detections import UNKNOWN
from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from tests.compiled_kernels import compiled_kernels
from tests.contract.conftest import POSES
from tests.threads import forced_threads


def test_batch_equals_one_by_one(case):
    for options in case.options:
        model = case.build(**options)
        for z in case.measurements:
            batch = model.log_likelihood(z, POSES)
            assert batch.shape == (len(POSES),)
            assert batch.tolist() == [float(model.log_likelihood(z, pose)) for pose in POSES]


def test_any_shape_of_poses(case):
    model, z = case.build(), case.measurements[0]
    poses = np.stack([POSES[:3], POSES[3:6]])
    assert model.log_likelihood(z, poses).shape == (2, 3)
    assert model.log_likelihood(z, poses)[1, 2] == model.log_likelihood(z, POSES[5])
    assert model.log_likelihood(z, POSES[0]).shape == ()
    assert model.log_likelihood(z, np.empty((0, 3))).shape == (0,)
    assert model.log_likelihood(z, np.empty((4, 0, 3))).shape == (4, 0)


@pytest.mark.parametrize("move", [(3.0, -7.0, 0.0), (0.0, 0.0, np.pi / 2), (-120.3, 45.7, 2.1)])
def test_moving_map_and_poses_together_changes_nothing(case, move):
    for options in case.options:
        model, moved = case.build(**options), case.build(np.array(move), **options)
        for z in case.measurements:
            expected = model.log_likelihood(z, POSES)
            np.testing.assert_allclose(moved.log_likelihood(z, compose(move, POSES)), expected, rtol=1e-7)


def test_never_nan_and_never_plus_infinity(case):
    for options in case.options:
        model = case.build(**options)
        for z in case.measurements:
            values = model.log_likelihood(z, POSES)
            assert not np.isnan(values).any()
            assert (values < np.inf).all()


def test_beams_or_features_sum_to_the_whole(case):
    for options in case.options:
        model = case.build(**options)
        parts = getattr(model, "beam_log_likelihood", None) or getattr(model, "detection_log_likelihood", None)
        if parts is None:
            continue
        for z in case.measurements:
            each, n = parts(z, POSES), len(z.ranges) if isinstance(z, Scan) else len(z)
            assert each.shape == (len(POSES), n)
            np.testing.assert_allclose(each.sum(axis=-1), model.log_likelihood(z, POSES), rtol=1e-12)


def test_a_measurement_of_nothing_says_nothing(case):
    maps_aside = [z for z in case.measurements if not isinstance(z, OccupancyGrid)]
    empty = [z for z in maps_aside if (np.isnan(z.ranges).all() if isinstance(z, Scan) else not len(z))]
    assert empty
    for options in case.options:
        for z in empty:
            assert not case.build(**options).log_likelihood(z, POSES).any()


def test_an_exponent_scales_the_logarithm(with_exponent):
    for z in with_exponent.measurements:
        plain, tempered = (with_exponent.build(exponent=x).log_likelihood(z, POSES) for x in (1.0, 0.25))
        assert (tempered == 0.25 * plain).all()


def test_poses_that_are_no_numbers_are_an_error(case):
    model = case.build()
    with pytest.raises(InvalidInputError, match="poses: expected finite numbers, got nan"):
        model.log_likelihood(case.measurements[0], [[0.0, np.nan, 0.0]])
    with pytest.raises(InvalidInputError, match=r"poses: expected shape \(\.\.\., 3\)"):
        model.log_likelihood(case.measurements[0], [[0.0, 0.0]])


def test_inputs_are_left_alone(case):
    model = case.build()
    for z in case.measurements:
        poses, before = POSES.copy(), copy.deepcopy(z)
        model.log_likelihood(z, poses)
        assert (poses == POSES).all()
        assert pickle.dumps(before) == pickle.dumps(copy.deepcopy(z))


def test_survives_pickling_and_compiles_nothing_anew(case):
    for options in case.options:
        model = case.build(**options)
        expected = [model.log_likelihood(z, POSES).tolist() for z in case.measurements]
        known = compiled_kernels()
        twin, measurements = pickle.loads(pickle.dumps((model, case.measurements)))
        assert [twin.log_likelihood(z, POSES).tolist() for z in case.measurements] == expected
        assert [model.log_likelihood(z, POSES).tolist() for z in measurements] == expected
        assert compiled_kernels() == known
        assert writeable((twin, measurements)) == writeable((model, case.measurements))


def writeable(value):
    """Return whether each array of a model may be written to."""
    if isinstance(value, np.ndarray):
        return value.flags.writeable
    return [
        writeable(part) for part in (value if isinstance(value, tuple) else getattr(value, "__dict__", {}).values())
    ]


def test_is_frozen(case):
    model = case.build()
    with pytest.raises(AttributeError):
        model.parameters = None


def test_any_number_of_threads_gives_the_same_bits(case, rng):
    poses = POSES[0] + rng.normal(0.0, [0.5, 0.5, 1.0], (9001, 3))
    z = case.measurements[0]
    with forced_threads(1):
        one = case.build().log_likelihood(z, poses)
    for threads in (2, 3, 5):
        with forced_threads(threads):
            assert (case.build().log_likelihood(z, poses) == one).all()


def test_one_model_serves_several_threads_at_once(case, rng):
    poses = POSES[0] + rng.normal(0.0, [0.5, 0.5, 1.0], (500, 3))
    model, z = case.build(), case.measurements[0]
    alone = model.log_likelihood(z, poses)
    with ThreadPoolExecutor(4) as pool:
        for result in pool.map(lambda _: model.log_likelihood(z, poses), range(16)):
            assert (result == alone).all()


def test_a_best_correspondence_is_the_largest_term_of_the_sum(of_unknown_id, rng):
    poses = np.vstack([POSES, POSES[0] + rng.normal(0.0, 0.5, (200, 3))])
    by_rest: dict[str, dict[str, object]] = {}
    for options in of_unknown_id.options:
        rest = {name: value for name, value in options.items() if name != "correspondence"}
        by_rest.setdefault(str(rest), {})[options["correspondence"]] = of_unknown_id.build(**options)
    for models in by_rest.values():
        for z in of_unknown_id.measurements:
            sums = models["sum"].detection_log_likelihood(z, poses)
            best = models["nearest"].detection_log_likelihood(z, poses)
            assert (best <= sums + 1e-12).all()
            unknown = [i for i in range(len(z)) if z.ids is None or z.ids[i] == UNKNOWN]
            n_terms = 1 + len(models["sum"]._map_features)
            finite = np.isfinite(sums[:, unknown])
            assert (best[:, unknown][finite] >= sums[:, unknown][finite] - np.log(n_terms)).all()
            same = models["nearest"].correspondences(z, poses) == models["sum"].correspondences(z, poses)
            assert same.all()
            exclusive = models["assignment"].log_likelihood(z, poses)
            assert (exclusive <= best.sum(axis=1) + 1e-12).all()


def test_normalised_models_integrate_to_one(normalized):
    for options in normalized.options:
        model = normalized.build(**options)
        is_power = options.get("exponent", 1.0) != 1.0
        assert model.is_normalized == (not is_power and options.get("n_beams") is None)
        for pose in POSES:
            assert (normalized.integral(model, pose) == pytest.approx(1.0, abs=2e-4)) != is_power


def test_samples_follow_the_distribution_function(generative, rng):
    for options in generative.options:
        model = generative.build(**options)
        for pose in POSES:
            samples = model.sample(np.tile(pose, (400, 1)), rng=rng)
            assert len(samples) == 400
            uniform = generative.transform(model, samples, pose, rng)
            assert stats.kstest(uniform, "uniform").pvalue > 1e-4


def test_samples_follow_the_density(generative, rng):
    """For z drawn from p and another density q, the mean of q(z) / p(z) is 1."""
    model, other = generative.build(), generative.build(**generative.options_close_by)
    pose = POSES[0]
    samples = model.sample(np.tile(pose, (3000, 1)), rng=rng)
    log_ratio = [float(other.log_likelihood(z, pose) - model.log_likelihood(z, pose)) for z in samples]
    ratio = np.exp(log_ratio)
    assert ratio.mean() == pytest.approx(1.0, abs=4.0 * ratio.std() / np.sqrt(len(ratio)))
    assert 4.0 * ratio.std() / np.sqrt(len(ratio)) < 0.05


def test_what_a_model_can_do_is_seen_from_its_methods(case):
    model = case.build()
    if case.transform is not None:
        assert hasattr(model, "sample")
    if "match" in case.name or "field" in case.name:
        assert not hasattr(model, "sample")
        assert not hasattr(model, "expected")
    if hasattr(model, "expected"):
        assert len(model.expected(POSES)) == len(POSES)


def test_samples_repeat_with_the_seed(generative):
    model = generative.build()
    first, second = (model.sample(POSES, rng=np.random.default_rng(11)) for _ in range(2))
    for a, b in zip(first, second, strict=True):
        assert pickle.dumps(a) == pickle.dumps(b)


def test_the_true_pose_is_more_likely_than_others_on_average(generative, rng):
    model, truth = generative.build(), POSES[0]
    others = truth + np.diag([0.3, -0.3, 0.3])
    samples = model.sample(np.tile(truth, (200, 1)), rng=rng)
    scores = np.array([model.log_likelihood(z, [truth, *others]) for z in samples]).mean(axis=0)
    assert scores.argmax() == 0
