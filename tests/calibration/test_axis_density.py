"""Learning a likelihood field along the axes of beams: against a slow density, from samples, and at its limits."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import expit, logit

from beamfield.calibration.field import axis_table
from beamfield.calibration.field.axis_density import (
    Mixture,
    climb,
    density_gradient,
    fit_axis_density,
    log_axis_density,
    share_bounds,
    sigma_bounds,
)
from beamfield.calibration.field.axis_intervals import axis_intervals
from beamfield.calibration.field.axis_table import AxisTable, build_axis_table
from beamfield.calibration.field.findings import density_findings
from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog
from tests.reference.axis_density_slow import SlowAxis, SlowMap
from tests.threads import forced_threads

ORIGIN = (-1.0, 2.0, 0.4)
FINDER = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 15), max_range=9.0, min_range=0.3, mount=(0.1, 0.0, 0.0))
NO_RETURN_SHARE = 0.2
ALL = np.ones(200, bool)


@pytest.fixture(scope="module")
def room() -> OccupancyGrid:
    cells = np.zeros((60, 80))
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    cells[25, :40] = cells[25:45, 60] = cells[40:43, 20:24] = 1.0
    cells[5:9, 45:55] = np.nan
    return OccupancyGrid(cells, 0.1, ORIGIN)


@pytest.fixture(scope="module")
def axes(room) -> tuple[np.ndarray, list[list[SlowAxis]]]:
    """Poses (200, 3) in the free half of the room, and the axis of every beam."""
    rng = np.random.default_rng(3)
    poses = compose(ORIGIN, np.column_stack([rng.uniform([0.5, 0.5], [7.5, 2.2], (200, 2)), rng.uniform(-3, 3, 200)]))
    world = SlowMap(room.occupied, 0.1, ORIGIN)
    limits = FINDER.min_range, FINDER.max_range
    return poses, [[SlowAxis(world, sensor, *limits) for sensor in compose(pose, FINDER.mounts)] for pose in poses]


def drawn(axes, draw, seed=0) -> SensorLog:
    """A log whose ranges are `draw`n axis by axis, a fifth of them without return."""
    poses, by_scan = axes
    rng = np.random.default_rng(seed)
    ranges = np.array([[draw(axis, rng) for axis in scan] for scan in by_scan])
    ranges[rng.random(ranges.shape) < NO_RETURN_SHARE] = np.inf
    return SensorLog(FINDER, np.arange(len(poses)) * 1.0, ranges, poses, poses)


@pytest.fixture(scope="module")
def truth() -> Mixture:
    return Mixture(0.7, 0.15)


@pytest.fixture(scope="module")
def table(room, axes, truth) -> AxisTable:
    return build_axis_table(drawn(axes, lambda axis, rng: axis.draw(*truth, rng)), room, ALL)


def slow_log_density(axes, log: SensorLog, mixture: Mixture) -> np.ndarray:
    values = []
    for scan, ranges in zip(axes[1], log.ranges, strict=True):
        for axis, z in zip(scan, ranges, strict=True):
            if z < FINDER.max_range:
                values.append(math.log(axis.density(*mixture)[int((z - FINDER.min_range) / axis.piece)]))
    return np.array(values)


@pytest.mark.parametrize("mixture", [Mixture(0.7, 0.15), Mixture(0.3, 0.6), Mixture(0.95, 0.05)])
def test_the_density_is_that_of_a_fine_sum_along_the_axis(axes, table, truth, mixture):
    log = drawn(axes, lambda axis, rng: axis.draw(*truth, rng))
    error = log_axis_density(table, mixture) - slow_log_density(axes, log, mixture)
    # Pieces of a quarter of a cell do not know exactly how much of the axis lies in a cell, half a sigma wide or two.
    assert np.quantile(np.abs(error), 0.9) < (0.1 if mixture.sigma > 0.1 else 0.2)
    assert abs(error.mean()) < 0.015


def test_known_parameters_come_back_within_their_standard_errors(table, truth):
    fit = fit_axis_density(table)
    assert fit.converged
    assert fit.n_hits == pytest.approx(truth.hit_share * len(table), rel=0.05)
    returned = len(table) / (len(table) + len(table.no_return_scan))
    assert returned == pytest.approx(1.0 - NO_RETURN_SHARE, abs=0.03)
    # Blocks of ten scans; readings are independent here, so that any blocks do.
    intervals, n_blocks = axis_intervals(table, fit, np.arange(200) // 10)
    assert n_blocks == 20
    expected = {
        "z_hit": truth.hit_share * (1.0 - NO_RETURN_SHARE),
        "z_rand": (1.0 - truth.hit_share) * (1.0 - NO_RETURN_SHARE),
        "sigma_hit": truth.sigma,
    }
    for name, value in expected.items():
        low, high = intervals[name]
        middle, reach = 0.5 * (low + high), 0.5 * (high - low)  # reach: about two standard errors
        assert abs(value - middle) < 2.0 * reach, name
        assert reach < 0.15 * value, name
    assert not list(density_findings(table, fit, n_blocks))


def test_intervals_are_as_wide_as_estimates_vary(room, axes, truth):
    """Eight logs from the same poses: the spread of what is learned, beside what one log says."""
    learned, reaches = [], []
    for seed in range(8):
        table = build_axis_table(drawn(axes, lambda axis, rng: axis.draw(*truth, rng), seed + 10), room, ALL)
        fit = fit_axis_density(table)
        learned.append(fit.mixture.sigma)
        intervals, _ = axis_intervals(table, fit, np.arange(200) // 10)
        reaches.append(0.5 * math.log(intervals["sigma_hit"][1] / intervals["sigma_hit"][0]))
    # Half the width is 2.09 standard errors for 20 blocks; a deviation of eight is known to a quarter.
    assert np.std(np.log(learned), ddof=1) == pytest.approx(np.mean(reaches) / 2.09, rel=0.7)


def test_the_likelihood_never_falls_and_ends_at_its_maximum(table):
    fit = fit_axis_density(table)
    for start in (Mixture(0.5, 0.02), Mixture(0.01, 0.9), Mixture(0.99, 0.3), fit.mixture):
        climbed = climb(table, start)
        assert (np.diff(climbed.trace) >= -1e-9 * np.abs(climbed.trace[:-1])).all()
        assert climbed.trace[-1] <= fit.trace[-1] + 1e-6
    found = minimize(
        lambda x: -log_axis_density(table, Mixture(float(expit(x[0])), math.exp(x[1]))).mean(),
        [0.0, math.log(0.2)], method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-10},
    )  # fmt: skip
    assert fit.trace[-1] == pytest.approx(-found.fun, abs=1e-6)
    assert fit.mixture == pytest.approx((expit(found.x[0]), math.exp(found.x[1])), rel=1e-2)


def test_the_gradient_is_that_of_the_log_density(table):
    mixture, step = Mixture(0.6, 0.2), 1e-3
    gradient = density_gradient(table, mixture)
    x = np.array([logit(mixture.hit_share), math.log(mixture.sigma)])
    for i in range(2):
        ahead, behind = (
            log_axis_density(table, Mixture(float(expit(y[0])), math.exp(y[1])))
            for y in (x + np.eye(2)[i] * step, x - np.eye(2)[i] * step)
        )
        np.testing.assert_allclose(gradient[:, i], (ahead - behind) / (2.0 * step), atol=2e-3)


def test_readings_that_ignore_the_map_show_no_hits(room, axes):
    log = drawn(axes, lambda _, rng: rng.uniform(FINDER.min_range, FINDER.max_range))
    table = build_axis_table(log, room, ALL)
    fit = fit_axis_density(table)
    assert "field-no-hits" in [finding.name for finding in density_findings(table, fit, 20)]
    assert axis_intervals(table, fit, np.arange(200) // 10)[0]["sigma_hit"] == (0.0, np.inf)


def test_readings_that_all_end_in_obstacles_leave_sigma_and_z_rand_open(room, axes):
    log = drawn(axes, lambda axis, _: axis.ranges[axis.distances == 0.0][0])
    table = build_axis_table(log, room, ALL)
    # Where an axis clips the corner of a cell, the quarter of a cell that counts may lie beside it.
    table = table.select(table.squares == 0.0)
    fit = fit_axis_density(table)
    assert fit.mixture == pytest.approx((share_bounds(len(table))[1], sigma_bounds(table)[0]), rel=1e-3)
    names = [finding.name for finding in density_findings(table, fit, 20)]
    assert names == ["field-sigma-at-floor", "field-no-random"]
    intervals, _ = axis_intervals(table, fit, np.arange(200) // 10)
    assert intervals["sigma_hit"] == (0.0, np.inf)


def test_one_block_gives_no_intervals_and_few_a_warning(table):
    fit = fit_axis_density(table)
    intervals, n_blocks = axis_intervals(table, fit, np.zeros(200, int))
    assert n_blocks == 1
    assert set(intervals.values()) == {(0.0, np.inf)}
    assert [finding.name for finding in density_findings(table, fit, 7)] == ["field-few-blocks"]
    # The widest hits that are searched, and a climb that was broken off.
    _, widest = sigma_bounds(table)
    for sigma, names in ((widest, ["field-sigma-at-ceiling"]), (0.99 * widest, [])):
        bad = replace(fit, mixture=fit.mixture._replace(sigma=sigma), converged=not names)
        expected = names + ["field-not-converged"] * bool(names)
        assert [finding.name for finding in density_findings(table, bad, 20)] == expected


def test_axes_without_obstacles_and_readings_without_measurement_are_left_out(room):
    finder = RangeFinder.from_bearings([0.0, np.pi, 0.1], max_range=3.0)
    poses = compose(ORIGIN, [[2.0, 1.3, 0.0], [7.0, 1.3, 0.0]])
    # From the second pose the wall is 0.9 m ahead; from the first, nothing is within 3 m but behind.
    log = SensorLog(finder, np.arange(2.0), np.array([[1.0, 1.9, np.nan], [0.9, 2.0, np.inf]]), poses, poses)
    table = build_axis_table(log, room, np.ones(2, bool))
    assert (len(table), table.n_excluded) == (2, 2)
    assert table.scan.tolist() == [0, 1]
    assert table.no_return_scan.tolist() == [1]
    assert (table.counts.sum(axis=1) == math.ceil(3.0 / 0.025)).all()
    with pytest.raises(InvalidInputError, match="no occupied cell"):
        build_axis_table(log, OccupancyGrid(np.zeros((5, 5)), 0.1), np.ones(2, bool))


def test_thinning_keeps_what_is_learned(room, axes, truth, table, monkeypatch):
    log = drawn(axes, lambda axis, rng: axis.draw(*truth, rng))
    with monkeypatch.context() as patch:
        patch.setattr(axis_table, "MOST_BEAMS", 1500)
        thin = build_axis_table(log, room, ALL)
    assert len(thin) + len(thin.no_return_scan) + thin.n_excluded <= 1500
    assert fit_axis_density(thin).mixture == pytest.approx(truth, rel=0.15)
    for threads in (1, 3):
        with forced_threads(threads):
            again = build_axis_table(log, room, ALL)
        assert (again.counts == table.counts).all()
