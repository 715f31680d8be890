"""A measurement model of one's own: what it may return in any form, and what everything that asks it refuses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.localization.mapped_area import MappedArea, MappedAreaModel
from beamfield.localization.particle_filter import ParticleFilter
from beamfield.localization.pose_posterior import PoseLattice, pose_posterior
from beamfield.localization.recovery import PosesFromScan
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.sensors import RangeFinder, Scan

GRID = OccupancyGrid.from_ros([[100, *[0] * 30, 100]] * 4, resolution=0.5)
SCAN = Scan([1.0], RangeFinder.from_bearings([0.0], 5.0))
CLOUD = np.linspace([1.0, 0.5, 0.0], [18.0, 1.5, 3.0], 40)  # some beyond the map


@dataclass(frozen=True)
class OwnModel:
    """The robot is near x = 4; `form` says what becomes of the values."""

    form: Callable[[np.ndarray], Any]
    is_normalized = False

    def log_likelihood(self, z: Scan, poses: np.ndarray) -> Any:  # noqa: ARG002
        return self.form(-np.square(np.atleast_2d(poses)[:, 0] - 4.0))


def filtered(model: Any) -> np.ndarray:
    own = ParticleFilter(model, GaussianMotion(), rng=1)
    own.start(CLOUD)
    own.update(SCAN, [0.0, 0.0, 0.0])
    return own.pose


ASKED = {
    "a filter": filtered,
    "a filter in a map with edges": lambda model: filtered(MappedAreaModel(model, MappedArea(GRID))),
    "a map": lambda model: likelihood_map(model, SCAN, GRID, resolution=0.5, headings=4).log_likelihood,
    "a posterior": lambda model: pose_posterior(model, SCAN, PoseLattice.over_map(GRID, headings=4)).best_pose(),
    "poses from a scan": lambda model: PosesFromScan(GRID, model).draw(SCAN, 5, np.random.default_rng(0)),
}


@pytest.mark.parametrize("asks", ASKED)
def test_values_may_have_any_form(asks):
    expected = ASKED[asks](OwnModel(np.copy))
    for form in (np.ndarray.tolist, lambda values: values.astype(">f8"), lambda values: np.repeat(values, 2)[::2]):
        np.testing.assert_array_equal(ASKED[asks](OwnModel(form)), expected)


@pytest.mark.parametrize("asks", ASKED)
@pytest.mark.parametrize(
    ("form", "message"),
    [
        (lambda values: values[:, None], r"model: expected one log-likelihood per pose, \d+, got shape \(\d+, 1\)"),
        (lambda values: values * np.nan, "model: expected log-likelihoods, got NaN"),
        (lambda values: values + np.inf, r"model: expected log-likelihoods below \+inf"),
        (lambda values: None, "log_likelihood: expected an array of numbers, got None"),  # noqa: ARG005
    ],
)
def test_what_is_no_log_likelihood_is_refused(asks, form, message):
    with pytest.raises(InvalidInputError, match=message):
        ASKED[asks](OwnModel(form))
