"""A room of 24 x 18 cells, four poses and a scan; the tests beside this hold what programs return for it."""

from __future__ import annotations

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan

MAX_RANGE = 2.0
WEIGHTS = {"z_hit": 0.6, "z_short": 0.15, "z_max": 0.05, "z_rand": 0.2, "sigma_hit": 0.08, "lambda_short": 1.2}
# What all stacks call alike.
COMMON = WEIGHTS | {"laser_likelihood_max_dist": 0.5, "max_beams": 16}

POSES = np.array([[-0.213, 0.871, 0.137], [1.013, 0.613, -2.93], [-0.437, 1.787, 0.703], [1.463, 1.857, -0.777]])
RANGES = np.float32(
    [0.392036915, 0.458962381, 0.583775878, 0.184512898, 0.462359876, 0.516250610, 0.781804323, 1.398206472,
     0.503233790, 1.821385741, 1.432695270, 1.710000038, 0.739162445, 0.738085985, 0.485122442, 0.422859102]
).astype(np.float64)  # fmt: skip
SPECIAL = {1: 2.0, 4: np.nan, 6: np.inf, 8: 2.5}


def small_room() -> OccupancyGrid:
    cells = np.zeros((18, 24), np.int64)
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    cells[9:12, 23] = 0  # a door
    cells[5:8, 10:13] = 100
    cells[13, 3:9] = 100
    cells[2:5, 18:22] = -1
    cells[15, 20] = 40
    return OccupancyGrid.from_ros(cells, 0.1, [-0.7, 0.3, 0.0])


def small_scan(*, special: bool = False, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Scan:
    finder = RangeFinder.from_bearings(np.arange(16) * np.pi / 8 - np.pi, MAX_RANGE, mount=mount)
    ranges = RANGES.copy()
    if special:
        ranges[list(SPECIAL)] = list(SPECIAL.values())
    return Scan(ranges, finder)
