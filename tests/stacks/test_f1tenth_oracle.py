"""F1TENTH's table against what range_libc's compiled code answered, on the ranges of its own ray methods."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.stacks.f1tenth.parameters import F1tenthParameters
from beamfield.stacks.f1tenth.table import F1tenthTable, sensor_table

pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("past_the_message")]

METHODS = ("bl", "rm", "cddt112")


@pytest.fixture
def model(case):
    v = case.values
    parameters = F1tenthParameters(
        **{name: v[name] for name in ("z_hit", "z_short", "z_max", "z_rand")},
        sigma_hit=v["sigma_hit"] / case.grid.resolution, max_range=v["max_range"], angle_step=1, squash_factor=2.2,
    )  # fmt: skip
    return F1tenthTable(case.grid, parameters, map_mode="raw")


def test_the_table(case, model):
    table = sensor_table(model.parameters, case.grid.resolution)
    np.testing.assert_allclose(table.ravel(), case.rangelibc["sensor_model_table_r_by_d"], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("how", ["eval_sensor_model", "oneshot"])
def test_weights_on_its_own_ranges(case, model, method, how):
    evidence = model.evidence(case.scan(), case.poses)
    ranges = np.reshape(case.rangelibc[f"{method}_ranges_PxK"], evidence.expected_ranges.shape)
    got = model.log_weights(replace(evidence, expected_ranges=ranges))
    expected = np.log(case.rangelibc[f"{method}_weights_{how}"]) / 2.2
    assert np.exp(got - expected) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_exact_rays_are_near_most_of_its_ranges(case, model, method):
    exact = model.evidence(case.scan(), case.poses).expected_ranges
    ranges = np.minimum(np.reshape(case.rangelibc[f"{method}_ranges_PxK"], exact.shape), model.parameters.max_range)
    cells = (ranges - exact) / case.grid.resolution
    assert 0.0 <= np.median(cells) < 0.7
    assert (np.abs(cells) < 2.0).mean() > 0.8
