"""What every measurement model must offer the contract tests: one `Case` per model, listed in CASES."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from beamfield.detections import SPURIOUS, Detections
from beamfield.geometry import compose, transform_points
from beamfield.localization.coarse_model import CoarseModel
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.maps.markers import MarkerMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.ceiling_camera import CeilingCamera
from beamfield.models.cell_difference import CellDifferenceModel
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.histogram_matching import HistogramMatchingModel
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.models.map_matching import MapMatchingModel
from beamfield.models.marker import MarkerDetections, MarkerModel, MarkerParameters
from beamfield.models.sonar import SonarModel
from beamfield.sensors import RangeFinder, Scan
from tests.contract.densities import (
    beam_transform,
    integrate_one_beam,
    integrate_one_feature,
    integrate_one_line,
    integrate_one_marker,
    landmark_transform,
    line_transform,
    marker_transform,
)


@dataclass(frozen=True)
class Case:
    """One model under contract.

    Parameters
    ----------
    build
        (map_from_moved, **options) -> model; the whole map is moved by the pose `map_from_moved`. Among the options
        are parameters by name.
    options
        Variants of construction; each is tested.
    measurements
        Measurements, odd ones included.
    integral
        (model, pose) -> integral of the density over all measurements of one feature (beam, landmark), plus masses;
        None for models that are no densities.
    transform
        (model, measurements, pose, rng) -> values that are uniform on [0, 1] for measurements drawn at that pose; None
        for models that cannot draw.
    options_close_by
        Options of a second model that is close to the first, for importance sampling.
    """

    name: str
    build: Callable[..., Any]
    options: tuple[dict[str, Any], ...]
    measurements: tuple[Any, ...]
    integral: Callable[[Any, np.ndarray], float] | None = None
    transform: Callable[[Any, list[Any], np.ndarray, np.random.Generator], np.ndarray] | None = None
    options_close_by: dict[str, Any] | None = None

    def __str__(self) -> str:
        return self.name


# Letters: # occupied, . free, ? unknown. The top line is the highest y.
FLOOR = """
##############
#......#.....#
#......#.....#
#..........?.#
#......#..??.#
#......#.....#
##.#####.....#
#............#
#.....##.....#
##############
"""
RESOLUTION = 0.5
FINDER = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 9), 5.0, mount=(0.11, -0.07, 0.3), name="lidar")
SONAR_FINDER = replace(FINDER, opening_angle=0.6, name="sonar")
# The same with a blind zone: for odd readings, and one that is wide beside the noise.
BLIND_FINDER = replace(FINDER, min_range=0.05)
BLIND_SONAR = replace(SONAR_FINDER, min_range=0.05)
SHORT_SIGHTED = replace(FINDER, min_range=0.3)
SHORT_SIGHTED_SONAR = replace(SONAR_FINDER, min_range=0.3)
# Odd ones included, with room to be in the map or out of it.
POSES = np.array(
    [
        [1.63, 1.21, 0.4],
        [1.63, 1.21, 3.5],
        [2.2, 3.37, -1.2],
        [5.3, 2.1, 2.9],
        [3.6, 2.3, 0.1],  # in a wall
        [-1.37, 2.2, 0.2],  # off the map, looking at it
        [40.0, 40.0, 0.0],  # off the map, far away
    ]
)


HOME = (0.0, 0.0, 0.0)
BEAM = BeamParameters(z_hit=0.6, z_short=0.2, z_max=0.1, z_rand=0.1, sigma_hit=0.1, lambda_short=0.8)
FIELD = LikelihoodFieldParameters(z_hit=0.7, z_rand=0.2, sigma_hit=0.2)
LANDMARK = LandmarkParameters(sigma_range=0.3, sigma_bearing=0.2, spurious_rate=0.2, max_range=80.0)
LINE = LineParameters(sigma_rho=0.3, sigma_alpha=0.2, spurious_rate=0.2, max_range=80.0)
MARKER = MarkerParameters(sigma_pixel=2.0, sigma_angle=0.05)


def changed(parameters: Any, options: dict[str, Any]) -> Any:
    """Return the parameters with the values that options have for them, which are taken out of the options."""
    known = [name for name in options if name in parameters.__dataclass_fields__]
    return replace(parameters, **{name: options.pop(name) for name in known})


def draw_floor(origin: ArrayLike) -> OccupancyGrid:
    """Return the floor as a grid whose lower-left corner has the given pose."""
    values = {"#": 100, ".": 0, "?": -1}
    rows = FLOOR.strip().splitlines()[::-1]
    return OccupancyGrid.from_ros([[values[c] for c in row] for row in rows], RESOLUTION, origin)


def build_beam_model(map_from_moved: ArrayLike = HOME, **options: Any) -> BeamModel:
    """Return a beam model of the floor."""
    parameters = changed(BEAM, options)
    return BeamModel(draw_floor(map_from_moved), parameters, **{"finder": FINDER, **options})


def build_sonar_model(map_from_moved: ArrayLike = HOME, **options: Any) -> SonarModel:
    """Return a sonar model of the floor, or of three posts."""
    posts = LandmarkMap(transform_points(map_from_moved, [[0.6, 0.7], [4.1, 2.2], [2.6, 1.6]]))
    chosen = posts if options.pop("landmarks", False) else draw_floor(map_from_moved)
    parameters = changed(BEAM, options)
    return SonarModel(chosen, parameters, **{"finder": SONAR_FINDER, **options})


def build_matching(model: Callable[..., Any]) -> Callable[..., Any]:
    """Return a `Case.build` for a model that compares local maps with the floor."""
    return lambda map_from_moved=HOME, **options: model(draw_floor(map_from_moved), **options)


def build_likelihood_field(map_from_moved: ArrayLike = HOME, **options: Any) -> LikelihoodFieldModel:
    """Return a likelihood field of the floor."""
    parameters = changed(FIELD, options)
    return LikelihoodFieldModel(draw_floor(map_from_moved), parameters, **options)


def build_coarse_model(map_from_moved: ArrayLike = HOME, **options: Any) -> CoarseModel:
    """Return the model of the floor that weighs scans until a robot is found."""
    return CoarseModel(draw_floor(map_from_moved), **options)


def build_landmark_model(map_from_moved: ArrayLike = HOME, **options: Any) -> LandmarkModel:
    """Return a landmark model of three landmarks."""
    landmarks = LandmarkMap(transform_points(map_from_moved, [[0.6, 0.7], [4.1, 2.2], [6.3, 3.9]]), ids=[7, 3, 12])
    parameters = changed(LANDMARK, options)
    return LandmarkModel(landmarks, parameters, **{"correspondence": "known", **options})


# One wall goes through a pose, another has its direction but for a little.
WALLS = np.array([[0.5, 0.2, 7.0, 0.4], [1.63, 1.21, 1.9, 4.0], [6.8, 4.6, 0.2, 4.5]])


def build_line_model(map_from_moved: ArrayLike = HOME, **options: Any) -> LineModel:
    """Return a model of three walls."""
    ends = transform_points(map_from_moved, WALLS.reshape(3, 2, 2)).reshape(3, 4)
    parameters = changed(LINE, options)
    return LineModel(LineMap.from_segments(ends, ids=[7, 3, 12]), parameters, **{"correspondence": "known", **options})


CEILING_CAMERA = CeilingCamera(400.0, 2.5, (0.11, -0.07, 0.3), (320.0, 240.0))
CEILING = MarkerMap([3, 8, "door"], [[1.0, 2.0, 0.5], [2.1, 1.7, -3.0], [0.4, 1.1, 2.0]])


def build_marker_model(map_from_moved: ArrayLike = HOME, **options: Any) -> MarkerModel:
    """Return a model of three markers on the ceiling."""
    markers = MarkerMap(CEILING.ids, compose(map_from_moved, CEILING.poses))
    parameters = changed(MARKER, options)
    return MarkerModel(markers, parameters, **{"camera": CEILING_CAMERA, **options})


NO_RETURN = [0.0, 1.2, np.inf, 5.0, 4.9999, 7.0, 0.3, 2.0, 2.5]
NOTHING = [np.nan] * 9
MIXED = [np.nan, -np.inf, 0.01, 1.0, 2.0, np.nan, np.inf, 0.5, 1.5]
USUAL = [1.0, 1.1, 1.2, 1.0, 2.1, 2.2, 0.4, 1.5, 1.5]
SCANS = tuple(Scan(ranges, BLIND_FINDER) for ranges in (USUAL, NO_RETURN, MIXED, NOTHING))
# A local map, turned in the robot's frame, with unknown cells.
LOCAL_MAP = OccupancyGrid(
    [[0.1, 0.2, 0.9, np.nan], [0.1, np.nan, 0.8, 0.5], [1.0, 1.0, 0.4, 0.0]], 0.4, (-0.7, 0.1, 0.6)
)

# Range and bearing, bearing only, range only, neither; a negative range and a bearing beyond pi.
FEATURES = Detections(
    [2.1, np.nan, 3.0, np.nan, -0.1, 4.0], [0.5, 2.0, np.nan, np.nan, 1.0, 7.3], ids=[7, 3, 12, 7, 3, SPURIOUS]
)

# A line through the sensor, one half a turn away, one whose alpha has turns of its own.
LINES = LineDetections(
    [[2.1, 0.5], [0.0, 2.0], [-3.0, 0.1], [1.2, 40.0], [70.0, 1.0]],
    [[0.04, 0.01], [0.01, 0.02]],
    [[2.0, -1.0, 2.1, 1.0], [0.0, 0.0, 1.0, 0.0], [3.0, 0.0, 3.0, 1.0], [1.0, 1.0, 2.0, 1.0], [0.0, 70.0, 1.0, 70.0]],
    ids=[7, 3, 12, 7, SPURIOUS],
)

CASES = [
    Case(
        name="beam",
        build=build_beam_model,
        options=(
            {},
            {"exponent": 0.3, "n_beams": 4},
            {"unknown": "occupied"},
            {"range_offset": 0.1, "sigma_slope": 0.05, "lambda_short": 0.0},
            {"z_hit": 0.9, "z_short": 0.1, "z_max": 0.0, "z_rand": 0.0, "sigma_hit": 0.01},
            {"finder": SHORT_SIGHTED, "range_offset": -0.05, "sigma_slope": 0.05},
        ),
        measurements=SCANS,
        integral=integrate_one_beam,
        transform=beam_transform,
        options_close_by={"z_hit": 0.55, "z_rand": 0.15, "sigma_hit": 0.105, "lambda_short": 0.7},
    ),
    Case(
        name="sonar",
        build=build_sonar_model,
        options=(
            {},
            {"exponent": 0.3, "n_beams": 4},
            {"unknown": "occupied", "range_offset": 0.1, "sigma_slope": 0.05},
            {"landmarks": True},
            {"landmarks": True, "landmark_radius": 0.1, "lambda_short": 0.0},
            {"finder": SHORT_SIGHTED_SONAR, "range_offset": -0.05, "sigma_slope": 0.05},
        ),
        measurements=tuple(Scan(z.ranges, BLIND_SONAR) for z in SCANS),
        integral=integrate_one_beam,
        transform=beam_transform,
        options_close_by={"z_hit": 0.55, "z_rand": 0.15, "sigma_hit": 0.105, "lambda_short": 0.7},
    ),
    Case(
        name="likelihood field",
        build=build_likelihood_field,
        options=(
            {},
            {"exponent": 0.3, "n_beams": 4},
            {"unknown": "uniform", "max_distance": 1.5},
            {"off_map": "far", "only_boundaries": True},
            {"z_hit": 1.0, "z_rand": 0.0, "sigma_hit": 0.03},
            {"interpolation": "bilinear"},
            {"interpolation": "bilinear", "unknown": "uniform", "off_map": "far"},
            {"interpolation": "bilinear", "z_hit": 1.0, "z_rand": 0.0, "sigma_hit": 0.03},
        ),
        measurements=SCANS,
    ),
    Case(name="coarse", build=build_coarse_model, options=({}, {"n_beams": 4}), measurements=SCANS),
    Case(
        name="landmarks",
        build=build_landmark_model,
        options=(
            {},
            {"correspondence": "sum"},
            {"mount": (0.3, -0.2, 0.9), "range_bias": 0.4, "bearing_bias": -0.3, "range_scale": 1.1},
            {"sigma_bearing": 2.5, "correspondence": "sum"},
        ),
        measurements=(FEATURES, Detections([], [])),
        integral=integrate_one_feature,
        transform=landmark_transform,
        options_close_by={"sigma_range": 0.31, "sigma_bearing": 0.205},
    ),
    Case(
        name="landmarks of unknown id",
        build=partial(build_landmark_model, correspondence="nearest"),
        options=tuple(
            {"correspondence": how, "spurious_rate": rate}
            for how in ("nearest", "sum", "assignment")
            for rate in (0.2, 0.0)
        ),
        measurements=(FEATURES.without_ids(), FEATURES, Detections([], [])),
    ),
    Case(
        name="lines",
        build=build_line_model,
        options=(
            {},
            {"correspondence": "sum"},
            {"mount": (0.3, -0.2, 0.9)},
            {"sigma_alpha": 2.0, "sigma_rho": 1.0, "correspondence": "sum"},
        ),
        measurements=(LINES, LineDetections([])),
        integral=integrate_one_line,
        transform=line_transform,
        options_close_by={"sigma_rho": 0.31, "sigma_alpha": 0.205},
    ),
    Case(
        name="lines of unknown id",
        build=partial(build_line_model, correspondence="nearest"),
        options=tuple(
            {"correspondence": how, "spurious_rate": rate, "min_overlap": overlap}
            for how in ("nearest", "sum", "assignment")
            for rate, overlap in ((0.2, 0.5), (0.0, None))
        ),
        measurements=(LINES.without_ids(), LINES, LineDetections([])),
    ),
    Case(
        name="ceiling marker",
        build=build_marker_model,
        options=(
            {},
            {"sigma_angle": 2.0},
            {"sigma_pixel": 30.0, "camera": CeilingCamera(900.0, 9.0)},
        ),
        measurements=(
            MarkerDetections([3, 8], [[400.0, 300.0, -0.4], [351.3, 77.0, 2.9]]),
            MarkerDetections(["door", 3, 3], [[1e6, -1e6, 100.0], [0.0, 0.0, np.nan], [320.0, 240.0, np.pi]]),
            MarkerDetections([], []),
        ),
        integral=integrate_one_marker,
        transform=marker_transform,
        options_close_by={"sigma_pixel": 2.1, "sigma_angle": 0.052},
    ),
    *(
        Case(
            name=name,
            build=build_matching(model),
            options=({}, {"min_overlap": 0.9}, *options),
            measurements=(*SCANS, LOCAL_MAP),
        )
        for name, model, options in (
            ("map matching", MapMatchingModel, ({"smoothing": 0.3},)),
            ("cell difference", CellDifferenceModel, ({"sigma": 5.0},)),
            ("histogram matching", HistogramMatchingModel, ()),
        )
    ),
]


@pytest.fixture(params=CASES, ids=str)
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


@pytest.fixture(params=[case for case in CASES if case.name.endswith("of unknown id")], ids=str)
def of_unknown_id(request: pytest.FixtureRequest) -> Case:
    return request.param


@pytest.fixture(params=[case for case in CASES if any("exponent" in options for options in case.options)], ids=str)
def with_exponent(request: pytest.FixtureRequest) -> Case:
    return request.param


@pytest.fixture(params=[case for case in CASES if case.integral is not None], ids=str)
def normalized(request: pytest.FixtureRequest) -> Case:
    return request.param


@pytest.fixture(params=[case for case in CASES if case.transform is not None], ids=str)
def generative(request: pytest.FixtureRequest) -> Case:
    return request.param
