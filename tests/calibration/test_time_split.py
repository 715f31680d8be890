from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.time_split import held_out_mask, time_blocks
from beamfield.errors import InvalidInputError


def test_a_long_log_has_blocks_of_twenty_seconds():
    stamps = np.arange(0.0, 600.0, 0.1) + 1e9
    blocks = time_blocks(stamps)
    assert blocks[0] == 0
    edges = stamps[np.flatnonzero(np.diff(blocks)) + 1]
    np.testing.assert_allclose(np.diff(edges), 20.0, atol=0.11)


def test_a_short_log_still_has_twelve_blocks():
    assert len(np.unique(time_blocks(np.linspace(0.0, 30.0, 301)))) == 12


def test_the_last_stamp_belongs_to_the_last_block():
    blocks = time_blocks(np.linspace(0.0, 100.0, 101), 20.0)
    assert blocks[-1] == blocks[-2] == 4


def test_stamps_may_come_in_any_order():
    stamps = np.linspace(0.0, 100.0, 101)
    order = np.random.default_rng(0).permutation(101)
    np.testing.assert_array_equal(time_blocks(stamps[order], 10.0), time_blocks(stamps, 10.0)[order])


def test_equal_stamps_make_one_block():
    np.testing.assert_array_equal(time_blocks([5.0, 5.0, 5.0]), 0)


def test_held_out_blocks_are_whole_and_a_third():
    stamps = np.arange(0.0, 600.0, 0.1)
    held = held_out_mask(stamps)
    blocks = time_blocks(stamps)
    for block in np.unique(blocks):
        assert len(np.unique(held[blocks == block])) == 1
    assert held.mean() == pytest.approx(1 / 3, abs=0.02)
    assert not held[0]


def test_no_stamps_make_no_blocks():
    assert len(time_blocks([])) == 0


@pytest.mark.parametrize("stamp", [np.nan, np.inf])
def test_a_stamp_that_is_none_is_refused_by_its_number(stamp):
    with pytest.raises(InvalidInputError, match=r"stamps\[2\]: expected a finite number of seconds, got"):
        time_blocks([0.0, 1.0, stamp, 3.0])


@pytest.mark.parametrize("length", [0.0, -1.0, np.nan])
def test_a_block_without_length_is_refused(length):
    with pytest.raises(InvalidInputError, match="block_s"):
        time_blocks([0.0, 1.0], length)


def test_stamps_that_are_no_seconds_are_refused_as_such():
    nanoseconds = np.arange(3.0) * 5e9
    with pytest.raises(InvalidInputError, match=r"stamps: 1e\+10 s in blocks of 20 s .* expected stamps in seconds$"):
        time_blocks(nanoseconds)
    with pytest.raises(InvalidInputError, match=r"block_s: 1e\+10 s in blocks of 5 s .* seconds, or longer blocks$"):
        time_blocks(nanoseconds, 5.0)
