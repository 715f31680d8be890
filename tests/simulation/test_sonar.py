"""Rings of sonars: where they look, and which walls they hear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.io.logs.carmen import read_carmen, write_carmen
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.simulation.sonar import heard_ranges, sonar_ring

TRUTH = BeamParameters(z_hit=0.8, z_short=0.05, z_max=0.05, z_rand=0.1, sigma_hit=0.05, lambda_short=0.5)
OPENING = np.radians(30.0)


def slanted_wall(normal_deg: float) -> OccupancyGrid:
    """Return cells of 1 cm beyond a line 1 m from the middle of the map, whose normal has that direction."""
    x, y = np.meshgrid(np.arange(-2.0, 2.0, 0.01) + 0.005, np.arange(-2.0, 2.0, 0.01) + 0.005)
    angle = np.radians(normal_deg)
    return OccupancyGrid((x * np.cos(angle) + y * np.sin(angle) > 1.0).astype(np.float64), 0.01, (-2.0, -2.0, 0.0))


def heard(grid: OccupancyGrid, axis_deg: float, roughness: float = 0.0, n: int = 1) -> np.ndarray:
    finder = RangeFinder.from_bearings([np.radians(axis_deg)], 3.0, opening_angle=OPENING)
    rng = np.random.default_rng(4)
    return heard_ranges(ConeCaster(grid), np.zeros((n, 3)), finder, roughness, rng)[:, 0]


@pytest.mark.parametrize("normal_deg", [0.0, 20.0, 45.0, -70.0])
@pytest.mark.parametrize("off_axis_deg", [-35.0, -28.0, -12.0, 0.0, 12.0, 28.0, 35.0])
def test_a_smooth_wall_is_heard_only_where_its_normal_lies_in_the_cone(normal_deg, off_axis_deg):
    """Half the opening angle is 15 degrees; staircases of cells leave the normal open by some degrees."""
    z = heard(slanted_wall(normal_deg), normal_deg + off_axis_deg)[0]
    assert z == (pytest.approx(1.0, abs=0.015) if abs(off_axis_deg) < 15.0 else 3.0)


def test_the_share_of_scattered_pulses_comes_back_from_walls_that_are_not_faced():
    z = heard(slanted_wall(0.0), 30.0, roughness=0.3, n=4000)
    assert (z < 3.0).mean() == pytest.approx(0.3, abs=4.0 * np.sqrt(0.21 / 4000))
    np.testing.assert_allclose(z[z < 3.0], 1.0 / np.cos(np.radians(15.0)), atol=0.015)


def test_a_post_is_heard_anywhere_in_the_cone():
    cells = np.zeros((400, 400))
    cells[200, 300] = 1.0
    assert heard(OccupancyGrid(cells, 0.01, (-2.0, -2.0, 0.0)), 10.0)[0] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("n", [8, 16, 24])
def test_a_ring_looks_outwards_from_the_rim_and_survives_a_log(tmp_path, n):
    ring = sonar_ring(n, radius=0.21, opening_angle=0.4)
    ring = replace(ring, mounts=compose([0.0, 0.0, 0.1], ring.mounts))
    np.testing.assert_allclose(np.hypot(*ring.mounts[:, :2].T), 0.21)
    np.testing.assert_allclose(
        np.exp(1j * np.arctan2(ring.mounts[:, 1], ring.mounts[:, 0])), np.exp(1j * ring.bearings)
    )
    log = simulate_log(draw_floor_plan(), ring, TRUTH, duration=5.0, scan_rate=4.0, seed=2, roughness=0.3)
    write_carmen(tmp_path / "ring.log", log)
    read, written = read_carmen(tmp_path / "ring.log").only_sensor(), log.only_sensor()
    np.testing.assert_allclose(read.finder.mounts, ring.mounts, atol=1e-9)
    assert read.finder.opening_angle == ring.opening_angle
    assert read.finder.max_range == ring.max_range
    measured = np.isfinite(written.ranges)
    np.testing.assert_array_equal(np.isposinf(read.ranges), np.isposinf(written.ranges))
    np.testing.assert_allclose(read.ranges[measured], written.ranges[measured], atol=1e-6)
    np.testing.assert_allclose(read.poses, written.poses, atol=1e-8)


def test_impossible_rings_and_shares_are_refused():
    with pytest.raises(InvalidInputError, match="n_sensors: expected 1 to 360, got 0"):
        sonar_ring(0)
    with pytest.raises(InvalidInputError, match=r"radius: expected a finite number of metres >= 0, got -0.1"):
        sonar_ring(8, radius=-0.1)
    with pytest.raises(InvalidInputError, match=r"roughness: expected a share in \[0, 1\], got 1.5"):
        heard(slanted_wall(0.0), 0.0, roughness=1.5)
