"""What holds for every emulator."""

from __future__ import annotations

import dataclasses
import pickle
import re

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.beluga.models import BelugaBeam, BelugaField, BelugaFieldProb
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.f1tenth.parameters import F1tenthParameters
from beamfield.stacks.f1tenth.table import F1tenthTable
from beamfield.stacks.mrpt.field import MrptField
from beamfield.stacks.mrpt.parameters import MrptFieldParameters, MrptRayParameters
from beamfield.stacks.mrpt.rays import MrptRays
from beamfield.stacks.nav2.models import Nav2Beam, Nav2Field, Nav2FieldProb
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.registry import model_named, parameter_class
from beamfield.stacks.ros1.models import Ros1Beam, Ros1Field, Ros1FieldProb
from beamfield.stacks.ros1.parameters import Ros1Parameters
from tests.compiled_kernels import compiled_kernels
from tests.stacks.small_room import COMMON, small_room, small_scan
from tests.threads import forced_threads

NAV2 = Nav2Parameters(**COMMON)
ROS1 = Ros1Parameters.from_amcl(NAV2)
BELUGA = BelugaParameters(**COMMON, laser_max_range=2.0)
MRPT_FIELD = MrptFieldParameters(LF_stdHit=0.08, LF_zHit=0.6, LF_zRandom=0.2, LF_maxRange=2.0, LF_decimation=1)
MRPT_RAYS = MrptRayParameters(rayTracing_stdHit=0.3, rayTracing_decimation=1)
F1TENTH = F1tenthParameters(sigma_hit=0.8, max_range=2.0, angle_step=1)
KINDS = {
    **{f"nav2 {kind.model}": (kind, NAV2) for kind in (Nav2Field, Nav2FieldProb, Nav2Beam)},
    **{f"ros1 {kind.model}": (kind, ROS1) for kind in (Ros1Field, Ros1FieldProb, Ros1Beam)},
    **{f"beluga {kind.model}": (kind, BELUGA) for kind in (BelugaField, BelugaFieldProb, BelugaBeam)},
    "mrpt LF_Thrun": (MrptField, MRPT_FIELD),
    "mrpt rayTracing": (MrptRays, MRPT_RAYS),
    "f1tenth table": (F1tenthTable, F1TENTH),
}
OTHER_WAY = {"likelihood_field": {"distance": "brushfire"}, "likelihood_field_prob": {"distance": "brushfire"},
             "beam": {"rays": "exact"}, "LF_Thrun": {"precision": "single"}, "rayTracing": {"rays": "exact"},
             "table": {"map_mode": "raw"}}  # fmt: skip

# Widths and powers; all other numbers may be 0.
POSITIVE = re.compile("sigma|std|squash")


@pytest.fixture(params=KINDS)
def emulator(request):
    return KINDS[request.param]


@pytest.fixture(params=["default", "other way"])
def model(request, emulator):
    kind, parameters = emulator
    return kind(small_room(), parameters, **(OTHER_WAY[kind.model] if request.param == "other way" else {}))


@pytest.fixture
def poses(rng):
    """In and around the room, in walls and off the map."""
    return np.array([0.5, 1.2, 0.0]) + rng.normal(0.0, [0.8, 0.7, 2.0], (200, 3))


def test_says_who_it_is(emulator):
    kind, parameters = emulator
    assert not kind.is_normalized
    assert model_named(kind.stack, kind.model).emulator is kind
    assert parameter_class(kind.stack, kind.model) is type(parameters)
    for name in (*kind.evidence_settings, *kind.fitted_parameters):
        assert hasattr(parameters, name)
    assert not set(kind.evidence_settings) & set(kind.fitted_parameters)


def test_a_batch_equals_one_by_one(model, poses):
    scan = small_scan(special=True)
    batch = model.log_likelihood(scan, poses)
    assert batch.shape == (200,)
    assert [float(model.log_likelihood(scan, pose)) for pose in poses[:20]] == batch[:20].tolist()
    assert (model.log_likelihood(scan, poses.reshape(10, 20, 3)) == batch.reshape(10, 20)).all()


def test_no_poses_have_no_weights(model):
    assert model.log_likelihood(small_scan(), np.empty((0, 3))).shape == (0,)


def test_evidence_serves_all_fitted_parameters(model, poses):
    # One NaN leaves ROS 1's beam model without weights.
    scan = small_scan(special=not isinstance(model, Ros1Beam))
    evidence = model.evidence(scan, poses)
    for factor in (0.3, 1.7):
        changes = {name: factor * getattr(model.parameters, name) for name in model.fitted_parameters}
        parameters = dataclasses.replace(model.parameters, **changes)
        got = model.log_weights(evidence, parameters)
        assert (got == model.with_parameters(parameters).log_likelihood(scan, poses)).all()
        assert (got != model.log_weights(evidence)).any()


def test_evidence_of_other_settings_is_refused(model, poses):
    evidence = model.evidence(small_scan(), poses)
    name = next(name for name in model.evidence_settings if name.endswith(("max_beams", "decimation", "_step")))
    was, other = (16, 8) if name.endswith("max_beams") else (1, 2)
    fewer = dataclasses.replace(model.parameters, **{name: other})
    with pytest.raises(InvalidInputError, match=f"{name}: expected {was} as in the evidence, got {other}"):
        model.log_weights(evidence, fewer)
    assert len(model.with_parameters(fewer).evidence(small_scan(), poses).beams) < len(evidence.beams)


def test_never_nan_whatever_the_readings_and_parameters(model, poses):
    finder = small_scan().finder
    far = np.array([[1e8, -1e8, 0.3], [1e15, 1e15, 1.0]])
    for readings in (np.nan, np.inf, -np.inf, 0.0, 2.0, 1e9, 1e300):
        scan = Scan(np.full(16, readings), finder)
        for changes in ({}, {name: 0.0 for name in model.fitted_parameters if not POSITIVE.search(name)}):
            with_zeros = model.with_parameters(dataclasses.replace(model.parameters, **changes))
            weights = with_zeros.log_likelihood(scan, np.concatenate([poses, far]))
            assert not np.isnan(weights).any()
            assert (weights < np.inf).all()


def test_maps_without_obstacles_and_without_free_cells_are_scored(emulator, poses):
    kind, parameters = emulator
    for value in (0, 100, -1):
        grid = OccupancyGrid.from_ros(np.full((4, 5), value), 0.1)
        for options in ({}, OTHER_WAY[kind.model]):
            weights = kind(grid, parameters, **options).log_likelihood(small_scan(special=True), poses)
            assert not np.isnan(weights).any()


def test_inputs_stay_as_they_are(model, poses):
    scan = small_scan(special=True)
    ranges, before = scan.ranges.copy(), poses.copy()
    evidence = model.evidence(scan, poses)
    arrays = {k: np.copy(v) for k, v in vars(evidence).items() if isinstance(v, np.ndarray)}
    model.log_weights(evidence)
    np.testing.assert_array_equal(scan.ranges, ranges)
    assert (poses == before).all()
    for name, array in arrays.items():
        np.testing.assert_array_equal(getattr(evidence, name), array)


def test_pickles(model, poses):
    scan = small_scan()
    expected, known = model.log_likelihood(scan, poses), compiled_kernels()
    again = pickle.loads(pickle.dumps(model))
    assert (again.log_likelihood(scan, poses) == expected).all()
    assert compiled_kernels() == known
    evidence = pickle.loads(pickle.dumps(model.evidence(scan, poses)))
    assert (model.log_weights(evidence) == model.log_likelihood(scan, poses)).all()


def test_any_number_of_threads_gives_the_same_bits(emulator, poses):
    kind, parameters = emulator
    one = kind(small_room(), parameters).log_likelihood(small_scan(), poses)
    with forced_threads(3):
        assert (kind(small_room(), parameters).log_likelihood(small_scan(), poses) == one).all()


def test_read_only_poses_and_maps_are_taken(model, poses):
    expected = model.log_likelihood(small_scan(), poses)
    poses.flags.writeable = False
    assert (model.log_likelihood(small_scan(), poses) == expected).all()


def test_moving_map_and_poses_together_changes_nothing(model, poses):
    """Some honour the yaw of the map's origin; AMCL and MRPT ignore it, so that only a shift leaves weights alone."""
    grid, scan = model.grid, small_scan()
    move = np.array([3.0, -7.0, 1.1 if model.stack in ("beluga", "f1tenth") else 0.0])
    moved = OccupancyGrid(grid.probability, grid.resolution, compose(move, grid.origin))
    again = dataclasses.replace(model, grid=moved)
    got = again.log_likelihood(scan, compose(move, poses))
    # MRPT moves maps by whole cells, whose side is in single precision.
    assert got == pytest.approx(model.log_likelihood(scan, poses), rel=1e-6 if model.stack == "mrpt" else 1e-9)


def test_poses_that_are_none_are_refused(model):
    with pytest.raises(InvalidInputError, match="poses: expected finite numbers"):
        model.log_likelihood(small_scan(), [[0.0, np.nan, 0.0]])
