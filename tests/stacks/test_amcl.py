"""nav2's and ROS 1's models: values on a small room, readings, beams and the map."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.emulation.emulator import KNOWN, OFF_MAP, UNKNOWN
from beamfield.stacks.nav2.models import Nav2Beam, Nav2Field, Nav2FieldProb
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.ros1.models import Ros1Beam, Ros1Field, Ros1FieldProb
from beamfield.stacks.ros1.parameters import Ros1Parameters
from tests.stacks.small_room import COMMON, MAX_RANGE, POSES, SPECIAL, small_room, small_scan

PARAMETERS = Nav2Parameters(**COMMON)
OFFSET = (0.1, -0.05, 0.3)
# What nav2's compiled code returned.
ANSWERS = {
    "field": (Nav2Field, {}, [2.508506680030707, 1.705120390188572, 2.096050811897076, 1.462240812869076]),
    "prob": (
        Nav2FieldProb, {}, [7.974275847121116e-09, 1.595437006582868e-14, 2.299848966537222e-13, 1.2449035680434e-14]
    ),
    "beam": (Nav2Beam, {}, [2.440179435715306, 1.0529211090921318, 1.8746209838345615, 1.507771891856137]),
    "beam, sensor off the centre": (
        Nav2Beam, {"mount": OFFSET}, [1.786721957695777, 1.5587832714182226, 2.1912774607980605, 1.3410995047352148]
    ),
}  # fmt: skip


@pytest.mark.usefixtures("past_the_message")
@pytest.mark.parametrize("name", ANSWERS)
def test_weights_are_those_of_the_program(name):
    kind, options, expected = ANSWERS[name]
    model = kind(small_room(), PARAMETERS, **({} if kind is Nav2Beam else {"distance": "brushfire"}))
    weights = np.exp(model.log_likelihood(small_scan(**options), POSES))
    assert weights == pytest.approx(expected, rel=1e-7, abs=0.0)


@pytest.mark.parametrize(("new", "old"), [(Nav2Field, Ros1Field), (Nav2FieldProb, Ros1FieldProb), (Nav2Beam, Ros1Beam)])
def test_ros1_returns_the_same_under_its_own_names(new, old):
    scan, grid = small_scan(special=old is not Ros1Beam), small_room()
    expected = new(grid, PARAMETERS).log_likelihood(scan, POSES)
    got = old(grid, Ros1Parameters.from_amcl(PARAMETERS)).log_likelihood(scan, POSES)
    assert (got == expected).all()


def test_field_skips_readings_of_the_longest_range_and_beyond_and_nan():
    scan = small_scan(special=True)
    model = Nav2Field(small_room(), PARAMETERS)
    assert model.evidence(scan, POSES).beams.tolist() == [i for i in range(16) if i not in SPECIAL]


def test_readings_that_are_too_short_become_the_longest_range():
    finder = RangeFinder.from_bearings(np.zeros(4), MAX_RANGE, min_range=0.1)
    scan = Scan([0.05, 0.1, -np.inf, 0.5], finder)
    parameters = dataclasses.replace(PARAMETERS, max_beams=4)
    assert Nav2Field(small_room(), parameters).evidence(scan, POSES).beams.tolist() == [3]
    beam = Nav2Beam(small_room(), parameters).evidence(scan, POSES)
    assert beam.ranges.tolist() == [2.0, 2.0, 2.0, 0.5]
    stricter = dataclasses.replace(parameters, laser_min_range=0.6)
    assert Nav2Field(small_room(), stricter).evidence(scan, POSES).beams.tolist() == []


def test_laser_max_range_holds_if_it_is_less_than_the_sensors():
    scan = Scan([0.5, 1.5], RangeFinder.from_bearings([0.0, 0.0], MAX_RANGE))
    for limit, used, max_range in ((1.0, [0], 1.0), (100.0, [0, 1], 2.0), (-1.0, [0, 1], 2.0), (1e40, [0, 1], 2.0)):
        parameters = Nav2Parameters(max_beams=2, laser_max_range=limit)
        evidence = Nav2Field(small_room(), parameters).evidence(scan, POSES)
        assert (evidence.beams.tolist(), evidence.max_range) == (used, max_range)


def test_limits_of_the_file_and_the_sensor_are_compared_in_single_precision():
    """In a message 8.1 is 8.10000038: the same limit, so that readings of it are the longest."""
    as_sent = [float(np.float32(8.1)), float(np.float32(0.1))]
    scan = Scan(as_sent, RangeFinder.from_bearings([0.0, 0.0], as_sent[0], min_range=0.05))
    parameters = Nav2Parameters(max_beams=2, laser_max_range=8.1, laser_min_range=0.1)
    evidence = Nav2Beam(small_room(), parameters).evidence(scan, POSES)
    assert evidence.max_range == as_sent[0]
    assert evidence.ranges.tolist() == [as_sent[0], as_sent[0]]
    # A log of numbers in double precision has a sensor's limit in double precision.
    text = Scan([5.6, 1.0], RangeFinder.from_bearings([0.0, 0.0], 5.6))
    evidence = Nav2Beam(small_room(), dataclasses.replace(parameters, laser_max_range=5.6)).evidence(text, POSES)
    assert (evidence.max_range, evidence.ranges.tolist()) == (5.6, [5.6, 1.0])


def test_beam_gives_each_class_of_readings_its_own_terms():
    """By hand: an obstacle 1 m ahead (centre to centre), readings short of it, at it, at range_max, beyond and NaN."""
    corridor = OccupancyGrid.from_ros([[0] * 11 + [100]], 0.1)
    parameters = Nav2Parameters(**WEIGHTS, max_beams=2)
    readings = [0.6, 1.1, 2.0, 2.5, np.inf, np.nan]
    finder = RangeFinder.from_bearings(np.zeros(6), MAX_RANGE)
    model = Nav2Beam(corridor, dataclasses.replace(parameters, max_beams=6))
    evidence = model.evidence(Scan(readings, finder), [[0.0, 0.0, 0.0]])
    assert evidence.expected_ranges[0] == pytest.approx([1.1] * 4)
    hit = 0.5 * np.exp(-0.5 * np.array([0.5, 0.0, 0.9, 1.4]) ** 2 / 0.1**2)
    rest = [0.1 * 2.0 * np.exp(-2.0 * 0.6) + 0.3 / 2.0, 0.3 / 2.0, 0.2, 0.0]
    # The expected range is 11 cells as the map's message has them, 16 nm more than 1.1 m: the reading is short.
    rest[1] += 0.1 * 2.0 * np.exp(-2.0 * 1.1)
    assert model.beam_values(evidence)[0] == pytest.approx(hit + rest)


WEIGHTS = {"z_hit": 0.5, "z_short": 0.1, "z_max": 0.2, "z_rand": 0.3, "sigma_hit": 0.1, "lambda_short": 2.0}


def test_z_max_comes_in_only_if_the_driver_reports_the_longest_range():
    grid, scan = small_room(), small_scan(special=True)
    missing = 6  # the reading that is +inf
    no_z_max = dataclasses.replace(PARAMETERS, z_max=0.0)
    rep_117 = Nav2Beam(grid, PARAMETERS).evidence(scan, POSES)
    assert missing not in rep_117.beams
    legacy = Nav2Beam(grid, PARAMETERS, no_return="range_max")
    evidence = legacy.evidence(scan, POSES)
    column = evidence.beams.tolist().index(missing)
    gain = legacy.beam_values(evidence) - legacy.beam_values(evidence, no_z_max)
    assert gain[:, column] == pytest.approx(PARAMETERS.z_max)


def test_beams_disagree_off_the_map_and_a_beam_that_most_poses_disagree_with_is_skipped():
    corridor = OccupancyGrid.from_ros([[0] * 11 + [100]], 0.1)
    scan = Scan([1.1, 0.5, 5.0], RangeFinder.from_bearings([0.0, 0.0, np.pi], 8.0))
    skipping = Nav2Parameters(max_beams=3, do_beamskip=True, beam_skip_distance=0.15)
    model = Nav2FieldProb(corridor, skipping)
    poses = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]
    plain = Nav2FieldProb(corridor, dataclasses.replace(skipping, do_beamskip=False))
    p = plain.beam_values(plain.evidence(scan, poses))
    assert model.log_likelihood(scan, poses) == pytest.approx(np.log(p[:, 0]))
    # With two of three beams left out, a threshold of 0.6 calls it an error: all count.
    strict = dataclasses.replace(skipping, beam_skip_error_threshold=0.6)
    assert model.with_parameters(strict).log_likelihood(scan, poses) == pytest.approx(np.log(p).sum(axis=1))
    assert plain.takes_poses_alone()
    assert not model.takes_poses_alone()
    likelihood_map(plain, scan, corridor, headings=2)
    with pytest.raises(InvalidInputError, match="switch beam skipping off"):
        likelihood_map(model, scan, corridor, headings=2)


def test_a_beam_is_skipped_by_the_share_of_poses_that_it_agrees_with():
    """Beam 0 ends within 15 cm of the obstacle at all four poses, beam 1 at two of them."""
    corridor = OccupancyGrid.from_ros([[0] * 11 + [100]], 0.1)
    scan = Scan([1.1, 1.0], RangeFinder.from_bearings([0.0, 0.0], 8.0))
    poses = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [-0.1, 0.0, 0.0], [-0.1, 0.0, 0.0]]
    parameters = Nav2Parameters(max_beams=2, do_beamskip=True, beam_skip_distance=0.15)
    for threshold, counted in ((0.45, [0, 1]), (0.55, [0]), (0.95, [0])):
        model = Nav2FieldProb(corridor, dataclasses.replace(parameters, beam_skip_threshold=threshold))
        plain = Nav2FieldProb(corridor, dataclasses.replace(parameters, do_beamskip=False))
        p = plain.beam_values(plain.evidence(scan, poses))
        assert model.log_likelihood(scan, poses) == pytest.approx(np.log(p[:, counted]).sum(axis=1))


ABOVE = Nav2Parameters(**{**COMMON, "max_beams": 17})


@pytest.mark.parametrize(
    ("kind", "parameters"), [(Nav2Beam, ABOVE), (Ros1Beam, Ros1Parameters.from_amcl(ABOVE))], ids=["nav2", "ros1"]
)
def test_max_beams_above_the_scans_beams_is_refused_in_the_beam_models_which_never_return(kind, parameters):
    with pytest.raises(InvalidInputError, match=r"max_beams: expected at most .* 16, got 17: .* never returns"):
        kind(small_room(), parameters).evidence(small_scan(), POSES)


@pytest.mark.parametrize("kind", [Nav2Field, Nav2FieldProb, Ros1Field, Ros1FieldProb])
def test_fields_then_take_all_beams(kind):
    parameters = ABOVE if kind.stack == "nav2" else Ros1Parameters.from_amcl(ABOVE)
    evidence = kind(small_room(), parameters).evidence(small_scan(), POSES)
    assert evidence.beams.tolist() == list(range(16))


def test_nan_makes_all_weights_of_ros1s_beam_model_nothing_and_is_left_out_in_nav2():
    scan = small_scan(special=True)
    without = Scan(np.where(np.isnan(scan.ranges), np.inf, scan.ranges), scan.finder)
    ros1 = Ros1Beam(small_room(), Ros1Parameters.from_amcl(PARAMETERS))
    assert ros1.log_likelihood(scan, POSES).tolist() == [-np.inf] * 4
    assert np.isfinite(ros1.log_likelihood(without, POSES)).all()
    nav2 = Nav2Beam(small_room(), PARAMETERS)
    assert (nav2.log_likelihood(scan, POSES) == nav2.log_likelihood(without, POSES)).all()
    # Of the beams that are looked at.
    few = Ros1Beam(small_room(), Ros1Parameters.from_amcl(dataclasses.replace(PARAMETERS, max_beams=6)))
    assert 4 not in few.beam_rule(16, few.parameters.as_amcl().max_beams)
    assert np.isfinite(few.log_likelihood(scan, POSES)).all()


def test_readings_beyond_laser_max_range_are_hits_in_nav2s_beam_model_and_nothing_in_ros1s():
    corridor = OccupancyGrid.from_ros([[0] * 11 + [100]], 0.1)
    scan = Scan([1.1, 0.6], RangeFinder.from_bearings([0.0, 0.0], MAX_RANGE))
    parameters = Nav2Parameters(**WEIGHTS, max_beams=2, laser_max_range=1.05)
    nav2 = Nav2Beam(corridor, parameters).evidence(scan, [[0.0, 0.0, 0.0]])
    ros1 = Ros1Beam(corridor, Ros1Parameters.from_amcl(parameters)).evidence(scan, [[0.0, 0.0, 0.0]])
    assert (nav2.beams.tolist(), ros1.beams.tolist()) == ([0, 1], [1])


def test_cells_are_centred_on_the_origin_and_its_yaw_is_ignored():
    cells = np.zeros((3, 3))
    cells[1, 1] = 100
    scan = Scan([0.0, 0.0], RangeFinder.from_bearings([0.0, 0.0], 5.0, min_range=0.0))
    scan = Scan([1e-9, 1e-9], scan.finder)
    for yaw in (0.0, 0.7):
        grid = OccupancyGrid.from_ros(cells, 1.0, [10.0, 20.0, yaw])
        model = Nav2Field(grid, Nav2Parameters(max_beams=2))
        # ROS has the cell span [11, 12) x [21, 22).
        points = [[10.51, 20.51, 0.0], [11.49, 21.49, 0.0], [11.51, 21.0, 0.0], [9.49, 20.0, 0.0]]
        evidence = model.evidence(scan, points)
        assert evidence.distances[:, 0].tolist() == [0.0, 0.0, 1.0, np.inf]
        assert evidence.places[:, 0].tolist() == [KNOWN, KNOWN, KNOWN, OFF_MAP]


def test_field_takes_unknown_cells_as_free_and_rays_take_them_as_walls():
    row = OccupancyGrid.from_ros([[0, 0, -1, -1, 0, 100]], 1.0)
    scan = Scan([2.0, 2.0], RangeFinder.from_bearings([0.0, 0.0], 10.0))
    parameters = Nav2Parameters(max_beams=2)
    field = Nav2Field(row, parameters).evidence(scan, [[0.0, 0.0, 0.0]])
    assert (field.distances[0, 0], field.places[0, 0]) == (3.0, UNKNOWN)
    rays = {
        way: Nav2Beam(row, parameters, rays=way).evidence(scan, [[0.0, 0.0, 0.0]]) for way in ("bresenham", "exact")
    }
    assert rays["bresenham"].expected_ranges[0, 0] == 2.0
    # To the border of the cell, which nav2 has at 1.5.
    assert rays["exact"].expected_ranges[0, 0] == 1.5


@pytest.mark.parametrize("rays", ["bresenham", "exact"])
def test_rays_end_at_the_edge_of_the_map_and_are_0_off_it(rays):
    grid = OccupancyGrid.from_ros(np.zeros((5, 5)), 1.0)
    model = Nav2Beam(grid, Nav2Parameters(max_beams=2), rays=rays)
    scan = Scan([2.0, 2.0], RangeFinder.from_bearings([0.0, np.pi], 10.0))
    ranges = model.evidence(scan, [[2.0, 2.0, 0.0], [-3.0, 2.0, 0.0]]).expected_ranges
    assert ranges[0] == pytest.approx([3.0, 3.0] if rays == "bresenham" else [2.5, 2.5])
    assert ranges[1].tolist() == [0.0, 0.0]


def test_distances_are_cut_off_where_the_parameters_say_without_new_evidence():
    model = Nav2Field(small_room(), PARAMETERS)
    evidence = model.evidence(small_scan(), POSES)
    for limit in (0.1, 0.5, 3.0):
        parameters = dataclasses.replace(PARAMETERS, laser_likelihood_max_dist=limit)
        anew = Nav2Field(small_room(), parameters).log_likelihood(small_scan(), POSES)
        assert (model.log_weights(evidence, parameters) == anew).all()


def test_a_brushfire_that_ends_elsewhere_needs_new_evidence():
    model = Nav2Field(small_room(), PARAMETERS, distance="brushfire")
    evidence = model.evidence(small_scan(), POSES)
    parameters = dataclasses.replace(PARAMETERS, laser_likelihood_max_dist=0.3)
    with pytest.raises(
        InvalidInputError, match=r"laser_likelihood_max_dist: expected 0\.5 as in the evidence, got 0\.3"
    ):
        model.log_weights(evidence, parameters)
    again = model.with_parameters(parameters)
    direct = Nav2Field(small_room(), parameters, distance="brushfire")
    assert (again.log_likelihood(small_scan(), POSES) == direct.log_likelihood(small_scan(), POSES)).all()


def test_options_that_do_not_exist_are_refused():
    grid = small_room()
    for kind, option, value in (
        (Nav2Field, "distance", "manhattan"),
        (Nav2Field, "map_mode", "binary"),
        (Nav2Beam, "rays", "cddt"),
        (Nav2Beam, "no_return", "zero"),
    ):
        with pytest.raises(InvalidInputError, match=f"{option}: expected .* got '{value}'"):
            kind(grid, PARAMETERS, **{option: value})
