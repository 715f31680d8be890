"""Maps, map matching and global search on the public logs with corrected poses."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from beamfield.geometry import wrap_angle
from beamfield.io.read_log import read_log
from beamfield.localization.global_search import GlobalSearch, SearchWindow
from beamfield.maps.mapping import build_map, local_map, share_of_hits_in_obstacles
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.cell_difference import CellDifferenceModel
from beamfield.models.histogram_matching import HistogramMatchingModel
from beamfield.models.map_matching import MapMatchingModel
from beamfield.sensors import SensorLog

# Least share of hits within one cell of an occupied one; resolution in metres. A hall with people, glass and far walls
# (acapulco) and the outdoor campus are less sharp than offices.
LOGS = {
    "acapulco": (0.70, 0.05),
    "csail": (0.93, 0.05),
    "freiburg-campus": (0.75, 0.1),
    "intel": (0.94, 0.05),
}
OFFICES = ("freiburg-079", "intel")


@cache
def read(data: Path, name: str) -> SensorLog:
    """Return about 500 scans of a log."""
    sensor = read_log(data / "carmen_radish_corrected" / f"{name}-corrected.log.gz").only_sensor()
    return sensor.select(np.arange(0, len(sensor), max(1, len(sensor) // 500)))


@cache
def map_of_every_other_scan(data: Path, name: str) -> OccupancyGrid:
    log = read(data, name)
    return build_map(log, scans=np.arange(0, len(log), 2))


@pytest.mark.real
@pytest.mark.parametrize("name", LOGS)
def test_maps_are_sharp_and_would_not_be_with_poses_ten_centimetres_off(data, name, rng):
    least, resolution = LOGS[name]
    log = read(data, name)
    share = share_of_hits_in_obstacles(build_map(log, resolution=resolution), log)
    assert share > least
    off = log.with_poses(log.poses + rng.normal(0.0, [0.1, 0.1, 0.02], log.poses.shape))
    assert share_of_hits_in_obstacles(build_map(off, resolution=resolution), off) < 0.75 * share


@pytest.mark.real
def test_scans_that_drew_no_map_are_found_in_it(data, rng):
    log = read(data, "intel")
    search = GlobalSearch(map_of_every_other_scan(data, "intel"))
    found = 0
    for i in np.linspace(1, len(log) - 1, 12).astype(int) // 2 * 2 - 1:
        window = SearchWindow(log.poses[i] + rng.uniform(-8.0, 8.0, 3))
        error = search.search(log.scan(i), window).best.pose - log.poses[i]
        found += bool(np.hypot(error[0], error[1]) < 0.2 and abs(wrap_angle(error[2])) < 0.05)
    assert found >= 11


@pytest.mark.real
@pytest.mark.parametrize("name", OFFICES)
@pytest.mark.parametrize("model", [MapMatchingModel, CellDifferenceModel, HistogramMatchingModel])
def test_map_matching_prefers_the_reference_pose(data, name, model, rng):
    """Among 300 poses within a metre and half a radian, for scans and for local maps of scans that drew no map."""
    log = read(data, name)
    matching = model(map_of_every_other_scan(data, name))
    others = log.select(np.arange(1, len(log), 2))
    errors = []
    for i in np.linspace(5, len(others) - 1, 10).astype(int):
        poses = others.poses[i] + rng.uniform([-1.0, -1.0, -0.5], [1.0, 1.0, 0.5], (300, 3))
        poses[0] = others.poses[i]
        for z in (others.scan(i), local_map(others, i, n=3)):
            best = poses[matching.log_likelihood(z, poses).argmax()]
            errors.append(np.hypot(*(best - poses[0])[:2]))
    assert np.median(errors) == 0.0
