"""The beams of a scan in the order in which they pass over the world, and where that order is broken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, require
from beamfield.geometry import FloatArray
from beamfield.maps.end_points import points_along
from beamfield.sensors import Scan, usable_ranges

# Beams whose origins agree to a micrometre start at one point.
ORIGIN_DECIMALS = 6
# A ring is closed when its widest gap is no wider than this many usual ones: a few readings may be missing.
CLOSING_GAPS = 5.0
# The smallest angle between beam and wall that is followed, radians.
GRAZING_ANGLE = np.deg2rad(8.0)


@dataclass(frozen=True)
class RangeNoise:
    """Gaussian noise of single readings, independent from beam to beam.

    Parameters
    ----------
    sigma_range
        Standard deviation along the beam, metres, > 0. It should hold the roughness of real walls as well.
    sigma_bearing
        Standard deviation of the beam's direction, radians, >= 0.
    sigma_slope
        Growth with the range r, metres per metre, >= 0: the variance along the beam is sigma_range^2 +
        (sigma_slope r)^2, as in `BeamParameters`. Scanners that triangulate need it: 0.004 for those of small robots.

    Raises
    ------
    InvalidInputError
        If a deviation is not finite, `sigma_range` is not positive or another one is negative.
    """

    sigma_range: float = 0.02
    sigma_bearing: float = 0.0
    sigma_slope: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        require(0.0 < self.sigma_range < np.inf, "sigma_range", "a positive number of metres", self.sigma_range)
        require(0.0 <= self.sigma_bearing < np.inf, "sigma_bearing", "a number of radians >= 0", self.sigma_bearing)
        require(0.0 <= self.sigma_slope < np.inf, "sigma_slope", "a number >= 0", self.sigma_slope)

    def along(self, ranges: ArrayLike) -> FloatArray:
        """Return the standard deviation along the beam at ranges in metres, same shape, metres."""
        z = np.asarray(ranges, dtype=np.float64)
        return np.asarray(np.hypot(self.sigma_range, self.sigma_slope * z))


@dataclass(frozen=True, eq=False)
class Sweep:
    """Beams in order of bearing, with everything that is not a measurement left out.

    Parameters
    ----------
    beams
        (n,) index of each beam in the scan.
    origins
        (n, 2) where each beam starts, robot frame, metres.
    angles
        (n,) direction of each beam, robot frame, radians, increasing (beyond pi where the sweep passes it).
    ranges
        (n,) metres; the sensor's max_range where nothing returned.
    returned
        (n,) whether the beam came back.
    closed
        Whether the first beam follows the last (a full turn).
    """

    beams: NDArray[np.int64]
    origins: FloatArray
    angles: FloatArray
    ranges: FloatArray
    returned: NDArray[np.bool_]
    closed: bool

    def __len__(self) -> int:
        return len(self.beams)

    @property
    def directions(self) -> FloatArray:
        """(n, 2) unit vectors along the beams."""
        return np.column_stack([np.cos(self.angles), np.sin(self.angles)])

    @property
    def points(self) -> FloatArray:
        """(n, 2) end points, robot frame, metres."""
        return self.origins + self.ranges[:, None] * self.directions


def sweeps(scan: Scan) -> list[Sweep]:
    """Return the beams of a scan that measured something, one sweep per origin.

    Beams whose origin only one or two beams share (a sonar ring) form one sweep in order of their bearings about the
    robot. A full turn starts at its widest jump, so that hardly any object is cut in two. NaN, -inf and readings below
    min_range are left out; readings of max_range and more are kept as "nothing returned".
    """
    ranges = usable_ranges(scan.ranges, scan.finder)
    return [
        one_sweep(group, scan, ranges)
        for group in beams_by_origin(scan.finder.mounts)
        if np.isfinite(ranges[group]).any()
    ]


def beams_by_origin(mounts: FloatArray) -> list[NDArray[np.int64]]:
    """Return the beams of each origin; those of rare origins together."""
    _, which, counts = np.unique(
        np.round(mounts[:, :2], ORIGIN_DECIMALS), axis=0, return_inverse=True, return_counts=True
    )
    which = which.reshape(-1)
    groups = [np.flatnonzero(which == origin) for origin in np.flatnonzero(counts >= 3)]
    rest = np.flatnonzero(counts[which] < 3)
    return [*groups, rest] if len(rest) else groups


def one_sweep(group: NDArray[np.int64], scan: Scan, ranges: FloatArray) -> Sweep:
    """Order the beams of a group that measured something."""
    beams = group[np.isfinite(ranges[group])]
    bearing = np.mod(scan.finder.bearings[beams], 2.0 * np.pi)
    order = np.argsort(bearing, kind="stable")
    beams, bearing = beams[order], bearing[order]
    spacing = np.diff(bearing, append=bearing[0] + 2.0 * np.pi)
    widest = int(np.argmax(spacing))
    others = np.delete(spacing, widest)
    closed = bool(len(others) and spacing[widest] <= CLOSING_GAPS * np.median(others) and spacing[widest] < np.pi)
    first = (widest_jump(scan, beams, ranges) if closed else widest) + 1
    beams, bearing = np.roll(beams, -first), np.roll(bearing, -first)
    angles = np.where(np.arange(len(beams)) < len(beams) - first, bearing, bearing + 2.0 * np.pi)
    z = ranges[beams]
    return Sweep(beams, scan.finder.mounts[beams, :2], angles, z, z < scan.finder.max_range, closed)


def widest_jump(scan: Scan, beams: NDArray[np.int64], ranges: FloatArray) -> int:
    """Return the place after which the next end point is farthest."""
    points = points_along(scan.finder.mounts[beams], ranges[beams])
    return int(np.argmax(np.hypot(*(np.roll(points, -1, axis=0) - points).T)))


def split_at_gaps(sweep: Sweep, noise: RangeNoise, *, max_gap: float) -> list[NDArray[np.int64]]:
    """Return runs of end points that may belong to one surface, as places in the sweep.

    Two neighbours part when they are farther apart than a wall under `GRAZING_ANGLE` puts them, with four deviations of
    the noise added (Borges and Aldon's adaptive breakpoints), or farther than `max_gap` metres. Missing readings in
    between widen what such a wall may do; beams without return are passed over, and readings no longer than their
    noise, such as 0: their end points lie in no sure direction.

    G. A. Borges and M.-J. Aldon, "Line extraction in 2D range images for mobile robotics", Journal of Intelligent and
    Robotic Systems 40, 2004.
    """
    require(max_gap > 0.0, "max_gap", "a positive number of metres", max_gap)
    places = np.flatnonzero(sweep.returned & (sweep.ranges > noise.sigma_range))
    if len(places) == 0:
        return []
    step = np.diff(sweep.angles[places])
    nearer = np.minimum(sweep.ranges[places[1:]], sweep.ranges[places[:-1]])
    closing = np.sin(np.maximum(GRAZING_ANGLE - step, 0.0))
    on_wall = np.divide(nearer * np.sin(step), closing, out=np.full(len(step), np.inf), where=closing > 0.0)
    allowed = np.minimum(on_wall + 4.0 * np.sqrt(2.0) * noise.along(nearer), max_gap)
    distance = np.hypot(*np.diff(sweep.points[places], axis=0).T)
    return list(np.split(places, np.flatnonzero(distance > allowed) + 1))
