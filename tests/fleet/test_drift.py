"""Faults over days: planted ones are found with their day and size, and no others."""

from __future__ import annotations

import datetime
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.fleet_beams import FIRST_DAY, memory_catalogue
from benchmarks.fleet_faults import MAX_RANGE, Planted, find, series_of, simulated_fleet
from scipy.stats import ttest_ind

from beamfield.errors import InvalidInputError
from beamfield.fleet.daily import DailySeries, FaultKind, daily_series
from beamfield.fleet.drift import FALSE_ALARMS, find_drift
from beamfield.fleet.engine import Engine
from beamfield.fleet.learning import FleetFit, learn

PLANTED = {
    0: Planted("dirty-lens", 0.5, 5, 3.0),  # about the back, where bearings wrap
    1: Planted("turned-mount", np.radians(2.0), 5),
    2: Planted("range-bias", 0.04, 4),
    3: Planted("wheel-scale", -0.04, 6),
    4: Planted("range-bias", -0.06, 0),
    5: Planted("wheel-scale", 0.06, 0),
}


@pytest.fixture(scope="module")
def fleet():
    return simulated_fleet(np.random.default_rng(6), PLANTED, n_robots=15, n_sites=2, n_days=10, n_scans=30)


@pytest.fixture(scope="module")
def series(fleet):
    return series_of(fleet)


@pytest.fixture(scope="module")
def drifts(series):
    return find_drift(series)


def test_planted_faults_are_found_with_their_day_and_size_and_no_others(drifts):
    for robot, planted in PLANTED.items():
        found = find(drifts, robot, planted)
        assert found is not None, planted
        if planted.day:
            assert found.since == FIRST_DAY + datetime.timedelta(days=planted.day)
        else:
            assert found.since is None
        assert found.low <= found.size <= found.high
        assert found.after - found.before == pytest.approx(found.size)
        assert found.low < planted.size < found.high
    alarms = {(drift.robot, drift.fault) for drift in drifts if drift.alarm}
    assert alarms == {(f"r{robot:02d}", planted.fault) for robot, planted in PLANTED.items()}
    smear = find(drifts, 0, PLANTED[0])
    start, end = np.degrees(smear.bearings)
    assert start < np.degrees(3.0) < end  # past 180
    assert 30.0 <= end - start <= 60.0
    assert smear.cause == "max"


def test_sentences_say_what_since_when_and_how_much(drifts):
    sentences = {robot: find(drifts, robot, planted).sentence for robot, planted in PLANTED.items()}
    assert sentences[0].startswith("r00 (s0): since 2026-03-06, ")
    assert " degrees have no return, before " in sentences[0]
    assert sentences[0].endswith("%: is the lens dirty there?")
    assert "the direction of motion is turned" in sentences[1]
    assert "degrees left (95%: " in sentences[1]
    assert "cm too long (95%: " in sentences[2]
    assert "distances of the odometry are" in sentences[3]
    assert "% too long" in sentences[3]
    assert sentences[4].startswith("r04 (s0): from its first day on, ranges are")
    assert "cm too short" in sentences[4]
    assert sentences[5].endswith("against the other robots.")


def test_daily_numbers_are_those_of_the_beams(fleet, series):
    robot, day = "r03", 2
    (shard,) = [s for s in fleet.all_shards if s.robot == robot and s.day == FIRST_DAY + datetime.timedelta(days=day)]
    beams = shard.columns
    for item in series:
        if item.robot == robot and item.cause == "max" and item.bearings[0] == pytest.approx(np.radians(30.0)):
            inside = (beams["bearing"] > item.bearings[0]) & (beams["bearing"] < item.bearings[1])
            inside &= beams["expected_range"] < np.float32(MAX_RANGE)
            want = np.mean(beams["range"][inside] >= np.float32(MAX_RANGE))
            assert item.values[day] == pytest.approx(want, rel=1e-12)
            # Of independent beams; these come in bursts.
            assert 0.5 < item.standard_errors[day] / np.sqrt(want * (1.0 - want) / inside.sum()) < 8.0
        if item.robot == robot and item.fault == "range-bias":
            residual = beams["range"] - beams["expected_range"]
            hits = np.abs(residual) < 0.2
            assert item.values[day] == pytest.approx(np.median(residual[hits]), abs=0.002)
            assert 0.2 < item.standard_errors[day] / (0.02 * 1.25 / np.sqrt(hits.sum())) < 5.0


def plain(x: np.ndarray, robot: str = "r", fault: FaultKind = "range-bias", error: float = 1e-9) -> DailySeries:
    days = tuple(FIRST_DAY + datetime.timedelta(days=k) for k in range(len(x)))
    errors = np.full(len(x), error)
    return DailySeries(robot, "s", fault, "m", days, x, errors, x, errors)


def test_a_change_of_one_robot_is_the_largest_t_test_with_bonferroni():
    x = np.random.default_rng(0).normal(size=12)
    x[7:] += 2.0
    (row,) = find_drift([plain(x)])
    tests = {day: ttest_ind(x[day:], x[:day]) for day in range(2, 11)}
    day = min(tests, key=lambda day: tests[day].pvalue)
    interval = tests[day].confidence_interval()
    assert row.since == FIRST_DAY + datetime.timedelta(days=day)
    assert row.p_value == pytest.approx(9 * tests[day].pvalue)
    assert (row.low, row.high) == pytest.approx(tuple(interval))
    # What a day's beams leave open is noise, however alike the days are.
    (blurred,) = find_drift([plain(x, error=5.0)])
    assert blurred.p_value == 1.0
    assert find_drift([plain(x[:3])]) == ()
    assert find_drift([]) == ()


def test_false_alarms_stay_below_the_bound():
    """Without any fault; robots differ in level and in noise."""
    rng = np.random.default_rng(1)
    faults: tuple[FaultKind, ...] = ("turned-mount", "range-bias", "wheel-scale")
    reports = 40
    alarms, p_values = 0, []
    for _ in range(reports):
        fleet = [
            plain(rng.normal() + np.exp(0.3 * rng.normal()) * rng.normal(size=14), f"r{robot}", fault)
            for fault in faults
            for robot in range(12)
        ]
        drifts = find_drift(fleet)
        # Ten times the bound, so that 40 reports tell.
        alarms += sum(drift.p_value * len(drifts) <= 10.0 * FALSE_ALARMS for drift in drifts)
        assert all(drift.alarm == (drift.p_value * len(drifts) <= FALSE_ALARMS) for drift in drifts)
        p_values += [drift.p_value for drift in drifts if drift.since is not None]
    assert alarms <= 32  # 20 are expected at most
    assert 0.002 < np.mean(np.array(p_values) < 0.02) < 0.02


def test_a_map_that_is_off_is_no_fault_of_a_few_robots_at_its_site():
    """Maps are off by centimetres, robots differ by millimetres."""
    rng = np.random.default_rng(2)
    for sizes in ([4, 4], [8, 1]):
        site = np.repeat([0, 1], sizes)
        levels = 0.05 * site + 0.003 * rng.normal(size=len(site))
        fleet = [
            replace(plain(level + 0.001 * rng.normal(size=3), f"r{robot}"), site=f"s{site[robot]}")
            for robot, level in enumerate(levels)
        ]
        drifts = find_drift(fleet)
        assert not any(drift.alarm for drift in drifts)
        # Whether a lone robot or its map is off nobody knows.
        assert {drift.robot for drift in drifts} == {f"r{k}" for k in range(8)}


def test_robots_that_did_little_on_a_day_or_see_little_are_left_out(fleet):
    shards = [s for s in fleet.all_shards if s.robot == "r07"]
    short = {name: column[:400] for name, column in shards[3].columns.items()}
    shards[3] = replace(shards[3], columns=short)
    front = {name: column[np.abs(shards[0].columns["bearing"]) < 1.0] for name, column in shards[0].columns.items()}
    shards.append(replace(shards[0], columns=front, robot="narrow", run="narrow-0"))
    catalogue = memory_catalogue(shards, max_range=MAX_RANGE)
    found = series_of(catalogue)
    days = {item.days for item in found if item.robot == "r07"}
    assert days == {tuple(shard.day for k, shard in enumerate(shards[:10]) if k != 3)}
    sectors = {item.bearings for item in found if item.robot == "narrow" and item.cause == "max"}
    assert sectors
    assert all(-1.1 < low < high < 1.1 for low, high in sectors)
    with Engine("serial") as engine:
        by_robot = learn(catalogue, engine, by="robot", thin=5)
        for wrong in (by_robot, FleetFit("fleet", ())):
            with pytest.raises(InvalidInputError, match="fleet: expected a fit by fleet"):
                daily_series(catalogue, engine, wrong)
