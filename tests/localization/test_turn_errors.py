"""By how much turns of the odometry differ from those of a fitted trajectory."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.geometry import between, chained
from beamfield.localization.turn_errors import drift_at_rest, turn_errors, turn_findings, turns_of_scans
from beamfield.sensors import SensorLog
from beamfield.simulation.odometry import OdometryNoise, noisy_odometry

STAMPS = 100.0 + 0.2 * np.arange(600)
NOWHERE = np.zeros(len(STAMPS) - 1, bool)


def drive_of(
    turn_scale: float = 0.0, drift: float = 0.0, noise: float = 0.3, cut=NOWHERE, seed: int = 2, n_slips: int = 0
):
    """Return the errors that are found of odometry along a drive of turns on the spot and straight stretches."""
    steps = np.zeros((len(STAMPS) - 1, 3))
    turning = np.arange(len(steps)) // 15 % 3 == 0
    steps[~turning, 0] = 0.12
    steps[turning, 2] = 0.12 * np.where(np.arange(len(steps)) // 45 % 2, 1.0, -0.6)[turning]
    poses = chained(np.zeros(3), steps)
    wheels = OdometryNoise(0.03 * noise, 0.03 * noise, 0.05 * noise, 0.0, turn_scale)
    odometry = noisy_odometry(poses, np.random.default_rng(seed), wheels)
    said = between(odometry[:-1], odometry[1:])
    said[:, 2] += drift * said[:, 0]
    said[np.random.default_rng(seed).choice(len(said), n_slips, replace=False), 2] += 2.0
    return turn_errors(SimpleNamespace(stamps=STAMPS, steps=np.where(cut[:, None], 3.0, said)), poses, cut)


def test_noise_of_each_step_does_not_bias_the_scale():
    found = [drive_of(turn_scale=-0.03, noise=1.0, seed=seed) for seed in range(20)]
    scales = np.array([one.scale for one in found])
    # By steps of 0.2 s it would come out 0.07 too large.
    assert scales.mean() == pytest.approx(-0.03, abs=0.012)
    assert np.mean([one.scale_error for one in found]) == pytest.approx(scales.std(), rel=0.5)


@pytest.mark.parametrize("scale", [0.08, -0.08])
def test_a_track_width_that_is_wrong_by_eight_percent_is_named(scale: float):
    (finding,) = turn_findings(drive_of(turn_scale=scale))
    assert finding.name == "odometry-turn-scale"
    assert finding.values["scale"] == pytest.approx(scale, abs=0.02)
    assert ("too large" in finding.text) == (scale > 0.0)


def test_a_drift_is_named_with_its_side():
    (finding,) = turn_findings(drive_of(drift=-0.06))
    assert finding.name == "odometry-drift"
    assert finding.values["radians_per_metre"] == pytest.approx(-0.06, abs=0.01)
    assert "to the right by 3." in finding.text


def test_good_odometry_is_not_accused():
    assert not any(list(turn_findings(drive_of(turn_scale=-0.02, seed=seed))) for seed in range(20))


def test_slips_in_a_fifth_of_the_windows_count_little():
    found = [drive_of(n_slips=8, seed=seed) for seed in range(10)]
    assert max(abs(one.scale) for one in found) < 0.025
    assert max(abs(one.drift) for one in found) < 0.015


def test_steps_that_say_nothing_are_left_out():
    cut = NOWHERE.copy()
    cut[[100, 300]] = True
    assert drive_of(turn_scale=0.08, cut=cut).scale == pytest.approx(0.08, abs=0.02)


def test_a_robot_that_hardly_turned_tells_nothing():
    straight = SimpleNamespace(stamps=STAMPS, steps=np.tile([0.1, 0.0, 0.0], (len(NOWHERE), 1)))
    assert turn_errors(straight, chained(np.zeros(3), straight.steps), NOWHERE) is None
    assert list(turn_findings(None)) == []


@pytest.mark.parametrize(
    ("share", "said", "advised"),
    [
        (0.0, "hardly turns", "encoders"),
        (0.5, "turns 0.5 times as far", "encoders"),
        (-1.0, "the other way", "upside down"),
        (1.0, "", ""),
    ],
)
def test_odometry_that_turns_far_too_little_or_too_much_is_named_without_poses(share, said, advised, drive: SensorLog):
    log = drive.select(np.arange(120))
    steps = between(log.odometry[:-1], log.odometry[1:]) * [1.0, 1.0, share]
    found = turns_of_scans(replace(log, odometry=chained(log.odometry[0], steps)))
    assert (said in found.text and advised in found.do) if said else found is None


@pytest.mark.parametrize(
    ("rate", "named"), [(0.02, "by 1.1 degrees a second to the left"), (-0.02, "right"), (0.001, "")]
)
def test_odometry_that_turns_while_the_robot_stands_is_named(rate: float, named: str):
    stands = np.arange(len(NOWHERE)) < 100  # 20 s
    moves = np.where(stands[:, None], 0.0, [0.1, 0.0, 0.05])
    drifts = np.where(stands, 0.2 * rate, 0.0)[:, None] * [0.0, 0.0, 1.0]
    found = list(drift_at_rest(SimpleNamespace(stamps=STAMPS, steps=moves + drifts), chained(np.zeros(3), moves)))
    assert [named in one.text for one in found] == ([True] if named else [])
    assert not list(drift_at_rest(SimpleNamespace(stamps=STAMPS[:2], steps=moves[:1]), np.zeros((2, 3))))
