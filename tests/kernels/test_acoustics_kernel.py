"""Ways of sound: the same both ways, never shorter than to the nearest thing, and unmoved by moving everything."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.geometry import compose, transform_points
from beamfield.kernels.acoustics import CORNER, DIFFUSE, EDGE, MIRROR, N_WAYS, SECOND, Pulse, find_ways
from beamfield.simulation.sonar import sonar_ring
from beamfield.simulation.surfaces import Surfaces

ROOM = np.array([[-3.0, -2.0], [3.5, -2.0], [3.5, 1.2], [1.0, 2.6], [-3.0, 2.6]])
BOX = np.array([[0.8, -0.9], [0.8, 0.1], [1.7, 0.1], [1.7, -0.9]])
PLATE = np.array([[-1.6, 0.6], [-1.0, 1.3], [-0.9, 1.2]])
POSES = np.array([[-1.0, -0.5, 0.3], [2.5, -1.0, 2.0], [0.2, 1.6, -1.1]])
RING = sonar_ring(6, opening_angle=np.radians(80.0))
PULSE = Pulse(np.radians(40.0), 15.0, 81, True)


def ways(moved: tuple[float, float, float] = (0.0, 0.0, 0.0), pulse: Pulse = PULSE) -> np.ndarray:
    """Return (t, from, to, kind) in the room, everything moved by a pose."""
    walls = Surfaces.from_outlines([transform_points(moved, outline) for outline in (ROOM, BOX, PLATE)]).walls()
    sensors = compose(compose(moved, POSES)[:, None], RING.mounts)
    out = np.empty((len(POSES), RING.n_beams, RING.n_beams, N_WAYS))
    find_ways(sensors, walls, pulse, out)
    return out


@pytest.fixture(scope="module")
def found() -> np.ndarray:
    return ways()


def test_sound_goes_the_same_way_back(found):
    for kind in (MIRROR, CORNER, EDGE):
        np.testing.assert_allclose(found[..., kind], np.swapaxes(found[..., kind], 1, 2), rtol=1e-12)
    # Pairs of walls are found by rays, which may miss a narrow one from one side.
    second = found[..., SECOND]
    same = np.isclose(second, np.swapaxes(second, 1, 2), rtol=1e-9) | (
        np.isinf(second) & np.isinf(second.swapaxes(1, 2))
    )
    assert same.mean() > 0.9


def test_every_kind_of_way_is_there(found):
    assert np.isfinite(found).any(axis=(0, 1, 2)).all()
    others = ~np.eye(RING.n_beams, dtype=bool)
    assert np.isfinite(found[:, others]).any(axis=(0, 1)).sum() >= 4


def test_no_echo_is_nearer_than_the_nearest_thing_in_the_cone(found):
    own = found[:, np.arange(RING.n_beams), np.arange(RING.n_beams)]
    assert (own >= own[..., [DIFFUSE]] - 1e-9).all()


def test_moving_everything_changes_nothing(found):
    np.testing.assert_allclose(ways((12.3, -4.5, 0.7)), found, rtol=1e-9)


def test_without_cross_talk_a_sensor_has_the_same_own_ways_and_no_others(found):
    alone = ways(pulse=PULSE._replace(cross_talk=False))
    own = np.arange(RING.n_beams)
    np.testing.assert_array_equal(alone[:, own, own], found[:, own, own])
    assert np.isinf(alone[:, ~np.eye(RING.n_beams, dtype=bool)]).all()


def test_ways_longer_than_the_pulse_lasts_are_not_heard(found):
    faint = ways(pulse=PULSE._replace(longest=4.0))
    np.testing.assert_array_equal(np.isfinite(faint), found <= 4.0)
