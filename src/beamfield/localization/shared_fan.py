"""One fan of rays per place that serves all headings of a range finder there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, wrap_angle
from beamfield.sensors import RangeFinder, Scan

# Mounts that agree within this many metres are one point.
SAME_POINT = 1e-6
# Rays per heading step at most; so fine a fan is shared by nobody.
FINEST_FACTOR = 10_000


@dataclass(frozen=True, eq=False)
class SharedFan:
    """Rays that stand for the beams of a sensor at all headings.

    Parameters
    ----------
    rays
        The rays as a finder at its own origin, directions in the map frame.
    index
        (h, k) which ray stands for beam k at heading h.
    offsets
        (h, 2) cells (row, col) from the robot's cell to that of the sensor.
    shifts
        (h, 2) metres from the centre of the robot's cell to the robot, in the lattice's frame, if the sensor is in the
        centre of its cell.
    direction_error
        Largest difference between a beam and its ray, radians.
    """

    rays: RangeFinder
    index: NDArray[np.int64]
    offsets: NDArray[np.int64]
    shifts: FloatArray
    direction_error: float

    def headings_by_offset(self) -> list[tuple[tuple[int, int], NDArray[np.int64]]]:
        """Return the headings that share an offset, for each offset.

        Returns
        -------
        (row, col) in cells, and indices of headings.
        """
        distinct, group = np.unique(self.offsets, axis=0, return_inverse=True)
        group = group.reshape(-1)
        return [((int(row), int(col)), np.flatnonzero(group == g)) for g, (row, col) in enumerate(distinct)]


def shared_fan(
    scan: Scan, headings: FloatArray, lattice_yaw: float, resolution: float, tolerance: float
) -> SharedFan | None:
    """Return the fan that serves a scan's beams at equally spaced headings.

    Parameters
    ----------
    scan
        The scan with the beams that count.
    headings
        (h,) radians in the map frame, equally spaced over the circle from 0 on.
    lattice_yaw
        Direction of the lattice's x axis in the map frame, radians.
    resolution
        Side of the lattice's cells, metres.
    tolerance
        Largest difference between a beam and its ray, radians.

    Returns
    -------
    The fan with the fewest rays; None if the beams start at different points, or sharing saves no ray.
    """
    mounts = scan.finder.mounts
    if not len(mounts) or tolerance <= 0.0 or np.ptp(mounts[:, :2], axis=0).max() > SAME_POINT:
        return None
    n_headings = len(headings)
    bearings = mounts[:, 2]
    factor, phase, error = _coarsest_step(bearings, n_headings, tolerance)
    n_rays = factor * n_headings
    step = 2.0 * np.pi / n_rays
    first = np.round((bearings - phase) / step).astype(np.int64)
    index = (first[None, :] + factor * np.arange(n_headings)[:, None]) % n_rays
    used, index = np.unique(index, return_inverse=True)
    index = index.reshape(n_headings, len(bearings))
    if len(used) >= index.size:
        return None
    rays = RangeFinder.from_bearings(wrap_angle(phase + step * used), scan.finder.max_range)
    turn = headings - lattice_yaw
    x, y = mounts[:, :2].mean(axis=0)
    in_cells = np.column_stack([np.sin(turn) * x + np.cos(turn) * y, np.cos(turn) * x - np.sin(turn) * y]) / resolution
    offsets = np.round(in_cells).astype(np.int64)
    shifts = resolution * (offsets - in_cells)[:, ::-1]
    return SharedFan(rays, index, offsets, shifts, error)


def _coarsest_step(bearings: FloatArray, n_headings: int, tolerance: float) -> tuple[int, float, float]:
    """Return (rays per heading step, phase, largest error) of the coarsest fan within the tolerance.

    A step of twice the tolerance always is.
    """
    factor = 0
    while True:
        factor += 1
        step = 2.0 * np.pi / (factor * n_headings)
        phase, error = _best_phase(bearings, step)
        if error <= tolerance or step <= 2.0 * tolerance or factor > FINEST_FACTOR:
            return factor, phase, error


def _best_phase(bearings: FloatArray, step: float) -> tuple[float, float]:
    """Return the direction of a ray such that rays `step` apart come close to all bearings, and the largest error."""
    on_circle = np.exp(2j * np.pi * bearings / step)
    centre = float(np.angle(on_circle.sum())) * step / (2.0 * np.pi)
    residual = (bearings - centre + 0.5 * step) % step - 0.5 * step
    middle = 0.5 * float(residual.min() + residual.max())
    return centre + middle, 0.5 * float(np.ptp(residual))
