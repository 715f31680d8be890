"""Every argument of what users call, replaced in turn by what does not belong there.

Allowed is a result, or an error of ours whose text names the argument; at once, and without taking memory for it.
"""

from __future__ import annotations

import inspect
import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from beamfield import geometry
from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.intrinsic.block_intervals import block_intervals
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic.priors import IntrinsicPriors
from beamfield.calibration.selection import SelectionOptions
from beamfield.detections import Detections
from beamfield.errors import BeamfieldError
from beamfield.features.corners import find_corners
from beamfield.features.lines import find_lines
from beamfield.features.minima import find_local_minima
from beamfield.features.poles import find_poles
from beamfield.features.sweep import RangeNoise
from beamfield.localization.alignment import align
from beamfield.localization.global_search import GlobalSearch, SearchWindow
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.localization.pose_posterior import PoseLattice, pose_posterior
from beamfield.maps.cone import ConeCaster
from beamfield.maps.distance import DistanceField
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.maps.mapping import build_map, local_map, scan_map
from beamfield.maps.markers import MarkerMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.occupancy_mapper import OccupancyMapper
from beamfield.maps.range_table import RangeTable
from beamfield.maps.raycast import RayCaster
from beamfield.maps.scan_field import ScanField
from beamfield.maps.smoothing import smooth_map
from beamfield.models import beam_density
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.models.ceiling_camera import CeilingCamera
from beamfield.models.cell_difference import CellDifferenceModel
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.histogram_matching import HistogramMatchingModel
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.landmark_poses import sample_poses
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.models.map_matching import MapMatchingModel
from beamfield.models.marker import MarkerDetections, MarkerModel, MarkerParameters
from beamfield.models.sonar import SonarModel
from beamfield.scan_fit.changed_places import find_changed_places
from beamfield.scan_fit.scan_fit import judge_scan
from beamfield.sensors import RangeFinder, Scan, SensorLog, usable_ranges
from beamfield.simulation.log import simulate_log
from beamfield.simulation.sonar import heard_ranges, sonar_ring
from tests.contract.conftest import CEILING, CEILING_CAMERA, draw_floor

HOSTILE: dict[str, Any] = {
    "None": None,
    "a text": "0.1",
    "bytes": b"1",
    "an object": object(),
    "a list": [],
    "a ragged list": [[1.0], [1.0, 2.0]],
    "a dict": {"x": 1.0},
    "True": True,
    "NaN": math.nan,
    "inf": math.inf,
    "-inf": -math.inf,
    "-1": -1,
    "0": 0,
    "0.5": 0.5,
    "1e308": 1e308,
    "-1e308": -1e308,
    "1e200": 1e200,
    "5e-324": 5e-324,
    "1e-170": 1e-170,
    "1e-9": 1e-9,
    "10^30": 10**30,
    "complex": 1.0 + 2.0j,
    "a stamp": np.datetime64("2026-01-01"),
    "an array of texts": np.array(["a", "b"]),
    "an array of objects": np.array([None, 1.0], dtype=object),
    "NaNs": np.full((2, 3), np.nan),
    "four axes": np.zeros((1, 1, 1, 3)),
    "huge poses": np.full((2, 3), 1e308),
    "a short vector": np.zeros(2),
    "a function": len,
}

GRID = draw_floor(np.zeros(3))
FINDER = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 9), 5.0)
SCAN = Scan(np.linspace(0.5, 4.0, 9), FINDER)
POSES = np.array([[1.6, 1.2, 0.4], [2.2, 3.3, -1.0]])
BEAM = BeamParameters(z_hit=0.6, z_short=0.2, z_max=0.1, z_rand=0.1, sigma_hit=0.1, lambda_short=0.8)
FIELD = LikelihoodFieldParameters(0.7, 0.2, 0.2)
LANDMARKS = LandmarkMap([[0.6, 0.7], [4.1, 2.2]], ids=[7, 3])
NOISE = LandmarkParameters(sigma_range=0.3, sigma_bearing=0.2, spurious_rate=0.2, max_range=8.0)
SEEN = Detections([1.0, 2.0], [0.1, 0.2], ids=[7, 3])
WALLS = LineMap.from_segments([[0.5, 0.2, 7.0, 0.4], [1.6, 1.2, 1.9, 4.0]], ids=[7, 3])
LINE_NOISE = LineParameters(sigma_rho=0.3, sigma_alpha=0.2, spurious_rate=0.2, max_range=8.0)
WALLS_SEEN = LineDetections(np.array([[1.0, 0.1], [2.0, 0.2]]), ids=[7, 3])
MARKER_SEEN = MarkerDetections([3], [[300.0, 200.0, 0.1]])
STAMPS = np.arange(40.0)
TRACK = np.tile(POSES[0], (40, 1))
LOG = SensorLog(FINDER, STAMPS, np.tile(SCAN.ranges, (40, 1)), TRACK, TRACK)


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


# What is built from the map: by the test that wants it, so that collecting the tests compiles no kernels.
CASTER = partial(RayCaster, GRID)
TABLE = partial(RangeTable.build, GRID, resolution=0.5, headings=8)
BEAM_MODEL = partial(BeamModel, GRID, BEAM)
LANDMARK_MODEL = partial(LandmarkModel, LANDMARKS, NOISE, correspondence="known")

# What is called, and arguments that are right.
CALLS: list[tuple[Callable[..., Any], dict[str, Any]]] = [
    (geometry.as_poses, {"poses": POSES}),
    (geometry.wrap_angle, {"angle": 4.0}),
    (geometry.compose, {"a_from_b": POSES, "b_from_c": POSES[0]}),
    (geometry.invert, {"a_from_b": POSES}),
    (geometry.between, {"a": POSES, "b": POSES[0]}),
    (geometry.transform_points, {"a_from_b": POSES, "points": POSES[:, :2]}),
    (geometry.interpolate_poses, {"stamps": [0.0, 1.0], "poses": POSES, "at": [0.5], "max_gap": 3.0}),
    (geometry.yaw_from_quaternion, {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}),
    (
        OccupancyGrid,
        {
            "probability": [[0.0, 1.0]],
            "resolution": 0.1,
            "origin": POSES[0],
            "occupied_thresh": 0.6,
            "free_thresh": 0.2,
        },
    ),
    (OccupancyGrid.from_ros, {"data": [[0, 100]], "resolution": 0.1, "origin": POSES[0]}),
    (GRID.to_cells, {"points": POSES[:, :2]}),
    (GRID.to_map, {"cells": POSES[:, :2]}),
    (RangeFinder, {"mounts": POSES, "max_range": 5.0, "min_range": 0.1, "opening_angle": 0.1}),
    (RangeFinder.from_bearings, {"bearings": [0.0, 1.0], "max_range": 5.0, "mount": POSES[0]}),
    (FINDER.subset, {"beams": [0, 2]}),
    (Scan, {"ranges": SCAN.ranges, "finder": FINDER, "stamp": 1.0}),
    (SCAN.every, {"n_beams": 3}),
    (SCAN.subset, {"beams": [0, 2]}),
    (usable_ranges, {"ranges": SCAN.ranges, "finder": FINDER}),
    (SensorLog, {"finder": FINDER, "ranges": LOG.ranges, "stamps": STAMPS, "odometry": TRACK, "poses": TRACK}),
    (Detections, {"ranges": [1.0], "bearings": [0.1], "signatures": [1.0], "ids": [7]}),
    (LandmarkMap, {"positions": [[0.6, 0.7]], "signatures": [1.0], "ids": [7]}),
    (LineMap.from_segments, {"segments": [[0.0, 0.0, 1.0, 1.0]], "ids": [7]}),
    (LineDetections, {"lines": [[1.0, 0.1]], "ids": [7]}),
    (MarkerMap, {"ids": [3], "poses": [[1.0, 2.0, 0.5]]}),
    (MarkerDetections, {"ids": [3], "image": [[300.0, 200.0, 0.1]]}),
    (CeilingCamera, {"focal_length": 400.0, "height": 2.5, "mount": POSES[0], "principal_point": (320.0, 240.0)}),
    (RayCaster, {"grid": GRID, "unknown": "free"}),
    (RayCaster.expected_ranges, {"self": CASTER, "poses": POSES, "finder": FINDER}),
    (RayCaster.expected_hits, {"self": CASTER, "poses": POSES, "finder": FINDER}),
    (RayCaster.cast, {"self": CASTER, "origins": POSES, "max_range": 5.0}),
    (RayCaster.cast_hits, {"self": CASTER, "origins": POSES, "max_range": 5.0}),
    (RangeTable.build, {"grid": GRID, "max_range": 5.0, "resolution": 0.5, "headings": 8}),
    (RangeTable.expected_ranges, {"self": TABLE, "poses": POSES, "finder": FINDER}),
    (RangeTable.cast, {"self": TABLE, "origins": POSES, "max_range": 5.0}),
    (ConeCaster, {"grid": GRID, "unknown": "free"}),
    (
        ConeCaster.expected_ranges,
        {"self": partial(ConeCaster, GRID), "poses": POSES, "finder": RangeFinder(POSES, 5.0, opening_angle=0.3)},
    ),
    (BeamParameters, {name: getattr(BEAM, name) for name in BeamParameters.__dataclass_fields__}),
    (BeamModel, {"grid": GRID, "parameters": BEAM, "n_beams": 5, "exponent": 0.5, "unknown": "free"}),
    (BeamModel.log_likelihood, {"self": BEAM_MODEL, "z": SCAN, "poses": POSES}),
    (BeamModel.beam_log_likelihood, {"self": BEAM_MODEL, "z": SCAN, "poses": POSES}),
    (BeamModel.sample, {"self": BEAM_MODEL, "poses": POSES, "finder": FINDER, "rng": rng()}),
    (SonarModel, {"map": GRID, "parameters": BEAM, "n_beams": 5, "exponent": 0.5}),
    (
        beam_density.beam_log_density,
        {"ranges": [1.0], "expected_ranges": [2.0], "max_range": 5.0, "parameters": BEAM, "min_range": 0.1},
    ),
    (
        beam_density.beam_responsibilities,
        {"ranges": [1.0], "expected_ranges": [2.0], "max_range": 5.0, "parameters": BEAM},
    ),
    (beam_density.beam_cdf, {"ranges": [1.0], "expected_ranges": [2.0], "max_range": 5.0, "parameters": BEAM}),
    (sample_beams, {"expected_ranges": [1.0, 2.0], "max_range": 5.0, "parameters": BEAM, "rng": rng()}),
    (LikelihoodFieldParameters, {"z_hit": 0.7, "z_rand": 0.2, "sigma_hit": 0.2}),
    (
        LikelihoodFieldModel,
        {
            "grid": GRID,
            "parameters": FIELD,
            "max_distance": 1.0,
        },
    ),
    (
        LikelihoodFieldModel.log_likelihood,
        {"self": partial(LikelihoodFieldModel, GRID, FIELD), "z": SCAN, "poses": POSES},
    ),
    (DistanceField.from_grid, {"grid": GRID, "max_distance": 1.0}),
    (
        LandmarkParameters,
        {
            "sigma_range": 0.3,
            "sigma_bearing": 0.2,
            "spurious_rate": 0.2,
            "max_range": 8.0,
            "range_bias": 0.1,
            "bearing_bias": 0.1,
            "range_scale": 1.1,
            "sigma_signature": 0.1,
        },
    ),
    (LandmarkModel, {"landmarks": LANDMARKS, "parameters": NOISE, "correspondence": "known", "mount": POSES[0]}),
    (LandmarkModel.log_likelihood, {"self": LANDMARK_MODEL, "z": SEEN, "poses": POSES}),
    (LandmarkModel.expected, {"self": LANDMARK_MODEL, "poses": POSES}),
    (
        sample_poses,
        {
            "model": LANDMARK_MODEL,
            "detections": SEEN.subset([0]),
            "n": 5,
            "rng": rng(),
            "method": "exact",
            "grid": GRID,
        },
    ),
    (LineParameters, {"sigma_rho": 0.3, "sigma_alpha": 0.2, "spurious_rate": 0.2, "max_range": 8.0}),
    (LineModel, {"lines": WALLS, "parameters": LINE_NOISE, "correspondence": "known"}),
    (
        LineModel.log_likelihood,
        {"self": partial(LineModel, WALLS, LINE_NOISE, correspondence="known"), "z": WALLS_SEEN, "poses": POSES},
    ),
    (MarkerParameters, {"sigma_pixel": 2.0, "sigma_angle": 0.05}),
    (MarkerModel, {"markers": CEILING, "parameters": MarkerParameters(2.0, 0.05), "camera": CEILING_CAMERA}),
    (
        MarkerModel.log_likelihood,
        {
            "self": partial(MarkerModel, CEILING, MarkerParameters(2.0, 0.05), CEILING_CAMERA),
            "z": MARKER_SEEN,
            "poses": POSES,
        },
    ),
    (MapMatchingModel, {"grid": GRID, "min_overlap": 2}),
    (MapMatchingModel.log_likelihood, {"self": partial(MapMatchingModel, GRID), "z": GRID, "poses": POSES}),
    (CellDifferenceModel, {"grid": GRID}),
    (HistogramMatchingModel, {"grid": GRID}),
    (ScanField.from_scan, {"scan": SCAN}),
    (scan_map, {"scan": SCAN, "resolution": 0.2}),
    (local_map, {"log": LOG, "index": 20, "n": 5, "resolution": 0.2}),
    (build_map, {"log": LOG, "resolution": 0.2}),
    (OccupancyMapper, {"resolution": 0.2}),
    (smooth_map, {"grid": GRID, "sigma": 0.3}),
    (SearchWindow, {"center": POSES[0], "width": 2.0, "height": 2.0, "turn": 1.0}),
    (GlobalSearch, {"grid": GRID, "sigma": 0.3, "angle_step": 0.1}),
    (
        GlobalSearch.search,
        {
            "self": partial(GlobalSearch, GRID, sigma=0.3, angle_step=0.1),
            "z": SCAN,
            "window": SearchWindow(POSES[0], 2.0, 2.0, 1.0),
        },
    ),
    (align, {"scan": SCAN, "onto": SCAN, "initial": [0.0, 0.0, 0.0], "search": (0.1, 0.05)}),
    (likelihood_map, {"model": BEAM_MODEL, "scan": SCAN, "grid": GRID, "resolution": 1.0, "headings": 8}),
    (PoseLattice.over_map, {"grid": GRID, "resolution": 1.0, "headings": 8}),
    (
        pose_posterior,
        {"model": BEAM_MODEL, "z": SCAN, "lattice": partial(PoseLattice.over_map, GRID, resolution=1.0)},
    ),
    (RangeNoise, {"sigma_range": 0.01, "sigma_bearing": 0.001, "sigma_slope": 0.01}),
    (find_lines, {"scan": SCAN, "noise": RangeNoise(0.05)}),
    (find_corners, {"lines": partial(find_lines, SCAN, RangeNoise(0.05))}),
    (find_local_minima, {"scan": SCAN, "noise": RangeNoise(0.05)}),
    (find_poles, {"scan": SCAN, "noise": RangeNoise(0.05)}),
    (
        learn_intrinsic_parameters,
        {
            "ranges": np.linspace(0.1, 4.9, 50),
            "expected_ranges": np.linspace(1.0, 4.0, 50),
            "max_range": 5.0,
            "min_range": 0.05,
            "n_starts": 1,
            "max_iterations": 4,
        },
    ),
    (
        block_intervals,
        {
            "ranges": np.linspace(0.1, 4.9, 40),
            "expected_ranges": np.linspace(1.0, 4.0, 40),
            "stamps": STAMPS,
            "max_range": 5.0,
            "parameters": BEAM,
            "block_s": 5.0,
        },
    ),
    (IntrinsicPriors, {}),
    (SelectionOptions, {}),
    (CalibrationOptions, {}),
    (calibrate, {"log": LOG, "grid": GRID}),
    (find_changed_places, {"log": LOG, "grid": GRID, "parameters": BEAM, "reference_error": 0.04, "block_s": 5.0}),
    (judge_scan, {"model": BEAM_MODEL, "scan": SCAN, "pose": POSES[0]}),
    (sonar_ring, {"n_sensors": 8, "radius": 0.2, "opening_angle": 0.3, "max_range": 5.0}),
    (
        heard_ranges,
        {
            "caster": partial(ConeCaster, GRID),
            "poses": POSES,
            "ring": RangeFinder(POSES, 5.0, opening_angle=0.3),
            "roughness": 0.5,
            "rng": np.random.default_rng(0),
        },
    ),
    (
        simulate_log,
        {
            "grid": GRID,
            "finder": FINDER,
            "parameters": BEAM,
            "duration": 2.0,
            "scan_rate": 2.0,
            "seed": 1,
            "start": 0.0,
        },
    ),
]


def name_of(function: Callable[..., Any]) -> str:
    return function.__qualname__


@pytest.mark.parametrize(("function", "arguments"), CALLS, ids=[name_of(call[0]) for call in CALLS])
def test_what_does_not_belong_there_is_refused_or_used(function, arguments):
    known = inspect.signature(function).parameters
    assert set(arguments) <= set(known), "the table calls something that there is not"
    arguments = {name: value() if isinstance(value, partial) else value for name, value in arguments.items()}
    attempt(function, arguments)  # compiled, and warm
    for name in known:
        if name in ("self", "args", "kwargs", "limits", "options", "progress"):
            continue
        for what, value in HOSTILE.items():
            began = time.process_time()
            text = attempt(function, {**arguments, name: value})
            assert time.process_time() - began < 2.0, f"{name}={what} took long: {text}"


def attempt(function: Callable[..., Any], arguments: dict[str, Any]) -> str:
    """Call it; return the text of an error that is ours. Everything else is the test's failure."""
    try:
        function(**arguments)
    except BeamfieldError as error:
        return str(error)
    return ""
