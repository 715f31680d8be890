"""Benchmarks say when a ratio falls: `benchmarks/history.py`."""

import json

import pytest
from benchmarks.history import HISTORY, N_BEFORE, add_entry, fallen_ratios, read_history, write_history


def entry(commit, machine="zen", **ratios):
    return {"commit": commit, "date": "2026-11-22", "machine": machine, "ratios": ratios}


def test_a_ratio_falls_when_it_is_15_percent_below_the_median_of_its_machine():
    # The median is 10: neither the one slow entry nor another machine's counts.
    before = [entry("a", rays=10.0, field=5.0), entry("b", rays=10.5), entry("c", rays=2.0, field=5.0)]
    others = [entry("d", machine="xeon", rays=30.0)]
    assert fallen_ratios([*before, *others, entry("e", rays=8.6, field=5.0, new=1.0)]) == []
    assert fallen_ratios([*before, *others, entry("e", rays=8.4, field=4.3)]) == [
        "rays: 8.4, 16% less than 10, the median of 3"
    ]
    assert fallen_ratios([*before, entry("e", machine="xeon", rays=1.0)]) == []


def test_only_the_last_entries_count():
    old, recent = [entry(f"old{i}", rays=100.0) for i in range(9)], [entry(f"{i}", rays=10.0) for i in range(N_BEFORE)]
    assert fallen_ratios([*old, *recent, entry("now", rays=9.0)]) == []
    assert len(fallen_ratios([*old, *recent[: N_BEFORE // 2], entry("now", rays=9.0)])) == 1


@pytest.mark.parametrize("entries", [[], [entry("a", rays=1.0)]])
def test_nothing_falls_without_an_earlier_entry(entries):
    assert fallen_ratios(entries) == []


def test_an_entry_replaces_that_of_its_commit_and_machine(tmp_path):
    entries = [entry("a", rays=1.0), entry("a", machine="xeon", rays=2.0)]
    entries = add_entry(entries, entry("a", rays=3.0))
    assert [(e["machine"], e["ratios"]["rays"]) for e in entries] == [("xeon", 2.0), ("zen", 3.0)]
    write_history(entries, tmp_path / "history.json")
    assert read_history(tmp_path / "history.json") == entries
    assert read_history(tmp_path / "none.json") == []


def test_the_kept_history_can_be_read():
    entries = read_history()
    assert HISTORY.exists()
    assert entries
    for e in entries:
        assert set(e) == {"commit", "date", "machine", "ratios"}
        assert all(ratio > 0.0 for ratio in e["ratios"].values())
    assert json.loads(HISTORY.read_text()) == entries
