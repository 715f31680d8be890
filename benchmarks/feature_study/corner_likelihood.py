"""The likelihood of a scan's corners over positions and headings, given which corners of the map are in view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_fields
from beamfield.errors import InvalidInputError
from beamfield.features.corners import Corner
from beamfield.features.feature import stack_features
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid

from .field_of_view import FieldOfView, corners_in_sight
from .noise import CornerNoise

# Beyond so many deviations of its tail a match adds nothing that clutter would not add as well.
CUT = 5.0


@dataclass(frozen=True, eq=False)
class CornerLikelihood:
    """p(corners of a scan | x, m) at all pairs of positions and headings, by `CornerNoise`.

    A density over each corner's range, bearing and opening, to the power `noise.exponent`: as in (6.39) corners are
    independent given pose and map, and the number of corners says nothing. What a corner is of has a prior that
    depends on the pose: corners of the map that are hidden, out of the field of view or far are hardly expected.

    Parameters
    ----------
    corners
        The map's, with opening angles as signatures.
    in_sight
        (c, N) from `corners_in_sight`.
    positions
        (c, 2) metres.
    view
        The sensor's.
    cell
        Side and heading step of the cells whose middles the poses are, metres and radians; zeros for exact poses.

    Raises
    ------
    InvalidInputError
        If the corners have no opening angle, or the shapes differ.
    """

    corners: LandmarkMap
    in_sight: NDArray[np.bool_]
    positions: FloatArray
    view: FieldOfView
    cell: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        check_fields(self)
        if self.corners.kind != "number":
            raise InvalidInputError(f"corners: expected opening angles as signatures, got kind {self.corners.kind!r}")
        if self.in_sight.shape != (len(self.positions), len(self.corners)):
            raise InvalidInputError(
                f"in_sight: expected shape {(len(self.positions), len(self.corners))}, got {self.in_sight.shape}"
            )

    @classmethod
    def on(
        cls,
        grid: OccupancyGrid,
        corners: LandmarkMap,
        positions: FloatArray,
        view: FieldOfView,
        cell: tuple[float, float] = (0.0, 0.0),
    ) -> CornerLikelihood:
        """Look up which corners the map hides from which positions."""
        return cls(corners, corners_in_sight(grid, corners, positions), positions, view, cell)

    def log_likelihood(self, seen: Sequence[Corner], headings: FloatArray, noise: CornerNoise) -> FloatArray:
        """Return nats (c, h) of corners of one scan; without a corner 0.

        Parameters
        ----------
        seen
            The corners.
        headings
            (h,) radians.
        noise
            Theirs.
        """
        total: FloatArray = np.zeros((len(self.positions), len(headings)))
        if not seen:
            return total
        measured, covariances = stack_features(seen)
        variances = np.diagonal(covariances, axis1=1, axis2=2)
        deviations = noise.deviations(measured, variances, self.cell)
        clutter = noise.clutter * np.exp(noise.log_clutter(measured, 2.0 * self.view.half))
        for k in range(len(measured)):
            total += np.log(clutter[k] + self._matches(measured[k], deviations[k], headings, noise))
        total -= len(measured) * np.log(self._expected(headings, noise))
        return np.asarray(noise.exponent * total)

    def _matches(
        self, measured: FloatArray, deviations: FloatArray, headings: FloatArray, noise: CornerNoise
    ) -> FloatArray:
        """Return sum_j d_j p(f | x, j), (c, h): only pairs of position and corner at about the measured range."""
        h, reach = len(headings), CUT * noise.tail_factor * deviations
        opening = np.asarray(self.corners.signatures) - measured[2]
        matches: FloatArray = np.zeros(len(self.positions) * h)
        for j in np.flatnonzero(np.abs(opening) < reach[2]):
            away = self.corners.positions[j] - self.positions
            distance = np.hypot(away[:, 0], away[:, 1])
            near = np.flatnonzero(np.abs(distance - measured[0]) < reach[0])
            bearing = wrap_angle(np.arctan2(away[near, 1], away[near, 0])[:, None] - headings - measured[1])
            pair, heading = np.nonzero(np.abs(bearing) < reach[1])
            place = near[pair]
            residuals = np.column_stack(
                [distance[place] - measured[0], bearing[pair, heading], np.full(len(place), opening[j])]
            )
            weight = self.in_sight[place, j] * noise.visibility(distance[place]) + noise.hidden / len(self.corners)
            matches[place * h + heading] += weight * np.exp(noise.log_match(residuals, deviations))
        return matches.reshape(-1, h)

    def _expected(self, headings: FloatArray, noise: CornerNoise) -> FloatArray:
        """Return clutter + sum_j d_j, (c, h)."""
        expected: FloatArray = np.full((len(self.positions), len(headings)), noise.clutter + noise.hidden)
        for j, corner in enumerate(self.corners.positions):
            seen = np.flatnonzero(self.in_sight[:, j])
            away = corner - self.positions[seen]
            bearing = np.arctan2(away[:, 1], away[:, 0])[:, None] - headings
            expected[seen] += noise.visibility(np.hypot(*away.T))[:, None] * self.view.holds(bearing)
        return expected
