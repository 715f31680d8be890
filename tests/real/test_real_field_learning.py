"""The likelihood field of a real log: what is learned, and what its posteriors are worth on held-out drives."""

from __future__ import annotations

import pytest

from beamfield.calibration.field.learning import learn_field_parameters
from beamfield.io.read_map import read_map
from tests.real.posed_logs import wean_log

pytestmark = pytest.mark.real


def test_wean_hall_teaches_a_field_whose_posteriors_hold_the_reference(data):
    learned = learn_field_parameters(wean_log(data, 1), read_map(data / "wean_hall/derived_wean.yaml"))
    fit, independent, uniform = learned.scores
    assert learned.converged
    assert learned.parameters.z_hit == pytest.approx(0.87, abs=0.03)
    assert learned.parameters.z_rand == pytest.approx(0.12, abs=0.03)
    assert learned.density_sigma == pytest.approx(0.052, rel=0.15)
    assert 0.04 < learned.exponent < 0.12
    assert fit.log_density > uniform.log_density + 2.5
    assert fit.posterior > 4.0
    assert 0.9 < fit.coverage <= 1.0
    # Beams taken for independent: certain, and wrong.
    assert independent.posterior < -2.0
    assert independent.coverage < 0.3
