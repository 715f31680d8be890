from __future__ import annotations

import numpy as np
import pytest

from beamfield.maps.occupancy import OccupancyGrid


@pytest.fixture(scope="module")
def room() -> OccupancyGrid:
    """40 x 60 cells of 10 cm, walls around, a few boxes, some of it unknown, turned and shifted."""
    data = np.zeros((40, 60))
    data[[0, -1]] = data[:, [0, -1]] = 100
    data[10:14, 20:22] = data[25:27, 40:45] = 100
    data[30:, :12] = -1
    return OccupancyGrid.from_ros(data, 0.1, (-1.3, 2.2, 0.6))
