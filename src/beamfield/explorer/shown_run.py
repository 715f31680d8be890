"""A filter's run beside the log that it was run on: where it took the robot to be, and whether it was there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.errors import FormatError, InvalidInputError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray, interpolate_poses
from beamfield.io.filter_run import FilterRun, read_run
from beamfield.localization.distance_scale import DistanceScale
from beamfield.localization.lost_robot import find_lost_robot
from beamfield.localization.particle_filter import FilterOptions, Update
from beamfield.localization.replay import PoseBelief
from beamfield.localization.resampling import systematic_indices
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import scan_agreement
from beamfield.models.gaussian_motion import USUAL_MOTION
from beamfield.sensors import MAX_GAP, SensorLog

# Seconds by which the stamps of particles and of their scan may differ.
SAME_TIME = 0.02
AGREEMENT, ERROR = "filter: share of readings that agree with the map", "filter: position error [m]"
# Of a filter that the page runs: particles, and how many of them are shown.
PARTICLES, DRAWN_PARTICLES = 2000, 200


@dataclass(frozen=True, eq=False)
class ShownRun:
    """What the page shows of a run.

    Parameters
    ----------
    poses
        (t, 3) where the filter took the robot to be at the scans, metres and radians; NaN where it said nothing.
    particles
        Poses (n, 3) by the index of the scan after which they are.
    numbers
        Values (t,) at the scans, for the timeline, by name.
    lost
        The warning if the scans contradict the poses.
    """

    poses: FloatArray
    particles: Mapping[int, FloatArray]
    numbers: Mapping[str, FloatArray] = field(default_factory=dict)
    lost: Finding | None = None


def read_shown_run(path: Path, log: SensorLog, grid: OccupancyGrid) -> ShownRun:
    """Read a run, and compare it with the scans of its log; FormatError if it cannot be read, or is of another log."""
    run = read_run(path)
    poses = interpolate_poses(run.track.stamps, run.track.poses, log.stamps, max_gap=MAX_GAP)
    if not np.isfinite(poses).all(axis=1).any():
        raise FormatError(
            path,
            f"the run is of another log: its poses are from {_span(run.track.stamps)}, the scans from "
            f"{_span(log.stamps)}",
        )
    numbers = {AGREEMENT: scan_agreement(log, grid, poses, most=len(log))}
    return ShownRun(poses, _by_scan(path, run, log), numbers, find_lost_robot(log, grid, poses))


def own_poses_as_run(log: SensorLog, grid: OccupancyGrid, lost: Finding) -> ShownRun:
    """Return the poses of a log that lost the robot as the run of a filter, to look at beside those fitted."""
    numbers = {AGREEMENT: scan_agreement(log, grid, log.poses, most=len(log))}
    return ShownRun(log.poses, {}, numbers, lost)


def run_from(log: SensorLog, grid: OccupancyGrid, model: Any, i: int, pose: tuple[float, float, float]) -> ShownRun:
    """Run a particle filter from a scan and a pose on; InvalidInputError if there is no odometry from there on."""
    if not np.isfinite(log.odometry[i:]).all(axis=1).any():
        raise InvalidInputError("filter: the scans have no odometry, which moves the particles")
    particles: dict[int, FloatArray] = {}
    rng = np.random.default_rng(0)

    def watch(at: int, update: Update) -> None:
        cloud = update.belief
        particles[i + at] = cloud.poses[systematic_indices(cloud.weights, DRAWN_PARTICLES, rng)]

    options = FilterOptions(n_particles=PARTICLES, distance_scale=DistanceScale())
    localizer = ScanLocalizer(grid, model, USUAL_MOTION, options)
    found = localizer.run(log[i:], PoseBelief.around(pose), np.random.default_rng(0), watch=watch)
    poses = np.full((len(log), 3), np.nan)
    poses[i:] = found.poses
    moved = [one for one in found.findings if one.name == "relocalized"]
    return ShownRun(poses, particles, lost=moved[0] if moved else find_lost_robot(log, grid, poses))


def _by_scan(path: Path, run: FilterRun, log: SensorLog) -> dict[int, FloatArray]:
    if not run.particles:
        return {}
    nearest = np.array([np.abs(log.stamps - stamp).argmin() for stamp in run.stamps])
    apart = np.abs(log.stamps[nearest] - run.stamps)
    if apart.max() > SAME_TIME:
        raise FormatError(
            path, f"the run is of another log: there is no scan at {run.stamps[apart.argmax()]:.3f} s, as of particles"
        )
    return dict(zip(nearest.tolist(), run.particles, strict=True))


def _span(stamps: FloatArray) -> str:
    return f"{stamps[0]:.3f} to {stamps[-1]:.3f} s"
