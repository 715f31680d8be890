"""Partial pooling: closed forms, coverage of known truths, and what robots borrow."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.fleet_beams import memory_catalogue, memory_shard

from beamfield.errors import InvalidInputError
from beamfield.fleet.engine import Engine
from beamfield.fleet.hierarchy import partial_pooling, pool
from beamfield.fleet.learning import learn
from beamfield.models.beam_parameters import BeamParameters

SERIAL = Engine("serial")
TRUTH = BeamParameters(0.7, 0.1, 0.1, 0.1, 0.05, 0.5, 0.02)


def test_pooling_is_the_posterior_of_the_joint_normal_distribution(monkeypatch):
    """With both spreads known: conditional mean and variance by brute linear algebra on the joint covariance."""
    rng = np.random.default_rng(0)
    sites = np.array([0, 0, 0, 1, 1, 2])
    values, variances = rng.normal(size=6), rng.uniform(0.1, 1.0, 6)
    r, s = 0.7, 0.4
    monkeypatch.setattr(
        "beamfield.fleet.hierarchy._spreads", lambda *_, **__: (np.array([r]), np.array([s]), np.zeros(1))
    )
    pooling = partial_pooling(values, variances, [f"site {k}" for k in sites])
    # Of the robots' values; the fleet's mean is flat.
    prior = 1e8 + s**2 * (sites[:, None] == sites) + r**2 * np.eye(6)
    gain = prior @ np.linalg.inv(prior + np.diag(variances))
    np.testing.assert_allclose(pooling.robots[0], gain @ values, rtol=1e-5)
    np.testing.assert_allclose(pooling.robots[1], np.diag(gain) * variances, rtol=1e-5)
    np.testing.assert_allclose(pooling.shrinkage, variances / (variances + r**2))


@pytest.mark.parametrize("between_sites", [0.0, 0.5])
def test_intervals_hold_the_truth_and_pooling_errs_less(between_sites):
    rng = np.random.default_rng(1)
    sites = [f"site {k}" for k in np.arange(24) % 3]
    held = {"robots": [], "sites": [], "fleet": []}
    own, pooled, spread = [], [], []
    for _ in range(80):
        of_sites = 1.0 + between_sites * rng.normal(size=3)
        truth = of_sites[np.arange(24) % 3] + 0.2 * rng.normal(size=24)
        variances = rng.choice([0.05, 0.2, 0.6], 24) ** 2
        values = truth + np.sqrt(variances) * rng.normal(size=24)
        pooling = partial_pooling(values, variances, sites)
        for name, want in (("robots", truth), ("sites", of_sites), ("fleet", 1.0)):
            mean, variance = getattr(pooling, name)
            held[name].append(np.mean(np.abs(mean - want) < 1.96 * np.sqrt(variance)))
        own.append(np.mean((values - truth) ** 2))
        pooled.append(np.mean((pooling.robots[0] - truth) ** 2))
        spread.append(pooling.spread_of_robots)
        assert np.all(np.diff(pooling.shrinkage[np.argsort(variances)]) > -1e-12)  # the less known, the more borrowed
    assert 0.94 < np.mean(held["robots"]) < 0.98
    assert np.mean(held["sites"]) > 0.92
    assert np.mean(held["fleet"]) > 0.92
    assert np.mean(pooled) < 0.4 * np.mean(own)
    assert np.mean(spread) == pytest.approx(0.2, abs=0.04)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_the_centre_of_a_few_robots_is_held_as_often_as_claimed(n):
    rng, held = np.random.default_rng(3), []
    for _ in range(300):
        mean, variance = partial_pooling(rng.normal(0.0, np.hypot(1.0, 0.3), n), np.full(n, 0.09), ["north"] * n).fleet
        held.append(abs(mean) < 1.96 * np.sqrt(variance))
    assert np.mean(held) > 0.91


def test_a_robot_with_few_beams_borrows_and_one_with_many_keeps_its_own():
    rng = np.random.default_rng(2)
    other = BeamParameters(0.6, 0.1, 0.2, 0.1, 0.08, 0.5, 0.02)
    shards = [memory_shard(rng, TRUTH, robot=f"r{k}", n_scans=60) for k in range(3)]
    shards += [memory_shard(rng, other, robot="many", n_scans=300), memory_shard(rng, other, robot="few", n_scans=12)]
    fit = learn(memory_catalogue(shards), SERIAL, by="robot")
    (hierarchy,) = pool(fit)
    few, many = hierarchy.robots[0], hierarchy.robots[1]
    assert (few.robot, many.robot) == ("few", "many")
    assert many.shrinkage["sigma_hit"] < 0.1
    assert few.shrinkage["z_short"] > 3.0 * many.shrinkage["z_short"]
    own = fit.fits[0].parameters
    assert abs(few.parameters.z_rand - 0.1) < abs(own.z_rand - 0.1) + 0.01
    for pooled in (*hierarchy.robots, *hierarchy.sites, hierarchy.fleet):
        for name, (low, high) in pooled.intervals.items():
            assert low < getattr(pooled.parameters, name) < high, name
    low, high = many.intervals["z_max"]
    assert low < 0.2 < high < 0.23
    with pytest.raises(InvalidInputError, match="expected one by robot"):
        pool(learn(memory_catalogue(shards[:1]), SERIAL))
