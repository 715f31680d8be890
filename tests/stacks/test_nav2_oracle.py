"""nav2's models against what nav2's own compiled code answered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.stacks.emulation.field_table import AMCL_BRUSHFIRE, field_table
from beamfield.stacks.emulation.stack_map import read_as_stack
from beamfield.stacks.nav2.models import Nav2Beam, Nav2Field, Nav2FieldProb
from beamfield.stacks.ros1.models import Ros1Field
from beamfield.stacks.ros1.parameters import Ros1Parameters

pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("past_the_message")]

KINDS = ("", "special_", "offset_sensor_")


def only(case, name):
    if name not in case.nav2:
        pytest.skip(f"this oracle has no {name}")
    return case.nav2[name]


def weights(model, case, kind):
    return np.exp(model.log_likelihood(case.scan(kind), case.poses))


@pytest.mark.parametrize("kind", KINDS)
def test_likelihood_field(case, kind):
    model = Nav2Field(case.grid, case.nav2_parameters, distance="brushfire")
    assert weights(model, case, kind) == pytest.approx(case.nav2[f"{kind}likelihood_field"], rel=1e-12)


@pytest.mark.parametrize("kind", ["", "special_"])
def test_likelihood_field_prob(case, kind):
    expected = case.nav2[f"{kind}likelihood_field_prob"]
    model = Nav2FieldProb(case.grid, case.nav2_parameters, distance="brushfire")
    # abs=0: the weights are as small as 1e-52.
    assert weights(model, case, kind) == pytest.approx(expected, rel=1e-11, abs=0.0)


@pytest.mark.parametrize("kind", KINDS)
def test_beam(case, kind):
    model = Nav2Beam(case.grid, case.nav2_parameters)
    assert weights(model, case, kind) == pytest.approx(case.nav2[f"{kind}beam"], rel=1e-10)


def test_a_turned_sensor_is_as_one_whose_bearings_are_shifted(case):
    expected = case.nav2["offset_sensor_beam_as_amcl_node_yaw0_bearings_shifted"]
    assert weights(Nav2Beam(case.grid, case.nav2_parameters), case, "offset_sensor_") == pytest.approx(expected)


@pytest.mark.parametrize("name", ["likelihood_field", "beam"])
def test_each_beam(case, name):
    """The oracle scored two copies of one beam, because nav2 cannot score one: w = 1 + 2 p^3."""
    shape = len(case.poses), len(case.bearings)
    doubled = case.nav2[f"{name}_two_copies_of_one_beam_PxK"].reshape(shape)
    options = {"distance": "brushfire"} if name == "likelihood_field" else {}
    model = (Nav2Field if name == "likelihood_field" else Nav2Beam)(case.grid, case.nav2_parameters, **options)
    p = model.beam_values(model.evidence(case.scan(), case.poses))
    # Two beams only: max_beams = 2 gives the step (2 - 1) / (2 - 1) = 1.
    assert 1.0 + 2.0 * p**3 == pytest.approx(doubled, rel=1e-12)


def test_brushfire_is_that_of_the_program(case):
    expected = case.nav2["occ_dist_row_major"].reshape(case.grid.shape)
    limit = case.values["max_occ_dist"]
    seen = read_as_stack(case.grid)
    burnt = field_table(seen, seen.occupied, "brushfire", AMCL_BRUSHFIRE, limit).distance
    assert (np.minimum(burnt, np.float32(limit)) == expected.astype(np.float32)).all()


def test_brushfire_differs_little_from_exact_distances(case):
    expected = case.nav2["occ_dist_row_major"].reshape(case.grid.shape)
    limit = case.values["max_occ_dist"]
    seen = read_as_stack(case.grid)
    exact = np.minimum(field_table(seen, seen.occupied, "exact", AMCL_BRUSHFIRE, limit).distance, limit)
    too_long = expected - exact
    assert too_long.min() > -1e-6
    assert 0.0 < too_long.max() < case.grid.resolution
    assert 0.0 < np.mean(too_long > 1e-6) < 0.01


def test_ranges_are_those_of_the_program(case):
    model = Nav2Beam(case.grid, case.nav2_parameters)
    ranges = model.evidence(case.scan(), case.poses).expected_ranges
    assert ranges == pytest.approx(case.nav2["ranges_PxK"].reshape(ranges.shape), rel=1e-14)


@pytest.mark.parametrize(
    ("kind", "error_threshold", "name"),
    [
        ("", 0.9, "likelihood_field_prob_beamskip_dist0.15_thr0.3_err0.9"),
        ("", 0.01, "likelihood_field_prob_beamskip_dist0.15_thr0.3_err0.01"),
        ("special_", 0.9, "special_likelihood_field_prob_beamskip_err0.9"),
    ],
)
def test_beam_skipping(case, kind, error_threshold, name):
    expected = only(case, name)
    parameters = replace(
        case.nav2_parameters, do_beamskip=True, beam_skip_distance=0.15, beam_skip_error_threshold=error_threshold
    )
    model = Nav2FieldProb(case.grid, parameters, distance="brushfire")
    assert weights(model, case, kind) == pytest.approx(expected, rel=1e-11, abs=0.0)


def test_after_too_much_skipping_the_program_multiplies_in_beams_of_an_earlier_scan(case):
    """What the documentation says of the program: at its first scan zeros, as in the emulator, later stale values."""
    expected = only(case, "special_likelihood_field_prob_beamskip_err0.01")
    model = Nav2FieldProb(case.grid, case.nav2_parameters, distance="brushfire")
    before = model.evidence(case.scan(), case.poses)
    now = model.evidence(case.scan("special_"), case.poses)
    without_reading = ~np.isin(before.beams, now.beams)
    assert without_reading.sum() == 4
    stale = model.beam_values(before)[:, without_reading].prod(axis=1)
    assert stale * np.exp(model.log_weights(now)) == pytest.approx(expected, rel=1e-11, abs=0.0)
    skipping = replace(case.nav2_parameters, do_beamskip=True, beam_skip_distance=0.15, beam_skip_error_threshold=0.01)
    assert (only(case, "special_likelihood_field_prob_beamskip_err0.01_fresh_object") == 0.0).all()
    emulated = Nav2FieldProb(case.grid, skipping, distance="brushfire")
    assert (weights(emulated, case, "special_") == 0.0).all()


def test_ros1_has_the_same_formula(case):
    parameters = Ros1Parameters.from_amcl(case.nav2_parameters)
    model = Ros1Field(case.grid, parameters, distance="brushfire")
    assert weights(model, case, "") == pytest.approx(case.nav2["likelihood_field"], rel=1e-12)
