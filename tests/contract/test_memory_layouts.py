"""Arrays as they come, read-only or in any order: the same results, and nothing compiled anew, which takes seconds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from beamfield.localization.particle_filter import ParticleFilter
from beamfield.localization.particles import Particles
from beamfield.localization.resampling import systematic_indices
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable
from beamfield.maps.raycast import RayCaster
from beamfield.maps.scan_field import ScanField
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.sensors import RangeFinder, Scan, SensorLog
from tests.compiled_kernels import compiled_kernels
from tests.contract.conftest import FINDER, POSES, SONAR_FINDER, USUAL, build_likelihood_field, draw_floor

CELLS = np.nan_to_num(draw_floor((0.0, 0.0, 0.0)).probability.astype(np.float64), nan=0.5)
SCAN = Scan(USUAL, FINDER)
ODOMETRY = [[0.0, 0.0, 0.0], [0.5, 0.1, 0.3]]
MANY = np.tile(POSES, (8, 1))
WEIGHTS = np.full(64, 1.0 / 64.0)


def layouts(array: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Return the same numbers in other places of memory."""
    fixed, spread = array.copy(), np.repeat(array, 2, axis=-1)[..., ::2]
    fixed.flags.writeable = False
    unaligned = np.frombuffer(b"x" + array.tobytes(), offset=1).reshape(array.shape)
    return {"read-only": fixed, "columns first": np.asfortranarray(array), "spread": spread, "unaligned": unaligned}


@dataclass(frozen=True)
class OwnModel:
    """A model that hands out its values in a layout."""

    layout: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    is_normalized = False

    def log_likelihood(self, z: object, poses: NDArray[np.float64]) -> NDArray[np.float64]:  # noqa: ARG002
        return self.layout(-np.square(poses[:, 0]))


def filtered(layout: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return where a filter with one's own model is."""
    own = ParticleFilter(OwnModel(layout), GaussianMotion(), rng=1)
    own.start(MANY)
    own.update(None, ODOMETRY[0])
    return own.pose


CALLS: dict[str, tuple[NDArray[np.float64], Callable[[NDArray[np.float64]], Any]]] = {
    "poses after": (POSES, lambda x: DifferentialMotion().log_density(x, POSES[:1], ODOMETRY)),
    "poses before": (POSES, lambda x: DifferentialMotion().log_density(POSES, x, ODOMETRY)),
    "a scan field's points": (POSES[:, :2], lambda x: ScanField.from_scan(SCAN).log_density(x)),
    "a scan field's poses": (POSES, lambda x: ScanField.from_scan(SCAN).log_likelihood(SCAN, x)),
    "particles": (MANY, lambda x: Particles(x).best_cluster.pose),
    "particles' weights": (WEIGHTS, lambda x: Particles(np.resize(POSES, (64, 3)), x).best_cluster.pose),
    "weights": (WEIGHTS, lambda x: systematic_indices(x, 9, np.random.default_rng(0))),
    "a map, for rays": (CELLS, lambda x: RayCaster(OccupancyGrid(x, 0.5)).expected_ranges(POSES, FINDER)),
    "a message's map": (CELLS, lambda x: RayCaster(OccupancyGrid.from_ros(x * 100, 0.5)).cast(POSES, 5.0)),
    "a map, for cones": (CELLS, lambda x: ConeCaster(OccupancyGrid(x, 0.5)).expected_ranges(POSES, SONAR_FINDER)),
    "a map, for a table": (
        CELLS, lambda x: RangeTable.build(OccupancyGrid(x, 0.5), max_range=5.0).expected_ranges(POSES, FINDER)
    ),
    "mounts": (
        FINDER.mounts, lambda x: build_likelihood_field().log_likelihood(Scan(USUAL, RangeFinder(x, 5.0)), POSES)
    ),
    "a log's ranges": (
        np.tile(USUAL, (7, 1)),
        lambda x: build_likelihood_field().log_likelihood(SensorLog(FINDER, np.arange(7.0), x, POSES, POSES)[2], POSES),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_arrays_of_any_layout_give_the_same_and_compile_nothing_anew(name):
    array, call = CALLS[name]
    expected = call(array.copy())
    known = compiled_kernels()
    for layout, same in layouts(array).items():
        np.testing.assert_array_equal(call(same), expected, err_msg=layout)
        assert compiled_kernels() == known, layout


def test_poses_of_any_layout_give_every_model_the_same_and_compile_nothing_anew(case):
    model, z = case.build(), case.measurements[0]
    expected = model.log_likelihood(z, POSES.copy())
    known = compiled_kernels()
    for layout, poses in layouts(POSES).items():
        np.testing.assert_array_equal(model.log_likelihood(z, poses), expected, err_msg=layout)
        assert compiled_kernels() == known, layout


def test_a_filter_compiles_nothing_anew_for_the_values_of_ones_own_model():
    expected = filtered(np.copy)
    known = compiled_kernels()
    for layout in layouts(WEIGHTS):
        np.testing.assert_array_equal(filtered(lambda values, name=layout: layouts(values)[name]), expected)
        assert compiled_kernels() == known, layout
