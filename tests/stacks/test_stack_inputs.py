"""Selection of beams, reading of maps, distances by brushfire and validation of parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.emulation.beam_selection import ceil_step_beams, even_beams, floor_step_beams
from beamfield.stacks.emulation.field_table import AMCL_BRUSHFIRE, BELUGA_BRUSHFIRE, field_table
from beamfield.stacks.emulation.stack_map import read_as_stack
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.ros1.parameters import Ros1Parameters

STACKS = (Nav2Parameters, Ros1Parameters, BelugaParameters)


@pytest.mark.parametrize(
    ("n", "max_beams", "step"), [(16, 16, 1), (360, 60, 6), (400, 60, 6), (119, 60, 2), (118, 60, 1), (2, 2, 1)]
)
def test_floor_step(n, max_beams, step):
    beams = floor_step_beams(n, max_beams, least_step=0)
    assert beams.tolist() == list(range(0, n, step))
    assert beams[0] == 0
    # 118 beams with max_beams = 60 are all used.
    assert min(n, max_beams) <= len(beams) < 2 * max_beams


@pytest.mark.parametrize(("n", "max_beams"), [(59, 60), (1, 2), (0, 2)])
def test_floor_step_of_too_few_beams(n, max_beams):
    with pytest.raises(InvalidInputError, match="never returns"):
        floor_step_beams(n, max_beams, least_step=0)
    assert floor_step_beams(n, max_beams, least_step=1).tolist() == list(range(n))


@pytest.mark.parametrize(
    ("n", "max_beams", "step"), [(60, 60, 1), (59, 60, 1), (1, 60, 1), (61, 60, 2), (360, 60, 6), (0, 60, 1)]
)
def test_ceil_step(n, max_beams, step):
    beams = ceil_step_beams(n, max_beams)
    assert beams.tolist() == list(range(0, n, step))
    assert len(beams) <= max_beams


@pytest.mark.parametrize(("n", "max_beams"), [(10, 4), (723, 60), (60, 60), (59, 60), (5, 1), (0, 3), (2, 2)])
def test_even_beams_run_from_the_first_to_the_last(n, max_beams):
    beams = even_beams(n, max_beams)
    assert len(beams) == len(set(beams.tolist())) == min(n, max_beams)
    if n:
        assert beams[0] == 0
    if n and max_beams > 1:
        assert beams[-1] == n - 1
    if len(beams) > 2:
        assert np.ptp(np.diff(beams)) <= 1


def test_maps_are_read_by_thresholds_percents_or_raw_values():
    grid = OccupancyGrid([[0.0, 0.2, 0.253, 0.45, 0.648, 0.7, 1.0, np.nan]], 1.0)
    nan = np.nan
    expected = {
        "trinary": [0.0, 0.0, nan, nan, nan, 1.0, 1.0, nan],
        # (0.253 - 0.25) / 0.4 rounds to 1%, (0.648 - 0.25) / 0.4 to 100%.
        "scale": [0.0, 0.0, 0.5, 0.5, 1.0, 1.0, 1.0, nan],
        "raw": [0.0, 0.5, 0.5, 0.5, 0.5, 0.5, 1.0, nan],
    }
    for mode, values in expected.items():
        seen = read_as_stack(grid, mode)
        np.testing.assert_array_equal(seen.probability[0], values)
        assert seen.unknown[0].tolist() == [v not in (0.0, 1.0) for v in values]


def test_the_origin_is_shifted_along_the_axes_of_the_grid():
    grid = OccupancyGrid.from_ros(np.zeros((2, 2)), 2.0, [1.0, 5.0, np.pi / 2])
    assert read_as_stack(grid).origin == pytest.approx(grid.origin)
    assert read_as_stack(grid, shift_cells=-0.5).origin == pytest.approx([2.0, 4.0, np.pi / 2])
    assert read_as_stack(grid, ignore_yaw=True, shift_cells=-0.5).origin == pytest.approx([0.0, 4.0, 0.0])


@pytest.mark.parametrize("fire", [AMCL_BRUSHFIRE, BELUGA_BRUSHFIRE], ids=["amcl", "beluga"])
def test_brushfire_is_never_nearer_than_the_nearest_obstacle_and_seldom_farther(fire, rng):
    cells = np.where(rng.random((120, 90)) < 0.01, 100, 0)
    grid = OccupancyGrid.from_ros(cells, 0.05)
    burnt, exact = (field_table(grid, grid.occupied, way, fire, 100.0).distance for way in ("brushfire", "exact"))
    too_long = burnt - exact
    assert too_long.min() > -1e-6
    assert 0.0 < np.mean(too_long > 1e-6) < 0.05
    assert too_long.max() < 2.0 * grid.resolution


@pytest.mark.parametrize("fire", [AMCL_BRUSHFIRE, BELUGA_BRUSHFIRE], ids=["amcl", "beluga"])
def test_brushfire_ends_at_its_limit(fire):
    cells = np.zeros((1, 30))
    cells[0, 0] = 100
    grid = OccupancyGrid.from_ros(cells, 0.5)
    distance = field_table(grid, grid.occupied, "brushfire", fire, 3.0).distance
    # 3.2 m is 6 whole cells; Beluga's maximum is not a whole number of them.
    assert np.isinf(field_table(grid, grid.occupied, "brushfire", fire, 3.2).distance[0, 7:]).all()
    assert np.minimum(distance[0], 3.0) == pytest.approx(np.minimum(0.5 * np.arange(30), 3.0))
    assert np.isinf(distance[0, 7:]).all()


@pytest.mark.parametrize("kind", STACKS)
def test_defaults_need_not_sum_to_1(kind):
    defaults = kind()
    total = sum(v for k, v in dataclasses.asdict(defaults).items() if k.removeprefix("laser_").startswith("z_"))
    assert total == pytest.approx(1.15 if kind is Ros1Parameters else 1.1)
    assert defaults.laser_model_type == "likelihood_field"


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("z_rand", float("inf"), "expected a finite number, got inf"),
        ("z_hit", float("nan"), "expected a finite number, got nan"),
        ("z_hit", -0.1, "expected a number >= 0, got -0.1"),
        ("z_hit", "0.5", "expected a finite number, got '0.5'"),
        ("z_hit", True, "expected a finite number, got True"),
        ("sigma_hit", 0.0, "expected a positive number, got 0.0"),
        ("laser_likelihood_max_dist", 0, "expected a positive number, got 0"),
        ("max_beams", 0, "expected an integer >= [12], got 0"),
        ("max_beams", 60.0, "expected an integer >= [12], got 60.0"),
        ("laser_model_type", "landmark", "expected one of 'likelihood_field', .*, got 'landmark'"),
    ],
)
@pytest.mark.parametrize("kind", STACKS)
def test_parameters_a_program_cannot_compute_with_are_refused(kind, name, value, message):
    names = [field.name for field in dataclasses.fields(kind)]
    own = name if name in names else f"laser_{name}"
    with pytest.raises(InvalidInputError, match=f"{own}: {message}"):
        kind(**{own: value})


def test_switches_are_true_or_false():
    with pytest.raises(InvalidInputError, match="do_beamskip: expected True or False, got 1"):
        Nav2Parameters(do_beamskip=1)
    with pytest.raises(InvalidInputError, match="model_unknown_space: expected True or False, got 'no'"):
        BelugaParameters(model_unknown_space="no")


def test_ros1_and_nav2_names_go_both_ways():
    nav2 = Nav2Parameters(z_hit=0.7, sigma_hit=0.1, max_beams=90, laser_max_range=12.0, do_beamskip=True)
    ros1 = Ros1Parameters.from_amcl(nav2)
    assert (ros1.laser_z_hit, ros1.laser_max_beams, ros1.laser_max_range) == (0.7, 90, 12.0)
    assert dataclasses.asdict(ros1.as_amcl()) == dataclasses.asdict(nav2)
