"""Readings that are probably of people: much shorter than the map says, wherever in the cloud the robot is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import ndtr

from beamfield.arguments import check_fields, check_magnitude, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.localization.particles import Particles
from beamfield.localization.resampling import systematic_indices
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import Scan, usable_ranges
from beamfield.short_repr import short_repr

# Nothing is left out while the root of the summed variances of x and y is wider, metres.
WIDEST_CLOUD = 0.5
# Particles whose expected ranges are computed, drawn by weight.
N_POSES = 50


@dataclass(frozen=True, eq=False)
class ShortReadings:
    """Leaves out readings that are probably shorter than expected, under the belief (the distance filter).

    A reading z is left out if the probability that it is shorter than what the map lets expect, averaged over the
    particles, P = sum_x w_x Phi((z*(x) - z) / sigma), exceeds `probability`: with 0.99 and sigma as the noise of hits,
    where nearly all particles agree that something unknown to the map stands in the way.

    While the cloud is wide, nothing is left out: a filter that has the wrong place would leave out what contradicts it.

    Parameters
    ----------
    grid
        The map.
    sigma
        Standard deviation of a hit, metres.
    probability
        From which on a reading is left out, in (0.5, 1).

    Raises
    ------
    InvalidInputError
        If a number is out of range.

    References
    ----------
    Fox, Burgard and Thrun, "Markov localization for mobile robots in dynamic environments" (1999), section 4.2.
    """

    grid: OccupancyGrid
    sigma: float = field(default=0.1, kw_only=True)
    probability: float = field(default=0.99, kw_only=True)
    _caster: RayCaster = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        check_magnitude("sigma", self.sigma)
        require(0.5 < self.probability < 1.0, "probability", "a number between 0.5 and 1", self.probability)
        object.__setattr__(self, "_caster", RayCaster(self.grid))

    def leave_out(self, scan: Scan, belief: Particles, rng: np.random.Generator) -> Scan:
        """Return the scan with NaN for the readings that are left out.

        Parameters
        ----------
        scan
            The measurement.
        belief
            Before the measurement.
        rng
            Source of randomness, for the choice of particles.
        """
        if belief.whole.spread > WIDEST_CLOUD:
            return scan
        poses = belief.poses[systematic_indices(belief.weights, N_POSES, rng)]
        short = self.probability_short(scan, poses) > self.probability
        return Scan(np.where(short, np.nan, scan.ranges), scan.finder, scan.stamp) if short.any() else scan

    def probability_short(self, scan: Scan, poses: FloatArray) -> FloatArray:
        """Return the probability that each reading is shorter than expected, (k,): the mean over poses (n, 3).

        0 for readings without return and for those that are no measurement.

        Raises
        ------
        InvalidInputError
            If the sensor sees cones: an echo from their edge is shorter than their axis, and right.
        """
        if scan.finder.opening_angle > 0.0:
            raise InvalidInputError(
                "short readings: expected a sensor of beams, got cones of "
                f"{np.degrees(scan.finder.opening_angle):.3g} degrees; use all readings of a sonar"
            )
        ranges = usable_ranges(scan.ranges, scan.finder)
        expected = self._caster.expected_ranges(poses, scan.finder)
        probability = ndtr((expected - ranges) / self.sigma).mean(axis=0)
        return np.where(ranges < scan.finder.max_range, probability, 0.0)
