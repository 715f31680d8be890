"""Robots against the others: false discoveries at their rate, and those that do differ."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtr

from beamfield.calibration.intrinsic.block_intervals import IntervalResult
from beamfield.calibration.intrinsic.likelihood import N_PARAMETERS, OFFSET, RATE, VARIANCE, theta_of
from beamfield.errors import InvalidInputError
from beamfield.fleet.comparison import adjusted, compare_robots, unlike_others
from beamfield.fleet.learning import FleetFit, GroupFit
from beamfield.fleet.shard_passes import SensorLimits
from beamfield.fleet.transformed import NAMES, intervals_from, parameters_from, transformed

USUAL = np.log([0.12, 0.08, 0.05, 0.05, 0.5, np.e])  # of NAMES; range_offset is 1 cm then
USUAL[5] = 0.01
SPREAD = np.array([0.2, 0.2, 0.2, 0.1, 0.2, 0.005])
ERRORS = np.array([0.05, 0.05, 0.1, 0.02, 0.1, 0.002])


def fit_of(values: np.ndarray, robot: str, site: str) -> GroupFit:
    """A robot's fit with these transformed parameters and `ERRORS`."""
    parameters = parameters_from(values)
    theta = theta_of(parameters)
    slopes = np.zeros((N_PARAMETERS, 6))  # of the working vector in the transformed parameters
    weights = theta[:4]
    slopes[:4, :3] = (np.eye(4) - weights)[:, 1:] * weights[:, None]
    slopes[VARIANCE, 3], slopes[RATE, 4], slopes[OFFSET, 5] = 2.0 * theta[VARIANCE], theta[RATE], 1.0
    covariance = slopes @ np.diag(ERRORS**2) @ slopes.T
    errors = np.sqrt(np.diag(covariance))
    named = dict(zip(("z_hit", "z_short", "z_max", "z_rand"), errors[:4], strict=True))
    named |= {
        "sigma_hit": parameters.sigma_hit * ERRORS[3],
        "lambda_short": errors[RATE],
        "range_offset": errors[OFFSET],
    }
    intervals = IntervalResult(intervals_from(values, ERRORS**2, 1.96), named, 0.95, 50, ())
    return GroupFit(
        site, robot, SensorLimits(8.0, 0.0), parameters, parameters, intervals, covariance, 0.0, 10_000, 4, True
    )


def fleet_of(rng: np.random.Generator, shifts: np.ndarray) -> FleetFit:
    values = USUAL + SPREAD * rng.normal(size=shifts.shape) + ERRORS * rng.normal(size=shifts.shape) + shifts
    fits = [fit_of(row, f"r{k:02d}", f"s{k % 3}") for k, row in enumerate(values)]
    return FleetFit("robot", tuple(fits))


def test_transformed_parameters_come_back_with_their_variances():
    values = USUAL + 0.3
    got, variances = transformed(fit_of(values, "r", "s"))
    np.testing.assert_allclose(got, values, rtol=1e-9)
    np.testing.assert_allclose(variances, ERRORS**2, rtol=1e-9)


def test_intervals_of_weights_are_those_of_draws():
    hit, *others = np.exp(np.random.default_rng(4).normal([0.0, *USUAL[:3]], [0.0, *ERRORS[:3]], (20_000, 4))).T
    weights = np.array([hit, *others]) / (hit + sum(others))
    found = intervals_from(USUAL, ERRORS**2, 1.96)
    for name, draws in zip(("z_hit", "z_short", "z_max", "z_rand"), weights, strict=True):
        assert found[name] == pytest.approx(np.quantile(draws, [0.025, 0.975]), rel=0.03), name


def test_a_weight_that_was_not_seen_counts_as_its_interval_says():
    seen = fit_of(USUAL, "r", "s")
    intervals = {**seen.intervals.intervals, "z_short": (0.0, 0.003)}
    errors = {**seen.intervals.standard_errors, "z_short": np.nan, "lambda_short": np.inf}
    parameters = replace(seen.parameters, z_short=0.0, z_hit=seen.parameters.z_hit + seen.parameters.z_short)
    absent = replace(
        seen, parameters=parameters, intervals=replace(seen.intervals, intervals=intervals, standard_errors=errors)
    )
    values, variances = transformed(absent)
    draws = np.random.default_rng(0).exponential(0.003 / np.log(20.0), 200_000)
    assert values[0] == pytest.approx(np.log(draws / parameters.z_hit).mean(), abs=0.01)
    assert variances[0] == pytest.approx(np.log(draws).var(), rel=0.02)
    assert variances[4] == 1e12


def test_false_discoveries_stay_at_their_rate_and_robots_that_differ_are_found():
    rng = np.random.default_rng(2)
    false, found, any_in_equal_fleets = [], [], []
    for fleet in range(30):
        shifts = np.zeros((24, 6))
        if fleet % 2:
            shifts[:3, rng.integers(6)] = 1.0
            shifts *= 8.0 * SPREAD
        rows = compare_robots(fleet_of(rng, shifts))
        assert len(rows) == 24 * 6
        differs = [(int(row.robot[1:]), NAMES.index(row.parameter)) for row in rows if row.differs]
        wrong = sum(shifts[k, i] == 0.0 for k, i in differs)
        if fleet % 2:
            false.append(wrong / max(len(differs), 1))
            found.append((len(differs) - wrong) / 3)
        else:
            any_in_equal_fleets.append(wrong > 0)
    assert np.mean(false) < 0.08  # 0.05, and what 15 fleets leave to chance
    assert np.mean(any_in_equal_fleets) < 0.16
    assert np.mean(found) > 0.75


def test_tails_are_those_of_student_also_within_sites():
    rng = np.random.default_rng(3)
    p = np.concatenate(
        [
            unlike_others(
                rng.normal(size=24) + np.arange(24) % 3, np.full(24, 1e-4), [f"s{k % 3}" for k in range(24)]
            ).p_values
            for _ in range(120)
        ]
    )
    assert 0.3 < np.mean(p < 0.05) / 0.05 < 1.1
    assert np.mean(p < 0.002) < 2.0 * 0.002


@pytest.mark.parametrize("sizes", [[4, 4], [3, 3, 3, 3], [2] * 6, [8, 1, 1]])
def test_sites_of_a_few_robots_that_differ_make_none_of_them_odd(sizes: list[int]):
    rng, site = np.random.default_rng(7), np.repeat(np.arange(len(sizes)), sizes)
    p = np.array(
        [
            unlike_others(
                rng.normal(size=len(site)) + 30.0 * rng.normal(size=len(sizes))[site], np.full(len(site), 1e-4),
                [f"s{k}" for k in site],
            ).p_values
            for _ in range(100)
        ]
    )  # fmt: skip
    # Two lone robots are too few sites to say what is usual.
    assert (np.isnan(p) == (np.bincount(site)[site] == 1)).all()
    assert np.nanmean(p < 0.01) < 0.01


def test_a_robot_of_a_small_site_that_is_unlike_the_sites_is_found():
    values = np.concatenate([np.random.default_rng(1).normal(size=14), [30.0]])
    p = unlike_others(values, np.full(15, 0.1), [f"s{k // 2}" for k in range(14)] + ["alone"]).p_values
    assert p[14] < 1e-3 < np.sort(p)[1]


def test_with_known_spread_it_is_the_usual_test():
    values = np.array([0.0, 0.1, -0.1, 0.05, -0.05, 4.0])
    unlike = unlike_others(values, np.full(6, 1.0))  # they differ by less than their errors
    total = 6.0 / 5.0
    assert unlike.dof.tolist() == [3.0] * 6
    np.testing.assert_allclose(unlike.errors, np.sqrt(total))
    np.testing.assert_allclose(unlike.p_values, 2.0 * stdtr(3, -np.abs(values - unlike.centres) / np.sqrt(total)))


def test_robots_of_a_site_that_is_unlike_the_others_differ():
    rng = np.random.default_rng(5)
    shifts = np.zeros((24, 6))
    shifts[::3, 0] = 20.0 * SPREAD[0]  # all of site s0
    fit = fleet_of(rng, shifts)
    assert {row.site for row in compare_robots(fit) if row.differs} == {"s0"}
    few = FleetFit("robot", fit.fits[:4])
    assert compare_robots(few) == ()
    with pytest.raises(InvalidInputError, match="by robot"):
        compare_robots(FleetFit("fleet", fit.fits))


def test_q_values_are_those_of_benjamini_and_hochberg():
    """Their example: 15 tests, of which 4 count at 0.05."""
    p = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459, 0.3240, 0.4262, 0.5719, 0.6528,
         0.7590, 1.0]  # fmt: skip
    assert [q <= 0.05 for q in adjusted(p)] == [True] * 4 + [False] * 11
    assert adjusted([]) == []
