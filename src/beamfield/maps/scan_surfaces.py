"""What the beams of one scan measured: surfaces, and the space that they passed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, compose
from beamfield.kernels import surfaces as kernels
from beamfield.maps.end_points import points_along
from beamfield.sensors import Scan, usable_ranges

# A surface goes on behind at most this many beams in a row that measured something else, or nothing.
BRIDGED_BEAMS = 2


@dataclass(frozen=True, eq=False)
class Fan:
    """Beams of one origin in the order of their directions, k of them, in the frame of the field.

    Parameters
    ----------
    origin
        (2,) metres.
    bearings
        (k,) radians.
    passed
        (k,) how far the beams have seen, metres; 0 for those that say nothing.
    half_width
        (k,) how far aside the beams see, radians.
    joined
        (k,) whether a beam and the next measured one surface.
    elements
        (m, COLUMNS) line elements of the surfaces, see `kernels.surfaces`.
    """

    origin: FloatArray
    bearings: FloatArray
    passed: FloatArray
    half_width: FloatArray
    joined: NDArray[np.bool_]
    elements: FloatArray


def measured_fans(scan: Scan, pose: FloatArray, free_without_return: bool) -> list[Fan]:
    """Return the beams of a scan, fan by fan: those that start at one place, to a micrometre, are a fan.

    Fans are in the frame of the robot's pose (3,); none for a sensor without beams. A beam without return may count as
    having seen free space up to its limit.
    """
    finder = scan.finder
    ranges = usable_ranges(scan.ranges, finder)
    mounts = compose(pose, finder.mounts)
    if not len(mounts):
        return []
    if np.ptp(finder.mounts[:, :2], axis=0).max() < 1e-6:
        return [_fan(mounts, ranges, finder.max_range, finder.opening_angle, free_without_return)]
    # Positions that agree within a micrometre are one origin.
    _, which = np.unique(np.round(finder.mounts[:, :2], 6), axis=0, return_inverse=True)
    which = which.ravel()
    return [
        _fan(mounts[which == g], ranges[which == g], finder.max_range, finder.opening_angle, free_without_return)
        for g in range(which.max() + 1)
    ]


def _fan(mounts: FloatArray, ranges: FloatArray, max_range: float, opening: float, free_without_return: bool) -> Fan:
    """Sort the beams of one origin and find the surfaces they measured."""
    order = np.argsort(mounts[:, 2], kind="stable")
    mounts, ranges = mounts[order], ranges[order]
    with np.errstate(invalid="ignore"):
        returned = ranges < max_range
    passed = np.where(returned | (free_without_return & (ranges == max_range)), ranges, 0.0)
    ranges = np.where(returned, ranges, np.nan)
    joined, half_width = np.empty(len(ranges), np.bool_), np.empty(len(ranges))
    kernels.find_surfaces(mounts, ranges, opening, 0.0, joined, half_width)
    return Fan(mounts[0, :2], mounts[:, 2], passed, half_width, joined, _elements(mounts, ranges, joined, opening))


def _elements(mounts: FloatArray, ranges: FloatArray, joined: NDArray[np.bool_], opening: float) -> FloatArray:
    """Return the elements (m, COLUMNS) of all end points, those in line past lone ones too."""
    points = points_along(mounts, ranges)
    in_company = joined | np.roll(joined, 1)
    lone = points[~in_company & ~np.isnan(ranges)]
    kept = np.flatnonzero(in_company)
    # A gap of a metre is filled with three elements, or four if rounding makes it longer.
    elements = np.zeros((5 * len(kept) + len(lone), kernels.COLUMNS))
    n = 0
    if len(kept):
        noise = kernels.range_noise(mounts[:, 2], ranges, joined)
        mounts, ranges, points = mounts[kept], ranges[kept], points[kept]
        linked, _ = np.empty(len(kept), np.bool_), np.empty(len(kept))
        kernels.find_surfaces(mounts, ranges, opening, noise, linked, _)
        linked &= (np.roll(kept, -1) - kept) % len(joined) <= BRIDGED_BEAMS + 1
        n = kernels.fit_elements(points, ranges, linked, noise, elements)
    last = elements[n : n + len(lone)]
    last[:, : kernels.NX] = lone
    last[:, kernels.NX], last[:, kernels.PULL] = 1.0, kernels.NONE
    return elements[: n + len(lone)]
