"""What fits an annotation, what is said where nothing does, and that calls which succeed are left alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

import beamfield as bf
from beamfield.arguments import as_count, as_floats, check_fields, check_magnitude, checked
from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.base import MeasurementModel
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, Scan


class Pose(Protocol):
    def heading(self) -> float: ...


P = TypeVar("P", bound=Pose)


@pytest.mark.parametrize(
    ("hint", "right", "wrong", "wanted"),
    [
        (float, [1, 1.5, np.float32(2), np.array(3.0), True], ["1", None, [1.0], 1j], "a number"),
        (int, [1, np.int64(2)], [1.5, "1"], "a whole number"),
        (bool, [True, np.bool_(False)], [1, "yes"], "True or False"),
        (str, ["x"], [1, b"x"], "a text"),
        (float | None, [None, 2.0], ["x"], "a number or None"),
        (Literal["free", "occupied"], ["free"], [None, 1], "'free' or 'occupied'"),
        (
            ArrayLike,
            [[1, 2], 3.0, np.zeros(2), np.ma.array([1.0, 2.0])],
            ["x", [None], {"x": 1}, [[1], [1, 2]], np.ma.array([1.0, 2.0], mask=[True, False])],
            "an array of numbers",
        ),
        (NDArray[np.float64], [np.zeros(2)], [["a"]], "an array of numbers"),
        (tuple[float, float], [(1.0, 2), [1, 2]], [(1.0,), 1.0, "ab"], "(a number, a number)"),
        (Sequence[str], [["a"], ()], ["a", 1], "a sequence"),
        (Mapping[str, float], [{}], [[]], "a Mapping"),
        (Callable[[int], None], [print], [1], "a function"),
        (Scan, [], ["scan", None], "a Scan"),
        (P, [], [1.0], "a Pose"),
        (Any, [1, "x", None], [], ""),
    ],
)
def test_what_fits_an_annotation(hint, right, wrong, wanted):
    @dataclass
    class Holder:
        value: hint

        def __post_init__(self):
            check_fields(self)

    Holder.__annotations__["value"] = hint
    for value in right:
        Holder(value)
    for value in wrong:
        with pytest.raises(InvalidInputError) as caught:
            Holder(value)
        assert str(caught.value).startswith(f"value: expected {wanted}, got ")


def test_an_error_that_the_arguments_do_not_explain_stays_what_it_is():
    @checked
    def divide(a: float, b: float) -> float:
        return a / (b if b else {}["zero"])

    assert divide(1.0, 2.0) == 0.5
    with pytest.raises(KeyError, match="zero"):
        divide(1.0, 0.0)
    with pytest.raises(TypeError, match="missing 1 required"):
        divide(1.0)
    with pytest.raises(InvalidInputError, match="b: expected a number, got the text '2'") as caught:
        divide(1.0, "2")
    assert isinstance(caught.value.__cause__, TypeError)


def test_what_users_mix_up_is_said_in_one_line():
    parameters = BeamParameters(0.8, 0.1, 0.05, 0.05, sigma_hit=0.1, lambda_short=0.5)
    finder = RangeFinder.from_bearings([0.0, 1.0], 5.0)
    with pytest.raises(InvalidInputError, match=r"^grid: expected an OccupancyGrid, got the text 'map\.yaml'"):
        BeamModel("map.yaml", parameters)
    with pytest.raises(InvalidInputError, match=r"^parameters: expected a BeamParameters, got the dict"):
        BeamModel(_grid(), {"z_hit": 1.0})
    model = BeamModel(_grid(), parameters)
    with pytest.raises(InvalidInputError, match="expected a Scan, got an array of float64 with shape"):
        model.log_likelihood(np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(
        InvalidInputError, match=r"^poses: expected an array of numbers, got a Scan: the scan comes first"
    ):
        model.log_likelihood(np.zeros((1, 3)), Scan([1.0, 2.0], finder))


GRID = OccupancyGrid([[0.0, 1.0]], 1.0)
BEAM = BeamParameters(0.8, 0.1, 0.05, 0.05, sigma_hit=0.1, lambda_short=0.5)
FIELD = bf.LikelihoodFieldParameters(0.8, 0.1, 0.1)
FINDER = RangeFinder.from_bearings([0.0, 1.0], 5.0)
SCAN = Scan([1.0, 2.0], FINDER)
LOG = bf.SensorLog(FINDER, [0.0], [[1.0, 2.0]], np.zeros((1, 3)), np.zeros((1, 3)))
EMPTY_LOG = bf.SensorLog(FINDER, [0.0], [[np.nan, np.nan]], np.zeros((1, 3)), np.zeros((1, 3)))
SEVERAL = bf.ScanLog({"/a": LOG, "/b": LOG}, source="run.bag")
MODEL = BeamModel(GRID, BEAM)
POSES = np.zeros((4, 3))
BELIEF = bf.localization.PoseBelief.around(POSES[0], sd_position=0.5)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: bf.calibrate("run.bag", "map.yaml"), r"log: .*'run.bag': read_log\(path\).only_sensor\(\) reads one"),
        (lambda: bf.calibrate(LOG, Path("map.yaml")), r"grid: .*: read_map\(path\) reads one"),
        (lambda: bf.calibrate(SEVERAL, GRID), r"got a ScanLog: choose a sensor of it with .only_sensor\(name\)"),
        (lambda: BeamModel(POSES, BEAM), r"grid: .*: OccupancyGrid.from_ros\(cells, resolution\) makes one"),
        (lambda: BeamModel(GRID, {"z_hit": 1.0}), r"parameters: .*: BeamParameters\(\*\*values\) makes them"),
        (lambda: BeamModel(GRID, "beam_model.yaml"), r"parameters: .*: read_beam_model\(path\) reads them"),
        (
            lambda: bf.LikelihoodFieldModel(GRID, BEAM),
            r"parameters: .*: LikelihoodFieldParameters.from_beam_parameters",
        ),
        (lambda: bf.LikelihoodFieldModel(GRID, {"z_hit": 1}), r": LikelihoodFieldParameters\(\*\*values\) makes them"),
        (lambda: MODEL.log_likelihood(POSES, SCAN), "the scan comes first, then the poses"),
        (lambda: MODEL.responsibilities(POSES, SCAN), r"z: expected a Scan, .*: Scan\(ranges, finder\) makes one"),
        (lambda: bf.LikelihoodFieldModel(GRID, FIELD).log_likelihood(POSES, SCAN), "it comes before the poses"),
        (lambda: MODEL.log_likelihood(LOG, POSES), r"z: .*got a SensorLog: log\[i\] is one of its scans"),
        (lambda: MODEL.log_likelihood(EMPTY_LOG, POSES), r"z: .*got a SensorLog: log\[i\] is one of its scans"),
        (lambda: MODEL.responsibilities(LOG, POSES), r"z: .*got a SensorLog: log\[i\] is one of its scans"),
        (
            lambda: bf.LikelihoodFieldModel(GRID, FIELD, n_beams=1).log_likelihood(LOG, POSES),
            r"z: .*got a SensorLog: log\[i\] is one of its scans",
        ),
        (lambda: bf.align(SCAN, onto=SCAN.ranges, initial=POSES[0]), r"onto\[0\]: expected a Scan, got 1.0"),
        (
            lambda: _filter().start(BELIEF),
            r"poses: .*: localization.belief_poses\(belief, n, rng\) draws poses from it",
        ),
        (lambda: bf.GaussianMotion().sample(POSES, POSES[:2], 0), r"rng: .*np.random.default_rng\(seed\) makes one"),
        (lambda: _filter(options=2000), r"options: expected a FilterOptions or None, got 2000$"),
        (lambda: _filter(source=GRID), r"source: expected a PoseSource or None, got an OccupancyGrid"),
        (lambda: _filter(short_readings=MODEL), "short_readings: expected a ShortReadings or None, got a BeamModel"),
        (lambda: OccupancyGrid.from_ros(np.eye(3), 0.1), r"data: expected percent, .*, got 1.0 at most: 100 \* data"),
        (lambda: OccupancyGrid.from_ros(np.eye(3) > 0, 0.1), r"data: expected percent, .* got True at most"),
        (lambda: _filter(rng=np.random.RandomState(0)), "rng: expected a Generator, a whole number or None, got a Ran"),
        (lambda: MODEL.expected(SCAN, FINDER), "poses: .*got a Scan: the scan comes first, then the poses"),
        (lambda: MODEL.sample(POSES, np.random.default_rng(0)), r"finder: .*sample\(poses, finder, rng\)"),
        (lambda: bf.RayCaster("map.yaml"), r"grid: .*: read_map\(path\) reads one"),
        (lambda: bf.RayCaster(GRID).expected_ranges(POSES, SCAN), "finder: .*: it is the scan's .finder"),
        (lambda: bf.attach_poses(SEVERAL, "poses.tum"), r"track: .*: read_trajectory\(path\) reads one"),
        (lambda: bf.attach_poses("run.bag", "poses.tum"), r"log: .*: read_log\(path\) reads one"),
    ],
)
def test_what_users_mix_up_comes_with_what_to_do(call, words):
    with pytest.raises(InvalidInputError, match=words):
        call()


def _filter(**options: Any) -> bf.ParticleFilter[Scan]:
    return bf.ParticleFilter(MODEL, bf.GaussianMotion(), **options)


def _grid():
    return OccupancyGrid([[0.0, 1.0]], 1.0)


def test_a_model_is_known_by_what_it_offers():
    @checked
    def score(model: MeasurementModel[Any]) -> None:
        raise TypeError(f"inside {model}")

    with pytest.raises(TypeError, match="inside"):
        score(BeamModel(_grid(), BeamParameters(0.8, 0.1, 0.05, 0.05, sigma_hit=0.1, lambda_short=0.5)))
    with pytest.raises(InvalidInputError, match=r"^model: expected a MeasurementModel, got an OccupancyGrid$"):
        score(_grid())


def test_numbers_are_taken_as_they_are_or_refused():
    doubles = np.zeros(3)
    assert as_floats(doubles, "x") is doubles
    assert as_floats([1, True], "x").tolist() == [1.0, 1.0]
    masked = np.ma.array([1.0, 2.0, 3.0], mask=[False, True, False])
    with pytest.raises(InvalidInputError, match=r"x: .* got an array with 1 of 3 masked: \.filled\(np\.nan\) has NaN"):
        as_floats(masked, "x")
    with pytest.raises(InvalidInputError, match="expected an array of numbers, got the list"):
        as_floats([*np.ma.array([[1, 2]] * 2, mask=[[0, 0], [0, 1]])], "x")
    assert type(as_floats(masked[::2], "x")) is np.ndarray
    assert as_floats([masked[::2]], "x").tolist() == [[1.0, 3.0]]
    for wrong in (["1"], [None], np.array([np.datetime64("2026-01-01")]), [[1.0], [1.0, 2.0]], 1j, {1.0}):
        with pytest.raises(InvalidInputError, match=r"^x: expected an array of numbers, got "):
            as_floats(wrong, "x")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "1 to 10, got 0"), (11, "1 to 10, got 11"), (1.0, "a whole number, got 1.0"), (None, "a whole number")],
)
def test_counts_have_bounds(value, text):
    assert as_count(np.int32(5), "n", least=1, most=10) == 5
    with pytest.raises(InvalidInputError, match=f"^n: expected {text}"):
        as_count(value, "n", least=1, most=10)


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, 5e-324, 9e-13, 1.1e9])
def test_magnitudes_that_cannot_be_computed_with_are_refused_by_name(value):
    check_magnitude("sigma_hit", 1e-12)
    with pytest.raises(InvalidInputError, match=r"^sigma_hit: expected a positive number from 1e-12 to 1e\+09"):
        check_magnitude("sigma_hit", value)
