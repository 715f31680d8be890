"""Beluga's models against what Beluga's own compiled code answered.

Its library counts cells with the values 1 to 99 as known, so that the map is read "raw".
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.beluga.models import BelugaBeam, BelugaField, BelugaFieldProb
from beamfield.stacks.beluga.scan import boundaries
from beamfield.stacks.emulation.field_table import BELUGA_BRUSHFIRE, field_table
from beamfield.stacks.emulation.stack_map import read_as_stack

pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("past_the_message")]

KINDS = ("", "special_filtered_", "offset_sensor_")
# With the map options; the node hands them to likelihood_field only.
OPTIONS = {
    "_model_unknown_space": {"model_unknown_space": True},
    "_only_obstacle_boundaries": {"only_obstacle_boundaries": True},
}


def field(case, **changes):
    return BelugaField(case.grid, replace(case.beluga_parameters, **changes), distance="brushfire", map_mode="raw")


def field_prob(case):
    return BelugaFieldProb(case.grid, case.beluga_parameters, distance="brushfire", map_mode="raw")


def beam(case):
    return BelugaBeam(case.grid, case.beluga_parameters, map_mode="raw")


@pytest.mark.parametrize(("kind", "option"), [*((kind, "") for kind in KINDS), *(("", option) for option in OPTIONS)])
def test_likelihood_field(case, kind, option):
    expected = case.beluga[f"{kind}likelihood_field{option}"]
    model = field(case, **OPTIONS.get(option, {}))
    assert np.exp(model.log_likelihood(case.scan(kind), case.poses)) == pytest.approx(expected, rel=2e-9)


@pytest.mark.parametrize("kind", ["", "special_filtered_"])
def test_likelihood_field_prob(case, kind):
    expected = case.beluga[f"{kind}likelihood_field_prob"]
    weights = np.exp(field_prob(case).log_likelihood(case.scan(kind), case.poses))
    assert weights == pytest.approx(expected, rel=1e-11, abs=0.0)


def test_the_library_knows_unknown_space_in_likelihood_field_prob_too(case):
    """Its node does not use this."""
    model = field(case, model_unknown_space=True)
    p = model.beam_values(model.evidence(case.scan(), case.poses))
    expected = case.beluga["likelihood_field_prob_model_unknown_space"]
    # It keeps a distance whose p is 1 / laser_max_range in single precision.
    assert p.prod(axis=1) == pytest.approx(expected, rel=3e-7, abs=0.0)


# The oracle's own special_filtered_beam keeps a range of 0.0, which the node drops.
@pytest.mark.parametrize("kind", ["", "offset_sensor_"])
def test_beam(case, kind):
    weights = np.exp(beam(case).log_likelihood(case.scan(kind), case.poses))
    assert weights == pytest.approx(case.beluga[f"{kind}beam"], rel=1e-11)


@pytest.mark.parametrize(
    ("name", "make", "weight"),
    [
        ("likelihood_field", field, lambda p: 1.0 + p**3),
        ("likelihood_field_prob", field_prob, lambda p: p),
        ("beam", beam, lambda p: p**3),
    ],
    ids=["likelihood_field", "likelihood_field_prob", "beam"],
)
def test_each_beam(case, name, make, weight):
    model = make(case)
    values = model.beam_values(model.evidence(case.scan(), case.poses))
    expected = case.beluga[f"{name}_one_beam_KxP"].reshape(values.shape[::-1]).T
    assert weight(values) == pytest.approx(expected, rel=1e-11, abs=0.0)


def test_a_reading_of_the_longest_range_is_a_measurement(case):
    scan = Scan([case.values["max_range"]], RangeFinder.from_bearings([0.0], case.values["max_range"]))
    weights = np.exp(beam(case).log_likelihood(scan, case.poses))
    assert weights == pytest.approx(case.beluga["beam_single_reading_at_zmax"], rel=1e-12)


@pytest.mark.parametrize("option", ["", *OPTIONS])
def test_likelihood_field_of_every_cell(case, option):
    expected = case.beluga[f"likelihood_field_grid{option}"].reshape(case.grid.shape)
    model = field(case, **OPTIONS.get(option, {}))
    rows, cols = case.grid.shape
    row, col = np.mgrid[:rows, :cols].reshape(2, -1)
    centres = case.grid.to_map(np.column_stack([col + 0.5, row + 0.5]))
    scan = Scan([0.0], RangeFinder.from_bearings([0.0], case.values["max_range"]))
    p = model.beam_values(model.evidence(scan, np.column_stack([centres, np.zeros(len(centres))])))
    np.testing.assert_allclose(p.reshape(case.grid.shape), expected, rtol=2e-7)


def test_brushfire_is_that_of_the_program(case):
    expected = case.beluga["squared_distance_row_major"].reshape(case.grid.shape)
    limit = case.values["max_occ_dist"]
    seen = read_as_stack(case.grid)
    burnt = field_table(seen, seen.occupied, "brushfire", BELUGA_BRUSHFIRE, limit).distance
    assert (np.minimum(burnt**2, limit**2).astype(np.float32) == expected.astype(np.float32)).all()


def test_boundaries_are_those_of_the_program(case):
    peaks = case.beluga["likelihood_field_grid_only_obstacle_boundaries"].reshape(case.grid.shape)
    assert (boundaries(read_as_stack(case.grid)) == (peaks > peaks.max() * (1.0 - 1e-6))).all()


def test_ranges_are_those_of_the_program(case):
    model = beam(case)
    ranges = model.evidence(case.scan(), case.poses).expected_ranges
    expected = case.beluga["ranges_PxK_minus1_is_nullopt"].reshape(ranges.shape)
    assert ranges == pytest.approx(np.where(expected < 0.0, case.values["max_range"], expected), rel=1e-14)
