"""What `make bench` holds against baselines and limits: rays, models, learning, maps; one thread."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.special import ndtr

import limit
from beam_model import PARAMETERS, anywhere, near, numpy_log_likelihood, office
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, theta_of
from beamfield.calibration.intrinsic.m_steps import m_step
from beamfield.geometry import FloatArray
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.mapping import scan_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import BeamModel
from beamfield.models.beam_sampling import sample_beams
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.map_matching import MapMatchingModel
from beamfield.models.range_mixture import RAYS_PER_CHUNK
from beamfield.sensors import RangeFinder, Scan
from landmark import numpy_log_likelihood as numpy_landmarks
from learning import TRUTH
from likelihood_field import PARAMETERS as FIELD_PARAMETERS
from likelihood_field import numpy_interpolated, numpy_model
from map_matching import plain_correlation
from measure import Call, Case
from raycast import textbook_traversal

MAX_RANGE, N_BEAMS, N_POSES = 20.0, 60, 2000
PLACE = np.array([25.0, 25.0, 0.3])
PLAIN = "cell by cell (Numba)"


def cases() -> Iterator[Case]:
    """Yield every case; maps and models of one are gone before the next group is measured."""
    grid, rng = office(np.random.default_rng(7)), np.random.default_rng(8)
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, N_BEAMS, endpoint=False), MAX_RANGE)
    scan = BeamModel(grid, PARAMETERS).sample(PLACE, finder, rng)[0]
    patterns = {"track": near(PLACE, rng, N_POSES), "global": anywhere(grid, rng, N_POSES)}
    for name, poses in patterns.items():
        yield from rays(name, grid, finder, poses)
        yield beams(f"beam model, {name}", grid, scan, poses)
        yield looked_up(name, grid, scan)
        yield from fields(name, grid, scan, poses)
    yield from landmarks(rng)
    yield matching(grid, scan, near(PLACE, rng, 500))
    for n in (10**4, 10**5, 10**6):
        yield learning(n, rng)
    yield distances(grid)
    one = PLACE[None]
    yield casting("one pose: rays", RayCaster(grid), grid, finder, one)
    yield beams("one pose: beam model", grid, scan, one)
    yield from fields("one pose", grid, scan, one)


def rays(name: str, grid: OccupancyGrid, finder: RangeFinder, poses: FloatArray) -> Iterator[Case]:
    """Yield exact and pre-cached ranges."""
    yield casting(f"rays, {name}", RayCaster(grid), grid, finder, poses)
    table = RangeTable.build(grid, max_range=MAX_RANGE)
    yield casting(f"rays from a table of 0.15 m x 2 deg, {name}", table, grid, finder, poses)


def casting(
    name: str, caster: RayCaster | RangeTable, grid: OccupancyGrid, finder: RangeFinder, poses: FloatArray,
) -> Case:  # fmt: skip
    """Return casting beside the traversal of the textbooks, in ranges of metres."""
    plain = textbook_ranges(grid, finder, poses)
    off = np.abs(caster.expected_ranges(poses, finder) - plain())
    by_hand = limit.cast(caster, poses, finder) if isinstance(caster, RayCaster) else None
    return Case(
        name, lambda: caster.expected_ranges(poses, finder), plain, PLAIN, *unit(poses), by_hand,
        f"{np.mean(off > grid.resolution):.2g} of rays off by > a cell, median {np.median(off):.1g} m",
    )  # fmt: skip


def beams(name: str, grid: OccupancyGrid, scan: Scan, poses: FloatArray) -> Case:
    """Return the beam model, rays included, beside plain rays and the closed form."""
    model, caster = BeamModel(grid, PARAMETERS), RayCaster(grid)
    ranges = textbook_ranges(grid, scan.finder, poses)

    def plain() -> FloatArray:
        return numpy_log_likelihood(scan.ranges, ranges())

    return Case(
        name, lambda: model.log_likelihood(scan, poses), plain, f"{PLAIN}, NumPy's closed form", *unit(poses),
        limit.beam(caster, poses, scan, PARAMETERS), nats(model.log_likelihood(scan, poses), plain()),
    )  # fmt: skip


def looked_up(name: str, grid: OccupancyGrid, scan: Scan) -> Case:
    """Return the beam model at very many poses, rays included, beside our rays alone, in parts as large as its own."""
    model, rng, n = BeamModel(grid, PARAMETERS), np.random.default_rng(9), 10**5
    poses = near(PLACE, rng, n) if name == "track" else anywhere(grid, rng, n)
    parts = np.array_split(poses, n * N_BEAMS // RAYS_PER_CHUNK)

    def rays_alone() -> None:
        for part in parts:
            model.expected(part, scan.finder)

    computed = np.concatenate([model.log_likelihood(scan, part) for part in np.split(poses, n // N_POSES)])
    return Case(
        f"beam model, {n:,} poses, {name}", lambda: model.log_likelihood(scan, poses), rays_alone, "our rays alone",
        *unit(poses), accuracy=nats(model.log_likelihood(scan, poses), computed),
    )  # fmt: skip


def fields(name: str, grid: OccupancyGrid, scan: Scan, poses: FloatArray) -> Iterator[Case]:
    """Yield the likelihood field, nearest and bilinear."""
    for how, reference in (("nearest", numpy_model(grid)), ("bilinear", numpy_interpolated(grid))):
        model = LikelihoodFieldModel(grid, FIELD_PARAMETERS, interpolation=how)  # type: ignore[arg-type]
        plain = partial(reference, scan, poses)
        title = f"one pose: field, {how}" if name == "one pose" else f"field, {how}, {name}"
        yield Case(
            title, partial(model.log_likelihood, scan, poses), plain, "NumPy float32", *unit(poses),
            accuracy=nats(model.log_likelihood(scan, poses), plain()),
        )  # fmt: skip


def landmarks(rng: np.random.Generator) -> Iterator[Case]:
    """Yield features of known and of unknown landmarks."""
    noise = LandmarkParameters(sigma_range=0.2, sigma_bearing=0.03, spurious_rate=0.05, max_range=30.0)
    field = LandmarkMap(rng.uniform(0.0, 20.0, (50, 2)))
    known = LandmarkModel(field, noise, correspondence="known")
    truth = np.array([9.0, 8.0, 0.7])
    z = known.sample(truth, rng)[0]
    for name, n in (("", N_POSES), ("one pose: ", 1)):
        poses = near(truth, rng, n)
        plain = partial(numpy_landmarks, field, z, poses)
        units = (1e3, "us per call") if n == 1 else (n * len(z), "ns per pose x feature")
        yield Case(
            f"{name}landmarks, known", partial(known.log_likelihood, z, poses), plain, "NumPy", *units,
            accuracy=nats(known.log_likelihood(z, poses), plain()),
        )  # fmt: skip
    # Features that no landmark can mask: of 5 of 50 landmarks.
    few, poses = known.sample(truth, rng, ids=[1, 11, 21, 31, 41])[0], near(truth, rng, N_POSES)
    model = LandmarkModel(field, noise, correspondence="nearest")

    def nearest() -> FloatArray:
        measured = zip(few.ranges, few.bearings, strict=True)
        each = [numpy_landmarks_each(field, noise, r, phi, poses) for r, phi in measured]
        none = -np.log(2.0 * np.pi * 30.0) + np.log(0.05)
        return np.sum([np.maximum(e.max(axis=1) + np.log(0.95 / 50), none) for e in each], axis=0)

    unknown = few.without_ids()
    yield Case(
        "landmarks, nearest of 50", partial(model.log_likelihood, unknown, poses), nearest, "NumPy",
        len(poses) * len(few), "ns per pose x feature", accuracy=nats(model.log_likelihood(unknown, poses), nearest()),
    )  # fmt: skip


def numpy_landmarks_each(
    field: LandmarkMap, noise: LandmarkParameters, r: float, phi: float, poses: FloatArray
) -> FloatArray:
    """Return log p of one feature given each landmark, (n, N)."""
    away = field.positions - poses[:, None, :2]
    a = (np.hypot(away[..., 0], away[..., 1]) - r) / noise.sigma_range
    turn = np.arctan2(away[..., 1], away[..., 0]) - poses[:, None, 2] - phi
    b = (np.mod(turn + np.pi, 2.0 * np.pi) - np.pi) / noise.sigma_bearing
    return np.asarray(-0.5 * (a * a + b * b) - np.log(2.0 * np.pi * noise.sigma_range * noise.sigma_bearing))


def matching(grid: OccupancyGrid, scan: Scan, poses: FloatArray) -> Case:
    """Return the correlation of a scan's map with the map."""
    model = MapMatchingModel(grid)
    local = scan_map(scan, resolution=grid.resolution)
    plain = partial(plain_correlation(grid, local), poses)
    off = np.abs(plain() - model.correlation(scan, poses)).max()
    cells = int(np.count_nonzero(~np.isnan(local.probability)))
    return Case(
        "map matching", lambda: model.correlation(scan, poses), plain, "NumPy float32", len(poses) * cells,
        "ns per pose x cell", accuracy=f"{off:.1g} of correlation, largest",
    )  # fmt: skip


def learning(n: int, rng: np.random.Generator) -> Case:
    """Return an iteration of EM beside its E-step in closed form with whole arrays."""
    expected = np.minimum(rng.gamma(2.0, 2.5, n) + 0.2, 29.9)
    z = sample_beams(expected, 30.0, TRUTH, rng)
    likelihood, problem = IntrinsicLikelihood(z, expected, 30.0), learning_problem(30.0)
    theta = problem.apply(theta_of(TRUTH))

    def iteration() -> float:
        statistics = likelihood.expected_statistics(theta)
        m_step(statistics, theta, problem)
        return statistics.log_likelihood

    plain = numpy_e_step(z, expected, 30.0, theta)
    return Case(
        f"EM, {n:,} beams", iteration, plain, "NumPy's E-step alone", n, "ns per beam and iteration",
        accuracy=f"{abs(iteration() / plain() - 1.0):.1g} of log-likelihood",
    )  # fmt: skip


def numpy_e_step(z: FloatArray, expected: FloatArray, max_range: float, theta: FloatArray) -> Callable[[], float]:
    """Return the E-step of (6.27), weighted, with hits and shorts cut to where they can be."""

    def call() -> float:
        s, b, rate = np.sqrt(theta[4]), theta[6], theta[7]
        mass = ndtr((max_range - expected - b) / s) - ndtr((-expected - b) / s)
        hit = theta[0] * np.exp(-0.5 * ((z - expected - b) / s) ** 2) / (s * np.sqrt(2.0 * np.pi) * mass)
        short = theta[1] * np.where(z <= expected, rate * np.exp(-rate * z) / -np.expm1(-rate * expected), 0.0)
        density = hit + short + theta[3] / max_range
        returned = z < max_range
        (hit / density)[returned].sum(), (short / density * z)[returned].sum(), (short / density)[returned].sum()
        return float(np.log(np.where(returned, density, theta[2])).sum())

    return call


def distances(grid: OccupancyGrid) -> Case:
    """Return the distance map beside SciPy's exact transform."""
    occupied = grid.occupied

    def scipys() -> FloatArray:
        return np.asarray(distance_transform_edt(~occupied) * grid.resolution)

    off = np.abs(distance_to_obstacles(grid) - scipys()).max()
    return Case(
        "distance map", lambda: distance_to_obstacles(grid), scipys, "SciPy", occupied.size, "ns per cell",
        accuracy=f"{off:.1g} m, largest",
    )  # fmt: skip


def textbook_ranges(grid: OccupancyGrid, finder: RangeFinder, poses: FloatArray) -> Call:
    """Return the traversal of the textbooks, in metres."""
    out, bearings, occupied = np.empty((len(poses), finder.n_beams)), np.array(finder.bearings), np.array(grid.occupied)

    def call() -> FloatArray:
        textbook_traversal(poses, bearings, occupied, 1.0 / grid.resolution, MAX_RANGE / grid.resolution, out)
        return np.asarray(out * grid.resolution)

    return call


def unit(poses: FloatArray) -> tuple[float, str]:
    """Return what the time of a call is divided by, and what that makes of it."""
    return (1e3, "us per call") if len(poses) == 1 else (len(poses) * N_BEAMS, "ns per pose x beam")


def nats(ours: FloatArray, baseline: FloatArray) -> str:
    """Return how far two log-likelihoods of scans are apart."""
    apart = np.abs(ours - baseline)
    return f"{np.median(apart):.1g} nats a scan, median; largest {apart.max():.1g}"
