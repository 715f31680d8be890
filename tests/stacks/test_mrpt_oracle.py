"""MRPT's models against what MRPT's own compiled code answered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.sensors import Scan
from beamfield.stacks.mrpt.field import MrptField
from beamfield.stacks.mrpt.parameters import MrptFieldParameters, MrptRayParameters
from beamfield.stacks.mrpt.rays import MrptRays

pytestmark = [pytest.mark.oracle, pytest.mark.usefixtures("past_the_message")]

# The oracle's answers are logarithms.
OPTIONS = {"LF_useSquareDist": {"LF_useSquareDist": True}, "alternateAverage": {"LF_alternateAverageMethod": True}}


def scan(case, kind):
    # The oracle's reading of 0 is no shorter than the sensor's limit.
    return Scan(case.ranges_special if kind else case.ranges, case.scan().finder)


def field(case, **options):
    v = case.values
    parameters = MrptFieldParameters(
        LF_stdHit=v["sigma_hit"], LF_zHit=v["z_hit"], LF_zRandom=v["z_rand"], LF_maxRange=v["max_range"],
        LF_decimation=1, LF_maxCorrsDistance=v["max_occ_dist"],
    )  # fmt: skip
    return MrptField(case.grid, parameters, **options)


def rays(case, **options):
    parameters = MrptRayParameters(rayTracing_stdHit=case.values["sigma_hit"], rayTracing_decimation=1)
    return MrptRays(case.grid, parameters, **options)


@pytest.mark.parametrize("kind", ["", "special_"])
@pytest.mark.parametrize(("precision", "tolerance"), [("single", 1e-12), ("double", 1e-5)])
def test_field(case, kind, precision, tolerance):
    """In double precision 60 points round 60 times less: 6e-6."""
    got = field(case, precision=precision).log_likelihood(scan(case, kind), case.poses)
    assert np.exp(got - case.mrpt[f"log_{kind}lmLikelihoodField_Thrun"]) == pytest.approx(1.0, abs=tolerance)


@pytest.mark.parametrize("option", OPTIONS)
def test_field_options(case, option):
    model = field(case, precision="single")
    model = model.with_parameters(replace(model.parameters, **OPTIONS[option]))
    got = model.log_likelihood(scan(case, ""), case.poses)
    assert np.exp(got - case.mrpt[f"log_lmLikelihoodField_Thrun_{option}"]) == pytest.approx(1.0, abs=1e-12)


def test_field_of_single_points(case):
    model = field(case, precision="single")
    p = model.beam_values(model.evidence(scan(case, ""), case.poses))
    expected = np.reshape(case.mrpt["log_lmLikelihoodField_Thrun_one_beam_KxP"], p.shape[::-1]).T
    np.testing.assert_allclose(np.log(p), expected, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("kind", ["", "special_"])
def test_rays(case, kind):
    got = rays(case).log_likelihood(scan(case, kind), case.poses)
    assert np.exp(got - case.mrpt[f"log_{kind}lmRayTracing"]) == pytest.approx(1.0, abs=1e-6)


def test_rays_of_single_beams(case):
    model = rays(case)
    expected = np.reshape(case.mrpt["log_lmRayTracing_one_beam_KxP"], (len(case.bearings), -1)).T
    evidence = model.evidence(scan(case, ""), case.poses)
    for beam in range(len(case.bearings)):
        one = replace(
            evidence,
            beams=evidence.beams[[beam]],
            ranges=evidence.ranges[[beam]],
            expected_ranges=evidence.expected_ranges[:, [beam]],
        )
        assert model.log_weights(one) == pytest.approx(expected[:, beam], abs=2e-7)


def test_rays_end_at_the_same_step(case):
    expected = np.reshape(case.mrpt["simulateScanRay_PxK_minus1_is_invalid"], (-1, len(case.bearings)))
    got = rays(case).evidence(scan(case, ""), case.poses).expected_ranges
    hits = expected >= 0.0
    np.testing.assert_array_equal(got[hits], expected[hits])
    limit = case.values["max_range"]
    assert set(np.round(got[~hits], 6)) <= {limit, round(0.8 * limit, 6)}


def test_exact_rays_are_half_a_step_nearer(case):
    """A ray that marches sees a wall when it is in it."""
    marching, exact = (rays(case, rays=way).evidence(scan(case, ""), case.poses).expected_ranges
                       for way in ("marching", "exact"))  # fmt: skip
    near = marching < 0.8 * case.values["max_range"] - 1e-6
    cells = (marching - exact)[near] / case.grid.resolution
    assert 0.0 <= np.median(cells) <= 0.8
    assert (np.abs(cells) < 0.9).mean() > 0.95
