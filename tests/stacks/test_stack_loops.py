"""Each emulator against a literal loop over poses, beams and cells, on random maps, scans and parameters."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.registry import build_model, parameter_class
from beamfield.stacks.ros1.parameters import Ros1Parameters
from tests.reference import stack_loops
from tests.reference.stack_loops import NEVER_RETURNS, Input

SEEDS = range(40)
N_POSES = 6
# Programs' maps are in single precision, so that weights agree to about 1e-7 of a beam's logarithm.
CLOSE = {"rel": 2e-6, "abs": 2e-6}
AMCL_MODELS = ("likelihood_field", "likelihood_field_prob", "beam")


def random_input(rng: np.random.Generator, values: dict) -> tuple[Input, list]:
    """Return a small map, a scan and poses with everything in them that programs treat in their own ways."""
    resolution = float(rng.choice([0.05, 0.1, 0.025, 0.07, float(np.float32(0.05)), 0.25]))
    rows, cols = rng.integers(4, 14, 2)
    cells = np.zeros((rows, cols), np.int64)
    cells[rng.random((rows, cols)) < rng.choice([0.0, 0.05, 0.3])] = 100
    cells[rng.random((rows, cols)) < rng.choice([0.0, 0.2])] = -1
    k = int(rng.integers(1, 28))
    range_max = resolution * float(rng.choice([12.0, 20.0, rng.uniform(6.0, 30.0)]))
    range_min = float(rng.choice([0.0, 0.1])) * range_max
    ranges = rng.uniform(0.0, 1.1 * range_max, k)
    special = rng.random(k) < rng.choice([0.0, 0.1, 0.4])
    ranges[special] = rng.choice([np.nan, np.inf, -np.inf, range_max, range_min, 2.0 * range_max], special.sum())
    if rng.random() < 0.5:
        ranges[np.isnan(ranges)] = np.inf
    size = resolution * np.array([cols, rows])
    origin = (*rng.uniform(-5.0, 5.0, 2).tolist(), float(rng.choice([0.0, rng.uniform(-3.0, 3.0)])))
    mount = (0.0, 0.0, 0.0) if rng.random() < 0.3 else tuple(rng.uniform(-0.3, 0.3, 3).tolist())
    # Around where the map is with and without its yaw, and off it.
    middle = np.array(origin[:2]) + 0.5 * size
    poses = np.column_stack([middle + rng.uniform(-0.8, 0.8, (N_POSES, 2)) * size, rng.uniform(-3.0, 3.0, N_POSES)])
    given = Input(
        cells.tolist(), resolution, origin, ranges.tolist(), np.sort(rng.uniform(-3.1, 3.1, k)).tolist(), mount,
        range_min, range_max, values,
    )  # fmt: skip
    return given, [tuple(pose) for pose in poses.tolist()]


def emulated(stack: str, given: Input, parameters: object, model: str, poses: list, **options) -> np.ndarray:
    grid = OccupancyGrid.from_ros(given.cells, given.resolution, given.origin)
    finder = RangeFinder.from_bearings(given.bearings, given.range_max, min_range=given.range_min, mount=given.mount)
    emulator = build_model(stack, model, grid, parameters, **options)
    return emulator.log_likelihood(Scan(given.ranges, finder), poses)


def weights_and_widths(rng: np.random.Generator, model: str) -> dict:
    """Return what nav2, ROS 1 and Beluga have in common, under nav2's names."""
    return {
        "laser_model_type": model,
        "z_hit": float(rng.uniform(0.05, 0.95)),
        "z_short": float(rng.uniform(0.0, 0.3)),
        "z_max": float(rng.uniform(0.0, 0.3)),
        "z_rand": float(rng.uniform(0.05, 0.9)),
        "sigma_hit": float(rng.uniform(0.05, 0.4)),
        "lambda_short": float(rng.choice([0.0, 0.1, 2.0])),
        "laser_likelihood_max_dist": float(rng.choice([0.05, 0.1, 0.15, 0.3, 0.5, 0.7, 2.0, rng.uniform(0.02, 1.0)])),
        "laser_max_range": float(rng.choice([0.5, 1.0, 100.0])),
        "laser_min_range": float(rng.choice([-1.0, 0.1])),
        "max_beams": int(rng.choice([2, 3, 5, 9, 16, 30, 60])),
    }


@pytest.mark.parametrize("model", AMCL_MODELS)
@pytest.mark.parametrize("stack", ["nav2", "ros1"])
def test_amcl(stack, model):
    hung = lost = 0
    for seed in SEEDS:
        rng = np.random.default_rng([seed, AMCL_MODELS.index(model), len(stack)])
        values = weights_and_widths(rng, model) | {
            "do_beamskip": bool(rng.random() < 0.5),
            "beam_skip_distance": float(rng.choice([0.1, 0.2, 0.5])),
            "beam_skip_threshold": float(rng.choice([0.0, 0.3, 0.6])),
            "beam_skip_error_threshold": float(rng.choice([0.3, 0.9, 1.1])),
        }
        values["laser_max_range"] = float(rng.choice([-1.0, values["laser_max_range"]]))
        given, poses = random_input(rng, values)
        nav2 = Nav2Parameters(**values)
        parameters = nav2 if stack == "nav2" else Ros1Parameters.from_amcl(nav2)
        options = {"converged": bool(rng.random() < 0.7)} if model == "likelihood_field_prob" else {}
        expected = stack_loops.amcl_weights(given, poses, stack, **options)
        if expected == NEVER_RETURNS:
            hung += 1
            with pytest.raises(InvalidInputError, match="never returns"):
                emulated(stack, given, parameters, model, poses)
            continue
        assert emulated(stack, given, parameters, model, poses, **options) == pytest.approx(expected, **CLOSE)
        lost += np.isneginf(expected).all()
    # What is special happened, and not too often.
    assert (0 < hung < len(SEEDS) / 1.5) == (model == "beam")
    assert (0 < lost < len(SEEDS) / 2) == (model == "likelihood_field_prob" or (stack, model) == ("ros1", "beam"))


@pytest.mark.parametrize("model", AMCL_MODELS)
def test_beluga(model):
    for seed in SEEDS:
        rng = np.random.default_rng([seed, AMCL_MODELS.index(model), 3])
        values = weights_and_widths(rng, model) | {
            "laser_max_range": float(rng.choice([0.5, 1.0, 3.0])),
            "model_unknown_space": bool(rng.random() < 0.5),
            "only_obstacle_boundaries": bool(rng.random() < 0.5),
        }
        values["z_rand"] = float(rng.choice([0.2, 1.0, 1.3]))
        values["max_beams"] = int(rng.choice([1, values["max_beams"]]))
        given, poses = random_input(rng, values)
        expected = stack_loops.beluga_weights(given, poses)
        got = emulated("beluga", given, parameter_class("beluga")(**values), model, poses)
        assert got == pytest.approx(expected, **CLOSE)


def test_mrpt_field():
    for seed in SEEDS:
        rng = np.random.default_rng([seed, 4])
        values = {
            "LF_stdHit": float(rng.uniform(0.05, 0.5)),
            "LF_zHit": float(rng.uniform(0.05, 0.95)),
            "LF_zRandom": float(rng.uniform(0.05, 0.9)),
            "LF_maxRange": float(rng.choice([1.0, 81.0])),
            "LF_decimation": int(rng.integers(1, 6)),
            "LF_maxCorrsDistance": float(rng.choice([0.0, 0.1, 0.3, 0.5, rng.uniform(0.02, 1.0)])),
            "LF_useSquareDist": bool(rng.random() < 0.3),
            "LF_alternateAverageMethod": bool(rng.random() < 0.3),
        }
        given, poses = random_input(rng, values)
        expected = stack_loops.mrpt_field_weights(given, poses)
        got = emulated("mrpt", given, parameter_class("mrpt", "LF_Thrun")(**values), "LF_Thrun", poses)
        assert got == pytest.approx(expected, **CLOSE)


def test_mrpt_rays():
    for seed in SEEDS:
        rng = np.random.default_rng([seed, 5])
        values = {
            "rayTracing_stdHit": float(rng.uniform(0.05, 1.0)),
            "rayTracing_decimation": int(rng.integers(1, 5)),
            "rayTracing_useDistanceFilter": bool(rng.random() < 0.5),
        }
        given, poses = random_input(rng, values)
        expected = stack_loops.mrpt_ray_weights(given, poses)
        got = emulated("mrpt", given, parameter_class("mrpt", "rayTracing")(**values), "rayTracing", poses)
        assert got == pytest.approx(expected, **CLOSE)


def test_f1tenth():
    for seed in SEEDS:
        rng = np.random.default_rng([seed, 6])
        values = {
            "z_short": float(rng.uniform(0.0, 0.3)),
            "z_max": float(rng.uniform(0.0, 0.3)),
            "z_rand": float(rng.uniform(0.05, 0.5)),
            "z_hit": float(rng.uniform(0.1, 0.9)),
            "sigma_hit": float(rng.uniform(0.5, 8.0)),
            "squash_factor": float(rng.uniform(0.5, 4.0)),
            "max_range": float(rng.choice([0.5, 1.0, 2.0, rng.uniform(0.3, 3.0)])),
            "angle_step": int(rng.integers(1, 5)),
        }
        given, poses = random_input(rng, values)
        expected = stack_loops.f1tenth_weights(given, poses)
        got = emulated("f1tenth", given, parameter_class("f1tenth")(**values), "table", poses)
        assert got == pytest.approx(expected, **CLOSE)
