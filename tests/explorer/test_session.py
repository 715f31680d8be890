"""What the explorer answers is what the models say."""

import base64
import io
import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image
from scipy.integrate import trapezoid

from beamfield.errors import InvalidInputError
from beamfield.explorer.heat_maps import DEPTH, heat_around, quick_weights
from beamfield.explorer.parameter_set import _default_set, read_set, typical_sets
from beamfield.explorer.server import as_json
from beamfield.explorer.session import Session
from beamfield.io.parameters.beam_model_file import read_beam_model
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import Scan
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.files.typed_values import checked_values
from beamfield.stacks.registry import STACKS, build_model, model_named

BEAM, FIELD, NAV2 = 0, 1, 2
POSE = [1.2, 0.5, 0.2]


def ask(session, name, *, parameters=None, **fields):
    """Return the answer as the page gets it; parameters are those of the chosen set."""
    if parameters is not None:
        fields["parameters"] = {str(fields["set"]): parameters}
    return json.loads(as_json(session.answer({"name": name, **fields})))


def typical_beam() -> BeamParameters:
    return BeamParameters(0.8, 0.08, 0.02, 0.1, 0.15, 0.4)


def nav2_default(model, grid):
    return build_model("nav2", model, grid, replace(model_named("nav2", model).parameters(), max_beams=41))


def test_the_start_has_the_map_and_the_log(session, log):
    start = ask(session, "start")
    assert (start["map"]["width_m"], start["map"]["height_m"]) == (10.0, 6.0)
    assert start["map"]["origin"] == [-1.0, -2.0, 0.0]
    assert_allclose(start["map"]["free"], [-0.9, 8.9, -1.9, 3.9])
    assert_allclose(start["times"], log.stamps)
    assert start["poses"][-1] is None
    assert_allclose(start["poses"][:-1], log.poses[:-1])
    assert start["numbers"]["p-value"][-1] is None
    assert [one["kind"] for one in start["sets"]] == ["beam", "field", "stack"]
    assert base64.b64decode(start["map"]["picture"])[:4] == b"\x89PNG"


def test_a_wall_of_one_cell_is_in_the_picture_of_a_map_that_is_too_large_for_it(log, session, monkeypatch):
    monkeypatch.setattr("beamfield.explorer.session.LARGEST_PICTURE", 3)
    probability = np.full((7, 5), np.nan)
    probability[:4] = 0.0
    probability[1, 3] = 1.0
    start = ask(Session(log, OccupancyGrid(probability, 0.1), session.sets), "start")
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(start["map"]["picture"]))))
    # Blocks of three cells, the highest first: unknown, free in part, and with the wall in the second column.
    assert picture.tolist() == [[[0, 0], [0, 0]], [[255, 255], [255, 255]], [[255, 255], [0, 255]]]


def test_scores_are_those_of_the_models(session, grid, log):
    answer = ask(session, "scan", i=2, pose=POSE, shown=[BEAM])
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
    assert_allclose([share for share in answer["shares"][str(BEAM)] if share], shares[shares.any(axis=1)])


def test_without_a_reference_pose_there_is_nothing_to_compare_with(session):
    assert ask(session, "scan", i=11, pose=POSE, shown=[])["scores"][FIELD]["over_reference"] is None


def test_a_weight_that_is_moved_scales_the_others(session):
    values = ask(session, "scan", i=0, pose=POSE, set=BEAM, shown=[], parameters={"z_hit": 0.4})["values"][BEAM]
    assert sum(values[name] for name in ("z_hit", "z_short", "z_max", "z_rand")) == pytest.approx(1.0)
    assert values["z_hit"] / values["z_short"] == pytest.approx(0.4 / 0.08)


def test_the_field_says_which_readings_lie_at_obstacles(session, log, grid):
    shares = ask(session, "scan", i=3, pose=log.poses[3].tolist(), shown=[FIELD, BEAM])["shares"][str(FIELD)]
    ends = LikelihoodFieldModel(grid, session.sets[FIELD].make(session.sets[FIELD].values).parameters)
    near = ends.distances_to_obstacles(log[3], log.poses[3])
    known = [k for k, share in enumerate(shares) if share is not None]
    assert np.corrcoef([shares[k][0] > 0.5 for k in known], np.nan_to_num(near)[known] < 0.3)[0, 1] > 0.9


@pytest.mark.parametrize("number", [BEAM, NAV2])
def test_a_heat_map_is_the_best_of_the_headings_and_holds_the_robots_own_pose(session, grid, log, number):
    answer = ask(session, "heat", i=4, pose=POSE, set=number, width_m=1.2)
    shade = np.frombuffer(base64.b64decode(answer["heat"]), np.uint8).reshape(60, 60)
    steps = 1.2 * (np.arange(60) - 30) / 60
    headings = POSE[2] + np.radians(np.arange(36) - 18.0)
    model = (
        BeamModel(grid, typical_beam(), exponent=0.1) if number == BEAM else nav2_default("likelihood_field_prob", grid)
    )
    poses = [[[[POSE[0] + x, POSE[1] + y, turn] for turn in headings] for x in steps[::10]] for y in steps[::10]]
    values = model.log_likelihood(log[4], poses).max(axis=2)
    own = float(model.log_likelihood(log[4], POSE))
    best = own + answer["best_over_here"]
    assert float(model.log_likelihood(log[4], answer["best"])) == pytest.approx(best)
    assert best >= values.max()
    assert_allclose(shade[::10, ::10], 255.0 * np.clip(1.0 + (values - best) / DEPTH, 0.0, 1.0), atol=1.0)
    assert_allclose(np.array(answer["origin"][:2]) + 30.5 * answer["step_m"], POSE[:2])


def test_while_the_robot_is_dragged_some_beams_stand_for_all(session, log):
    words = {"i": 4, "pose": log.poses[4].tolist(), "width_m": 4.0}
    dragged = ask(session, "heat", set=BEAM, dragged=True, **words)
    at_rest = ask(session, "heat", set=BEAM, **words)
    assert (dragged["beams"], at_rest["beams"]) == ([20, 41], [41, 41])
    few, all_ = (np.frombuffer(base64.b64decode(one["heat"]), np.uint8).astype(float) for one in (dragged, at_rest))
    seen = (few > 0) & (all_ > 0) & (all_ < 255)
    # Not twice as wide, as half of the beams were without a scale.
    assert np.mean(few > 0) == pytest.approx(np.mean(all_ > 0), rel=0.35)
    assert np.median((255 - few[seen]) / (255 - all_[seen])) == pytest.approx(1.0, abs=0.25)
    for number in (FIELD, NAV2):
        field = ask(session, "heat", set=number, dragged=True, **words)
        assert field["beams"] == [1, 1]
        assert field["heat"] == ask(session, "heat", set=number, **words)["heat"]
    rays = nav2_default("beam", session.grid)
    weigh = quick_weights(session.sets[NAV2], rays)
    assert heat_around(session.sets[NAV2], rays, weigh, log[4], tuple(POSE), 4.0, dragged=True)["rows"] == 30


def test_a_scan_that_is_impossible_everywhere_makes_an_empty_heat_map(session, log):
    one, impossible = session.sets[BEAM], lambda _scan, poses: np.full(len(poses), -np.inf)
    answer = heat_around(one, one.make(one.values), impossible, log[4], tuple(POSE), 4.0, dragged=False)
    assert answer["best_over_here"] is None
    assert not any(base64.b64decode(answer["heat"]))


def test_over_the_building_the_best_place_is_the_robots(session, log):
    for number in (BEAM, FIELD):
        answer = ask(session, "building", i=5, set=number, pose=POSE)
        assert np.hypot(*(np.array(answer["best"])[:2] - log.poses[5, :2])) < 0.5
        assert len(base64.b64decode(answer["heat"])) == answer["rows"] * answer["cols"]


def test_the_density_of_a_reading_is_that_of_the_beam_model(session, log):
    answer = ask(session, "density", i=6, pose=log.poses[6].tolist(), set=BEAM, beam=20)
    total = np.sum([answer["curves"][name] for name in ("hit", "short", "rand")], axis=0)
    assert_allclose(
        np.log(total), beam_log_density(answer["ranges"], answer["expected"], 8.0, typical_beam()), atol=1e-9
    )
    assert trapezoid(total, answer["ranges"]) == pytest.approx(0.98, abs=0.01)
    assert sum(answer["shares"]) == pytest.approx(1.0)
    assert ask(session, "density", i=6, pose=POSE, set=FIELD, beam=20)["curves"] is None


def test_better_values_are_better_over_the_log(session, grid, log):
    answer = ask(session, "judge", set=BEAM, parameters={"sigma_hit": 0.05})
    assert answer["now"]["reading"] > answer["before"]["reading"] + 0.2
    assert (answer["scans"], answer["held_out"]) == (11, False)
    field = ask(session, "judge", set=FIELD, parameters={"sigma_hit": 1.5})
    assert field["now"]["reading"] is None
    # A constant factor of the likelihood, which says nothing of the pose, does not count as better.
    assert field["now"]["pose"] < field["before"]["pose"] - 0.5
    some = Session(log, grid, session.sets, held_out=np.array([2, 5, 11]))
    assert ask(some, "judge", set=FIELD) | {"now": 0, "before": 0} == {
        "now": 0, "before": 0, "scans": 2, "held_out": True,
    }  # fmt: skip


def test_scores_say_which_model_tells_the_pose(session, log):
    scans = [2, 11, 7]
    first, none, third = ask(session, "scores", scans=scans, sets=[BEAM, FIELD])["scores"]
    assert none is None
    scan, usable = log[2], np.isfinite(log[2].ranges)
    expected = BeamModel(session.grid, typical_beam()).expected(log.poses[2], log.finder)
    reading = beam_log_density(scan.ranges, expected, 8.0, typical_beam())[usable].mean()
    assert first["reading"] == [pytest.approx(reading), None]
    assert min(first["pose"] + third["pose"]) > 1.0
    # All but deaf: it says nothing. Too sure of too much: it is punished.
    deaf = ask(session, "scores", scans=[2], sets=[FIELD], set=FIELD, parameters={"exponent": 0.001})
    assert abs(deaf["scores"][0]["pose"][0]) < 0.2
    wrong = session.log.with_poses(log.poses + np.array([0.6, 0.0, 0.0]))
    moved = Session(wrong, session.grid, session.sets)
    sure = ask(moved, "scores", scans=[2], sets=[FIELD], set=FIELD, parameters={"exponent": 1.0})
    assert sure["scores"][0]["pose"][0] < -3.0


def test_a_filter_follows_the_robot(session, log):
    answer = ask(session, "filter", i=2, pose=log.poses[2].tolist(), set=FIELD)
    assert answer["poses"][:2] == [None, None]
    assert np.hypot(*(np.array(answer["poses"][2:]) - log.odometry[2:])[:, :2].T).max() < 0.4
    last = max(answer["particles"], key=int)
    cloud = np.array(answer["particles"][last])
    assert cloud.shape == (200, 3)
    assert np.hypot(*(cloud[:, :2].mean(axis=0) - log.odometry[int(last), :2])) < 0.4
    assert answer["lost"] is None
    elsewhere = (log.odometry[2] + np.array([2.5, 3.2, 1.3])).tolist()
    assert "of a scan's readings agree with the map" in ask(session, "filter", i=2, pose=elsewhere, set=FIELD)["lost"]


FILES = {
    "amcl.launch": '<launch><node pkg="amcl" type="amcl"><param name="laser_max_beams" value="9"/></node></launch>',
    "mrpt.ini": "[MetricMap_occupancyGrid_00_likelihoodOpts]\nlikelihoodMethod = 4\n",
    "two.yaml": "a: {ros__parameters: {z_hit: 0.5}}\nb: {ros__parameters: {z_hit: 0.6, model_unknown_space: false}}\n",
}


@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("amcl.launch", "ROS 1 amcl likelihood_field"),
        ("mrpt.ini", "MRPT LF_Thrun"),
        ("two.yaml", "nav2 likelihood_field"),
    ],
)
def test_files_of_all_programs_are_shown(grid, log, tmp_path, name, label):
    (tmp_path / name).write_text(FILES[name])
    section = "a.ros__parameters" if name == "two.yaml" else None
    assert read_set(tmp_path / name, grid, log.finder, section=section).label == f"{name}: {label}"


@pytest.mark.parametrize(("name", "idle"), [
    ("likelihood_field_prob", {"z_short", "z_max", "lambda_short"}), ("beam", {"laser_likelihood_max_dist"}),
])  # fmt: skip
def test_a_programs_model_has_the_sliders_of_what_it_looks_at(grid, log, tmp_path, name, idle):
    path = tmp_path / "nav2.yaml"
    path.write_text(f"amcl:\n  ros__parameters:\n    laser_model_type: {name}\n    max_beams: 20\n")
    read = read_set(path, grid, log.finder)
    poses, ranges = log.poses[:5] + 0.05, log[2].ranges.copy()
    ranges[::5] = log.finder.max_range

    def scores(values):
        return read.make(values).log_likelihood(Scan(ranges, log.finder), poses)

    every = {"z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short", "laser_likelihood_max_dist"}
    assert every - set(read.values) == idle
    for slider in read.sliders:
        if slider.name in every:
            moved = {**read.values, slider.name: 0.5 * read.values[slider.name]}
            assert np.any(scores(moved) != scores(read.values)), slider.name


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


@pytest.mark.parametrize(("stack", "model"), [(name, model) for name in STACKS for model in STACKS[name].models])
def test_a_file_of_a_programs_defaults_names_their_model(stack, model, grid, tmp_path):
    default = _default_set(stack, model, grid)
    name, text = default.write({**default.values, "sigma_hit": 0.15} if "sigma_hit" in default.values else {})
    (tmp_path / name).write_text(text)
    file = read_stack_file(tmp_path / name)
    assert (file.stack, file.model) == (stack, model)
    if "sigma_hit" in default.values:
        assert checked_values(file).sigma_hit == 0.15


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
        ({"name": "scan", "i": 1, "pose": [1.0, 2.0, 10**400], "set": 0}, "pose"),
        ({"name": "file", "set": 3}, "set"),
        ({"name": "scan", "i": 1, "pose": POSE, "shown": [0, 3]}, "shown"),
        ({"name": "scan", "i": 1, "pose": POSE, "shown": [0, 1, 2]}, "at most 2"),
        ({"name": "scores", "scans": list(range(12)) * 2, "sets": [0]}, "at most 20"),
        ({"name": "scores", "scans": [0], "sets": 0}, "list"),
        ({"name": "scores", "scans": [0], "sets": []}, "sets: expected at least one"),
        ({"name": "scan", "i": 1, "pose": POSE, "set": 0, "shown": [], "parameters": []}, "parameters"),
        ({"name": "scan", "i": 1, "pose": POSE, "shown": [], "parameters": {"0": {"__class__": 1}}}, "expected names"),
        ({"name": "scan", "i": 1, "pose": POSE, "shown": [], "parameters": {"0": {"sigma_hit": -1}}}, "sigma_hit"),
        ({"name": "scan", "i": 1, "pose": POSE, "shown": [], "parameters": {"0": {"sigma_hit": "1"}}}, "sigma_hit"),
        (
            {"name": "scan", "i": 1, "pose": POSE, "shown": [], "parameters": {"1": {"z_hit": 0, "z_rand": 0}}},
            "weight above 0",
        ),
        ({"name": "heat", "i": 1, "pose": POSE, "set": 0, "width_m": 1e9}, "width_m"),
        ({"name": "heat", "i": 1, "pose": POSE, "set": 0, "width_m": 1.0, "dragged": 1}, "dragged"),
        ({"name": "density", "i": 1, "pose": POSE, "set": 0, "beam": 41}, "beam"),
    ],
)
def test_what_the_page_cannot_send_is_refused(session, message, words):
    with pytest.raises(InvalidInputError, match=words):
        session.answer(message)


def test_a_pose_far_off_the_map_has_an_answer(session):
    answer = ask(session, "scan", i=1, pose=[9e5, 0.0, 0.0], shown=[BEAM])
    assert all(value == 8.0 for value in answer["expected"])
