"""Benchmarks whose maps no scan helped to draw: `benchmarks/half_maps.py`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.registry import STACKS


@pytest.mark.parametrize("shared_tables", [False, True], ids=["filter", "filter_with"])
def test_each_scan_is_weighed_by_the_map_that_it_has_no_part_in(shared_tables, monkeypatch, drive, office):
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "benchmarks")
    from half_maps import HalfMaps, HalfMapSettings

    nav2, model, log = STACKS["nav2"], "likelihood_field", drive[:2]
    plain = FilterSettings("nav2", model, nav2.start(model), nav2.filter.motion(), nav2.filter.parameters())
    elsewhere = replace(office, origin=office.origin + np.array([3.0, 0.0, 0.0]))
    settings = HalfMapSettings.of(plain, HalfMaps(log, np.array([0, 1]), (elsewhere, office)))
    made = settings.filter_with(settings.emulator(office)) if shared_tables else settings.filter(office)
    poses = log.poses[:1] + np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]])
    for scan, grid in zip(log, (office, elsewhere), strict=True):
        np.testing.assert_array_equal(made._weights_of(scan, poses), plain.filter(grid)._weights_of(scan, poses))
