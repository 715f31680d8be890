"""nav2's models at the edges: 42 random cases that its compiled code answered, and a few small ones by hand.

Many maximum distances are short or no multiple of a cell, scans have fewer beams than max_beams, NaN and missing
returns, maps have no obstacles, and poses lie off them.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.nav2.models import Nav2Beam, Nav2Field, Nav2FieldProb
from beamfield.stacks.nav2.parameters import Nav2Parameters

KINDS = {kind.model: kind for kind in (Nav2Field, Nav2FieldProb, Nav2Beam)}
N_CASES = 42


@pytest.mark.oracle
@pytest.mark.usefixtures("past_the_message")
@pytest.mark.parametrize("number", range(N_CASES))
def test_weights_are_those_of_the_program(oracle, number):
    with np.load(oracle / "nav2_edges" / "cases.npz") as file:
        assert len({name[:2] for name in file}) == N_CASES
        case = {name[3:]: file[name] for name in file if name.startswith(f"{number:02d}_")}
    values = json.loads(str(case["p"]))
    grid = OccupancyGrid.from_ros(case["occ"], float(case["res"]), [*case["origin"], 0.0])
    bearings = np.zeros((len(case["ang"]), 3))
    bearings[:, 2] = case["ang"]
    finder = RangeFinder(compose(case["mount"], bearings), float(case["rmax"]), min_range=float(case["rmin"]))
    kind = KINDS[values["laser_model_type"]]
    options = {} if kind is Nav2Beam else {"distance": "brushfire"}
    model = kind(grid, Nav2Parameters(**values), **options)
    got = np.exp(model.log_likelihood(Scan(case["z"], finder), case["poses"]))
    assert got == pytest.approx(case["w"], rel=1e-12, abs=0.0)


# Of cells of 0.1 m: maximum distances, metres, and how many whole cells of the message's size fit into them.
REACHES = {0.3: 2, 0.25: 2, 0.3000001: 3, 0.15: 1, 0.05: 0, 0.7: 6, 0.5: 4}
CORNER = OccupancyGrid.from_ros([[100] + [0] * 9] + [[0] * 10] * 9, 0.1)


def values_of_cells(limit: float, distance: str) -> np.ndarray:
    """Return p of a beam that ends in each cell, (100,)."""
    parameters = Nav2Parameters(laser_likelihood_max_dist=limit, sigma_hit=0.2, max_beams=2)
    scan = Scan([1e-9], RangeFinder.from_bearings([0.0], 5.0))
    model = Nav2Field(CORNER, parameters, distance=distance)
    cols, rows = np.meshgrid(np.arange(10), np.arange(10))
    poses = np.column_stack([0.1 * cols.ravel(), 0.1 * rows.ravel(), np.zeros(100)])
    return model.beam_values(model.evidence(scan, poses))[:, 0]


def expected_of_cells(limit: float, reach: int) -> np.ndarray:
    cols, rows = np.meshgrid(np.arange(10), np.arange(10))
    cells = np.hypot(cols, rows).ravel()
    d = np.where(cells <= reach, 0.1 * cells, limit)
    return 0.5 * np.exp(-0.5 * (d / 0.2) ** 2) + 0.5 / 5.0


@pytest.mark.parametrize("distance", ["exact", "brushfire"])
@pytest.mark.parametrize("limit", REACHES)
def test_distances_are_cut_off_at_whole_cells_of_the_message(limit, distance):
    """In single precision 0.1 is a little more than that, so that 5 cells do not fit into 0.5 m."""
    expected = expected_of_cells(limit, REACHES[limit])
    assert values_of_cells(limit, distance) == pytest.approx(expected, rel=1e-6)


@pytest.mark.usefixtures("past_the_message")
@pytest.mark.parametrize(("limit", "reach"), [(0.3, 2), (0.2, 2), (0.5, 5), (0.7, 6)])
def test_the_quotient_is_cut_down_as_computed(limit, reach):
    """0.3 / 0.1 is 2.9999999999999996, 0.7 / 0.1 is 6.999999999999999, the others are whole."""
    for distance in ("exact", "brushfire"):
        assert values_of_cells(limit, distance) == pytest.approx(expected_of_cells(limit, reach), rel=1e-6)


def test_a_limit_of_another_length_needs_no_new_evidence_of_exact_distances():
    scan = Scan([0.15, 0.25], RangeFinder.from_bearings([0.8, 1.1], 5.0))
    poses = [[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]
    model = Nav2FieldProb(CORNER, Nav2Parameters(max_beams=2))
    evidence = model.evidence(scan, poses)
    for limit in (0.12, 0.25, 0.3, 0.35, 0.5):
        parameters = replace(model.parameters, laser_likelihood_max_dist=limit)
        anew = Nav2FieldProb(CORNER, parameters, distance="brushfire").log_likelihood(scan, poses)
        assert model.log_weights(evidence, parameters) == pytest.approx(anew, rel=1e-6)


SKIPPING = Nav2Parameters(max_beams=3, do_beamskip=True, beam_skip_distance=0.15)
CORRIDOR = OccupancyGrid.from_ros([[0] * 11 + [100]], 0.1)


def test_no_beam_is_skipped_before_the_filter_has_converged():
    scan = Scan([1.1, 0.5, 5.0], RangeFinder.from_bearings([0.0, 0.0, np.pi], 8.0))
    poses = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]
    plain = Nav2FieldProb(CORRIDOR, replace(SKIPPING, do_beamskip=False))
    spread_out = Nav2FieldProb(CORRIDOR, SKIPPING, converged=False)
    assert (spread_out.log_likelihood(scan, poses) == plain.log_likelihood(scan, poses)).all()
    assert spread_out.takes_poses_alone()
    assert (Nav2FieldProb(CORRIDOR, SKIPPING).log_likelihood(scan, poses) > plain.log_likelihood(scan, poses)).all()


@pytest.mark.parametrize("ranges", [[5.0, 5.0], [5.0, np.nan, 5.0], [5.0, np.inf, 5.0]])
def test_where_all_beams_count_after_all_a_place_without_reading_makes_all_weights_0(ranges):
    """All end points are off the map, so that all beams would be skipped; three places are multiplied."""
    finder = RangeFinder.from_bearings(np.full(len(ranges), np.pi), 8.0)
    model = Nav2FieldProb(CORRIDOR, SKIPPING)
    assert model.log_likelihood(Scan(ranges, finder), [[0.0, 0.0, 0.0]] * 2).tolist() == [-np.inf] * 2
    full = Scan(np.full(len(ranges), 5.0), finder)
    if len(ranges) == SKIPPING.max_beams:
        assert np.isfinite(model.log_likelihood(full, [[0.0, 0.0, 0.0]] * 2)).all()


def test_whether_a_beam_agrees_is_compared_in_double_precision():
    """A cell holds 0.7 m in single precision, a little less; cut off there, the beam agrees within 0.7 m."""
    assert float(np.float32(0.7)) < 0.7
    scan = Scan([0.3, 0.3, 0.3], RangeFinder.from_bearings([0.0, 0.0, 0.0], 8.0))
    parameters = replace(SKIPPING, laser_likelihood_max_dist=0.7, beam_skip_distance=0.7, beam_skip_error_threshold=1.1)
    poses = [[0.0, 0.0, 0.0]]
    agreeing = Nav2FieldProb(CORRIDOR, parameters)
    assert agreeing.log_likelihood(scan, poses) == pytest.approx(3.0 * np.log(0.5 * np.exp(-6.125) + 0.5 / 8.0))
    nearer = Nav2FieldProb(CORRIDOR, replace(parameters, beam_skip_distance=0.69))
    assert nearer.log_likelihood(scan, poses).tolist() == [0.0]
