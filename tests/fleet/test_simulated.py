"""A simulated fleet: each fault shows in the drives since its day, and files say what is true."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.fleet.engine import Engine
from beamfield.fleet.manifest import read_manifest
from beamfield.fleet.simulated import FAULT_KINDS, FleetSize, nominal_finder, plan_fleet, simulate_drive, site_map
from beamfield.fleet.simulated_files import write_fleet, write_raw_carmen
from beamfield.geometry import between
from beamfield.io.read_log import read_log
from beamfield.maps.raycast import RayCaster

SIZE = FleetSize(robots=8, sites=1, days=3, duration=30.0, scan_rate=2.0, beams=45, width=26.0, height=20.0)


def measured(plan, number, day, *, turned=0.0):
    """Return the residual of each reading at the true pose, and the drive."""
    log, poses = simulate_drive(plan, number, day)
    sensor = log.only_sensor()
    assert not sensor.has_poses
    finder = nominal_finder(plan.size)
    finder = replace(finder, mounts=finder.mounts + np.array([0.0, 0.0, turned]))
    return sensor.ranges - RayCaster(site_map(plan.size, plan.sites[0])).expected_ranges(poses, finder), sensor, poses


def steps(poses):
    return np.hypot(*between(poses[:-1], poses[1:])[:, :2].T)


@pytest.mark.parametrize("kind", FAULT_KINDS)
def test_a_fault_shows_from_its_day_on(kind):
    plan = plan_fleet(SIZE)
    # The site does not change, so that readings can be compared with its map.
    plan = replace(plan, sites=(replace(plan.sites[0], changed_since=None),))
    number, fault = next((i, one.fault) for i, one in enumerate(plan.robots) if one.fault and one.fault.kind == kind)
    assert 0 < fault.since < SIZE.days
    (before, *_), (after, sensor, poses) = (measured(plan, number, day) for day in (fault.since - 1, fault.since))
    if kind == "range-bias":
        assert np.median(after) - np.median(before) == pytest.approx(fault.size, abs=0.01)
    elif kind == "wheel-scale":
        scale = steps(sensor.odometry).sum() / steps(poses).sum() - 1.0
        assert scale == pytest.approx(fault.size, abs=0.01)
    elif kind == "turned-mount":
        straight, _, _ = measured(plan, number, fault.since, turned=fault.size)
        assert np.quantile(np.abs(straight), 0.6) < 0.5 * np.quantile(np.abs(after), 0.6)
    else:
        robots = [replace(robot, fault=None) for robot in plan.robots]
        clean = measured(replace(plan, robots=tuple(robots)), number, fault.since)[1].ranges
        dirty = (sensor.finder.bearings >= fault.sector[0]) & (sensor.finder.bearings <= fault.sector[1])
        np.testing.assert_array_equal(sensor.ranges[:, ~dirty], clean[:, ~dirty])
        assert (np.isinf(sensor.ranges) & ~np.isinf(clean))[:, dirty].mean() == pytest.approx(fault.size, abs=0.06)
        assert (sensor.ranges < clean)[:, dirty].mean() == pytest.approx(fault.size, abs=0.06)


def test_files_are_a_fleet_that_can_be_scanned(tmp_path, monkeypatch):
    monkeypatch.setattr("beamfield.fleet.simulated_files.LOGS_WITH_A_CUT", 4)
    plan = plan_fleet(replace(SIZE, robots=2, sites=2, days=2, duration=3.0), seed=3)
    with Engine("serial") as engine:
        truth = write_fleet(tmp_path, plan, engine)
    assert json.loads((tmp_path / "truth.json").read_text()) == truth
    rows = read_manifest(tmp_path / "manifest.yaml")
    assert len(rows) == 4
    assert {row.site for row in rows} == {"site-1", "site-2"}
    assert [one["changed_since"] for one in truth["sites"]] == [None, plan.size.date(1).isoformat()]
    assert rows[0].log == truth["cut_off"]
    with pytest.raises(FormatError):
        read_log(tmp_path / rows[0].log)
    row = rows[-1]
    read = read_log(row.resolve(row.log)).only_sensor()
    assert not read.has_poses
    sensor = simulate_drive(plan, 1, 1)[0].only_sensor()
    np.testing.assert_allclose(read.odometry, sensor.odometry, atol=1e-6)
    np.testing.assert_allclose(read.finder.mounts, sensor.finder.mounts, atol=1e-9)
    np.testing.assert_allclose(np.minimum(read.ranges, 12.0), np.minimum(sensor.ranges, 12.0), atol=1e-9)
    write_raw_carmen(tmp_path / "again.log.gz", sensor)
    assert (tmp_path / "again.log.gz").read_bytes() == (tmp_path / row.log).read_bytes()
