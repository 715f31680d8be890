"""Sensors that measure ranges along beams or cones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import LARGEST, as_floats, check_fields, checked, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose, require_radians
from beamfield.indices import as_indices
from beamfield.short_repr import short_repr

# Metres between a sensor's limits. In less, the densities of wide hits and steep shorts cannot be told from 0 / 0.
SHORTEST_SPAN = 1e-6


@dataclass(frozen=True, eq=False)
class RangeFinder:
    """A sensor that measures ranges along beams (or cones) with fixed mounts on the robot.

    Parameters
    ----------
    mounts
        (k, 3) pose of each beam's origin and direction in the robot frame, (x, y, theta)_k,sens of (6.32), in metres
        and radians. Any order and spacing; one sensor may combine several origins (a merged scan, a sonar ring).
    max_range
        Ranges from here on mean "no return": the chapter's z_max (as a distance), in metres.
    min_range
        Ranges below mean "too close to measure", in metres.
    opening_angle
        Full width of the cone in radians; 0 for a beam.
    name
        Topic, frame or message name in the log.

    Raises
    ------
    InvalidInputError
        If the mounts are not finite (k, 3), the limits are not 0 <= min_range < max_range <= 1e9, or the opening angle
        is not in [0, pi).

    Examples
    --------
    A laser 0.25 m before the robot's centre, with 181 beams over a half circle:

    >>> bearings = np.linspace(-np.pi / 2, np.pi / 2, 181)
    >>> laser = RangeFinder.from_bearings(bearings, max_range=12.0, mount=(0.25, 0.0, 0.0))
    >>> laser.n_beams, laser.mounts[90].tolist()
    (181, [0.25, 0.0, 0.0])
    """

    mounts: FloatArray
    max_range: float
    min_range: float = 0.0
    opening_angle: float = 0.0
    name: str = ""

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            mounts: ArrayLike,
            max_range: float,
            min_range: float = 0.0,
            opening_angle: float = 0.0,
            name: str = "",
        ) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        given = as_floats(self.mounts, "mounts")
        if given.ndim != 2:
            hint = "; RangeFinder.from_bearings(bearings, max_range) takes bearings" if given.ndim == 1 else ""
            raise InvalidInputError(f"mounts: expected shape (k, 3), got {given.shape}{hint}")
        mounts = np.array(as_poses(given, "mounts"), order="C")
        # Whole numbers would be another type to the compiler.
        limits = {name: float(getattr(self, name)) for name in ("max_range", "min_range", "opening_angle")}
        keep(self, mounts=mounts, **limits)
        if not (0.0 <= self.min_range <= self.max_range - SHORTEST_SPAN and self.max_range <= LARGEST):
            raise InvalidInputError(
                f"range limits: expected 0 <= min_range < max_range <= {LARGEST:g}, {SHORTEST_SPAN:g} m or more apart, "
                f"got min_range {self.min_range} and max_range {self.max_range}"
            )
        require(0.0 <= self.opening_angle < np.pi, "opening_angle", "[0, pi) radians", self.opening_angle)

    @classmethod
    @checked
    def from_bearings(cls, bearings: ArrayLike, max_range: float, *, mount: ArrayLike = (0.0, 0.0, 0.0),
                      **limits: Any) -> RangeFinder:  # fmt: skip
        """Build a finder whose beams start at one point.

        Parameters
        ----------
        bearings
            (k,) directions in the sensor frame, radians, counter-clockwise; any order and spacing.
        max_range
            As for the class.
        mount
            (3,) the sensor's pose in the robot frame.
        **limits
            `min_range`, `opening_angle`, `name`.

        Returns
        -------
        A finder with k beams; `bearings` are then in the robot frame, in (-pi, pi].

        Raises
        ------
        InvalidInputError
            If the bearings are not finite (k,), the mount is not a finite pose, an angle is beyond a full turn (degrees
            are, nearly always), or as for the class.
        """
        angles = as_floats(bearings, "bearings")
        require(angles.ndim == 1, "bearings", "shape (k,)", angles.shape)
        require_radians("bearings", angles)
        require_radians("heading of mount", as_poses(mount, "mount")[..., 2])
        in_sensor = np.column_stack([np.zeros_like(angles), np.zeros_like(angles), angles])
        return cls(compose(as_poses(mount, "mount"), in_sensor), max_range, **limits)

    @property
    def n_beams(self) -> int:
        """Number of beams, k."""
        return len(self.mounts)

    @property
    def bearings(self) -> FloatArray:
        """(k,) direction of each beam in the robot frame, radians."""
        return self.mounts[:, 2]

    @checked
    def subset(self, beams: ArrayLike) -> RangeFinder:
        """Return the finder with only the given beams, in the given order.

        Parameters
        ----------
        beams
            Indices, or a mask (k,).

        Returns
        -------
        The finder with the same limits and name.

        Raises
        ------
        InvalidInputError
            If the choice is neither indices that are there nor a mask of the right length.
        """
        return self._with_mounts(self.mounts[as_indices(beams, self.n_beams, "beams")])

    def _with_mounts(self, mounts: FloatArray) -> RangeFinder:
        """Return the finder with some of its own mounts, which need no check; models ask for it with each scan."""
        other = object.__new__(RangeFinder)
        other.__dict__.update(self.__dict__)
        keep(other, mounts=mounts)
        return other
