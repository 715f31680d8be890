"""Translated parameters weigh as the originals do, by the emulators of both stacks."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.emulation.emulator import KNOWN, FieldEvidence
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.formula import Formula
from beamfield.stacks.registry import model_named, parameter_class, stack_named
from beamfield.stacks.translation.translate import translate
from beamfield.stacks.translation.weight_comparison import (
    TOLERANCE,
    between_cells,
    compare,
    compare_fields,
    sample_distances,
)

GRID = OccupancyGrid.from_ros(np.zeros((2, 2)), resolution=0.05)
SENSOR_LIMIT = 12.0


@pytest.fixture
def params(tmp_path):
    def write(stack: str, **values):
        path = tmp_path / ("p.ini" if stack == "mrpt" else "p.yaml")
        lines = [f"{name}: {value}" for name, value in values.items()]
        if stack == "mrpt":
            path.write_text("[a_likelihoodOpts]\nlikelihoodMethod = 4\n" + "\n".join(lines).replace(": ", " = "))
        else:
            head = "amcl:\n  " if stack == "ros1" else "amcl:\n  ros__parameters:\n    "
            path.write_text(head + head.rsplit("\n", 1)[1].join(f"{line}\n" for line in lines))
        return read_stack_file(path, stack=stack)

    return write


def weights(stack, model, parameters, max_range):
    """Return the stack's log weights of 50 poses at given distances of 20 beams."""
    made = model_named(stack, model).emulator(GRID, parameters)
    rng = np.random.default_rng(3)
    distances = rng.exponential(0.3, (50, 20))
    settings = {name: getattr(parameters, name) for name in made.evidence_settings}
    limit = parameters.laser_max_range if stack == "beluga" else max_range
    evidence = FieldEvidence(np.arange(20), limit, distances, np.full((50, 20), KNOWN, np.int8), settings=settings)
    return made.log_weights(evidence)


PRODUCTS = [
    ("nav2", "mrpt"),
    ("ros1", "mrpt"),
    ("beluga", "mrpt"),
    ("mrpt", "nav2"),
    ("mrpt", "ros1"),
    ("mrpt", "beluga"),
]
FIELDS = [("nav2", "beluga"), ("ros1", "beluga"), ("beluga", "nav2"), ("beluga", "ros1"), ("nav2", "ros1")]


@pytest.mark.parametrize(("source", "to"), FIELDS)
@pytest.mark.parametrize("model", ["likelihood_field", "likelihood_field_prob"])
def test_relative_weights_stay_the_same(params, source, to, model):
    prefix = "laser_" if source == "ros1" else ""
    file = params(source, laser_model_type=model, laser_likelihood_max_dist=1.5, laser_max_range=20.0,
                  **{f"{prefix}z_hit": 0.7, f"{prefix}z_rand": 0.4, f"{prefix}sigma_hit": 0.13})  # fmt: skip
    result = translate(file, to, max_range=SENSOR_LIMIT)
    assert result.exact
    assert (result.stack, result.model) == (to, model)
    before = weights(source, model, checked_values(file), SENSOR_LIMIT)
    after = weights(to, model, parameter_class(to)(**result.values), SENSOR_LIMIT)
    if model == "likelihood_field_prob":  # a product: up to a common factor
        before, after = before - before.mean(), after - after.mean()
    np.testing.assert_allclose(after, before, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize(("source", "to"), PRODUCTS)
def test_products_of_fields_translate_to_and_from_mrpt(params, source, to):
    if source == "mrpt":
        file = params("mrpt", LF_zHit=0.7, LF_zRandom=0.4, LF_stdHit=0.13, LF_maxRange=20.0, LF_maxCorrsDistance=0.8)
    else:
        prefix = "laser_" if source == "ros1" else ""
        file = params(source, laser_model_type="likelihood_field_prob", laser_likelihood_max_dist=0.8,
                      laser_max_range=20.0, **{f"{prefix}z_hit": 0.7, f"{prefix}z_rand": 0.4,
                                               f"{prefix}sigma_hit": 0.13})  # fmt: skip
    result = translate(file, to, max_range=SENSOR_LIMIT, n_beams=181)
    assert result.exact
    assert result.model == ("LF_Thrun" if to == "mrpt" else "likelihood_field_prob")
    before = weights(source, file.model, checked_values(file), SENSOR_LIMIT)
    after = weights(to, result.model, parameter_class(to, result.model)(**result.values), SENSOR_LIMIT)
    # Up to AMCL's single precision, and its reach of 15 whole cells where MRPT has 0.8 m.
    np.testing.assert_allclose(after - after.mean(), before - before.mean(), rtol=1e-5, atol=1e-5)
    assert before.std() > 1.0


def test_numbers_of_beams_become_a_decimation_and_back(params):
    to_mrpt = translate(params("nav2", laser_model_type="likelihood_field_prob", max_beams=60), "mrpt", n_beams=361)
    assert to_mrpt.values["LF_decimation"] == 6
    back = translate(params("mrpt", LF_decimation=6), "nav2", n_beams=361)
    assert back.values["max_beams"] == 61
    without = translate(params("mrpt", LF_decimation=6), "nav2")
    assert "max_beams" not in without.values
    assert any("max_beams is left out" in note for note in without.notes)


@pytest.mark.parametrize("name", ["LF_useSquareDist", "LF_alternateAverageMethod"])
def test_what_only_mrpt_can_do_is_not_translated(params, name):
    with pytest.raises(InvalidInputError, match=f"{name}: .*which no other stack does"):
        translate(params("mrpt", **{name: "true"}), "nav2")
    assert translate(params("mrpt", **{name: "false"}), "beluga").exact


def test_the_gaussian_constant_of_the_chapter(params):
    """z_hit .8, z_rand .2 and sigma .05 of the chapter are nav2's .970 and .030: here the other way round."""
    file = params("nav2", laser_model_type="likelihood_field_prob", z_hit=0.969619, z_rand=0.030381, sigma_hit=0.05)
    result = translate(file, "chapter", max_range=10.0)
    assert result.values["z_hit"] == pytest.approx(0.8, abs=1e-4)
    assert result.values["z_rand"] == pytest.approx(0.2, abs=1e-4)


def test_the_sensors_limit_decides_what_z_rand_means(params):
    file = params("nav2", laser_model_type="likelihood_field_prob")
    with_limit, without = translate(file, "beluga", max_range=10.0), translate(file, "beluga")
    # nav2 divides z_rand by the sensor's 10 m instead of the file's 100 m.
    ratio = with_limit.values["z_rand"] / with_limit.values["z_hit"]
    assert ratio == pytest.approx(0.5 / 0.5 / (np.sqrt(2 * np.pi) * 0.2))
    assert with_limit.values["laser_max_range"] == 10.0
    assert with_limit.exact
    assert not without.exact
    assert any("assumed that the sensor's longest range is 100 m" in said for said in without.assumptions)


def test_beam_models_are_translated_with_the_reasons_why_not_exactly(params):
    file = params("nav2", laser_model_type="beam", laser_max_range=10.0, max_beams=37, lambda_short=0.3)
    result = translate(file, "beluga")
    assert not result.exact
    same = {"laser_max_range": 10.0, "max_beams": 37, "lambda_short": 0.3, "sigma_hit": 0.2}
    assert {name: result.values[name] for name in same} == same
    assert sum(result.values[name] for name in ("z_hit", "z_short", "z_max", "z_rand")) == pytest.approx(1.0)
    # The peak of a hit against the random floor stays.
    peak = result.values["z_hit"] / (np.sqrt(2 * np.pi) * 0.2)
    assert peak / result.values["z_rand"] == pytest.approx(1.0)
    assert any("add 1 to the sum of cubes" in note for note in result.notes)
    back = translate(params("beluga", **{n: v for n, v in result.values.items() if n != "max_beams"}), "nav2")
    assert back.values["z_hit"] / back.values["z_rand"] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("source", "values", "to", "model", "reason"),
    [
        (
            "nav2",
            {},
            "mrpt",
            None,
            "mrpt has no model that weighs as nav2's likelihood_field does: nav2's likelihood_field takes 1 \\+",
        ),
        ("nav2", {}, "beluga", "beam", r"takes 1 \+ the sum of p\^3 over end points, beluga's beam takes a sum"),
        ("nav2", {"laser_model_type": "beam"}, "f1tenth", None, "f1tenth has no model that weighs as nav2's beam"),
        ("nav2", {}, "ros9", None, "stack: expected one of nav2"),
        ("nav2", {}, "beluga", "table", "model: beluga has likelihood_field"),
        ("ros1", {"laser_model_type": "beam"}, "beluga", None, "max_range: the sensor's longest range is needed"),
    ],
    ids=["no such family", "other family", "table", "no stack", "no model", "no limit"],
)
def test_what_cannot_be_translated_says_why(params, source, values, to, model, reason):
    with pytest.raises(InvalidInputError, match=reason):
        translate(params(source, z_hit=0.5, **values), to, model=model)


def test_beam_skipping_does_not_get_lost_in_silence(params):
    file = params("nav2", laser_model_type="likelihood_field_prob", do_beamskip="true", laser_max_range=10.0)
    assert any("beam skipping is left out" in note for note in translate(file, "beluga").notes)
    assert translate(file, "ros1").values["do_beamskip"] is True


def test_weights_of_a_product_sum_to_one_whatever_the_sensors_limit(params):
    file = params("mrpt", LF_zHit=0.95, LF_zRandom=0.05, LF_maxRange=81)
    values = translate(file, "nav2", max_range=12.0).values
    assert values["z_hit"] + values["z_rand"] == pytest.approx(1.0)
    assert values["z_hit"] / values["z_rand"] == pytest.approx(0.95 / (0.05 / 81 * 12))


@pytest.mark.parametrize(("sigma", "above"), [(0.05, True), (0.4, False)])
def test_a_peak_that_amcl_asserts_against_is_said(params, sigma, above):
    """Beluga's 0.5 N(0; 0, 0.05^2) is 3.99, and so is nav2's z_hit then."""
    file = params("beluga", laser_model_type="likelihood_field", z_hit=0.5, z_rand=0.5, sigma_hit=sigma)
    assert any("z_hit is above 1" in note for note in translate(file, "nav2").notes) is above


@pytest.mark.parametrize(("sigma", "above"), [(0.6, True), (0.3, False)])
def test_a_weight_that_beluga_refuses_is_said(params, sigma, above):
    """nav2's z_hit 0.8 is 0.8 sigma_hit sqrt(2 pi) in Beluga, whose node declares that it takes 0 to 1."""
    found = translate(params("nav2", laser_model_type="likelihood_field", z_hit=0.8, sigma_hit=sigma), "beluga")
    assert (found.values["z_hit"] > 1.0) is above
    said = "z_hit is above 1: Beluga's node for ROS 2 refuses it and does not start"
    assert any(note.startswith(said) for note in found.notes) is above


@pytest.mark.parametrize(
    ("to", "said"),
    [
        ("ros1", "chosen for the map amcl_map.yaml"),
        ("beluga", "chosen with amcl_map.yaml, which is for nav2 alone: give Beluga the map that it was made from"),
        ("chapter", "chosen with amcl_map.yaml, which is for nav2 alone: give beamfield the map that it was made from"),
    ],
)
def test_which_map_goes_with_values_for_the_moved_one_is_said(params, to, said):
    file = params("nav2", laser_model_type="likelihood_field_prob", z_hit="0.5  # chosen for the map amcl_map.yaml")
    assert said in translate(file, to).notes
    assert not any("amcl_map" in note for note in translate(params("nav2", z_hit=0.5), "beluga").notes)


def test_options_that_only_beluga_has_are_not_lost_in_silence(params):
    notes = translate(params("beluga", laser_model_type="likelihood_field", z_hit=0.5), "nav2").notes
    assert any("only_obstacle_boundaries is left out" in note for note in notes)
    assert any("not the same beams" in note for note in notes)


def amcl_log_weights(d, z_hit, z_rand, sigma, max_distance, max_range, reach, *, constant=1.0):
    """Return the log-weights of likelihood_field_prob, written from amcl_laser: beyond `reach` d is max_distance."""
    weights = []
    for row in d:
        total = 0.0
        for x in row:
            z = max_distance if x > reach else x
            total += math.log(z_hit * constant * math.exp(-z * z / (2 * sigma * sigma)) + z_rand / max_range)
        weights.append(total)
    return np.array(weights)


def test_distances_cut_at_whole_cells_are_part_of_the_comparison(params):
    """nav2 looks int(0.3 / 0.1) = 2 cells far, Beluga 0.3 m: in products that is worth nats."""
    close = {"laser_model_type": "likelihood_field_prob", "laser_max_range": 10.0, "z_hit": 0.8, "z_rand": 0.2,
             "sigma_hit": 0.2}  # fmt: skip
    file = params("nav2", laser_likelihood_max_dist=0.3, **close)
    result = translate(file, "beluga", max_range=12.0, resolution=0.1)
    assert not result.exact
    assert result.summary.startswith("not the same weights: computed for one scan of 30 beams at 500 poses")
    assert any("whole number of cells" in note and "cells of 0.1 m" in note for note in result.notes)
    d = between_cells(sample_distances(0.2, 0.3), 0.1)
    before = amcl_log_weights(d, 0.8, 0.2, 0.2, 0.3, 10.0, 2.01 * 0.1)
    v = result.values
    after = amcl_log_weights(
        d, v["z_hit"], v["z_rand"], 0.2, 0.3, 10.0, 0.3, constant=1 / (math.sqrt(2 * math.pi) * 0.2)
    )
    assert result.comparison.difference == pytest.approx(np.ptp(before - after), abs=1e-3)
    assert result.comparison.difference > 1.0
    far = translate(params("nav2", laser_likelihood_max_dist=2.0, **close), "beluga", max_range=12.0, resolution=0.1)
    assert far.exact
    assert far.summary.startswith("the same relative weights at equal distances: computed for")
    assert not any("whole number of cells" in note for note in far.notes)


def test_the_side_of_cells_is_taken_in_single_precision_as_in_the_message(params):
    """0.5 m are 10 cells of 0.05 m, but 9 of float32(0.05)."""
    file = params("nav2", laser_model_type="likelihood_field_prob", laser_likelihood_max_dist=0.5, sigma_hit=0.2,
                  laser_max_range=10.0)  # fmt: skip
    assert translate(file, "mrpt", max_range=12.0, resolution=0.05).comparison.difference > 0.1
    assert translate(file, "mrpt", max_range=12.0, resolution=0.125).exact


def test_wrong_parameters_are_seen_by_the_comparison():
    kind = parameter_class("nav2")
    right = kind(laser_model_type="likelihood_field_prob")
    wrong = kind(laser_model_type="likelihood_field_prob", z_hit=0.49)
    distances = sample_distances(0.2, 2.0)
    for other, same in ((right, True), (wrong, False)):
        model = model_named("nav2", "likelihood_field_prob")
        pair = [Formula(stack_named("nav2"), model, parameters) for parameters in (right, other)]
        made = compare_fields(pair[0], pair[1], distances, (10.0, 10.0), 0.05)
        assert (made.difference <= TOLERANCE) is same
        assert made.is_same is same


def test_a_weight_of_zero_on_one_side_only_is_an_infinite_difference():
    some, none = np.array([0.0, -1.0]), np.array([0.0, -np.inf])
    assert compare(some, none).difference == np.inf
    assert compare(none, none).is_same
    assert compare(some, some + 3.0).difference == 0.0


def test_beam_models_say_how_far_their_weights_are_apart(params):
    result = translate(params("nav2", laser_model_type="beam", laser_max_range=10.0), "beluga", max_range=12.0)
    assert not result.exact
    assert 0.01 < result.comparison.difference < 10.0
    assert f"differ by up to {result.comparison.difference:.3g}" in result.summary
    assert translate(params("nav2", laser_model_type="beam"), "ros1").exact


def test_words_of_notes_decide_nothing(params, monkeypatch):
    """Once `exact` was whether a note has the word "assumed"."""
    from beamfield.stacks.translation import translate as module

    monkeypatch.setattr(module, "map_notes", lambda *_: ["assumed nothing"])
    file = params("nav2", laser_model_type="likelihood_field_prob", laser_max_range=10.0)
    assert translate(file, "beluga", max_range=12.0).exact


def test_belugas_names_for_ros_1_are_translated(tmp_path):
    path = tmp_path / "default.ros.yaml"
    path.write_text("laser_z_hit: 0.77\nlaser_sigma_hit: 0.11\nlaser_max_beams: 100\nexecution_policy: seq\n")
    file = read_stack_file(path)
    assert (file.stack, file.stack_is_certain, file.is_of_other_node) == ("beluga", True, True)
    values = translate(file, "nav2", max_range=12.0).values
    assert values["max_beams"] == 100
    assert values["sigma_hit"] == 0.11
    # z_rand as ROS 1's amcl and Beluga's node for ROS 1 have it by default, 0.05.
    assert values["z_hit"] / values["z_rand"] == pytest.approx(0.77 / (np.sqrt(2 * np.pi) * 0.11) / (0.05 / 100 * 12))


def test_names_that_the_stack_does_not_read_are_said(params):
    notes = translate(params("nav2", laser_z_hit=0.9, laser_max_range=5.0), "ros1").notes
    assert any(note.startswith("laser_z_hit was not read: nav2 has no such parameter") for note in notes)
