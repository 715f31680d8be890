"""What every measurement model must offer the contract tests: one `Case` per model, listed in CASES."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import stats

from beamfield.detections import SPURIOUS, UNKNOWN, Detections
from beamfield.geometry import compose, transform_points, wrap_angle
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.maps.markers import MarkerMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel, beam_pit
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.cell_difference import CellDifferenceModel
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.histogram_matching import HistogramMatchingModel
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.models.map_matching import MapMatchingModel
from beamfield.models.marker import CeilingCamera, MarkerDetections, MarkerModel, MarkerParameters
from beamfield.models.sonar import SonarModel
from beamfield.sensors import RangeFinder, Scan


@dataclass(frozen=True)
class Case:
    """One model under contract.

    Parameters
    ----------
    build
        (map_from_moved, **options) -> model; the whole map is moved by the pose `map_from_moved`.
    options
        Variants of construction; each is tested.
    measurements
        Measurements, odd ones included.
    poses
        (n, 3), odd ones included, with room to be in the map or out of it.
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
    poses: np.ndarray
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


def draw_floor(origin: np.ndarray) -> OccupancyGrid:
    """Return the floor as a grid whose lower-left corner has the given pose."""
    values = {"#": 100, ".": 0, "?": -1}
    rows = FLOOR.strip().splitlines()[::-1]
    return OccupancyGrid.from_ros([[values[c] for c in row] for row in rows], RESOLUTION, origin)


def build_beam_model(map_from_moved: ArrayLike = (0.0, 0.0, 0.0), **options: Any) -> BeamModel:
    """Return a beam model of the floor; `parameters` as keywords of their own replace the defaults."""
    values = {"z_hit": 0.6, "z_short": 0.2, "z_max": 0.1, "z_rand": 0.1, "sigma_hit": 0.1, "lambda_short": 0.8}
    changed = {name: options.pop(name) for name in list(options) if name in BeamParameters.__dataclass_fields__}
    grid = draw_floor(compose(map_from_moved, np.zeros(3)))
    return BeamModel(grid, BeamParameters(**{**values, **changed}), **{"finder": FINDER, **options})


def build_sonar_model(map_from_moved: ArrayLike = (0.0, 0.0, 0.0), **options: Any) -> SonarModel:
    """Return a sonar model of the floor, or of three posts; `parameters` as for the beam model."""
    if options.pop("landmarks", False):
        points = [[0.6, 0.7], [4.1, 2.2], [2.6, 1.6]]
        chosen: Any = LandmarkMap(transform_points(map_from_moved, points))
    else:
        chosen = draw_floor(compose(map_from_moved, np.zeros(3)))
    values = {"z_hit": 0.6, "z_short": 0.2, "z_max": 0.1, "z_rand": 0.1, "sigma_hit": 0.1, "lambda_short": 0.8}
    changed = {name: options.pop(name) for name in list(options) if name in BeamParameters.__dataclass_fields__}
    return SonarModel(chosen, BeamParameters(**{**values, **changed}), **{"finder": SONAR_FINDER, **options})


def build_matching(model: Callable[..., Any]) -> Callable[..., Any]:
    """Return a `Case.build` for a model that compares local maps with the floor."""

    def build(map_from_moved: ArrayLike = (0.0, 0.0, 0.0), **options: Any) -> Any:
        return model(draw_floor(compose(map_from_moved, np.zeros(3))), **options)

    return build


def integrate_one_beam(model: BeamModel | SonarModel, pose: np.ndarray) -> float:
    """Return the integral over the range of a single beam, by the midpoint rule, plus the mass at max_range."""
    finder = model.finder.subset([4])
    total = np.exp(model.log_likelihood(Scan([FINDER.max_range], finder), pose))
    # In a wall, p_short fills the first micrometre.
    first = finder.min_range + 2e-6
    for low, high, n in [(finder.min_range, first, 100), (first, FINDER.max_range, 50_000)]:
        ranges = low + (np.arange(n) + 0.5) * (high - low) / n
        same_ray = finder.subset(np.zeros(n, np.int64))
        density = np.exp(model.beam_log_likelihood(Scan(ranges, same_ray), pose))
        total += density.mean() * (high - low)
    return float(total)


def beam_transform(
    model: BeamModel | SonarModel, scans: list[Scan], pose: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the randomised probability integral transform of all beams of all scans."""
    ranges = np.array([scan.ranges for scan in scans])
    low = model.finder.min_range
    return beam_pit(ranges, model.expected(pose), FINDER.max_range, model.parameters, rng, min_range=low).ravel()


def build_likelihood_field(map_from_moved: ArrayLike = (0.0, 0.0, 0.0), **options: Any) -> LikelihoodFieldModel:
    """Return a likelihood field of the floor; `parameters` as keywords of their own replace the defaults."""
    values = {"z_hit": 0.7, "z_rand": 0.2, "sigma_hit": 0.2}
    changed = {name: options.pop(name) for name in list(options) if name in values}
    grid = draw_floor(compose(map_from_moved, np.zeros(3)))
    return LikelihoodFieldModel(grid, LikelihoodFieldParameters(**{**values, **changed}), **options)


def build_landmark_model(map_from_moved: ArrayLike = (0.0, 0.0, 0.0), **options: Any) -> LandmarkModel:
    """Return a landmark model of three landmarks; `parameters` as keywords of their own replace the defaults."""
    values = {"sigma_range": 0.3, "sigma_bearing": 0.2, "spurious_rate": 0.2, "max_range": 80.0}
    changed = {name: options.pop(name) for name in list(options) if name in LandmarkParameters.__dataclass_fields__}
    landmarks = LandmarkMap(transform_points(map_from_moved, [[0.6, 0.7], [4.1, 2.2], [6.3, 3.9]]), ids=[7, 3, 12])
    return LandmarkModel(
        landmarks, LandmarkParameters(**{**values, **changed}), **{"correspondence": "known", **options}
    )


def integrate_one_feature(model: LandmarkModel, pose: np.ndarray) -> float:
    """Return the integral over range and bearing of one feature, by the midpoint rule."""
    ranges, bearings = -4.95 + 0.1 * np.arange(950), (np.arange(160) + 0.5) * np.pi / 80.0
    r, phi = (axis.ravel() for axis in np.meshgrid(ranges, bearings))
    which = UNKNOWN if model.correspondence == "sum" else 3
    density = np.exp(model.detection_log_likelihood(Detections(r, phi, ids=np.full(r.size, which)), pose))
    return float(density.sum() * 0.1 * np.pi / 80.0)


def landmark_transform(
    model: LandmarkModel, features: list[Detections], pose: np.ndarray, _: np.random.Generator
) -> np.ndarray:
    """Return the probability integral transform of all ranges and bearings."""
    expected = model.expected(pose)
    a = np.array([z.ranges - expected[:, 0] for z in features]) / model.parameters.sigma_range
    b = np.array([wrap_angle(z.bearings - expected[:, 1]) for z in features]) / model.parameters.sigma_bearing
    end = np.pi / model.parameters.sigma_bearing
    return np.concatenate([stats.norm.cdf(a).ravel(), stats.truncnorm.cdf(b, -end, end).ravel()])


# One wall goes through a pose, another has its direction but for a little.
WALLS = np.array([[0.5, 0.2, 7.0, 0.4], [1.63, 1.21, 1.9, 4.0], [6.8, 4.6, 0.2, 4.5]])


def build_line_model(map_from_moved: ArrayLike = (0.0, 0.0, 0.0), **options: Any) -> LineModel:
    """Return a model of three walls; `parameters` as keywords of their own replace the defaults."""
    values = {"sigma_rho": 0.3, "sigma_alpha": 0.2, "spurious_rate": 0.2, "max_range": 80.0}
    changed = {name: options.pop(name) for name in list(options) if name in LineParameters.__dataclass_fields__}
    ends = transform_points(map_from_moved, WALLS.reshape(3, 2, 2)).reshape(3, 4)
    walls = LineMap.from_segments(ends, ids=[7, 3, 12])
    return LineModel(walls, LineParameters(**{**values, **changed}), **{"correspondence": "known", **options})


def integrate_one_line(model: LineModel, pose: np.ndarray) -> float:
    """Return the integral over rho and alpha of one line, by the midpoint rule."""
    rho, alpha = 0.05 + 0.1 * np.arange(800), (np.arange(160) + 0.5) * np.pi / 80.0
    r, a = (axis.ravel() for axis in np.meshgrid(rho, alpha))
    which = np.full(r.size, UNKNOWN if model.correspondence == "sum" else 3)
    density = np.exp(model.detection_log_likelihood(LineDetections(np.column_stack([r, a]), ids=which), pose))
    return float(density.sum() * 0.1 * np.pi / 80.0)


def line_transform(
    model: LineModel, samples: list[LineDetections], pose: np.ndarray, _: np.random.Generator
) -> np.ndarray:
    """Return the distribution functions of rho, folded at 0, and of alpha given rho, from half a turn before it."""
    expected = model.expected(pose)
    measured = np.array([z.lines for z in samples])
    rho, wide = measured[..., 0] / model.parameters.sigma_rho, np.pi / model.parameters.sigma_alpha
    d = expected[:, 0] / model.parameters.sigma_rho
    of_rho = stats.norm.cdf(rho - d) - stats.norm.cdf(-rho - d)
    turn = wrap_angle(measured[..., 1] - expected[:, 1])
    same = stats.norm.pdf(rho - d) / (stats.norm.pdf(rho - d) + stats.norm.pdf(rho + d))
    law = stats.truncnorm(-wide, wide, scale=model.parameters.sigma_alpha)
    behind = np.where(turn <= 0.0, law.cdf(turn + np.pi) - 0.5, 0.5 + law.cdf(turn - np.pi))
    return np.concatenate([of_rho.ravel(), (same * law.cdf(turn) + (1.0 - same) * behind).ravel()])


CEILING_CAMERA = CeilingCamera(400.0, 2.5, (0.11, -0.07, 0.3), (320.0, 240.0))
CEILING = MarkerMap([3, 8, "door"], [[1.0, 2.0, 0.5], [2.1, 1.7, -3.0], [0.4, 1.1, 2.0]])


def build_marker_model(map_from_moved: ArrayLike = (0.0, 0.0, 0.0), **options: Any) -> MarkerModel:
    """Return a model of three markers on the ceiling."""
    markers = MarkerMap(CEILING.ids, compose(map_from_moved, CEILING.poses))
    noise = {name: options.pop(name, value) for name, value in (("sigma_pixel", 2.0), ("sigma_angle", 0.05))}
    return MarkerModel(markers, MarkerParameters(**noise), **{"camera": CEILING_CAMERA, **options})


def integrate_one_marker(model: MarkerModel, pose: np.ndarray) -> float:
    """Return the integral over place and angle of one marker, by the trapezoidal rule in steps of sigma."""
    steps = np.arange(-6.0, 7.0) * model.parameters.sigma_pixel
    n_angles = int(np.ceil(2.0 * np.pi / model.parameters.sigma_angle)) + 8
    angles = -np.pi + 2.0 * np.pi * np.arange(n_angles) / n_angles
    noise = np.stack(np.meshgrid(steps, steps, angles, indexing="ij"), axis=-1).reshape(-1, 3)
    z = MarkerDetections([8] * len(noise), model.expected(pose)[1] + noise)
    cell = (steps[1] - steps[0]) ** 2 * 2.0 * np.pi / n_angles
    return float(np.exp(model.detection_log_likelihood(z, pose)).sum() * cell)


def marker_transform(
    model: MarkerModel, samples: list[MarkerDetections], pose: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Return the distribution functions of places and (from half a turn before the expected one) of angles."""
    del rng  # nothing is discrete
    error = np.array([z.image for z in samples]) - model.expected(pose)
    angle = np.pi - np.mod(np.pi - error[..., 2], 2.0 * np.pi)
    turns = 2.0 * np.pi * np.arange(-10, 11)[:, None, None]
    law = stats.norm(0.0, model.parameters.sigma_angle)
    of_angle = (law.cdf(angle + turns) - law.cdf(-np.pi + turns)).sum(axis=0)
    return np.concatenate([stats.norm.cdf(error[..., :2] / model.parameters.sigma_pixel).ravel(), of_angle.ravel()])


NO_RETURN = [0.0, 1.2, np.inf, 5.0, 4.9999, 7.0, 0.3, 2.0, 2.5]
NOTHING = [np.nan] * 9
MIXED = [np.nan, -np.inf, 0.01, 1.0, 2.0, np.nan, np.inf, 0.5, 1.5]
USUAL = [1.0, 1.1, 1.2, 1.0, 2.1, 2.2, 0.4, 1.5, 1.5]
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
        measurements=tuple(Scan(ranges, BLIND_FINDER) for ranges in (USUAL, NO_RETURN, MIXED, NOTHING)),
        poses=POSES,
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
        measurements=tuple(Scan(ranges, BLIND_SONAR) for ranges in (USUAL, NO_RETURN, MIXED, NOTHING)),
        poses=POSES,
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
        measurements=tuple(Scan(ranges, BLIND_FINDER) for ranges in (USUAL, NO_RETURN, MIXED, NOTHING)),
        poses=POSES,
    ),
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
        poses=POSES,
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
        measurements=(FEATURES.without_ids(), FEATURES),
        poses=POSES,
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
        poses=POSES,
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
        measurements=(LINES.without_ids(), LINES),
        poses=POSES,
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
        poses=POSES,
        integral=integrate_one_marker,
        transform=marker_transform,
        options_close_by={"sigma_pixel": 2.1, "sigma_angle": 0.052},
    ),
    *(
        Case(
            name=name,
            build=build_matching(model),
            options=({}, {"min_overlap": 0.9}, *options),
            measurements=(*(Scan(ranges, BLIND_FINDER) for ranges in (USUAL, NO_RETURN, MIXED, NOTHING)), LOCAL_MAP),
            poses=POSES,
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


@pytest.fixture
def of_unknown_id(case: Case) -> Case:
    if not case.name.endswith("of unknown id"):
        pytest.skip(f"{case.name} knows no correspondences")
    return case


@pytest.fixture
def normalized(case: Case) -> Case:
    if case.integral is None:
        pytest.skip(f"{case.name} is no density over measurements")
    return case


@pytest.fixture
def generative(case: Case) -> Case:
    if case.transform is None:
        pytest.skip(f"{case.name} cannot draw measurements")
    return case
