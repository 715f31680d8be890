"""Which stamps of a text log are used, and what happens where none is usable."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.logs.carmen_writer import write_carmen
from beamfield.io.logs.scan_stamps import resolve_stamps
from beamfield.io.read_log import read_log
from beamfield.sensors import ScanLog, SensorLog


def resolve(columns, rule="file"):
    table = np.column_stack(columns)
    return resolve_stamps("run.log", "FLASER", list(range(10, 10 + len(table))), table, rule)


def test_good_stamps_pass_unchanged_and_without_a_note():
    times = np.cumsum(np.full(50, 0.2))
    found = resolve([times, times + 5.0])
    np.testing.assert_array_equal(found.seconds, times)
    assert (found.column, found.notes) == (0, ())


def test_lost_stamps_are_replaced_by_the_second_clock():
    clock = np.linspace(0.0, 60.0, 100)
    found = resolve([np.full(100, 1.13486e9), clock])
    np.testing.assert_array_equal(found.seconds, clock)
    assert found.column == 1
    assert "column 2" in found.notes[0]


def test_scans_are_numbered_where_all_stamps_are_lost():
    found = resolve([np.r_[np.zeros(3), np.full(97, 4.29e9)]] * 2)
    np.testing.assert_array_equal(found.seconds, np.arange(100))
    assert found.column is None
    assert "the stamps are lost (2 different values in 100 scans)" in found.notes[0]


def test_scans_that_come_twice_keep_their_stamps(tmp_path: Path, drive: SensorLog):
    twice = drive[np.repeat(np.arange(20), 2)]
    write_carmen(tmp_path / "twice.log", ScanLog({"laser": twice}))
    found = read_log(tmp_path / "twice.log")
    np.testing.assert_allclose(found.only_sensor().stamps, twice.stamps, atol=1e-6)
    assert any("20 of 40 scans repeat the one before" in note for note in found.notes)


def test_stamps_that_are_no_numbers_are_lost_and_a_single_one_is_named():
    assert resolve([[0.0, np.nan, np.inf, np.nan]]).column is None
    with pytest.raises(FormatError, match=r"run\.log:11: FLASER: expected a stamp in seconds, got nan"):
        resolve([[0.0, np.nan, 2.0]])
    assert resolve([[0.0, np.nan, 2.0], [5.0, 6.0, 7.0]]).column == 1


def test_a_run_that_is_joined_to_itself_has_not_lost_its_stamps():
    with pytest.raises(FormatError, match=r"run\.log:60: .* 0\.0.* after 49\.0"):
        resolve([np.tile(np.arange(50.0), 2)])


def test_stamps_in_another_unit_are_noted():
    (note,) = resolve([np.arange(10) * 2e8]).notes
    assert "scans are 2e+08 s apart: are the stamps in milliseconds or nanoseconds?" in note
    assert len(resolve([np.arange(10) * 61.0]).notes) == 1
    assert resolve([np.arange(10) * 59.0]).notes == ()


def test_few_short_steps_back_are_raised_with_a_note():
    times = np.arange(200.0)
    times[[50, 51]] = times[[51, 50]]
    times[51] = 50.5
    found = resolve([times])
    assert (np.diff(found.seconds) >= 0.0).all()
    changed = np.flatnonzero(found.seconds != times)
    assert changed.tolist() == [51]
    assert "1 of 200 stamps go backwards, by up to 0.5 s" in found.notes[0]


def test_a_step_back_of_more_than_a_second_is_no_difference_of_clocks():
    times = 2.0 * np.arange(200.0)
    times[51] = times[50] - 0.99
    assert resolve([times]).seconds[51] == times[50]
    times[51] = times[50] - 1.01
    with pytest.raises(FormatError, match="run backwards"):
        resolve([times])


def test_stamps_that_run_backwards_name_line_and_values():
    times = np.arange(100.0)
    times[60:] -= 30.0
    with pytest.raises(FormatError, match=r"run\.log:70: FLASER: the stamps run backwards: 30\.0.* after 59\.0"):
        resolve([times])


def test_many_steps_back_are_an_error():
    times = np.arange(100.0)
    times[1::10] -= 1.5
    times[2::10] -= 0.9
    with pytest.raises(FormatError, match="run backwards"):
        resolve([times])


def test_the_order_of_the_file_can_be_asked_for():
    found = resolve([np.arange(10.0)[::-1]], "order")
    np.testing.assert_array_equal(found.seconds, np.arange(10))
    assert found.notes


def test_an_unknown_rule_is_refused():
    with pytest.raises(InvalidInputError, match="expected 'file' or 'order'"):
        resolve([np.arange(3.0)], "sort")
