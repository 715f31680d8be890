"""Relocalization: a second search for a robot that is not where its filter takes it to be."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from beamfield.argument_kinds import expect
from beamfield.arguments import as_count, as_generator, checked
from beamfield.geometry import FloatArray
from beamfield.localization.coarse_model import CoarseModel
from beamfield.localization.mapped_area import MappedArea
from beamfield.localization.particle_filter import ParticleFilter, Update
from beamfield.localization.particles import free_poses, require_free
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import LEAST_AGREEMENT, agreement_at
from beamfield.maps.raycast import RayCaster
from beamfield.models.base import MeasurementModel
from beamfield.sensors import Scan

# Shares of scans that agree less than EXPECTED add up to the doubt that begins a search; more of it takes doubt away.
EXPECTED, DOUBT = 0.3, 1.0
# By so many scans' shares the other place has to be ahead, and half as many behind it is given up; at the latest after
# COMPARED scans. A search in vain costs time, hardly ever the place: scans among people agree with the map no better
# than those of a robot that is elsewhere, but with no other place either (docs/evidence/localization.md).
AHEAD, COMPARED = 2.0, 20


class Relocalizer:
    """Searches for a robot on the whole map where scans contradict the place that its filter believes in.

    The filter runs on meanwhile. A second one begins anywhere on the map, and takes over once the scans agree clearly
    better with its place than with the first one's: the share of their beams that are as long as the map says is ahead
    by 2 in the sum over scans used, and at least 45% in the mean. So a robot that is where its filter says stays there,
    however many people or moved things hide the map. Cones of a sonar are not judged.

    Parameters
    ----------
    grid
        The map.
    make
        Makes a filter like the robot's own; called for each search.
    coarse
        Weighs scans until the second filter is sure of a place; None: a `CoarseModel`.
    n_anywhere
        Particles to begin a search with.
    rng
        Source of the poses that searches begin with.

    Raises
    ------
    InvalidInputError
        If the map has no free cell, or n_anywhere < 1.

    Examples
    --------
    >>> from beamfield import LikelihoodFieldModel, draw_floor_plan
    >>> from beamfield.models.field_parameters import LikelihoodFieldParameters
    >>> from beamfield.models.gaussian_motion import GaussianMotion
    >>> grid = draw_floor_plan(seed=1)
    >>> field = LikelihoodFieldModel(grid, LikelihoodFieldParameters(0.8, 0.1, 0.1), n_beams=60, exponent=0.03)
    >>> again = Relocalizer(grid, lambda: ParticleFilter(field, GaussianMotion(), rng=1), rng=2)
    >>> again.is_searching
    False
    """

    def __init__(
        self,
        grid: OccupancyGrid,
        make: Callable[[], ParticleFilter[Scan]],
        *,
        coarse: MeasurementModel[Scan] | None = None,
        n_anywhere: int = 200_000,
        rng: np.random.Generator | int | None = None,
    ) -> None:
        for name, given, hint in (
            ("grid", grid, OccupancyGrid), ("make", make, Callable), ("coarse", coarse, MeasurementModel | None),
        ):  # fmt: skip
            expect(name, given, hint)
        require_free(grid)
        self._grid, self._make, self._given = grid, make, coarse
        self._n = as_count(n_anywhere, "n_anywhere", least=1, most=10_000_000)
        self._rng = as_generator(rng)
        self._doubt = 0.0
        self._other: ParticleFilter[Scan] | None = None
        self._shares: list[tuple[float, float]] = []

    @property
    def is_searching(self) -> bool:
        """Whether a second filter is running."""
        return self._other is not None

    @checked
    def follow(
        self,
        own: ParticleFilter[Scan],
        update: Update | None,
        scan: Scan,
        odometry: ArrayLike,
        stamp: float | None = None,
    ) -> tuple[ParticleFilter[Scan], Update | None]:
        """Return the filter to go on with, and what the scan did to it; call it after each update of the filter.

        Parameters
        ----------
        own
            The robot's filter.
        update
            What `own.update` returned for the scan.
        scan, odometry, stamp
            What `own.update` was given.

        Returns
        -------
        The filter and its update: those given, or those of the second filter where that has found the robot elsewhere.

        Raises
        ------
        InvalidInputError
            As `ParticleFilter.update`.
        """
        if scan.finder.opening_angle > 0.0 or not own.is_found:
            return own, update
        if update is not None:
            self._add_doubt(agreement_at(scan, self._caster, own.pose))
        other = self._other
        if other is None:
            return own, update
        was_found = other.is_found
        of_other = other.update(scan, odometry, stamp)
        # The scan that makes it sure of a place says nothing for the place.
        if of_other is not None and was_found and self._is_better(scan, own.pose, other.pose):
            return other, of_other
        return own, update

    def _add_doubt(self, share: float) -> None:
        """Take in how much of a scan agrees with the filter's place; begin or end a search."""
        if np.isfinite(share):
            self._doubt = max(0.0, self._doubt + EXPECTED - share)
        if self._doubt == 0.0:
            self._other = None
        elif self._other is None and self._doubt > DOUBT:
            self._other, self._shares = self._make(), []
            self._other.start(free_poses(self._grid, self._n, self._rng), coarse=self._coarse)

    def _is_better(self, scan: Scan, pose: FloatArray, other_pose: FloatArray) -> bool:
        """Compare two places by one more scan: whether the other one has proved right; gives it up if it has not."""
        shares = agreement_at(scan, self._caster, pose), agreement_at(scan, self._caster, other_pose)
        # Beyond the map a scan agrees with nothing: another place has to be a good one, not just better.
        if self._area.is_beyond(pose):
            shares = float(np.fmax(shares[0], LEAST_AGREEMENT)), shares[1]
        if not np.isfinite(shares).all():
            return False
        self._shares.append(shares)
        n, (of_own, of_other) = len(self._shares), np.sum(self._shares, axis=0)
        is_better = bool(of_other - of_own > AHEAD and of_other >= LEAST_AGREEMENT * n)
        if is_better or of_other - of_own < -0.5 * AHEAD or n >= COMPARED:
            self._other, self._doubt = None, 0.0
        return is_better

    @cached_property
    def _caster(self) -> RayCaster:
        return RayCaster(self._grid)

    @cached_property
    def _area(self) -> MappedArea:
        return MappedArea(self._grid)

    @cached_property
    def _coarse(self) -> MeasurementModel[Scan]:
        return self._given or CoarseModel(self._grid)
