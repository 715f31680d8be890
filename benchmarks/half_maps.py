"""Logs without a map of their own, replayed so that no scan meets a map that it helped to draw.

Stretches of 5 m draw two maps in turn, and each scan is weighed by the other's map. Poses were corrected by SLAM.
fr079's odometry loses its sign when the robot backs up; it has it from the corrected poses here. Logs that have no
odometry have it drawn about the corrected poses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.geometry import FloatArray, between
from beamfield.io.read_log import read_log
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.maps.mapping import build_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.sensors import Scan, SensorLog
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.filters.scan_weights import ScanWeights
from odometry_noise import chained, fr079, with_signs_of_reference

GROUP = 5.0
LOGS: dict[str, Callable[[Path], SensorLog]] = {
    "intel": lambda folder: read_log(folder / "intel_gfs/derived_intel_rawodom.log.gz").only_sensor(),
    "fr079": lambda folder: with_signs_of_reference(
        fr079(folder / "carmen_radish_corrected/freiburg-079-corrected.log.gz")
    ),
    "csail": lambda folder: read_log(folder / "csail_gfs/derived_csail_rawodom.log.gz").only_sensor(),
}
# To be found in, from anywhere.
MORE_LOGS: dict[str, Callable[[Path], SensorLog]] = {
    **LOGS,
    "Belgioioso": lambda folder: with_drawn_odometry(corrected(folder, "belgioioso")),
    "real Pioneer": lambda folder: attach_poses(
        read_log(folder / "uob_pioneer_real/trace1.bag"),
        read_trajectory(folder / "uob_pioneer_real/derived_amcl_poses_trace1.csv.gz"),
    ).only_sensor(),
}
# How a program's filter is calibrated was not decided with these in sight.
OTHER_LOGS: dict[str, Callable[[Path], SensorLog]] = {
    name: lambda folder, name=name: with_drawn_odometry(corrected(folder, name))
    for name in ("aces", "edmonton", "fhw", "acapulco", "infinite-corridor", "freiburg-campus")
}


class HalfMaps(NamedTuple):
    """A log and its two maps."""

    log: SensorLog
    half: NDArray[np.int64]
    """(t,) which map each scan helped to draw."""
    grids: tuple[OccupancyGrid, OccupancyGrid]

    @property
    def to_fit(self) -> tuple[SensorLog, OccupancyGrid]:
        """The scans of the first half of the way that drew one map, and the other."""
        first = np.arange(len(self.log)) < len(self.log) // 2
        return self.log.select(first & (self.half == 0)), self.grids[1]


def half_maps(folder: Path, name: str) -> HalfMaps:
    """Draw the maps of a log, with cells of 5 cm."""
    log = (MORE_LOGS | OTHER_LOGS)[name](folder)
    half = (way_of(log) // GROUP).astype(np.int64) % 2
    first, second = (build_map(log, resolution=0.05, scans=half == i) for i in (0, 1))
    return HalfMaps(log, half, (first, second))


def way_of(log: SensorLog) -> FloatArray:
    """Return how far the robot has come at each scan, metres."""
    return np.append(0.0, np.cumsum(np.hypot(*np.diff(log.poses[:, :2], axis=0).T)))


def corrected(folder: Path, name: str) -> SensorLog:
    """Return the first laser of a log whose poses SLAM has corrected."""
    return read_log(folder / f"carmen_radish_corrected/{name}-corrected.log.gz").only_sensor()


def with_drawn_odometry(log: SensorLog) -> SensorLog:
    """Return the log with odometry that errs as a good robot's does."""
    rng, steps = np.random.default_rng(0), between(log.poses[:-1], log.poses[1:])
    drawn = [GaussianMotion().sample(np.zeros((1, 3)), [np.zeros(3), step], rng)[0] for step in steps]
    return replace(log, odometry=chained(np.array(drawn)))


class ByOtherMap:
    """A measurement model that weighs each scan by the map that it has no part in."""

    is_normalized = False

    def __init__(self, maps: HalfMaps, model_of: Callable[[OccupancyGrid], Any]) -> None:
        self._models, self._half = (
            [model_of(grid) for grid in maps.grids],
            dict(zip(maps.log.stamps, maps.half, strict=True)),
        )

    def log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Weigh poses."""
        weights: FloatArray = self._models[1 - self._half[z.stamp]].log_likelihood(z, poses)
        return weights


@dataclass(frozen=True, eq=False)
class HalfMapSettings(FilterSettings):
    """A filter that weighs each scan by the map that it has no part in."""

    maps: HalfMaps

    @classmethod
    def of(cls, settings: FilterSettings, maps: HalfMaps) -> HalfMapSettings:
        """Return settings of a filter for these maps."""
        return cls(**{item.name: getattr(settings, item.name) for item in fields(FilterSettings)}, maps=maps)

    def emulator(self, grid: OccupancyGrid) -> Any:
        """Return the measurement models on both maps, moved as `grid` is, the second of them."""
        of, shift = super().emulator, grid.origin - self.maps.grids[1].origin
        return [of(replace(one, origin=one.origin + shift)) for one in self.maps.grids]

    def filter_with(self, emulator: Any) -> Any:
        """Return the filter with the models of both maps."""
        made = super().filter_with(emulator[1])
        weights = _EachByItsMap(self.maps, [ScanWeights(one) for one in emulator])
        object.__setattr__(made, "_weights_of", weights)
        return made


class _EachByItsMap:
    def __init__(self, maps: HalfMaps, weights: list[ScanWeights]) -> None:
        drawn = zip(maps.log.stamps.tolist(), maps.half.tolist(), strict=True)
        self._by_stamp = {stamp: weights[1 - half] for stamp, half in drawn}

    def __call__(self, scan: Scan, poses: FloatArray, *, converged: bool = False) -> FloatArray:
        return self._by_stamp[scan.stamp](scan, poses, converged=converged)
