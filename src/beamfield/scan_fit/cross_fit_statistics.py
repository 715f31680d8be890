"""How well the scans of a log without a map fit: each in the map that the other half of the scans drew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields

import numpy as np

from beamfield.arguments import require
from beamfield.calibration.cross_fit import CrossFitMaps
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.scan_fit.statistics import FitModel, FitStatistics, fit_statistics
from beamfield.sensors import SensorLog


def cross_fit_statistics(
    model_on: Callable[[OccupancyGrid], FitModel], maps: CrossFitMaps, log: SensorLog
) -> FitStatistics:
    """Return how badly each scan fits the map of the other half, at its reference pose, in the order of the log.

    A scan fits a map that it helped to draw whatever happens. In the other half's map it disagrees where its pose does
    not go with those of the scans around it, or where a place is seen again and again; an error of the poses that both
    halves share at a place that is seen once stays hidden.

    The maps are what `build_cross_fit_maps` made of the log; `model_on` makes the model on one of them.
    InvalidInputError if they are of a log with another number of scans, or as for `fit_statistics`.
    """
    require(len(maps.half) == len(log), "log", f"the {len(maps.half)} scans that the maps were built from", len(log))
    scans = [np.flatnonzero(maps.half == half) for half in (0, 1)]
    parts = [
        fit_statistics(model_on(maps.halves[1 - half]), log.ranges[mine], log.finder, log.poses[mine])
        for half, mine in enumerate(scans)
    ]
    order = np.argsort(np.concatenate(scans), kind="stable")
    columns = ([getattr(part, item.name) for part in parts] for item in fields(FitStatistics))
    return FitStatistics(*(np.concatenate(column)[order] for column in columns))
