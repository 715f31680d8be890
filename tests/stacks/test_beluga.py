"""Beluga's models: values on a small room, readings, beams and the map."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.beluga.models import BelugaBeam, BelugaField, BelugaFieldProb
from beamfield.stacks.beluga.parameters import BelugaParameters
from tests.stacks.small_room import COMMON, MAX_RANGE, POSES, small_room, small_scan

PARAMETERS = BelugaParameters(**COMMON, laser_max_range=MAX_RANGE, only_obstacle_boundaries=False)
OFFSET = (0.1, -0.05, 0.3)
# What Beluga's compiled code returned.
ANSWERS = {
    "field": (BelugaField, {}, {}, [197.5708335830173, 60.79428104517796, 64.58033302086248, 31.84075902314112]),
    "field, unknown space": (
        BelugaField, {"model_unknown_space": True}, {},
        [197.6834330199053, 61.030799009285104, 64.58033302086248, 31.84075902314112],
    ),
    "prob": (
        BelugaFieldProb, {}, {},
        [10.74694443672811, 4.113650737014059e-09, 0.0001177785129263598, 1.660531336449495e-07],
    ),
    "beam": (BelugaBeam, {}, {}, [270.05315507355647, 0.0806446293231219, 12.83335160818874, 10.329477998389686]),
    "beam, sensor off the centre": (
        BelugaBeam, {}, {"mount": OFFSET},
        [114.35863650157276, 30.285737730685206, 52.62784272848823, 21.581412127046868],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ANSWERS)
def test_weights_are_those_of_the_program(name):
    kind, changes, options, expected = ANSWERS[name]
    distance = {} if kind is BelugaBeam else {"distance": "brushfire"}
    model = kind(small_room(), dataclasses.replace(PARAMETERS, **changes), map_mode="raw", **distance)
    weights = np.exp(model.log_likelihood(small_scan(**options), POSES))
    assert weights == pytest.approx(expected, rel=1e-6, abs=0.0)


def test_readings_outside_the_limits_are_dropped_and_the_longest_range_is_a_hit():
    scan = Scan([0.05, 0.1, 2.0, np.inf, np.nan, -np.inf], RangeFinder.from_bearings(np.zeros(6), 2.0, min_range=0.1))
    assert BelugaField(small_room(), PARAMETERS).evidence(scan, POSES).beams.tolist() == [1, 2]
    legacy = BelugaField(small_room(), PARAMETERS, no_return="range_max")
    assert legacy.evidence(scan, POSES).beams.tolist() == [1, 2, 3]
    nearer = dataclasses.replace(PARAMETERS, laser_max_range=1.0, laser_min_range=0.2)
    assert BelugaField(small_room(), nearer).evidence(scan, POSES).beams.tolist() == []


def test_beams_are_selected_before_readings_are_dropped():
    ranges = np.full(16, np.nan)
    ranges[1:5] = 0.5
    scan = Scan(ranges, small_scan().finder)
    few = dataclasses.replace(PARAMETERS, max_beams=4)
    assert BelugaField(small_room(), PARAMETERS).evidence(scan, POSES).beams.tolist() == [1, 2, 3, 4]
    assert len(BelugaField(small_room(), few).evidence(scan, POSES).beams) < 4


def test_z_rand_is_divided_by_laser_max_range_whatever_the_sensors():
    far = OccupancyGrid.from_ros([[100] + [0] * 200], 0.1)
    scan = Scan([1.0], RangeFinder.from_bearings([0.0], 8.0))
    model = BelugaField(far, BelugaParameters(z_rand=0.4, laser_max_range=50.0))
    assert model.beam_values(model.evidence(scan, [[10.0, 0.05, 0.0]]))[0, 0] == pytest.approx(0.4 / 50.0)


def test_in_a_map_without_obstacles_every_distance_is_the_maximum():
    scan = Scan([1.0], RangeFinder.from_bearings([0.0], 8.0))
    for distance in ("exact", "brushfire"):
        parameters = BelugaParameters(laser_likelihood_max_dist=0.4)
        model = BelugaField(OccupancyGrid.from_ros(np.zeros((30, 30)), 0.1), parameters, distance=distance)
        evidence = model.evidence(scan, [[1.0, 1.0, 0.0], [2.5, 1.0, 0.0]])
        farthest = 0.5 / (0.2 * np.sqrt(2.0 * np.pi)) * np.exp(-2.0) + 0.5 / 100.0
        assert model.beam_values(evidence)[:, 0] == pytest.approx([farthest, 1.0 / 100.0])


def test_unknown_space_is_worth_no_less_than_the_maximum_distance():
    row = OccupancyGrid.from_ros([[100, 0, 0, 0, 0, 0, 0, -1]], 1.0)
    scan = Scan([0.0], RangeFinder.from_bearings([0.0], 8.0))
    here = [[7.5, 0.5, 0.0]]
    for limit, expected in (
        (2.0, 1.0 / 100.0),
        (0.4, 0.5 / (0.2 * np.sqrt(2.0 * np.pi)) * np.exp(-2.0) + 0.5 / 100.0),
    ):
        model = BelugaField(row, BelugaParameters(model_unknown_space=True, laser_likelihood_max_dist=limit))
        assert model.beam_values(model.evidence(scan, here))[0, 0] == pytest.approx(expected)


def test_only_obstacles_beside_free_cells_count_with_only_obstacle_boundaries():
    thick = OccupancyGrid.from_ros([[0, 100, 100, 100, 100, 100, -1]], 1.0)
    scan = Scan([0.0], RangeFinder.from_bearings([0.0], 8.0))
    poses = [[col + 0.5, 0.5, 0.0] for col in range(7)]
    model = BelugaField(thick, BelugaParameters(only_obstacle_boundaries=True))
    evidence = model.evidence(scan, poses)
    assert evidence.distances[:, 0].tolist() == [1.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    inside = dataclasses.replace(model.parameters, model_unknown_space=True)
    # The inside of the wall and the unknown cell.
    assert (model.beam_values(evidence, inside)[:, 0] == 1.0 / 100.0).tolist() == [False, False] + [True] * 5
    everything = dataclasses.replace(model.parameters, only_obstacle_boundaries=False)
    again = model.with_parameters(everything).evidence(scan, poses)
    assert again.distances[:, 0].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    with pytest.raises(InvalidInputError, match="only_obstacle_boundaries: expected True as in the evidence"):
        model.log_weights(evidence, everything)


def test_the_node_hands_no_map_options_to_likelihood_field_prob():
    scan = small_scan()
    changed = dataclasses.replace(PARAMETERS, only_obstacle_boundaries=True, model_unknown_space=True)
    model = BelugaFieldProb(small_room(), PARAMETERS)
    expected = model.log_likelihood(scan, POSES)
    assert (BelugaFieldProb(small_room(), changed).log_likelihood(scan, POSES) == expected).all()
    # Neither needs new evidence there.
    assert (model.log_weights(model.evidence(scan, POSES), changed) == expected).all()


def test_unknown_space_needs_no_new_evidence():
    scan = small_scan()
    model = BelugaField(small_room(), PARAMETERS)
    changed = dataclasses.replace(PARAMETERS, model_unknown_space=True)
    got = model.log_weights(model.evidence(scan, POSES), changed)
    assert (got == BelugaField(small_room(), changed).log_likelihood(scan, POSES)).all()
    assert (got != model.log_likelihood(scan, POSES)).any()


def test_a_scan_without_beams_has_the_weight_0_in_the_beam_model_only():
    scan = Scan(np.full(16, np.nan), small_scan().finder)
    assert BelugaBeam(small_room(), PARAMETERS).log_likelihood(scan, POSES).tolist() == [-np.inf] * 4
    assert BelugaField(small_room(), PARAMETERS).log_likelihood(scan, POSES).tolist() == [0.0] * 4
    assert BelugaFieldProb(small_room(), PARAMETERS).log_likelihood(scan, POSES).tolist() == [0.0] * 4


def test_beam_sees_from_the_robots_centre():
    """A sensor 1 m ahead of the robot that measures 2 m is a reading of 3 m."""
    row = OccupancyGrid.from_ros([[0] * 40 + [100]], 0.1)
    scan = Scan([2.0], RangeFinder.from_bearings([0.0], 8.0, mount=(1.0, 0.0, 0.0)))
    evidence = BelugaBeam(row, PARAMETERS).evidence(scan, [[0.05, 0.05, 0.0]])
    assert evidence.ranges == pytest.approx([3.0])
    parameters = dataclasses.replace(PARAMETERS, laser_max_range=8.0)
    evidence = BelugaBeam(row, parameters).evidence(scan, [[0.05, 0.05, 0.0]])
    assert evidence.expected_ranges[0] == pytest.approx([4.0])


@pytest.mark.parametrize("rays", ["bresenham", "exact"])
def test_rays_meet_nothing_past_the_edge_of_the_map(rays):
    grid = OccupancyGrid.from_ros([[0, 0, 0, 100]], 1.0)
    model = BelugaBeam(grid, BelugaParameters(laser_max_range=9.0), rays=rays)
    scan = Scan([2.0, 2.0], RangeFinder.from_bearings([0.0, np.pi], 10.0))
    ranges = model.evidence(scan, [[1.5, 0.5, 0.0], [-3.0, 0.5, 0.0]]).expected_ranges
    assert ranges.tolist() == [[2.0 if rays == "bresenham" else 1.5, 9.0], [9.0, 9.0]]


def test_lambda_short_0_leaves_the_short_term_out():
    model = BelugaBeam(small_room(), dataclasses.replace(PARAMETERS, lambda_short=0.0))
    without = dataclasses.replace(PARAMETERS, z_short=0.0)
    evidence = model.evidence(small_scan(), POSES)
    assert (model.beam_values(evidence) == model.beam_values(evidence, without)).all()
