"""Learn the noise of features from scans with reference poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar
from scipy.special import expit, logsumexp

from beamfield.errors import TooLittleDataError
from beamfield.features.corners import Corner
from beamfield.features.feature import stack_features
from beamfield.geometry import FloatArray, transform_points, wrap_angle
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections

from .field_of_view import FieldOfView, corners_in_sight
from .noise import TYPICAL_CORNERS, CornerNoise

# Corners of the map farther than this from a measured one cannot be what it is of, metres.
CANDIDATES = 1.5
FEWEST = 10
# What is learned on a logarithmic scale, with the standard deviation of its prior about `TYPICAL_CORNERS`: about what
# buildings differ by. Fifty corners alone make noise too small. Shares are on the scale of log odds.
LOGARITHMS = {
    "sigma_place": 0.4, "sigma_heading": 0.4, "sigma_opening": 0.7, "clutter": 0.7, "clutter_shape": 0.5,
    "clutter_scale": 0.5, "clutter_opening": 0.4, "reach": 0.4, "hidden": 0.5,
}  # fmt: skip
ODDS = {"tail_share": 0.6, "convex_share": 0.6}
EXCESS = {"tail_factor": 0.4}
# As wide as walls of the map and of scans are ever apart: metres, radians.
WIDEST_LINES = (0.3, 0.1)


@dataclass(frozen=True, eq=False)
class CornerSightings:
    """Corners of scans at their reference poses, against those of the map that they can be of.

    Parameters
    ----------
    measured, variances
        (k, 3) range, bearing and opening with the variances of their extraction.
    corner
        (p,) of which measured corner a pair is.
    residuals, distances, in_view
        (p, 3), (p,) and (p,) of the pair's corner of the map: map minus measured, metres from the robot, and whether it
        should be seen.
    expected_corner, expected_distance
        (q,) and (q,): for each measured corner the corners of the map in view.
    n_map
        (k,) number of corners in the map.
    views
        (k,) radians that the sensor covers.
    """

    measured: FloatArray
    variances: FloatArray
    corner: NDArray[np.int64]
    residuals: FloatArray
    distances: FloatArray
    in_view: NDArray[np.bool_]
    expected_corner: NDArray[np.int64]
    expected_distance: FloatArray
    n_map: NDArray[np.int64]
    views: FloatArray

    @classmethod
    def of(
        cls,
        scans: Sequence[Sequence[Corner]],
        poses: FloatArray,
        grid: OccupancyGrid,
        corners: LandmarkMap,
        view: FieldOfView,
    ) -> CornerSightings:
        """Pair the corners of scans (t) taken at poses (t, 3) with those of a map."""
        sight = corners_in_sight(grid, corners, poses[:, :2])
        openings = np.asarray(corners.signatures)
        measured: list[FloatArray] = []
        variances: list[FloatArray] = []
        pairs: list[FloatArray] = []
        expected: list[tuple[int, float]] = []
        for t, seen in enumerate(scans):
            away = corners.positions - poses[t, :2]
            distance = np.hypot(away[:, 0], away[:, 1])
            bearing = wrap_angle(np.arctan2(away[:, 1], away[:, 0]) - poses[t, 2])
            in_view = sight[t] & view.holds(bearing)
            values, covariances = stack_features(seen)
            for corner, value, covariance in zip(seen, values, covariances, strict=True):
                here = transform_points(poses[t], corner.position)
                for j in np.flatnonzero(np.hypot(*(corners.positions - here).T) < CANDIDATES):
                    turn = float(wrap_angle(bearing[j] - value[1]))
                    errors = (distance[j] - value[0], turn, openings[j] - value[2])
                    pairs.append(np.array([len(measured), *errors, distance[j], sight[t, j]]))
                expected += [(len(measured), float(distance[j])) for j in np.flatnonzero(in_view)]
                measured.append(value)
                variances.append(np.diagonal(covariance))
        table, k = np.array(pairs, dtype=np.float64).reshape(-1, 6), len(measured)
        seen_table = np.array(expected, dtype=np.float64).reshape(-1, 2)
        return cls(
            np.array(measured).reshape(-1, 3), np.array(variances).reshape(-1, 3), table[:, 0].astype(np.int64),
            table[:, 1:4], table[:, 4], table[:, 5] > 0.0, seen_table[:, 0].astype(np.int64), seen_table[:, 1],
            np.full(k, len(corners)), np.full(k, 2.0 * view.half),
        )  # fmt: skip

    @classmethod
    def stacked(cls, parts: Sequence[CornerSightings]) -> CornerSightings:
        """Put the sightings of several logs behind each other."""
        first = np.cumsum([0, *(len(part) for part in parts)])
        joined = {
            name: np.concatenate(
                [
                    getattr(part, name) + (offset if name in ("corner", "expected_corner") else 0)
                    for part, offset in zip(parts, first[:-1], strict=True)
                ]
            )
            for name in cls.__dataclass_fields__
            if name != "in_view"
        }
        return cls(**joined, in_view=np.concatenate([part.in_view for part in parts]))

    def __len__(self) -> int:
        return len(self.measured)

    def log_likelihood(self, noise: CornerNoise) -> FloatArray:
        """Return log p(f | x, m) of each corner at its reference pose, (k,), without the exponent."""
        deviations = noise.deviations(self.measured, self.variances, (0.0, 0.0))
        density = np.exp(noise.log_match(self.residuals, deviations[self.corner]))
        weight = self.in_view * noise.visibility(self.distances) + noise.hidden / self.n_map[self.corner]
        k = len(self)
        matches = np.bincount(self.corner, weight * density, k)
        expected = np.bincount(self.expected_corner, noise.visibility(self.expected_distance), k)
        clutter = np.empty(k)
        for view in np.unique(self.views):
            chosen = self.views == view
            clutter[chosen] = np.exp(noise.log_clutter(self.measured[chosen], float(view)))
        return np.asarray(
            np.log(np.maximum(noise.clutter * clutter + matches, 1e-300))
            - np.log(noise.clutter + noise.hidden + expected)
        )


def learn_corner_noise(sightings: CornerSightings) -> CornerNoise:
    """Return the most probable noise of corners, given their sightings at reference poses; its exponent is 1.

    Correspondences are summed over. Each parameter has a prior about `TYPICAL_CORNERS`, as wide as buildings differ.

    Parameters
    ----------
    sightings
        Of scans that are not judged by it, with a map that others drew.

    Raises
    ------
    TooLittleDataError
        If there are fewer than ten corners.
    """
    if len(sightings) < FEWEST:
        raise TooLittleDataError(f"noise of corners: {len(sightings)} corners seen; at least {FEWEST} are needed")
    return most_probable_noise(sightings, TYPICAL_CORNERS)


def most_probable_noise(sightings: CornerSightings, start: CornerNoise) -> CornerNoise:
    """Return the same for any number of corners: for none it is the middle of the prior."""
    names = [*LOGARITHMS, *ODDS, *EXCESS]
    widths = np.array([*LOGARITHMS.values(), *ODDS.values(), *EXCESS.values()])
    middle = np.array(
        [np.log(getattr(start, name)) for name in LOGARITHMS]
        + [np.log(getattr(start, name) / (1.0 - getattr(start, name))) for name in ODDS]
        + [np.log(getattr(start, name) - 1.0) for name in EXCESS]
    )

    def noise(u: FloatArray) -> CornerNoise:
        value = dict(zip(names, middle + widths * u, strict=True))
        return CornerNoise(
            **{name: float(np.exp(value[name])) for name in LOGARITHMS},
            **{name: float(expit(value[name])) for name in ODDS},
            **{name: 1.0 + float(np.exp(value[name])) for name in EXCESS},
        )

    def cost(u: FloatArray) -> float:
        return float(0.5 * u @ u - sightings.log_likelihood(noise(u)).sum())

    best = minimize(cost, np.zeros(len(names)), method="L-BFGS-B", bounds=[(-5.0, 5.0)] * len(names))
    return noise(best.x)


def learn_line_noise(
    scans: Sequence[LineDetections], poses: FloatArray, lines: LineMap, start: LineParameters, min_overlap: float | None
) -> LineParameters:
    """Return the added deviations and the share of unmapped walls that make scans at their poses most probable.

    Unmapped walls have distances uniform up to the farthest wall that was seen: the sensor's own limit, often 80 m,
    would make any match in the map look like proof.

    Parameters
    ----------
    scans, poses
        (t) walls and (t, 3) reference poses.
    lines
        The map's.
    start
        Where the search starts.
    min_overlap
        As for `LineModel`.

    Raises
    ------
    TooLittleDataError
        If fewer than ten walls were seen.
    """
    count = sum(len(scan) for scan in scans)
    if count < FEWEST:
        raise TooLittleDataError(f"noise of walls: {count} walls seen; at least {FEWEST} are needed")
    limit = max(float(scan.lines[:, 0].max()) for scan in scans if len(scan))

    def parameters(u: FloatArray) -> LineParameters:
        rho, alpha = np.minimum(np.exp(u[:2]), WIDEST_LINES)
        return LineParameters(float(rho), float(alpha), float(np.clip(expit(u[2]), 0.005, 0.995)), limit)

    def cost(u: FloatArray) -> float:
        model = LineModel(lines, parameters(u), correspondence="sum", min_overlap=min_overlap)
        return -float(sum(model.log_likelihood(scan, pose) for scan, pose in zip(scans, poses, strict=True)))

    first = np.array([np.log(start.sigma_rho), np.log(start.sigma_alpha), np.log(0.25)])
    best = minimize(cost, first, method="Nelder-Mead", options={"maxfev": 80, "xatol": 0.05, "fatol": 0.5})
    return parameters(best.x)


def learn_exponent(at_reference: Sequence[float], elsewhere: Sequence[FloatArray]) -> float:
    """Return the exponent in (0, 1] under which reference poses are most probable among others.

    Parameters
    ----------
    at_reference
        Log-likelihood of each scan at its reference pose, nats, without exponent.
    elsewhere
        The same at other poses, any number for each scan.
    """

    def cost(exponent: float) -> float:
        gains = [
            exponent * here - float(logsumexp(exponent * np.append(others, here)))
            for here, others in zip(at_reference, elsewhere, strict=True)
        ]
        return -sum(gains)

    best = minimize_scalar(cost, bounds=(0.02, 1.0), method="bounded", options={"xatol": 0.01})
    return float(best.x)
