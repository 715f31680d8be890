"""F1TENTH's table: entries, readings, beams, rays and the map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.f1tenth.parameters import F1tenthParameters
from beamfield.stacks.f1tenth.table import F1tenthTable, pixels, sensor_table
from tests.stacks.small_room import MAX_RANGE, POSES, WEIGHTS, small_room, small_scan

FACTORS = {name: WEIGHTS[name] for name in ("z_hit", "z_short", "z_max", "z_rand")}
PARAMETERS = F1tenthParameters(**FACTORS, sigma_hit=0.8, max_range=MAX_RANGE, angle_step=1)
# The size of the room's cells in single precision, as in the map's message: 2 m has 19 of them.
CELL = float(np.float32(0.1))
# (r, d) and what range_libc's compiled code had there.
ENTRIES = {
    (0, 0): 0.441973073640753, (3, 5): 0.08179766008969187, (5, 3): 0.015962883238119174,
    (20, 7): 0.024390197326690358, (20, 20): 0.09071234112420824,
}  # fmt: skip


def test_entries_of_the_table_are_those_of_the_program():
    table = sensor_table(PARAMETERS, 0.1)
    assert table.shape == (21, 21)
    assert [table[place] for place in ENTRIES] == pytest.approx(list(ENTRIES.values()), rel=1e-12)


def test_a_longest_range_of_one_cell_is_the_least():
    assert pixels(0.1, 0.1) == 1
    with pytest.raises(InvalidInputError, match="max_range: expected 1 to"):
        pixels(0.09, 0.1)


def test_columns_sum_to_one_and_a_common_factor_changes_nothing():
    table = sensor_table(PARAMETERS, 0.1)
    assert table.sum(axis=0) == pytest.approx(1.0)
    twice = replace(PARAMETERS, **{name: 2.0 * value for name, value in FACTORS.items()})
    assert sensor_table(twice, 0.1) == pytest.approx(table)
    nothing = replace(PARAMETERS, **dict.fromkeys(FACTORS, 0.0))
    assert sensor_table(nothing, 0.1) == pytest.approx(1.0 / 21.0)


def test_table_by_hand():
    for d in range(21):
        column = [
            0.6 * math.exp(-0.5 * ((r - d) / 0.8) ** 2) / (0.8 * math.sqrt(2.0 * math.pi))
            + (2.0 * 0.15 * (d - r) / d if r < d else 0.0)
            + (0.05 if r == 20 else 0.2 / 20)
            for r in range(21)
        ]
        assert sensor_table(PARAMETERS, 0.1)[:, d] == pytest.approx(np.array(column) / sum(column))


def test_weights_are_products_of_entries_squashed():
    model = F1tenthTable(small_room(), PARAMETERS)
    evidence = model.evidence(small_scan(), POSES)
    table = sensor_table(PARAMETERS, CELL)
    for i in range(len(POSES)):
        product = 1.0
        for r, d in zip(evidence.ranges, evidence.expected_ranges[i], strict=True):
            product *= table[min(19, int(r / CELL)), min(19, int(d / CELL))]
        assert np.exp(model.log_weights(evidence)[i]) == pytest.approx(product ** (1.0 / 2.2))


def test_squash_factor_flattens_the_same_table():
    model = F1tenthTable(small_room(), PARAMETERS)
    evidence = model.evidence(small_scan(), POSES)
    assert model.log_weights(evidence, replace(PARAMETERS, squash_factor=1.0)) == pytest.approx(
        2.2 * model.log_weights(evidence)
    )


def test_logarithms_do_not_underflow_where_products_do():
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 1080, endpoint=False), 2.0)
    model = F1tenthTable(small_room(), PARAMETERS)
    weights = model.log_likelihood(Scan(np.full(1080, 1.9), finder), POSES)
    assert np.isfinite(weights).all()
    assert (np.exp(2.2 * weights) == 0.0).all()
    assert len(set(weights.tolist())) == len(POSES)


@pytest.mark.parametrize(("step", "beams"), [(1, [0, 2, 3, 4, 5, 6]), (2, [0, 2, 4, 6]), (3, [0, 3, 6]), (99, [0])])
def test_every_angle_step_th_beam_counts_but_nan(step, beams):
    scan = Scan([1.0, np.nan, np.inf, 9.0, -np.inf, 0.0, 0.5], RangeFinder.from_bearings(np.zeros(7), 5.0))
    model = F1tenthTable(small_room(), replace(PARAMETERS, angle_step=step))
    evidence = model.evidence(scan, POSES)
    assert evidence.beams.tolist() == beams
    assert evidence.ranges.tolist() == [{0: 1.0, 2: 2.0, 3: 2.0, 4: 0.0, 5: 0.0, 6: 0.5}[beam] for beam in beams]


def test_only_ranges_of_max_range_get_z_max():
    grid = OccupancyGrid.from_ros([[0] * 30], 0.1)
    model = F1tenthTable(grid, PARAMETERS)
    finder = RangeFinder.from_bearings([0.0], 5.0)
    values = {z: model.beam_log_values(model.evidence(Scan([z], finder), [[0.05, 0.05, 0.0]]))[0, 0]
              for z in (1.85, 1.899, 1.91, 2.0, 3.0, np.inf)}  # fmt: skip
    table = np.log(sensor_table(PARAMETERS, CELL))
    expected = {1.85: table[18, 19], 1.899: table[18, 19]} | dict.fromkeys((1.91, 2.0, 3.0, np.inf), table[19, 19])
    assert values == pytest.approx(expected)


def test_unknown_cells_and_faint_ones_let_rays_pass():
    grid = OccupancyGrid.from_ros([[0, -1, 10, 11, 100]], 0.5)
    scan = Scan([1.0], RangeFinder.from_bearings([0.0], 5.0))
    ranges = {mode: float(F1tenthTable(grid, PARAMETERS, map_mode=mode)
                          .evidence(scan, [[0.25, 0.25, 0.0]]).expected_ranges[0, 0])
              for mode in ("trinary", "raw")}  # fmt: skip
    assert ranges == pytest.approx({"trinary": 1.75, "raw": 1.25})


def test_ranges_of_another_method_can_be_put_in():
    model = F1tenthTable(small_room(), PARAMETERS)
    evidence = model.evidence(small_scan(), POSES)
    others = replace(evidence, expected_ranges=evidence.expected_ranges + 0.1)
    assert (model.log_weights(others) != model.log_weights(evidence)).all()


def test_methods_of_ray_casting_need_no_new_evidence():
    model = F1tenthTable(small_room(), PARAMETERS)
    evidence = model.evidence(small_scan(), POSES)
    other = replace(PARAMETERS, range_method="glt", theta_discretization=300)
    assert (model.log_weights(evidence, other) == model.log_weights(evidence)).all()


def test_a_range_of_whole_pixels_loses_one_to_the_single_precision_of_the_message():
    assert [pixels(10.0, float(np.float32(cell))) for cell in (0.05, 0.0625, 0.0504)] == [199, 160, 198]
    # 0.7 in single precision is less than 0.7.
    assert pixels(0.7, float(np.float32(0.7))) == 1


@pytest.mark.parametrize("max_range", [0.01, 1e5])
def test_tables_without_pixels_or_with_too_many_are_refused(max_range):
    with pytest.raises(InvalidInputError, match="max_range: expected 1 to 20000 cells"):
        F1tenthTable(small_room(), replace(PARAMETERS, max_range=max_range))
    with pytest.raises(InvalidInputError, match="max_range: expected 1 to 20000 cells"):
        F1tenthTable(small_room(), PARAMETERS).with_parameters(replace(PARAMETERS, max_range=max_range))


@pytest.mark.parametrize(
    ("name", "value"),
    [("z_hit", -1.0), ("z_short", np.nan), ("sigma_hit", 0.0), ("squash_factor", 0.0), ("max_range", np.inf),
     ("angle_step", 0), ("theta_discretization", 1.5), ("range_method", "rml")],
)  # fmt: skip
def test_parameters_without_meaning_are_refused(name, value):
    with pytest.raises(InvalidInputError, match=f"{name}: expected"):
        F1tenthParameters(**{name: value})


def test_map_modes_that_do_not_exist_are_refused():
    with pytest.raises(InvalidInputError, match="map_mode: expected one of 'trinary', 'raw', got"):
        F1tenthTable(small_room(), PARAMETERS, map_mode="scale")
