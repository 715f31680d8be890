"""beamfield's own beam_model.yaml in the words of other programs, by formulas written here."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np
import pytest
from scipy.stats import norm

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.parameters.beam_model_file import beam_model_text
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder
from beamfield.stacks.f1tenth.parameters import F1tenthParameters
from beamfield.stacks.f1tenth.table import sensor_table
from beamfield.stacks.registry import model_named
from beamfield.stacks.translation.translate_beam_model import translate_beam_model

PLAIN = BeamParameters(0.7, 0.1, 0.05, 0.15, 0.04, 0.5)
FULL = BeamParameters(0.7, 0.1, 0.05, 0.15, 0.02, 0.5, range_offset=-0.03, sigma_slope=0.01)
MAX_RANGE = 10.0


@pytest.fixture
def model(tmp_path):
    def write(parameters=PLAIN, min_range=0.0, opening_angle=0.0):
        bearings = [0.0] if opening_angle else np.linspace(-1.0, 1.0, 9)
        finder = RangeFinder.from_bearings(
            bearings, MAX_RANGE, min_range=min_range, name="scan", opening_angle=opening_angle
        )
        path = tmp_path / "beam_model.yaml"
        path.write_text(beam_model_text(parameters, finder))
        return path

    return write


def density(z, z_star, p=PLAIN):
    """Return (6.12) for readings that return, with the chapter's normalisers."""
    hit = norm.pdf(z, z_star, p.sigma_hit) / (
        norm.cdf(MAX_RANGE, z_star, p.sigma_hit) - norm.cdf(0, z_star, p.sigma_hit)
    )
    short = np.where(
        z <= z_star, p.lambda_short * np.exp(-p.lambda_short * z) / -np.expm1(-p.lambda_short * z_star), 0.0
    )
    return p.z_hit * hit + p.z_short * short + p.z_rand / MAX_RANGE


Z_STAR = 4.0
Z = np.array([3.9, 3.97, 4.01, 4.08, 5.0, 8.0])


def nav2_beam(z, v):
    """Return p of nav2's beam model from its documented terms, at Z_STAR."""
    p = v["z_hit"] * np.exp(-((z - Z_STAR) ** 2) / (2 * v["sigma_hit"] ** 2)) + v["z_rand"] / v["laser_max_range"]
    return p + np.where(z < Z_STAR, v["z_short"] * v["lambda_short"] * np.exp(-v["lambda_short"] * z), 0.0)


def test_nav2s_p_is_the_density_but_for_a_factor_at_the_typical_range(model):
    v = translate_beam_model(model(), "nav2", typical_range=Z_STAR).values
    p, q = nav2_beam(Z, v), density(Z, Z_STAR)
    np.testing.assert_allclose(p / p[2], q / q[2], rtol=1e-6)
    near = np.array([1.0, 2.0])
    np.testing.assert_allclose(nav2_beam(near, v) / p[2], density(near, Z_STAR) / q[2], rtol=1e-6)


def test_belugas_parameters_are_the_chapters(model):
    result = translate_beam_model(model(), "beluga")
    for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short"):
        assert result.values[name] == pytest.approx(getattr(PLAIN, name))
    assert not result.exact
    assert any("log" in note and "off by" in note and float(note.split("off by ")[1].split()[0]) < 1e-3
               for note in result.notes)  # fmt: skip


def test_offset_and_slope_go_into_sigma(model):
    """The Gaussian nearest in expected log density has the mean square about the expected range for its variance."""
    result = translate_beam_model(model(FULL, min_range=0.2), "beluga", typical_range=3.0)
    assert result.values["sigma_hit"] == pytest.approx(math.sqrt(0.02**2 + 0.03**2 + (0.01 * 3.0) ** 2))
    for name in ("range_offset", "sigma_slope", "min_range"):
        (note,) = [note for note in result.notes if note.startswith(f"{name} ")]
        assert "is lost" in note
        assert 0.0 < float(note.split("costs ")[1].split()[0]) < 1.0


def test_the_cost_of_an_offset_is_a_divergence(model):
    """Of hits alone: N(b, s^2) against N(0, s^2 + b^2) costs log(s' / s) nats in the mean."""
    hits = BeamParameters(1.0, 0.0, 0.0, 0.0, 0.03, 0.0, range_offset=0.03)
    notes = translate_beam_model(model(hits), "chapter", model="beam", typical_range=4.0).notes
    (note,) = [note for note in notes if note.startswith("range_offset")]
    assert float(note.split("costs ")[1].split()[0]) == pytest.approx(math.log(math.sqrt(2.0)), abs=0.02)


def test_the_typical_range_is_that_of_the_sensor_if_nobody_says(model):
    slope = BeamParameters(0.7, 0.1, 0.05, 0.15, 0.02, 0.5, sigma_slope=0.01)
    assert translate_beam_model(model(slope), "beluga").values["sigma_hit"] == pytest.approx(math.hypot(0.02, 0.04))


def test_f1tenths_table_keeps_the_shares(model):
    v = translate_beam_model(model(), "f1tenth", resolution=0.05, typical_range=Z_STAR).values
    assert v["sigma_hit"] == pytest.approx(0.04 / 0.05)
    kinds = {name: sensor_table(F1tenthParameters(**{**v, **{other: 0.0 for other in
             ("z_hit", "z_short", "z_max", "z_rand") if other != name}}), 0.05) for name in ("z_hit",)}  # fmt: skip
    assert kinds["z_hit"][:, 80].sum() == pytest.approx(1.0)
    column = sensor_table(F1tenthParameters(**v), 0.05)[:, 80]
    assert column[200] == pytest.approx(PLAIN.z_max, rel=1e-3)
    # Below the hit there are short and random readings.
    assert column[:60].sum() == pytest.approx(PLAIN.z_short * (1 - (20 / 80) ** 2) + PLAIN.z_rand * 60 / 200, rel=0.03)


def test_f1tenths_short_readings_are_not_multiplied_by_the_range():
    """Its triangle sums to z_short (d + 1) in pixels: taken over as it was, a tenth became nine tenths."""
    v = model_named("f1tenth").beam_values(PLAIN, Z_STAR, 0.05)
    column = sensor_table(F1tenthParameters(**v, max_range=MAX_RANGE), 0.05)[:, 80]
    assert column[75:86].sum() == pytest.approx(PLAIN.z_hit, abs=0.03)


@pytest.mark.parametrize(
    ("to", "name"), [("nav2", "likelihood_field_prob"), ("beluga", "likelihood_field_prob"), ("mrpt", None)]
)
def test_fields_have_the_hits_and_random_readings(model, to, name):
    result = translate_beam_model(model(), to, model=name)
    v = result.values
    hit, rand, sigma, limit = (
        ("LF_zHit", "LF_zRandom", "LF_stdHit", "LF_maxRange") if to == "mrpt"
        else ("z_hit", "z_rand", "sigma_hit", "laser_max_range")
    )  # fmt: skip
    d = np.array([0.0, 0.05, 0.5])
    constant = 1.0 if to != "beluga" else 1 / (math.sqrt(2 * math.pi) * v[sigma])
    p = v[hit] * constant * np.exp(-(d**2) / (2 * v[sigma] ** 2)) + v[rand] / v[limit]
    q = PLAIN.z_hit * norm.pdf(d, 0.0, PLAIN.sigma_hit) + PLAIN.z_rand / MAX_RANGE
    np.testing.assert_allclose(p / p[0], q / q[0], rtol=1e-6)
    assert not result.exact
    assert any("z_short and z_max are lost, 15.0% of the readings" in note for note in result.notes)


def test_the_chapters_parameters_without_losses_are_the_same(model):
    result = translate_beam_model(model(), "chapter")
    assert result.exact
    assert result.values == {k: v for k, v in asdict(PLAIN).items() if k not in ("range_offset", "sigma_slope")}
    assert not translate_beam_model(model(FULL), "chapter").exact


@pytest.mark.parametrize("to", ["nav2", "ros1", "beluga", "mrpt", "f1tenth"])
def test_no_stack_is_said_to_weigh_the_same(model, to):
    result = translate_beam_model(model(), to, resolution=0.05)
    assert not result.exact
    assert result.summary.startswith("not the same weights")
    assert result.comparison.difference > 1.0
    assert f"--stack {to}" in result.notes[-1]


def test_which_model_is_written_and_why(model):
    result = translate_beam_model(model(), "nav2")
    assert (result.model, result.values["laser_model_type"]) == ("beam", "beam")
    assert result.notes[0].startswith("beam was chosen, because it is nav2's model of ranges along rays, as yours is")
    rays = translate_beam_model(model(), "mrpt", model="rayTracing")
    assert rays.values == {"likelihoodMethod": 1, "rayTracing_stdHit": pytest.approx(0.04)}


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"to": "f1tenth"}, "resolution: F1TENTH measures sigma_hit in cells of the map"),
        ({"to": "nav3"}, "stack: expected one of"),
        ({"to": "nav2", "model": "table"}, "model: nav2 has likelihood_field"),
        ({"to": "chapter", "model": "table"}, "model: chapter has beam, likelihood_field, got 'table'"),
        ({"to": "nav2", "typical_range": 0.0}, "typical_range: expected a positive number of metres"),
    ],
)
def test_what_cannot_be_done_is_said(model, keywords, message):
    with pytest.raises(InvalidInputError, match=message):
        translate_beam_model(model(), **keywords)


def test_models_of_cones_are_refused(model):
    with pytest.raises(FormatError, match="is a model of cones"):
        translate_beam_model(model(opening_angle=0.3), "nav2")
