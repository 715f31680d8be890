"""One beam of the likelihood field as a density over the range: Figure 6.9."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder

PARAMETERS = LikelihoodFieldParameters(z_hit=0.7, z_rand=0.2, sigma_hit=0.1)
FINDER = RangeFinder([[0.0, 0.0, 0.5], [0.2, 0.1, 0.0]], max_range=6.0)


@pytest.fixture
def model():
    """Two single cells of 5 cm: one on the second beam's axis 2 m ahead, one 0.2 m beside it 4 m ahead."""
    data = np.zeros((60, 130))
    data[30, 44] = data[34, 84] = 100
    return LikelihoodFieldModel(OccupancyGrid.from_ros(data, 0.05), PARAMETERS, interpolation="bilinear")


POSE = [0.025, 1.425, 0.0]


def test_the_hit_density_integrates_to_one_and_the_whole_to_the_weights(model):
    ranges, hit, density = model.profile(POSE, FINDER, beam=1)
    spacing = ranges[1] - ranges[0]
    assert hit.sum() * spacing == pytest.approx(1.0, abs=1e-12)
    assert density.sum() * spacing == pytest.approx(0.7 + 0.2, abs=1e-12)
    np.testing.assert_allclose(density, 0.7 * hit + 0.2 / 6.0, rtol=1e-12)


def test_it_peaks_where_the_axis_passes_an_obstacle_the_nearer_the_higher(model):
    ranges, hit, _ = model.profile(POSE, FINDER, beam=1)
    first, second = ranges < 3.0, ranges >= 3.0
    assert ranges[first][np.argmax(hit[first])] == pytest.approx(2.0, abs=0.03)
    assert ranges[second][np.argmax(hit[second])] == pytest.approx(4.0, abs=0.03)
    expected = stats.norm.pdf(0.2, scale=0.1) / stats.norm.pdf(0.0, scale=0.1)
    assert hit[second].max() / hit[first].max() == pytest.approx(expected, rel=0.05)


def test_without_any_obstacle_there_is_no_hit_density():
    empty = LikelihoodFieldModel(OccupancyGrid.from_ros(np.zeros((5, 5)), 0.05), PARAMETERS)
    ranges, hit, density = empty.profile(POSE, FINDER, beam=0, n=100)
    assert ranges.shape == (100,)
    assert (hit == 0.0).all()
    assert density == pytest.approx(0.2 / 6.0)


def test_n_must_be_a_number_of_ranges_and_the_beam_one_of_the_sensor(model):
    with pytest.raises(InvalidInputError, match="n: expected at least 1, got 0"):
        model.profile(POSE, FINDER, n=0)
    with pytest.raises(InvalidInputError, match="beam: expected indices from"):
        model.profile(POSE, FINDER, beam=FINDER.n_beams)
