"""Learning over shards: the maximum of one process, whatever the shards, in bounded memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from benchmarks.fleet_beams import MemoryCatalogue, memory_catalogue, memory_shard

from beamfield.calibration.intrinsic.block_intervals import block_intervals
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, theta_of
from beamfield.calibration.intrinsic.m_steps import m_step
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.fleet import learning, shard_passes
from beamfield.fleet.engine import Engine
from beamfield.fleet.learning import learn
from beamfield.fleet.shard_passes import Part, SensorLimits, ShardedLikelihood, metres, sensor_limits
from beamfield.models.beam_parameters import BeamParameters

SERIAL = Engine("serial")
TRUTH = BeamParameters(0.7, 0.1, 0.1, 0.1, 0.05, 0.5, 0.02)
# A wide hit that is cut at both ends, and a blind zone.
WIDE = BeamParameters(0.6, 0.2, 0.1, 0.1, 0.4, 0.8, -0.05)


def fleet_of(truth: BeamParameters, *, n_shards: int = 5, **options: Any) -> MemoryCatalogue:
    rng = np.random.default_rng(3)
    limits = {name: options[name] for name in ("max_range", "min_range") if name in options}
    return memory_catalogue([memory_shard(rng, truth, day=day, **options) for day in range(n_shards)], **limits)


def beams_to_learn_from(catalogue: MemoryCatalogue) -> tuple[np.ndarray, ...]:
    limits = sensor_limits(catalogue.used[0])
    parts = [shard.read(("range", "expected_range", "stamp"), fit_only=True) for shard in catalogue.all_shards]
    range_, expected, stamps = (np.concatenate([part[name] for part in parts]) for name in parts[0])
    z, expected, hits = metres(range_, expected, limits)
    return z[hits], expected[hits], stamps[hits]


def parts_of(catalogue: MemoryCatalogue) -> list[Part]:
    return [Part(shard, sensor_limits(catalogue.used[0]), 0.0, 20.0) for shard in catalogue.all_shards]


@pytest.mark.parametrize(("truth", "min_range"), [(TRUTH, 0.0), (WIDE, 0.25)])
def test_a_fleet_learns_what_one_process_learns_from_the_same_beams(truth, min_range, monkeypatch):
    monkeypatch.setattr(learning, "SAMPLE_BEAMS", 4000)
    monkeypatch.setattr(learning, "SAMPLE_SHARDS", 2)
    monkeypatch.setattr(shard_passes, "BATCH_ROWS", 1500)
    catalogue = fleet_of(truth, n_scans=60, min_range=min_range)
    z, expected, _ = beams_to_learn_from(catalogue)
    alone = learn_intrinsic_parameters(z, expected, 8.1, min_range=min_range, fit_offset=True)
    (fit,) = learn(catalogue, SERIAL).fits
    assert fit.converged
    assert fit.n_beams == len(z)
    assert fit.first != fit.parameters
    assert fit.passes <= 7
    np.testing.assert_allclose(theta_of(fit.parameters), theta_of(alone.parameters), rtol=1e-12, atol=1e-12)
    assert fit.log_likelihood == pytest.approx(alone.log_likelihood, rel=1e-12)


@pytest.mark.parametrize("truth", [TRUTH, WIDE])
def test_sums_over_shards_are_those_of_all_beams(truth, monkeypatch):
    monkeypatch.setattr(shard_passes, "BATCH_ROWS", 700)
    catalogue = fleet_of(truth)
    z, expected, _ = beams_to_learn_from(catalogue)
    theta = theta_of(truth) * 1.1
    problem = learning_problem(8.1, fit_offset=True, fit_sigma_slope=True)
    alone = IntrinsicLikelihood(z, expected, 8.1)
    sharded = ShardedLikelihood(parts_of(catalogue), SERIAL, theta)
    for one, other in zip(alone.derivatives(theta), sharded.at_start, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12 * np.abs(one).max())
    of_alone = alone.expected_statistics(theta, slope_is_free=True)
    of_shards = sharded.expected_statistics(theta, slope_is_free=True)
    np.testing.assert_allclose(of_shards.counts, of_alone.counts, rtol=1e-12)
    np.testing.assert_allclose(m_step(of_shards, theta, problem), m_step(of_alone, theta, problem), rtol=1e-11)


def test_intervals_are_those_of_blocks_of_time(monkeypatch):
    monkeypatch.setattr(shard_passes, "BATCH_ROWS", 777)  # blocks straddle batches
    catalogue = fleet_of(TRUTH, n_shards=1, n_scans=100)
    (fit,) = learn(catalogue, SERIAL).fits
    z, expected, stamps = beams_to_learn_from(catalogue)
    alone = block_intervals(z, expected, stamps, 8.1, fit.parameters, fit_offset=True, block_s=20.0)
    assert fit.intervals.n_blocks == alone.n_blocks
    for name, interval in alone.intervals.items():
        assert fit.intervals.intervals[name] == pytest.approx(interval, rel=1e-9), name
        error = fit.intervals.standard_errors[name]
        assert error == pytest.approx(alone.standard_errors[name], rel=1e-9), name


def test_each_robot_and_each_kind_of_sensor_is_learned_apart():
    rng = np.random.default_rng(4)
    wide, narrow = TRUTH, BeamParameters(0.8, 0.05, 0.05, 0.1, 0.02, 0.5)
    shards = [memory_shard(rng, wide, robot="a"), memory_shard(rng, narrow, robot="b")]
    far = memory_shard(rng, narrow, robot="c", site="south", max_range=20.0)
    near, distant = memory_catalogue(shards), memory_catalogue([far], max_range=20.0)
    catalogue = MemoryCatalogue((*near.used, *distant.used), (*near.all_shards, *distant.all_shards))
    by_limits = learn(catalogue, SERIAL).fits
    assert [fit.limits for fit in by_limits] == [SensorLimits(8.1, 0.0), SensorLimits(20.0, 0.0)]
    assert [fit.site for fit in learn(catalogue, SERIAL, by="site").fits] == ["north", "south"]


def test_a_thinned_fit_uses_fewer_beams_and_agrees_within_its_intervals():
    catalogue = fleet_of(TRUTH, n_scans=120)
    (thin,) = learn(catalogue, SERIAL, thin=7).fits
    (whole,) = learn(catalogue, SERIAL).fits
    assert thin.n_beams == pytest.approx(whole.n_beams / 7, rel=0.05)
    for name, error in thin.intervals.standard_errors.items():
        assert abs(getattr(thin.parameters, name) - getattr(whole.parameters, name)) < 4.0 * error, name


@dataclass(frozen=True, eq=False)
class Endless:
    """A shard whose beams exist only while they are read."""

    n_batches: int
    rows: int = 0

    def batches(self, columns: Any, rows: int, **_: Any) -> Iterator[dict[str, np.ndarray]]:
        for batch in range(self.n_batches):
            shard = memory_shard(np.random.default_rng(batch), TRUTH, n_scans=rows // 90)
            yield shard.read(columns)


def test_memory_does_not_grow_with_the_beams(monkeypatch):
    monkeypatch.setattr(shard_passes, "BATCH_ROWS", 9000)
    theta = theta_of(TRUTH)

    def peak(n_batches: int) -> int:
        part = Part(Endless(n_batches), SensorLimits(8.1, 0.0), 0.0, 1e12)
        tracemalloc.start()
        likelihood = ShardedLikelihood([part], SERIAL, theta)
        likelihood.expected_statistics(theta)
        assert likelihood.n_beams > 7000 * n_batches
        used = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return used

    assert peak(2) > 9000 * 8
    assert peak(16) < 1.1 * peak(2)


def test_too_few_beams_are_named():
    catalogue = memory_catalogue([memory_shard(np.random.default_rng(0), TRUTH, n_scans=1, n_beams=10)])
    with pytest.raises(TooLittleDataError, match=r"nothing to learn from: .* need 20"):
        learn(catalogue, SERIAL)
    with pytest.raises(InvalidInputError, match="by: expected one of fleet, site, robot"):
        learn(catalogue, SERIAL, by="day")
    with pytest.raises(InvalidInputError, match="thin"):
        learn(catalogue, SERIAL, thin=0)
