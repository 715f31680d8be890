"""Expected ranges of cones among landmarks: the nearest feature in the measurement cone (6.3.1)."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import check_fields
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses
from beamfield.kernels.landmark_cone import nearest_in_cones
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.landmarks import LandmarkMap
from beamfield.sensors import RangeFinder


@dataclass(frozen=True, eq=False)
class LandmarkCones:
    """Finds the nearest landmark in a cone: the expected range z* of a sonar in a feature-based map.

    Parameters
    ----------
    landmarks
        The map.
    radius
        Radius of the landmarks, metres: one for all, or one each, (n,). A landmark of radius 0 is a point, which a cone
        sees if the direction to it is in the cone or on its edge. A round one is seen as soon as a part of it is in the
        cone, and its range is that of its nearest point in the cone.

    Raises
    ------
    InvalidInputError
        If a radius is negative or not finite, or there are neither one nor n of them.

    Notes
    -----
    Landmarks do not hide each other: what is nearer in a cone is what a sonar hears. Every landmark is looked at, about
    4 ns each. A beam without opening angle meets round landmarks only.

    References
    ----------
    Probabilistic Robotics, section 6.3.1: in feature-based maps, the closest feature within a measurement cone.

    Examples
    --------
    >>> posts = LandmarkCones(LandmarkMap([[2.0, 0.2], [1.0, 1.0]]), radius=0.1)
    >>> finder = RangeFinder.from_bearings([0.0, np.pi / 4], max_range=5.0, opening_angle=0.4)
    >>> posts.expected_ranges([0.0, 0.0, 0.0], finder).round(3).tolist()
    [1.91, 1.314]
    """

    landmarks: LandmarkMap
    radius: ArrayLike = 0.0
    _discs: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_fields(self)
        radius = np.asarray(self.radius, dtype=np.float64)
        n = len(self.landmarks)
        if radius.shape not in ((), (n,)):
            raise InvalidInputError(f"radius: expected one number or {n}, got shape {radius.shape}")
        wrong = ~((radius >= 0.0) & np.isfinite(radius))
        if wrong.any():
            raise InvalidInputError(f"radius: expected finite metres >= 0, got {radius[wrong].flat[0]}")
        object.__setattr__(self, "_discs", np.column_stack([self.landmarks.positions, np.broadcast_to(radius, n)]))

    def expected_ranges(self, poses: ArrayLike, finder: RangeFinder) -> FloatArray:
        """Return the expected range z* of every cone of a sensor at every pose.

        Parameters
        ----------
        poses
            (..., 3) robot poses in the map frame, metres and radians.
        finder
            The sensor; all cones have its `opening_angle`.

        Returns
        -------
        (..., k) metres in [0, finder.max_range]; max_range if there is no landmark in the cone, 0 inside one.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        robots = as_poses(poses)
        k = finder.n_beams
        ranges: FloatArray = np.empty((*robots.shape[:-1], k))
        rows = np.require(robots.reshape(-1, 3), requirements=["C", "W"])
        results = ranges.reshape(len(rows), k)
        mounts = np.column_stack([finder.mounts[:, :2], np.cos(finder.bearings), np.sin(finder.bearings)])
        half, longest = finder.opening_angle / 2.0, float(finder.max_range)

        def work(start: int, stop: int) -> None:
            nearest_in_cones(rows[start:stop], mounts, self._discs, half, longest, results[start:stop])

        run_in_blocks(work, len(rows), work_per_row=k * len(self.landmarks))
        return ranges
