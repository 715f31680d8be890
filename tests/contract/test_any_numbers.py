"""Whatever finite numbers are accepted: results are never NaN, stay in their range, and come at once."""

from __future__ import annotations

import math
import time

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.detections import Detections
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import between, compose, invert, wrap_angle
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_cdf, beam_log_density, beam_responsibilities
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.landmark_poses import sample_poses
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan
from tests.compiled_kernels import compiled_kernels
from tests.contract.conftest import draw_floor

EDGES = [0.0, -0.0, 5e-324, 1e-310, 1e-160, 1e-12, 1e-9, 1e9, 1e12, 1e100, 1e160, 1e308, -5.0, -1e308]
# Numbers at all scales, with those that break arithmetic among them.
ANY = st.one_of(st.floats(allow_nan=False, allow_infinity=False), st.sampled_from(EDGES), st.floats(-10.0, 10.0))
# Those that parameters may have: from a picometre to a million kilometres.
POWER = st.floats(-12.0, 9.0).map(lambda power: min(max(10.0**power, 1e-12), 1e9))
MAGNITUDE = st.one_of(POWER, st.sampled_from([1e-12, 1e-3, 1e9]))
SIZE = st.one_of(st.just(0.0), MAGNITUDE)
RANGE = ANY.map(abs)
LIMIT = MAGNITUDE.map(lambda metres: max(metres, 1e-4))
SHARES = st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4).filter(lambda shares: sum(shares) > 0.01)
GRID = draw_floor(np.array([1.0, -2.0, 0.3]))
relaxed = settings(max_examples=100, derandomize=True)


@st.composite
def beam_parameters(draw):
    weights = np.array(draw(SHARES))
    weights /= weights.sum()
    offset = draw(SIZE) * draw(st.sampled_from([-1.0, 1.0]))
    return BeamParameters(*weights, draw(MAGNITUDE), draw(SIZE), offset, draw(SIZE))


@relaxed
@given(beam_parameters(), st.lists(RANGE, min_size=1, max_size=4), RANGE, LIMIT, st.floats(0.0, 0.99))
def test_the_beam_densities_of_all_accepted_parameters_are_numbers(parameters, ranges, expected, max_range, share):
    min_range = share * max_range
    arguments = (np.array(ranges), expected, max_range, parameters)
    log_density = beam_log_density(*arguments, min_range=min_range)
    assert not np.isnan(log_density).any()
    assert (log_density < np.inf).all()
    shares = beam_responsibilities(*arguments, min_range=min_range)
    assert np.isfinite(shares).all()
    assert ((shares >= 0.0) & (shares <= 1.0 + 1e-12)).all()
    cdf = beam_cdf(*arguments, min_range=min_range)
    measured = arguments[0] >= min_range
    assert ((cdf[measured] >= 0.0) & (cdf[measured] <= 1.0 + 1e-12)).all()


@relaxed
@given(beam_parameters(), st.lists(ANY, min_size=3, max_size=3), st.tuples(ANY, ANY, ANY), LIMIT)
def test_models_of_range_finders_know_every_pose_and_reading(parameters, ranges, pose, max_range):
    finder = RangeFinder.from_bearings([-1.0, 0.0, 2.0], max_range)
    scan = Scan(ranges, finder)
    expected = RayCaster(GRID).expected_ranges(pose, finder)
    assert ((expected >= 0.0) & (expected <= max_range)).all()
    field = LikelihoodFieldModel(GRID, LikelihoodFieldParameters(0.8, 0.1, 0.1))
    for model in (BeamModel(GRID, parameters), field):
        value = float(model.log_likelihood(scan, pose))
        assert not math.isnan(value)
        assert value < math.inf


@relaxed
@given(ANY, MAGNITUDE, MAGNITUDE, ANY, MAGNITUDE, MAGNITUDE, st.sampled_from(["exact", "table"]))
def test_sampling_poses_ends_for_every_finite_input(measured, sigma, bias, bearing, sigma_bearing, scale, method):
    noise = LandmarkParameters(sigma, sigma_bearing, range_bias=bias, range_scale=scale)
    model = LandmarkModel(LandmarkMap([[2.0, 0.0], [3.0, 1.0]]), noise, correspondence="known")
    began = time.process_time()
    try:
        seen = Detections([measured], [bearing], ids=[1])
        samples = sample_poses(model, seen, 20, np.random.default_rng(0), method=method)
    except (InvalidInputError, TooLittleDataError):
        pass
    else:
        assert np.isfinite(samples.poses).all()
    assert time.process_time() - began < 1.0


@relaxed
@given(st.tuples(ANY, ANY, ANY), st.tuples(ANY, ANY, ANY))
def test_composing_poses_of_any_size_gives_headings_on_the_circle(a, b):
    for pose, turn in ((compose(a, b), a[2] + b[2]), (invert(a), a[2]), (between(a, b), b[2] - a[2])):
        assert -math.pi < pose[2] <= math.pi or math.isinf(turn)
    assert -math.pi < float(wrap_angle(a[2])) <= math.pi


def test_whole_numbers_are_taken_as_floats_so_that_nothing_is_compiled_anew(rng):
    expected = rng.uniform(1.0, 9.0, 500)
    ranges = rng.normal(expected, 0.05)
    field = LikelihoodFieldModel(GRID, LikelihoodFieldParameters(0.8, 0.1, 0.1))
    results = []
    for max_range, min_range in ((10.0, 0.0), (10, 0)):
        learned = learn_intrinsic_parameters(ranges, expected, max_range, min_range=min_range)
        scan = Scan([2.0], RangeFinder.from_bearings([0.0], max_range, min_range=min_range))
        results.append((learned.parameters, field.log_likelihood(scan, [2.0, 2.0, 0.0]), compiled_kernels()))
    assert results[0] == results[1]
