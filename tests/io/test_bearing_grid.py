"""Lidars whose number of beams, or first bearing, changes from scan to scan: nothing is refused, nothing made up."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.io.bags.bearing_grid import ScanGeometry, nearest_beams, usual_geometry
from beamfield.io.bags.reader import read_bag
from tests.io.mini_bag import MiniBag

NAN = np.nan


def read(bag, folder):
    log = read_bag(bag.write(folder), mount=(0.0, 0.0, 0.0))
    note = [note for note in log.notes if "other bearings" in note]
    return log.only_sensor(), note


def test_the_median_number_of_beams_counts_not_that_of_the_first_scan(tmp_path):
    # A part of a turn while the motor spins up, then three whole ones.
    bag = MiniBag().scan(1.0, [7.0, 8.0], angle_min=0.0, increment=0.5)
    for time in (2.0, 3.0, 4.0):
        bag.scan(time, [1.0, 2.0, 3.0, 4.0], angle_min=-0.5, increment=0.5)
    sensor, (note,) = read(bag, tmp_path)
    assert np.allclose(sensor.finder.bearings, [-0.5, 0.0, 0.5, 1.0])
    assert np.array_equal(sensor.ranges, [[NAN, 7.0, 8.0, NAN], *[[1.0, 2.0, 3.0, 4.0]] * 3], equal_nan=True)
    assert note == (
        "/scan: 1 of 4 scans have other bearings (2 beams) than usual (4 beams from -28.6 degrees, every 28.648); "
        "their readings are taken at the nearest of those, at most 0.00 degrees away; 0.0% of them are dropped, and "
        "50.0% of the bearings have none (NaN)"
    )


def test_readings_are_neither_interpolated_nor_used_twice(tmp_path):
    turn = 2.0 * np.pi
    rng = np.random.default_rng(3)
    bag, sent = MiniBag(), []
    for time, k in enumerate((360, 360, 351, 367, 360)):
        sent.append(rng.uniform(1.0, 9.0, k).astype(np.float32))
        bag.scan(1.0 + time, sent[-1], angle_min=-np.pi, increment=turn / k)
    sensor, (note,) = read(bag, tmp_path)
    for z, published in zip(sensor.ranges, sent, strict=True):
        kept = z[np.isfinite(z)].astype(np.float32)
        assert len(np.unique(kept)) == len(kept)
        assert np.isin(kept, published).all()
        # Each comes from where it was measured, to half a step of the grid.
        beam = np.array([int(np.flatnonzero(published == one)[0]) for one in kept])
        away = -np.pi + turn / len(published) * beam - sensor.finder.bearings[np.isfinite(z)]
        assert np.abs(np.angle(np.exp(1j * away))).max() <= 0.5 * turn / 360 + 1e-6
    assert (np.isfinite(sensor.ranges).sum(axis=1) >= [360, 360, 350, 359, 360]).all()
    assert "2 of 5 scans have other bearings (351 to 367 beams) than usual (360 beams" in note
    assert "at most 0.49 degrees away" in note


def test_of_two_beams_at_one_bearing_the_nearer_one_counts():
    found = nearest_beams(ScanGeometry(-0.04, 0.05, 3), ScanGeometry(-0.1, 0.1, 3))
    # Beams at -0.04, 0.01 and 0.06; bearings at -0.1, 0 and 0.1.
    assert found.grid.tolist() == [1, 2]
    assert found.beams.tolist() == [1, 2]
    assert found.moved == pytest.approx(0.04)


@pytest.mark.parametrize("change", [{"angle_min": -0.2}, {"increment": 0.3}])
def test_angles_that_change_are_followed(change, tmp_path):
    bag = MiniBag()
    for time in (1.0, 2.0):
        bag.scan(time)
    sensor, (note,) = read(bag.scan(3.0, **change), tmp_path)
    assert np.allclose(sensor.finder.bearings, [-0.25, 0.0, 0.25])
    assert sensor.ranges[2].tolist() == [1.0, 2.0, 3.0]
    assert "1 of 3 scans" in note


def test_a_turn_counted_from_0_goes_with_one_counted_from_minus_180_degrees(tmp_path):
    step, values = np.pi / 4, np.arange(1.0, 9.0)
    bag = MiniBag()
    for time in (1.0, 2.0):
        bag.scan(time, values, angle_min=-np.pi, increment=step)
    sensor, _ = read(bag.scan(3.0, values, angle_min=0.0, increment=step), tmp_path)
    assert sensor.ranges[2].tolist() == [5.0, 6.0, 7.0, 8.0, 1.0, 2.0, 3.0, 4.0]


def test_a_full_turn_keeps_both_of_its_ends():
    turn = ScanGeometry(-np.pi, np.pi / 180.0, 361)
    late = ScanGeometry(-np.pi + 0.004, np.pi / 180.0, 361)
    assert nearest_beams(late, turn).grid.tolist() == list(range(361))


def test_what_differs_by_rounding_is_the_same_beam_and_no_note_is_made(tmp_path):
    bag = MiniBag().scan(1.0).scan(2.0, angle_min=-0.2501)
    sensor, note = read(bag, tmp_path)
    assert sensor.ranges.tolist() == [[1.0, 2.0, 3.0]] * 2
    assert note == []


def test_single_beams_and_absurd_steps_are_no_trouble():
    one = ScanGeometry(0.0, 0.0, 1)
    assert nearest_beams(ScanGeometry(0.0, 0.1, 3), one).beams.tolist() == [0]
    assert len(nearest_beams(ScanGeometry(1.0, 0.1, 3), ScanGeometry(0.0, 1e-45, 3)).grid) == 0


def test_a_few_huge_scans_do_not_make_all_others_huge():
    huge = [ScanGeometry(-3.0, 6e-6, 1_000_000)] * 2
    assert usual_geometry([*huge, *(ScanGeometry(-3.0, 0.5, n) for n in range(3, 12))]).n_beams == 8
