"""The particle filter of MIT's racecar and F1TENTH, with its names and defaults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from beamfield.geometry import FloatArray, compose
from beamfield.localization.particles import normal_poses
from beamfield.localization.replay import PoseBelief
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.motion import MotionModel
from beamfield.sensors import Scan, SensorLog
from beamfield.stacks.emulation.stack_map import read_as_stack
from beamfield.stacks.filters.emulated_filter import EmulatedFilter
from beamfield.stacks.filters.loop import scans_with_odometry
from beamfield.stacks.filters.particles import (
    check_particle_counts,
    draw_by_weight,
    normalised,
    uniform_poses,
)

STANDSTILL = np.zeros((2, 3))


@dataclass(frozen=True)
class F1tenthFilterParameters:
    """What the launch or YAML file says about the particles.

    Parameters
    ----------
    max_particles
        How many there always are.

    Raises
    ------
    InvalidInputError
        If there is none, or more than memory has room for.
    """

    max_particles: int = 4000

    def __post_init__(self) -> None:
        check_particle_counts(self, "max_particles")


def f1tenth_filter(model: Any, motion: MotionModel, parameters: F1tenthFilterParameters) -> F1tenthFilter:
    """Return the filter that runs the table on its map."""
    seen = read_as_stack(model.grid, model.map_mode)
    # Global starts are at the corners of free cells.
    corner = compose(seen.origin, [-0.5 * seen.resolution, -0.5 * seen.resolution, 0.0])
    return F1tenthFilter(model, OccupancyGrid(seen.probability, seen.resolution, corner), motion, parameters)


@dataclass(frozen=True, eq=False)
class F1tenthFilter(EmulatedFilter):
    """The particle filter of MIT's racecar and F1TENTH on a map, as it is.

    Every update draws all particles anew by the weights of the last one, moves them and weighs them. Its answer is
    their weighted mean, the heading averaged as a plain number.

    Notes
    -----
    Re-derived from particle_filter.py: MCL, motion_model, expected_pose, initialize_particles_pose. The program
    updates with every odometry message and the newest scan; here every scan that has odometry updates. It takes the
    laser's pose for the car's; here `RangeFinder.mounts` says where the laser is. Where all weights are 0 the program
    stops with an error (its probabilities sum to NaN); here all particles become equal. Its weights underflow to 0
    with many beams, those here do not. Headings run on past pi, as the program's do. After a global start they are from
    0 to 2 pi in the map's axes: where the car heads along its x, some are near 0, others near 2 pi, and their mean is
    neither.
    """

    parameters: F1tenthFilterParameters = F1tenthFilterParameters()

    def update_scans(self, log: SensorLog) -> list[int]:
        """Return the scans with odometry; see `EmulatedFilter.update_scans`."""
        return scans_with_odometry(log)

    def _cloud(self, start: PoseBelief | None, rng: np.random.Generator) -> _Particles:
        return _Particles(self, start, rng)


class _Particles:
    """A `Cloud`."""

    def __init__(self, f1tenth: F1tenthFilter, start: PoseBelief | None, rng: np.random.Generator) -> None:
        self._f1tenth, self._rng, n = f1tenth, rng, f1tenth.parameters.max_particles
        self.poses = _global_poses(f1tenth.seen, n, rng) if start is None else normal_poses(start, n, rng)
        self.weights = np.full(n, 1.0 / n)
        self.move(STANDSTILL)  # the first update has the noise of a step, too

    def move(self, odometry: FloatArray) -> None:
        drawn = self.poses[draw_by_weight(self.weights, len(self.weights), self._rng)]
        self.poses = self._f1tenth.motion.sample(drawn, odometry, self._rng)

    def weigh(self, scan: Scan) -> None:
        self.weights = normalised(self._f1tenth._weights_of(scan, self.poses))

    def resample_when_due(self) -> FloatArray:
        return np.asarray(self.weights @ self.poses)


def _global_poses(seen: OccupancyGrid, n: int, rng: np.random.Generator) -> FloatArray:
    """Return n poses (n, 3) on free cells; headings are averaged as numbers, so it matters where they begin."""
    poses, yaw = uniform_poses(seen, n, rng), float(seen.origin[2])
    poses[:, 2] = yaw + (poses[:, 2] - yaw) % (2.0 * np.pi)
    return poses
