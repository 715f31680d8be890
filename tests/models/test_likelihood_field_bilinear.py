"""The likelihood field with interpolated distances against SciPy in double precision: values, sums, gradients."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from beamfield.geometry import compose, transform_points
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan
from tests.threads import forced_threads

MAX_RANGE = 8.0
PARAMETERS = {
    "usual": LikelihoodFieldParameters(0.7, 0.2, 0.1),
    "sharp": LikelihoodFieldParameters(0.99, 0.001, 0.01),
    "no rand": LikelihoodFieldParameters(1.0, 0.0, 0.3),
    "next to no rand": LikelihoodFieldParameters(1.0, 1e-300, 0.05),
    "no hit": LikelihoodFieldParameters(0.0, 0.5, 0.1),
}
OPTIONS = [{}, {"off_map": "far"}, {"off_map": "far", "max_distance": 0.25}, {"unknown": "uniform"}]


@pytest.fixture
def poses(room, rng):
    inside = np.column_stack([rng.uniform(-0.5, 6.5, 300), rng.uniform(-0.5, 4.5, 300)])
    return np.column_stack([transform_points(room.origin, inside), rng.uniform(-4, 4, 300)])


@pytest.fixture
def scan(rng):
    mounts = np.column_stack([rng.uniform(-0.3, 0.3, (41, 2)), rng.uniform(-3, 3, 41)])
    return Scan(rng.uniform(0.1, 3.0, 41), RangeFinder(mounts, MAX_RANGE))


def end_points(scan, poses):
    """Return the end points (n, k, 2) in the map frame: (6.32)."""
    ahead = np.pad(scan.ranges[:, None], ((0, 0), (0, 2)))
    return compose(compose(poses[:, None], scan.finder.mounts), ahead)[..., :2]


def cells_and_distance(model, points):
    """Return (col, row) in the field, the interpolated distance and its derivatives by them, each (n, k).

    The derivatives are differences between the ends of the piece of a line that the point lies on. The last returned
    says whether the point is on the field, and its cell not one of constant value.
    """
    field = model.distances
    u, v = np.moveaxis(field.grid.to_cells(points) + field.margin_cells, -1, 0)
    rows, cols = field.distance.shape
    values = field.distance.astype(np.float64)

    def at(u, v):
        return map_coordinates(values, [v - 0.5, u - 0.5], order=1, mode="nearest")

    left, low = np.floor(u - 0.5) + 0.5, np.floor(v - 0.5) + 0.5
    on = (u >= 0) & (u < cols) & (v >= 0) & (v < rows)
    d = np.where(on, at(u, v), min(field.max_distance, 1e3))  # infinitely far is no better than that
    counts = on.copy()
    if model.unknown == "uniform":
        unknown = np.pad(field.grid.unknown, field.margin_cells, constant_values=True)
        counts[on] = ~unknown[v[on].astype(int), u[on].astype(int)]
    return d, at(left + 1, v) - at(left, v), at(u, low + 1) - at(u, low), counts


def reference(model, scan, poses):
    """Return the value of each beam (n, k), and its derivative by the pose (n, k, 3)."""
    p, points = model.parameters, end_points(scan, poses)
    d, du, dv, counts = cells_and_distance(model, points)
    log_hit = np.full(d.shape, -math.inf)
    if p.z_hit > 0.0:
        exponent = -0.5 * (d / p.sigma_hit) ** 2
        log_hit = np.log(p.z_hit / (p.sigma_hit * math.sqrt(2 * math.pi))) + exponent
        log_hit = np.where(exponent > -745.0, log_hit, -math.inf)
    log_rand = math.log(p.z_rand / MAX_RANGE) if p.z_rand > 0.0 else -math.inf
    values = np.logaddexp(log_hit, log_rand)
    if model.unknown == "uniform":
        values = np.where(counts, values, -math.log(MAX_RANGE))
    with np.errstate(invalid="ignore"):
        share = np.where(values > -math.inf, np.exp(log_hit - values), 1.0)
    slope = np.where(counts, -d / p.sigma_hit**2 * share, 0.0) / model.distances.grid.resolution
    yaw = model.distances.grid.origin[2]
    by_x, by_y = slope * (du * np.cos(yaw) - dv * np.sin(yaw)), slope * (du * np.sin(yaw) + dv * np.cos(yaw))
    arm = points - poses[:, None, :2]
    return values, np.stack([by_x, by_y, arm[..., 0] * by_y - arm[..., 1] * by_x], axis=-1)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("name", PARAMETERS)
def test_values_and_sums_are_those_of_double_precision(room, poses, scan, name, options):
    model = LikelihoodFieldModel(room, PARAMETERS[name], interpolation="bilinear", **options)
    values, _ = reference(model, scan, poses)
    np.testing.assert_allclose(model.beam_log_likelihood(scan, poses), values, rtol=1e-11, atol=2e-7)
    np.testing.assert_allclose(model.log_likelihood(scan, poses), values.sum(axis=1), rtol=1e-11, atol=41 * 2e-7)


@pytest.mark.parametrize("name", PARAMETERS)
def test_values_are_within_the_stated_error_where_distances_are_those_of_the_field(room, poses, scan, name):
    """Off the field the distance given is not rounded to single precision; here none of it matters."""
    model = LikelihoodFieldModel(room, PARAMETERS[name], interpolation="bilinear")
    values, _ = reference(model, scan, poses)
    np.testing.assert_allclose(model.beam_log_likelihood(scan, poses), values, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(model.log_likelihood(scan, poses), values.sum(axis=1), rtol=1e-12, atol=41e-9)


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("name", PARAMETERS)
def test_the_gradient_is_that_of_double_precision(room, poses, scan, name, options):
    """But for hits that are less than 1e-11 of a beam's value, which are left out."""
    model = LikelihoodFieldModel(room, PARAMETERS[name], interpolation="bilinear", exponent=0.5, **options)
    _, slopes = reference(model, scan, poses)
    expected, size = 0.5 * slopes.sum(axis=1), 0.5 * np.abs(slopes).sum(axis=1)
    got = model.log_likelihood_gradient(scan, poses)
    left_out = len(scan.ranges) * 1e-10 / PARAMETERS[name].sigma_hit
    assert (np.abs(got - expected) <= 1e-9 * size + left_out).all()
    assert (size.max() > 1.0) == (name != "no hit")


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("unknown", ["free", "uniform"])
def test_any_number_of_threads_gives_the_same_bits(room, poses, scan, name, unknown):
    def results(threads):
        model = LikelihoodFieldModel(room, PARAMETERS[name], interpolation="bilinear", unknown=unknown)
        with forced_threads(threads):
            for method in (model.log_likelihood, model.beam_log_likelihood, model.log_likelihood_gradient):
                yield method(scan, poses)

    for threads in (2, 3):
        assert all((many == one).all() for many, one in zip(results(threads), results(1), strict=True))


@pytest.mark.parametrize("unknown", ["free", "uniform"])
def test_memory_of_the_table_is_as_stated(room, scan, unknown):
    model = LikelihoodFieldModel(room, PARAMETERS["usual"], interpolation="bilinear", unknown=unknown)
    model.log_likelihood(scan, np.zeros(3))
    table = model._look_ups.tables.smooth
    assert table.distance.nbytes + table.uniform.nbytes == model.table_bytes
