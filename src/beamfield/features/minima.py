"""Local minima of the ranges (6.6.1): the nearest points of obstacles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from beamfield.arguments import checked, require
from beamfield.features.feature import Feature, polar_jacobian
from beamfield.features.sweep import RangeNoise, Sweep, split_at_gaps, sweeps
from beamfield.geometry import FloatArray
from beamfield.sensors import Scan

# A parabola has three parameters; two more points show whether it fits.
FEWEST_POINTS = 5
# A fit this bad happens to a parabola once in a thousand times.
BAD_FIT = 1e-3
# The curvature must be this many deviations above zero: noise alone has minima everywhere.
CLEAR_CURVATURE = 4.0


@dataclass(frozen=True, eq=False)
class LocalMinimum(Feature):
    """A place nearer than its surroundings.

    The measurement is (range, bearing, curvature): the second derivative of the range in the bearing, metres. A
    straight wall has its distance from the sensor there, an edge or a pole more.

    Parameters
    ----------
    chi_square
        Of the parabola; n - 3 degrees of freedom. Where it is worse than expected the covariance has grown with it.
    """

    chi_square: float


@checked
def find_local_minima(
    scan: Scan, noise: RangeNoise, *, half_width: float = np.deg2rad(15.0), max_gap: float = 0.5
) -> list[LocalMinimum]:
    """Return the local minima of a scan, each from a parabola through the ranges around the least one.

    Where the parabola does not fit, the window is halved, at most twice. Sharp edges are no parabolas: their minimum is
    found too, with a bias of about the sagitta in the window and a covariance that the bad fit has widened. Straight
    walls are none either: their curvature comes out a few percent too large, up to about one standard deviation.

    Parameters
    ----------
    scan
        Ranges of any finder; beams that do not share their origin with others cannot be compared and are left out.
    noise
        Of single readings; the bearing's noise does not matter where the range is stationary.
    half_width
        Half the widest window in radians, in (0, pi/4): a minimum is the least reading in it.
    max_gap
        As for `split_at_gaps`, metres.

    Raises
    ------
    InvalidInputError
        If a limit makes no sense.
    """
    require(0.0 < half_width < np.pi / 4, "half_width", "(0, pi/4) radians", half_width)
    found = []
    for sweep in sweeps(scan):
        if np.ptp(sweep.origins, axis=0).max() > 1e-5:
            continue
        first, stop = 0, len(sweep)
        if sweep.closed:
            # Noise may put the start of a full turn at a minimum: its beams are looked at where both sides are there.
            first = int(np.searchsorted(sweep.angles, sweep.angles[0] + half_width))
            sweep, stop = two_turns(sweep), stop + first
        for run in split_at_gaps(sweep, noise, max_gap=max_gap):
            found += minima_of_run(sweep, run, noise, half_width, first, stop)
    return found


def two_turns(sweep: Sweep) -> Sweep:
    """Return a full turn followed by itself."""
    twice = [np.concatenate([each, each]) for each in (sweep.beams, sweep.origins, sweep.ranges, sweep.returned)]
    angles = np.concatenate([sweep.angles, sweep.angles + 2.0 * np.pi])
    return Sweep(twice[0], twice[1], angles, twice[2], twice[3], closed=True)


def minima_of_run(
    sweep: Sweep, run: NDArray[np.int64], noise: RangeNoise, half_width: float, first_place: int, stop_place: int
) -> list[LocalMinimum]:
    """Return the minima inside one run of end points, of those at places from the first one to before the last."""
    angles, ranges = sweep.angles[run], sweep.ranges[run]
    first = np.searchsorted(angles, angles - half_width - 1e-9)
    stop = np.searchsorted(angles, angles + half_width + 1e-9)
    found = []
    for k in np.flatnonzero((run >= first_place) & (run < stop_place)).tolist():
        window = slice(int(first[k]), int(stop[k]))
        # The first of equals stands for all of them.
        least = window.start + int(np.argmin(ranges[window])) == k
        inside = min(k - window.start, window.stop - 1 - k) >= 2
        if least and inside and window.stop - window.start >= FEWEST_POINTS:
            minimum = widest_fit(sweep, run[window], angles[k], noise, half_width)
            if minimum is not None:
                found.append(minimum)
    return found


def widest_fit(
    sweep: Sweep, places: NDArray[np.int64], middle: float, noise: RangeNoise, half_width: float
) -> LocalMinimum | None:
    """Return the minimum in the widest window that a parabola fits, or in the narrowest if it fits none."""
    minimum = None
    for width in (half_width, half_width / 2.0, half_width / 4.0):
        window = places[np.abs(sweep.angles[places] - middle) <= width + 1e-9]
        if len(window) < FEWEST_POINTS:
            break
        minimum = parabola(sweep, window, middle, noise)
        if minimum is not None and minimum.chi_square < float(chdtri(len(window) - 3, BAD_FIT)):
            break
    return minimum


def parabola(sweep: Sweep, places: NDArray[np.int64], middle: float, noise: RangeNoise) -> LocalMinimum | None:
    """Return the vertex of the parabola through the ranges, or None if there is no clear one between the beams."""
    x = sweep.angles[places] - middle
    z = sweep.ranges[places]
    sigma = noise.along(z)
    design = np.column_stack([np.ones_like(x), x, x * x]) / sigma[:, None]
    coefficients = np.linalg.lstsq(design, z / sigma, rcond=None)[0]
    chi_square = float(np.sum((z / sigma - design @ coefficients) ** 2))
    growth = max(1.0, chi_square / (len(places) - 3)) if len(places) > 3 else 1.0
    covariance = np.linalg.inv(design.T @ design) * growth
    _, slope, bend = coefficients
    # A vertex beyond the beams is extrapolated: where a view ends, walls only seem to come nearer behind its edge.
    if bend <= CLEAR_CURVATURE * np.sqrt(covariance[2, 2]) or not x[0] <= -slope / (2.0 * bend) <= x[-1]:
        return None
    jacobian = np.array(
        [
            [1.0, -slope / (2.0 * bend), slope**2 / (4.0 * bend**2)],
            [0.0, -1.0 / (2.0 * bend), slope / (2.0 * bend**2)],
            [0.0, 0.0, 2.0],
        ]
    )
    vertex = np.array([coefficients[0] - slope**2 / (4.0 * bend), middle - slope / (2.0 * bend), 2.0 * bend])
    measurement, turned = seen_from_robot(vertex, sweep.origins[places[0]])
    return LocalMinimum(measurement, turned @ jacobian @ covariance @ jacobian.T @ turned.T, sweep.beams[places],
                        chi_square)  # fmt: skip


def seen_from_robot(vertex: FloatArray, origin: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a vertex as seen from the robot, and its (3, 3) derivative in the vertex as seen from the sensor."""
    cos, sin = np.cos(vertex[1]), np.sin(vertex[1])
    position = origin + vertex[0] * np.array([cos, sin])
    jacobian = np.eye(3)
    jacobian[:2, :2] = polar_jacobian(position) @ np.array([[cos, -vertex[0] * sin], [sin, vertex[0] * cos]])
    measurement = np.array([np.hypot(*position), np.arctan2(position[1], position[0]), vertex[2]])
    return measurement, jacobian
