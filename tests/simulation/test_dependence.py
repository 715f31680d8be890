from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtri

from beamfield.errors import InvalidInputError
from beamfield.simulation.dependence import Dependence, dependent_uniforms

BEARINGS = np.deg2rad(np.arange(-10.0, 10.0, 2.0))


def test_each_number_alone_is_uniform(rng: np.random.Generator) -> None:
    dependence = Dependence(angle=0.2, time=0.5)
    # Scans 10 seconds apart are independent at this reach, so beam by beam these are independent draws.
    u = dependent_uniforms(np.arange(0.0, 40_000.0, 10.0), BEARINGS, dependence, rng)
    for beam in range(0, len(BEARINGS), 3):
        assert stats.kstest(u[:, beam], "uniform").pvalue > 0.01


def test_correlation_falls_exponentially_with_angle_and_time(rng: np.random.Generator) -> None:
    dependence = Dependence(angle=np.deg2rad(4.0), time=0.25)
    latent = ndtri(dependent_uniforms(np.arange(60_000) * 0.1, BEARINGS, dependence, rng))
    beams = np.corrcoef(latent.T)
    assert beams[0, 1] == pytest.approx(np.exp(-2.0 / 4.0), abs=0.02)
    assert beams[0, 4] == pytest.approx(np.exp(-8.0 / 4.0), abs=0.03)
    for lag in (1, 3):
        correlation = np.mean(latent[:-lag] * latent[lag:])
        assert correlation == pytest.approx(np.exp(-0.1 * lag / 0.25), abs=0.02)
    both = np.mean(latent[:-1, :-1] * latent[1:, 1:])
    assert both == pytest.approx(np.exp(-2.0 / 4.0) * np.exp(-0.1 / 0.25), abs=0.02)


def test_neighbours_are_told_by_bearing_not_by_order(rng: np.random.Generator) -> None:
    shuffled = rng.permutation(len(BEARINGS))
    dependence = Dependence(angle=np.deg2rad(2.0))
    latent = ndtri(dependent_uniforms(np.arange(30_000.0), BEARINGS[shuffled], dependence, rng))
    a, b = int(np.argmax(shuffled == 4)), int(np.argmax(shuffled == 5))
    assert np.mean(latent[:, a] * latent[:, b]) == pytest.approx(np.exp(-1.0), abs=0.02)


def test_no_dependence_means_independent_numbers(rng: np.random.Generator) -> None:
    assert Dependence().is_none
    assert not Dependence(angle=0.1).is_none
    latent = ndtri(dependent_uniforms(np.arange(20_000.0), BEARINGS, Dependence(), rng))
    assert np.abs(np.corrcoef(latent.T) - np.eye(len(BEARINGS))).max() < 0.03


def test_numbers_stay_strictly_between_0_and_1(rng: np.random.Generator) -> None:
    u = dependent_uniforms(np.arange(500.0), np.linspace(-2.0, 2.0, 200), Dependence(angle=0.1, time=3.0), rng)
    assert u.min() > 0.0
    assert u.max() < 1.0


@pytest.mark.parametrize("bad", [{"angle": -0.1}, {"time": np.nan}, {"time": np.inf}])
def test_an_impossible_reach_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError, match="dependence: expected"):
        Dependence(**bad)
