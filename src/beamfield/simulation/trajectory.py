"""Drives of a robot with differential drive through the free space of a map."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse
from scipy.sparse import csgraph

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Track

# Distance between points of a smoothed path, metres.
STEP = 0.05
# Paths are planned on cells of about this size, metres: finer ones cost time and change nothing after smoothing.
PLANNING_CELL = 0.1
MAX_PLANNING_CELLS = 4_000_000


@dataclass(frozen=True)
class DriveOptions:
    """How the robot drives.

    Parameters
    ----------
    robot_radius
        No pose is closer to an occupied or unknown cell than this, metres.
    comfort
        Distance to obstacles that the robot seeks where there is room, metres.
    speed
        Fastest speed on straight ground, m/s.
    acceleration
        Limit of the change of speed, m/s^2.
    turn_rate
        Fastest turn, rad/s.
    pause
        Time that the robot stands at each place it visits, seconds.
    """

    robot_radius: float = 0.25
    comfort: float = 0.7
    speed: float = 0.8
    acceleration: float = 0.6
    turn_rate: float = 1.0
    pause: float = 0.4

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not (np.isfinite(value) and (value > 0.0 or (value == 0.0 and item.name in ("pause", "comfort")))):
                raise InvalidInputError(f"{item.name}: expected a positive number, got {value}")


def drive_through(
    grid: OccupancyGrid, stamps: NDArray[np.float64], *, seed: int = 0, options: DriveOptions | None = None
) -> Track:
    """Drive from place to place through the largest free region of a map.

    The robot starts at the most open place and goes on to near places that it has not seen yet, so that a longer drive
    sees more of the map. At each place it stops and turns towards the next one. Paths are shortest on a graph of cells
    where closeness to obstacles costs, then smoothed without coming closer than allowed.

    Parameters
    ----------
    grid
        The map; unknown cells count as obstacles.
    stamps
        (t,) seconds, increasing: when the pose is wanted.
    seed
        Chooses the order of places.
    options
        Size and speed of the robot.

    Returns
    -------
    Track
        The stamps, and the true poses (t, 3) in the map frame, heading along the path.

    Raises
    ------
    InvalidInputError
        If the stamps do not increase or the map has no room for a drive of this robot.
    """
    options = options or DriveOptions()
    times = np.asarray(stamps, dtype=np.float64)
    if times.ndim != 1 or len(times) == 0 or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
        raise InvalidInputError(f"stamps: expected increasing finite seconds, shape (t,), got shape {times.shape}")
    space = _FreeSpace(grid, options)
    duration = float(times[-1] - times[0])
    clock, track = [np.zeros(1)], []
    for leg in _legs(space, np.random.default_rng(seed)):
        path = _smooth(leg, space)
        heading = _headings(path)
        if track:
            last = track[-1][-1]
            turn_times, turn = _turn_in_place(last, heading[0], options)
            _append(clock, track, turn_times, turn)
        leg_times = _travel_times(path, heading, options)
        _append(clock, track, leg_times, np.column_stack([path, heading]))
        if clock[-1][-1] >= duration:
            break
    drive_times, drive = np.concatenate(clock[1:]), np.concatenate(track)
    at = times - times[0]
    poses = np.column_stack([np.interp(at, drive_times, drive[:, i]) for i in range(3)])
    return Track(times.copy(), _in_map(grid, poses))
