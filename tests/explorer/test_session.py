"""What the explorer answers is what the models say."""

import base64
import json

import numpy as np
import pytest
from numpy.testing import assert_allclose

from beamfield.errors import InvalidInputError
from beamfield.explorer.parameter_set import read_set, typical_sets
from beamfield.explorer.server import as_json
from beamfield.explorer.session import DEPTH, HEAT_BEAMS, Session
from beamfield.io.parameters.beam_model_file import read_beam_model
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.registry import build_model

BEAM, FIELD, NAV2 = 0, 1, 2
POSE = [1.2, 0.5, 0.2]


def ask(session, name, **fields):
    """Return the answer as the page gets it."""
    return json.loads(as_json(session.answer({"name": name, **fields})))


def typical_beam() -> BeamParameters:
    return BeamParameters(0.8, 0.08, 0.02, 0.1, 0.15, 0.4)


def test_the_start_has_the_map_and_the_log(session, log):
    start = ask(session, "start")
    assert (start["map"]["width_m"], start["map"]["height_m"]) == (10.0, 6.0)
    assert start["map"]["origin"] == [-1.0, -2.0, 0.0]
    assert_allclose(start["times"], log.stamps)
    assert start["poses"][-1] is None
    assert_allclose(start["poses"][:-1], log.poses[:-1])
    assert start["numbers"]["p-value"][-1] is None
    assert [one["kind"] for one in start["sets"]] == ["beam", "field", "stack"]
    assert base64.b64decode(start["map"]["picture"])[:4] == b"\x89PNG"


def test_scores_are_those_of_the_models(session, grid, log):
    answer = ask(session, "scan", i=2, pose=POSE, set=BEAM)
    beam = BeamModel(grid, typical_beam(), exponent=0.1)
    both = beam.log_likelihood(log[2], [POSE, log.poses[2]])
    assert answer["scores"][BEAM]["log"] == pytest.approx(both[0])
    assert answer["scores"][BEAM]["over_reference"] == pytest.approx(both[0] - both[1])
    nav2 = build_model(
        "nav2", "likelihood_field_prob", grid, session.sets[NAV2].make(session.sets[NAV2].values).parameters
    )
    assert answer["scores"][NAV2]["log"] == pytest.approx(float(nav2.log_likelihood(log[2], POSE)))
    assert_allclose(answer["expected"], beam.expected(POSE, log.finder), atol=1e-12)
    shares = beam.responsibilities(log[2], POSE)
    assert_allclose([share for share in answer["shares"] if share], shares[shares.any(axis=1)])


def test_without_a_reference_pose_there_is_nothing_to_compare_with(session):
    assert ask(session, "scan", i=11, pose=POSE, set=FIELD)["scores"][FIELD]["over_reference"] is None


def test_a_weight_that_is_moved_scales_the_others(session):
    values = ask(session, "scan", i=0, pose=POSE, set=BEAM, parameters={"z_hit": 0.4})["values"]
    assert sum(values[name] for name in ("z_hit", "z_short", "z_max", "z_rand")) == pytest.approx(1.0)
    assert values["z_hit"] / values["z_short"] == pytest.approx(0.4 / 0.08)


def test_the_field_says_which_readings_lie_at_obstacles(session, log, grid):
    shares = ask(session, "scan", i=3, pose=log.poses[3].tolist(), set=FIELD)["shares"]
    ends = LikelihoodFieldModel(grid, session.sets[FIELD].make(session.sets[FIELD].values).parameters)
    near = ends.distances_to_obstacles(log[3], log.poses[3])
    known = [k for k, share in enumerate(shares) if share is not None]
    assert np.corrcoef([shares[k][0] > 0.5 for k in known], np.nan_to_num(near)[known] < 0.3)[0, 1] > 0.9


def test_a_heat_map_is_the_best_of_the_headings(session, grid, log):
    words = {"i": 4, "pose": POSE, "set": BEAM, "places": 6, "headings": 5, "width_m": 1.2, "turn_deg": 50.0}
    answer = ask(session, "heat", **words)
    bytes_ = np.frombuffer(base64.b64decode(answer["heat"]), np.uint8).reshape(6, 6)
    scan = log[4].subset(np.unique(np.round(np.linspace(0, 40, HEAT_BEAMS)).astype(int)))
    model = BeamModel(grid, typical_beam(), exponent=0.1)
    x, y = POSE[0] + 1.2 * ((np.arange(6) + 0.5) / 6 - 0.5), POSE[1] + 1.2 * ((np.arange(6) + 0.5) / 6 - 0.5)
    headings = POSE[2] + np.radians([-20.0, -10.0, 0.0, 10.0, 20.0])
    log_values = np.array([[[model.log_likelihood(scan, [a, b, c]) for c in headings] for a in x] for b in y])
    shade = 255.0 * np.clip(1.0 + (log_values.max(axis=2) - log_values.max()) / DEPTH, 0.0, 1.0)
    assert_allclose(bytes_, shade, atol=1.0)
    assert answer["best_log"] == pytest.approx(log_values.max())
    assert float(model.log_likelihood(scan, answer["best"])) == pytest.approx(log_values.max())


def test_over_the_building_the_best_place_is_the_robots(session, log):
    answer = ask(session, "building", i=5, set=FIELD, pose=POSE, parameters={"exponent": 1.0})
    assert np.hypot(*(np.array(answer["best"])[:2] - log.poses[5, :2])) < 0.5
    assert len(base64.b64decode(answer["heat"])) == answer["rows"] * answer["cols"]


def test_the_density_of_a_reading_is_that_of_the_beam_model(session, log):
    answer = ask(session, "density", i=6, pose=log.poses[6].tolist(), set=BEAM, beam=20)
    total = np.sum([answer["curves"][name] for name in ("hit", "short", "rand")], axis=0)
    assert_allclose(
        np.log(total), beam_log_density(answer["ranges"], answer["expected"], 8.0, typical_beam()), atol=1e-9
    )
    assert np.trapezoid(total, answer["ranges"]) == pytest.approx(0.98, abs=0.01)
    assert sum(answer["shares"]) == pytest.approx(1.0)
    assert ask(session, "density", i=6, pose=POSE, set=FIELD, beam=20)["curves"] is None


def test_better_values_are_better_over_the_log(session):
    answer = ask(session, "judge", i=0, pose=POSE, set=BEAM, parameters={"sigma_hit": 0.05})
    assert answer["now"] > answer["before"] + 0.2
    assert answer["scans"] == 11


def test_a_filter_follows_the_robot(session, log):
    answer = ask(session, "filter", i=0, pose=log.poses[0].tolist(), set=FIELD)
    poses = np.array(answer["poses"], dtype=float)
    assert np.hypot(*(poses - log.odometry)[:, :2].T).max() < 0.4
    assert answer["particles"]


def test_files_hold_the_values_that_were_chosen(session, grid, log, tmp_path):
    answer = ask(session, "file", i=0, pose=POSE, set=BEAM, parameters={"sigma_hit": 0.07, "exponent": 0.2})
    path = tmp_path / answer["file"]
    path.write_text(answer["text"])
    saved = read_beam_model(path)
    assert (saved.sigma_hit, saved.z_hit) == pytest.approx((0.07, 0.8))
    # One scan's exponent is the slider's; a filter's keeps its ratio to it.
    assert (saved.single_scan_exponent, saved.exponent) == pytest.approx((0.2, 0.06))
    again = read_set(path, grid, log.finder)
    assert again.kind == "beam"
    assert again.values["sigma_hit"] == pytest.approx(0.07)


def test_a_users_file_keeps_what_was_not_moved(grid, log, tmp_path):
    path = tmp_path / "nav2.yaml"
    text = (
        'amcl:\n  ros__parameters:\n    # mine\n    laser_model_type: "likelihood_field"\n'
        "    sigma_hit: 0.3  # wide\n    odom_frame_id: odom\n"
    )
    path.write_text(text)
    session = Session(log, grid, [read_set(path, grid, log.finder), *typical_sets(grid, log.finder)])
    moved = ask(session, "file", i=0, pose=POSE, set=0, parameters={"sigma_hit": 0.1})
    assert moved["text"] == text.replace("0.3 ", "0.1 ")
    assert path.read_text() == text
    path.write_text(moved["text"])
    assert checked_values(read_stack_file(path)).sigma_hit == 0.1


@pytest.mark.parametrize(
    ("message", "words"),
    [
        ("scan", "object"),
        ([1], "object"),
        ({"name": "secrets"}, "expected one of"),
        ({"name": "scan"}, "i: expected"),
        ({"name": "scan", "i": 12, "pose": POSE, "set": 0}, "from 0 to 11"),
        ({"name": "scan", "i": True, "pose": POSE, "set": 0}, "whole number"),
        ({"name": "scan", "i": 1, "pose": [1.0, 2.0], "set": 0}, "pose"),
        ({"name": "scan", "i": 1, "pose": [1.0, 2.0, float("nan")], "set": 0}, "pose"),
        ({"name": "scan", "i": 1, "pose": [1.0, 2.0, 1e300], "set": 0}, "pose"),
        ({"name": "scan", "i": 1, "pose": POSE, "set": 3}, "set"),
        ({"name": "scan", "i": 1, "pose": POSE, "set": 0, "parameters": []}, "parameters"),
        ({"name": "scan", "i": 1, "pose": POSE, "set": 0, "parameters": {"__class__": 1}}, "expected names"),
        ({"name": "scan", "i": 1, "pose": POSE, "set": 0, "parameters": {"sigma_hit": -1}}, "sigma_hit"),
        ({"name": "scan", "i": 1, "pose": POSE, "set": 0, "parameters": {"sigma_hit": "1"}}, "sigma_hit"),
        ({"name": "scan", "i": 1, "pose": POSE, "set": 1, "parameters": {"z_hit": 0, "z_rand": 0}}, "weight above 0"),
        ({"name": "heat", "i": 1, "pose": POSE, "set": 0, "places": 10**9}, "places"),
        ({"name": "density", "i": 1, "pose": POSE, "set": 0, "beam": 41}, "beam"),
    ],
)
def test_what_the_page_cannot_send_is_refused(session, message, words):
    with pytest.raises(InvalidInputError, match=words):
        session.answer(message)


def test_a_pose_far_off_the_map_has_an_answer(session):
    answer = ask(session, "scan", i=1, pose=[9e5, 0.0, 0.0], set=BEAM)
    assert all(value == 8.0 for value in answer["expected"])
