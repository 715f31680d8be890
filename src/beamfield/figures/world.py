"""What the chapter's figures are drawn from: a map, logs of one or more sensors, and a scan among them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.figures.obstacle_scene import ObstacleScene, scene_of_scan, three_obstacles
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, Scan, ScanLog, SensorLog, usable_ranges
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log

# Of the simulated sensors. The sonar's are those of a poor sensor in a reflecting corridor.
LASER = BeamParameters(z_hit=0.9, z_short=0.06, z_max=0.02, z_rand=0.02, sigma_hit=0.05, lambda_short=0.5)
SONAR = BeamParameters(z_hit=0.62, z_short=0.16, z_max=0.13, z_rand=0.09, sigma_hit=0.14, lambda_short=0.45)
DURATION, SCAN_RATE = 240.0, 5.0
# Scans with far and near readings, so far apart in metres, of which Figure 6.7 shows one.
N_FAR, FAR_APART = 4, 1.5


@dataclass(frozen=True, eq=False)
class FigureWorld:
    """A map, logs with reference poses, and which scan to show.

    Parameters
    ----------
    name
        What the data are, for captions: "simulated office", or the name of a file.
    grid
        The map.
    sensors
        Logs by the sensor's name. The last is the one whose scan is shown.
    index
        Index of the scan in the last sensor's log; it has a reference pose.
    scene
        The situation of Figures 6.8 and 6.9.
    open_index
        Index of a scan that sees space on all sides, for Figures 6.11 and 6.12.
    others
        Indices of scans like the first, at other places: Figure 6.7 may show one of them instead.

    Raises
    ------
    InvalidInputError
        If there is no sensor, the index is out of range, or that scan has no reference pose or no measured range.
    """

    name: str
    grid: OccupancyGrid
    sensors: Mapping[str, SensorLog]
    index: int
    scene: ObstacleScene
    open_index: int
    others: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.sensors:
            raise InvalidInputError("sensors: expected at least one, got none")
        check_scan(self.log, self.index)
        check_scan(self.log, self.open_index)

    @property
    def log(self) -> SensorLog:
        """The log whose scan is shown."""
        return list(self.sensors.values())[-1]

    @property
    def scan(self) -> Scan:
        """The scan that is shown."""
        return self.log.scan(self.index)

    @property
    def pose(self) -> FloatArray:
        """(3,) reference pose of that scan."""
        return np.asarray(self.log.poses[self.index])

    @cached_property
    def calibrations(self) -> Mapping[str, Calibration]:
        """The beam model learned from each log when it is first asked for; or an error says why it cannot be."""
        options = CalibrationOptions(refine=False)
        try:
            return {name: calibrate(log, self.grid, options) for name, log in self.sensors.items()}
        except (InvalidInputError, TooLittleDataError) as error:
            raise type(error)(f"the log does not teach a beam model: {error}") from error

    @property
    def parameters(self) -> BeamParameters:
        """The learned parameters of the sensor whose scan is shown."""
        return list(self.calibrations.values())[-1].parameters


def simulated_world(seed: int = 1, *, duration: float = DURATION) -> FigureWorld:
    """Return the world that the gallery shows by default: an office, a robot with a sonar ring and a laser scanner."""
    grid = draw_floor_plan(seed=seed)
    ring = np.arange(24) * np.radians(15.0)
    sonar = RangeFinder.from_bearings(ring, max_range=5.0, name="sonar")
    laser = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.5)), 20.0, mount=(0.2, 0.0, 0.0), name="laser")
    sensors = {}
    for finder, truth, rate in ((sonar, SONAR, 4 * SCAN_RATE), (laser, LASER, SCAN_RATE)):
        log = simulate_log(grid, finder, truth, duration=duration, scan_rate=rate, seed=seed)
        sensors[finder.name] = log.only_sensor()
    shown = sensors["laser"]
    first, *others = _far_scans(shown)
    scenes = three_obstacles(), _open_scan(shown)
    return FigureWorld("simulated office", grid, sensors, first, *scenes, tuple(others))


def world_of_log(
    log: ScanLog, grid: OccupancyGrid, *, sensor: str | None = None, index: int | None = None
) -> FigureWorld:
    """Return the world of a log with reference poses and its map.

    The sensor, whose scan is shown, may be None if there is only one; others with poses are drawn too. Without an index
    a scan with far and near readings is chosen. InvalidInputError if the sensor, the scan or its reference pose is
    missing, or the map has no obstacle.
    """
    if not grid.occupied.any():
        raise InvalidInputError("the map has no occupied cell, so that no figure shows anything")
    shown = log.only_sensor(sensor)
    if not shown.has_poses:
        raise InvalidInputError(f"{log.source}: no scan has a reference pose; the figures need them")
    chosen, *more = _far_scans(shown) if index is None else [index]
    check_scan(shown, chosen)
    others = {name: other for name, other in log.sensors.items() if other is not shown and other.has_poses}
    name = next(name for name, other in log.sensors.items() if other is shown)
    scene = scene_of_scan(grid, shown.scan(chosen), shown.poses[chosen])
    open_index = _open_scan(shown) if index is None else index
    sensors = {**others, name: shown}
    return FigureWorld(Path(log.source).name, grid, sensors, chosen, scene, open_index, tuple(more))


def check_scan(log: SensorLog, index: int) -> None:
    """Refuse a scan that is not there, has no reference pose or no measured range, and say which indices there are."""
    if not 0 <= index < len(log):
        raise InvalidInputError(f"scan: the log has scans 0 to {len(log) - 1}, got {index}")
    if not np.isfinite(log.poses[index]).all():
        raise InvalidInputError(f"scan: scan {index} has no reference pose")
    ranges = usable_ranges(log.ranges[index], log.finder)
    if not (ranges < log.finder.max_range).any():
        raise InvalidInputError(f"scan: scan {index} has no measured range")


def _far_scans(log: SensorLog) -> list[int]:
    """Return scans of corridors, half of their ranges short, some long: at different places, the best first."""
    z, candidates = _measured(log)
    near, far = np.nanquantile(z[candidates], (0.5, 0.95), axis=1)
    chosen: list[int] = []
    for index in candidates[np.argsort(near - far, kind="stable")].tolist():
        away = np.hypot(*(log.poses[chosen, :2] - log.poses[index, :2]).T)
        if len(chosen) < N_FAR and (away > FAR_APART).all():
            chosen.append(index)
    return chosen


def _open_scan(log: SensorLog) -> int:
    """Return a scan of a hall: the one with the longest typical range, but most of it within the sensor's reach."""
    z, candidates = _measured(log)
    complete = np.isfinite(z[candidates]).mean(axis=1)
    return int(candidates[np.argmax(np.nanmedian(z[candidates], axis=1) * complete**2)])


def _measured(log: SensorLog) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return ranges, NaN without return, and the scans that have a reference pose and measured most, or anything."""
    z = usable_ranges(log.ranges, log.finder)
    z[z >= log.finder.max_range] = np.nan
    counts = np.isfinite(z).sum(axis=1)
    posed = np.isfinite(log.poses).all(axis=1)
    for fewest in (max(1, log.finder.n_beams // 2), 1):
        candidates = np.flatnonzero(posed & (counts >= fewest))
        if len(candidates):
            return z, candidates
    raise InvalidInputError("no scan has both a reference pose and a measured range")
