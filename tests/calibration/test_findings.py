"""What is said of readings that do not count as they should."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import beamfield
from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.evaluation import ModelScore, uniform_parameters
from beamfield.calibration.findings import (
    blind_findings,
    cone_findings,
    left_out_findings,
    noise_findings,
    place_findings,
    score_findings,
    selection_findings,
    table_findings,
)
from beamfield.calibration.selection import REASONS, Selection
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog

FINDER = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0, 10.0)), 8.0)
N_SCANS = 80


def log_and_table(ranges: np.ndarray, expected: float = 3.0) -> tuple[SensorLog, BeamTable]:
    zeros = np.zeros((N_SCANS, 3))
    log = SensorLog(FINDER, 0.1 * np.arange(N_SCANS), ranges, zeros, zeros)
    there = ~np.isnan(ranges)
    scan, beam = np.nonzero(there)
    table = BeamTable(
        ranges[there], np.full(len(scan), expected), scan.astype(np.int32), beam.astype(np.int32), 0.1 * scan, 8.0,
        n_no_measurement=int((~there).sum()),
    )  # fmt: skip
    return log, table


def readings(rng: np.random.Generator) -> np.ndarray:
    """A tenth of the readings is lost anywhere; three beams at -160 to -140 degrees and one at 170 see the robot."""
    ranges = np.where(rng.random((N_SCANS, FINDER.n_beams)) < 0.1, 8.0, 3.0)
    ranges[:, [2, 3, 4, 35]] = 8.0
    return ranges


def test_hits_anywhere_are_no_hits(rng):
    _, table = log_and_table(readings(rng))
    good = BeamParameters(0.9, 0.05, 0.0, 0.05, sigma_hit=0.3, lambda_short=0.5, sigma_slope=0.2)
    assert list(noise_findings(good, table)) == []
    (finding,) = noise_findings(replace(good, sigma_slope=0.4), table)
    assert "by 1.24 m at a range of 3.00 m" in finding.text


def test_beams_that_never_return_are_named_with_the_mask_that_leaves_them_out(rng):
    log, table = log_and_table(readings(rng))
    (finding,) = blind_findings(table, log)
    assert finding.name == "blind-beams"
    assert "at bearings -160.1 to -139.9, 170 degrees" in finding.text
    assert "parts of the robot, or dirt" in finding.text
    assert "(--mask=-160.1:-139.9 --mask=169.9:170.1)" in finding.do
    assert finding.values == {"n_beams": 4.0, "share": pytest.approx(4 / 36)}


def test_nothing_is_blind_that_returns_or_sees_nothing_or_is_masked(rng):
    ranges = readings(rng)
    masked = np.where((ranges == 8.0).all(axis=0), np.nan, ranges)
    assert not list(blind_findings(*reversed(log_and_table(masked))))
    seldom = ranges.copy()
    seldom[::20] = 3.0
    assert not list(blind_findings(*reversed(log_and_table(seldom))))
    assert not list(blind_findings(*reversed(log_and_table(ranges, expected=8.0))))
    assert not list(blind_findings(*reversed(log_and_table(np.full_like(ranges, 8.0)))))


def test_masked_beams_are_not_taken_for_lost_measurements(rng):
    ranges = readings(rng)
    ranges[:, :6] = np.nan
    assert not list(left_out_findings(*reversed(log_and_table(ranges))))
    ranges[::5, 6:] = np.nan
    (finding,) = left_out_findings(*reversed(log_and_table(ranges)))
    assert finding.name == "nan-readings"
    assert finding.values["share"] == pytest.approx(30 / 36 / 5)


@pytest.mark.parametrize(("too_close", "names"), [(85, []), (87, ["too-close-readings"])])  # of 80 x 36
def test_readings_nearer_than_the_least_range_are_named_where_they_are_many(rng, too_close, names):
    ranges = readings(rng)
    ranges[:, :6] = np.nan  # masked: 480
    log, table = log_and_table(ranges)
    table = replace(table, n_no_measurement=480 + too_close, n_too_close=too_close, ranges=table.ranges[too_close:],
                    expected_ranges=table.expected_ranges[too_close:], scan=table.scan[too_close:],
                    beam=table.beam[too_close:], stamps=table.stamps[too_close:])  # fmt: skip
    found = list(left_out_findings(table, log))
    assert [one.name for one in found] == names
    assert all(one.text.startswith("3.0% of the readings are nearer") for one in found)


def test_a_beam_is_blind_by_fifty_readings_and_if_others_return(rng):
    log, table = log_and_table(readings(rng))
    for n, blind in ((49, 0.0), (50, 4.0)):
        found = list(blind_findings(table.select(table.scan < n), log))
        assert sum(one.values["n_beams"] for one in found) == blind
    # Where the map has nothing, a return is none of its obstacles.
    expected = np.where((table.beam == 2) & (table.scan < 25), 8.0, 3.0)
    found = replace(table, expected_ranges=expected, ranges=np.where(expected == 8.0, 3.0, table.ranges))
    (finding,) = blind_findings(found, log)
    assert finding.values == {"n_beams": 4.0, "share": pytest.approx((4 * 80 - 25) / (36 * 80 - 25))}
    # Of a sensor that hardly sees anything no beam is blind.
    seldom = np.where((table.beam % 9 == 0) & (table.ranges < 8.0), 3.0, 8.0)
    assert not list(blind_findings(replace(table, ranges=seldom), log))


@pytest.mark.parametrize(("n_off", "names"), [(10, []), (11, ["poses-off-map"])])
def test_poses_off_the_map_are_named_from_a_tenth_of_all_scans_on(n_off, names):
    reason = np.full(100, REASONS.index("standing still"), np.int8)
    reason[:n_off], reason[-5:] = REASONS.index("off the map"), -1
    found = list(selection_findings(Selection(reason < 0, reason)))
    assert [one.name for one in found] == names
    assert all("11 of 100 reference poses (11%)" in one.text for one in found)


@pytest.mark.parametrize(("driven", "names"), [(1.9, ["one-place"]), (2.1, [])])
def test_scans_from_one_place_are_named(rng, driven, names):
    log, _ = log_and_table(readings(rng))
    used = np.arange(len(log)) < len(log) - 1
    # The last scan, which is not used, is elsewhere.
    poses = np.zeros((len(log), 3))
    poses[:, 0] = np.where(used, np.linspace(0.0, driven, len(log)), 50.0)
    poses[:-1, 0] *= driven / poses[-2, 0]
    found = list(place_findings(replace(log, poses=poses), Selection(used, np.where(used, -1, 0).astype(np.int8))))
    assert [one.name for one in found] == names
    assert [one.values for one in found] == [{"across": pytest.approx(driven)}][: len(names)]


@pytest.mark.parametrize(
    ("behind", "names"),
    [
        ((0.1, 0.51), []),
        ((-0.01, 0.51), ["fit-not-better"]),
        ((0.1, 0.49), ["map-says-nothing"]),
        ((0.1, 0.0), ["fit-not-better", "map-says-nothing"]),
        ((0.1, -np.inf), ["fit-not-better"]),
    ],
)
def test_a_fit_is_judged_by_what_it_gains_over_other_models(behind, names):
    others = zip(("nav2 defaults", "uniform"), behind, strict=True)
    scores = [ModelScore("fit", uniform_parameters(0.1), -1.0, 0.1)]
    scores += [ModelScore(name, uniform_parameters(0.1), -1.0 - by, 0.1, by, 0.01) for name, by in others]
    assert [one.name for one in score_findings(tuple(scores))] == names


def test_cones_are_named_with_their_width():
    log = SensorLog(FINDER, np.zeros(0), np.zeros((0, 36)), np.zeros((0, 3)), np.zeros((0, 3)))
    assert not list(cone_findings(log))
    (finding,) = cone_findings(replace(log, finder=replace(FINDER, opening_angle=np.pi / 6)))
    assert "cones of 30 degrees" in finding.text


@pytest.mark.parametrize(("n_unknown", "text"), [(1120, ""), (1122, "Only 50%"), (3120, "Only 33%")])
def test_a_map_of_which_rays_see_little_is_named(rng, n_unknown, text):
    _, table = log_and_table(readings(rng))  # 2880 readings
    expected = np.where(np.arange(2880) < 880, 8.0, 3.0)
    found = list(table_findings(replace(table, expected_ranges=expected, n_unknown=n_unknown)))
    assert len(found) == bool(text)
    wanted = f"{text} of the readings have an expected range: {n_unknown} rays cross unknown space, 880 hit nothing"
    assert all(one.name == "few-expected-ranges" and one.text.startswith(wanted) for one in found)


def test_sectors_pass_half_a_turn_and_a_few_are_named(rng):
    log, table = log_and_table(readings(rng))
    table = replace(table, ranges=np.where(np.isin(table.beam, [17, 18, 19, 30]), 8.0, 3.0))
    around = replace(log, finder=RangeFinder.from_bearings(np.radians(np.arange(0.0, 360.0, 10.0)), 8.0))
    (finding,) = blind_findings(table, around)
    assert "at bearings 169.9 to -169.9, -60 degrees although" in finding.text
    (finding,) = blind_findings(replace(table, ranges=np.where(table.beam % 5 == 0, 8.0, 3.0)), around)
    assert "at bearings 0, 50, 100, 150, -160 degrees and 3 more sectors although" in finding.text
    assert finding.do.count("--mask=") == 5


def test_every_warning_says_why_it_matters_and_what_to_do():
    """Findings are made by literal calls: those in the source are all that a user can meet."""
    root = Path(beamfield.__file__).parent
    sources = [path for part in ("calibration", "landmark_noise", "scan_fit") for path in (root / part).rglob("*.py")]
    calls = [
        node
        for path in [*sources, root / "report" / "stack_findings.py"]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Finding"
    ]
    severe = [call for call in calls if not isinstance(call.args[1], ast.Constant) or call.args[1].value != "info"]
    assert len(severe) > 25
    for call in severe:
        given = {keyword.arg for keyword in call.keywords}
        assert {"why", "do"} <= given, ast.unparse(call.args[0])
