"""The likelihood field of one scan over the space it saw (Figure 6.11)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_floats, as_writeable, checked, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, pose_rows
from beamfield.kernels import scan_field as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.end_points import hit_points
from beamfield.maps.scan_surfaces import Fan, measured_fans
from beamfield.sensors import Scan

# Nearer than this many sigma to a surface, a point is taken to be on it.
HIT_SIGMAS = 3.0
# Surfaces further away than this many sigma add less than 1e-13 of their peak.
REACH_SIGMAS = 8.0
# Free space becomes certain this many sigma in front of what a beam measured.
MARGIN_SIGMAS = 2.0
# Cells of the index that finds what is near a point: at least this size, at most so many along an axis.
BUCKET, MAX_BUCKETS = 0.4, 512


class Category(IntEnum):
    """What a scan says about a place."""

    UNSEEN = 0
    """Occluded, beyond the range or outside the field of view: the scan says nothing."""
    FREE = 1
    """A beam passed: a surface there contradicts the scan."""
    HIT = 2
    """Within three sigma of a measured surface."""


@dataclass(frozen=True, eq=False)
class ScanField:
    """How likely another scan's end points are, by what one scan (or several) saw: Figure 6.11.

    The field has three parts, by what the scan says about a place:

    - **hit**, near a measured surface: z_hit times the normal density of the distance to it (6.33), with its constant;
    - **free**, where a beam passed: z_rand / max_range, the second part of (6.34), which is low: a surface there
      contradicts the scan;
    - **unseen**, behind what was hit, outside the field of view and along beams without return: 1 / max_range. No end
      point is punished for lying there.

    The hit part is added everywhere. The other two change from one to the other over two sigma in front of what a beam
    measured, smoothly along the beam; from beam to beam they may jump, as at the edge of a shadow.

    Surfaces are more than points: a line is fitted to the end points of neighbouring beams on one surface, and the gap
    between two of them belongs to the surface if it is at most 1 m long and not seen more grazingly than 8 degrees. Far
    walls whose end points are sparse stay walls. Lone end points, most of them random or short readings, do not part a
    wall. Distances to these lines are exact; there is no grid.

    Use `from_scan` or `from_scans`. To align scans with it, see `beamfield.localization.alignment.align`.

    Parameters
    ----------
    z_hit, z_rand
        Weights of (6.34) for what lies in seen space; they sum to 1.
    sigma_hit
        Standard deviation of the distance between an end point and the surface, metres. Both scans' noise counts.
    max_range
        The sensor's limit, metres.

    Notes
    -----
    - Not a density over z (`is_normalized` is False), like every likelihood field (6.4.1).
    - The constant of unseen places is that of 6.4.2. Like every constant it favours poses that move end points out of
      seen space if the hit part is weak: 1 / max_range lies far below a hit (a factor of 1000 for 80 m and 3 cm) and
      above z_rand / max_range.
    - A field never changes; any number of threads may use one.

    References
    ----------
    Probabilistic Robotics, section 6.4.2, Figure 6.11; 6.4.1, (6.32) to (6.34).
    """

    is_normalized: ClassVar[bool] = False

    z_hit: float
    z_rand: float
    sigma_hit: float
    max_range: float
    view: kernels.FieldView = field(repr=False)
    """The field as the kernels see it."""

    @classmethod
    @checked
    def from_scan(cls, scan: Scan, *, pose: ArrayLike = (0.0, 0.0, 0.0), z_hit: float = 0.9, z_rand: float = 0.1,
                  sigma_hit: float = 0.03, no_return: Literal["unseen", "free"] = "unseen") -> ScanField:  # fmt: skip
        """Return the field of one scan, in the robot's frame or, with the robot's pose, in the frame of the pose.

        Parameters
        ----------
        scan
            The scan. One without end points gives a field that is unseen everywhere.
        pose
            (3,) the robot's pose in the field's frame, metres and radians.
        z_hit, z_rand, sigma_hit
            As for the class.
        no_return
            Whether a beam without return saw nothing ("unseen"; dark and shiny surfaces return nothing either) or free
            space up to its limit ("free").

        Returns
        -------
        The field, with the sensor's max_range.

        Raises
        ------
        InvalidInputError
            If the weights are not positive with sum 1, sigma_hit is not positive, or the pose is not finite (3,).

        Examples
        --------
        >>> from beamfield.sensors import RangeFinder
        >>> finder = RangeFinder.from_bearings(np.radians([-1.0, 0.0, 1.0]), max_range=10.0)
        >>> field = ScanField.from_scan(Scan([2.0, 2.0, 2.0], finder))
        >>> [c.name for c in map(Category, field.category([[1.0, 0.0], [2.0, 0.0], [3.0, 0.0]]))]
        ['FREE', 'HIT', 'UNSEEN']
        """
        where, options = np.asarray(pose, np.float64)[None], {"z_hit": z_hit, "z_rand": z_rand, "sigma_hit": sigma_hit}
        return cls.from_scans([scan], where, no_return=no_return, **options)

    @classmethod
    @checked
    def from_scans(cls, scans: Sequence[Scan], poses: ArrayLike, *, z_hit: float = 0.9, z_rand: float = 0.1,
                   sigma_hit: float = 0.03, no_return: Literal["unseen", "free"] = "unseen") -> ScanField:  # fmt: skip
        """Return the field of several scans: free is what any of them saw through.

        Parameters
        ----------
        scans
            At least one.
        poses
            (n, 3) the robot's pose in the field's frame for each scan.
        z_hit, z_rand, sigma_hit, no_return
            As for `from_scan`. The limit is the longest of the sensors'.

        Returns
        -------
        The field, with the longest max_range of the sensors.

        Raises
        ------
        InvalidInputError
            As for `from_scan`, and if there is no scan or not one pose per scan.
        """
        _check_parameters(z_hit, z_rand, sigma_hit)
        require(no_return in ("unseen", "free"), "no_return", "'unseen' or 'free'", no_return)
        where = as_poses(poses)
        if not scans or where.shape != (len(scans), 3):
            raise InvalidInputError(
                f"poses: expected one per scan and at least one, got shape {where.shape} for {len(scans)} scans"
            )
        free = no_return == "free"
        fans = [fan for scan, pose in zip(scans, where, strict=True) for fan in measured_fans(scan, pose, free)]
        max_range = max(scan.finder.max_range for scan in scans)
        view = _index(fans, max(BUCKET, HIT_SIGMAS * sigma_hit), z_hit, z_rand, max_range)
        return cls(z_hit, z_rand, sigma_hit, max_range, view)

    @property
    def n_elements(self) -> int:
        """Number of line elements that the measured surfaces consist of; 0 if the field is unseen everywhere."""
        return len(self.view.elements)

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Left, bottom, right and top of the measured surfaces, metres; NaN if there is none."""
        if not self.n_elements:
            return (np.nan, np.nan, np.nan, np.nan)
        (left, bottom), (right, top) = (end(self.view.elements[:, :2], axis=0).tolist() for end in (np.min, np.max))
        return left, bottom, right, top

    def log_density(self, points: ArrayLike) -> FloatArray:
        """Return the logarithm of the field.

        Parameters
        ----------
        points
            (..., 2) metres, in the field's frame.

        Returns
        -------
        (...) always finite; log(1 / max_range) in unseen places.

        Raises
        ------
        InvalidInputError
            If the points are not finite (..., 2).
        """
        density, _, _ = self._look_up(points)
        return np.log(density)

    def distance(self, points: ArrayLike) -> FloatArray:
        """Return the distance to the nearest measured surface.

        Parameters
        ----------
        points
            (..., 2) metres, in the field's frame.

        Returns
        -------
        (...) metres; inf beyond eight sigma.

        Raises
        ------
        InvalidInputError
            If the points are not finite (..., 2).
        """
        _, distance, _ = self._look_up(points)
        return distance

    def category(self, points: ArrayLike) -> NDArray[np.int8]:
        """Return what the scan says about places.

        Parameters
        ----------
        points
            (..., 2) metres, in the field's frame.

        Returns
        -------
        (...) values of `Category`.

        Raises
        ------
        InvalidInputError
            If the points are not finite (..., 2).
        """
        _, distance, free = self._look_up(points)
        seen = np.where(free > 0.5, Category.FREE, Category.UNSEEN)
        return np.asarray(np.where(distance <= HIT_SIGMAS * self.sigma_hit, Category.HIT, seen), dtype=np.int8)

    @checked
    def log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return the sum over a scan's end points of the field's logarithm, for robot poses in the field's frame.

        Readings without return and without measurement are left out, as in Table 6.3.

        Parameters
        ----------
        z
            The scan.
        poses
            (..., 3) metres and radians.

        Returns
        -------
        (...) nats, always finite; 0 for a scan without end points.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        where = as_poses(poses)
        flat = pose_rows(where)
        points, out = hit_points(z.ranges, z.finder), np.empty(len(flat))
        reach, margin = REACH_SIGMAS * self.sigma_hit, MARGIN_SIGMAS * self.sigma_hit

        def work(start: int, stop: int) -> None:
            kernels.fill_scores(points, flat[start:stop], reach, margin, self.sigma_hit, self.view, out[start:stop])

        run_in_blocks(work, len(flat), work_per_row=len(points))
        return out.reshape(where.shape[:-1])

    def _look_up(self, points: ArrayLike) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return density, distance and free share at points."""
        where = as_floats(points, "points")
        if where.ndim == 0 or where.shape[-1] != 2 or not np.isfinite(where).all():
            raise InvalidInputError(f"points: expected finite numbers of shape (..., 2), got {where.shape}")
        flat = as_writeable(where.reshape(-1, 2))
        density, distance, free = (np.empty(len(flat)) for _ in range(3))
        reach, margin = REACH_SIGMAS * self.sigma_hit, MARGIN_SIGMAS * self.sigma_hit
        kernels.fill_field(flat, reach, margin, self.sigma_hit, self.view, density, distance, free)
        shape = where.shape[:-1]
        return density.reshape(shape), distance.reshape(shape), free.reshape(shape)


def _check_parameters(z_hit: float, z_rand: float, sigma_hit: float) -> None:
    """Refuse weights and sigmas that make no sense."""
    if not (z_hit > 0.0 and z_rand > 0.0 and abs(z_hit + z_rand - 1.0) <= 1e-9):
        raise InvalidInputError(f"z_hit, z_rand: expected positive weights with sum 1, got {z_hit} and {z_rand}")
    require(0.0 < sigma_hit < np.inf, "sigma_hit", "a positive number of metres", sigma_hit)


def _index(fans: list[Fan], bucket: float, z_hit: float, z_rand: float, max_range: float) -> kernels.FieldView:
    """Return the view of all fans, with their elements sorted into buckets."""
    elements = np.concatenate([np.empty((0, kernels.COLUMNS)), *(fan.elements for fan in fans)])
    left, bottom, rows, cols = 0.0, 0.0, 1, 1
    if len(elements):
        (left, bottom), high = elements[:, :2].min(axis=0).tolist(), elements[:, :2].max(axis=0)
        bucket = max(bucket, float(np.max(high - (left, bottom))) / MAX_BUCKETS)
        cols, rows = (int(v) + 1 for v in (high - (left, bottom)) / bucket)
    start, items = np.zeros(rows * cols + 1, np.int64), np.empty(len(elements), np.int64)
    kernels.fill_buckets(elements, left, bottom, bucket, cols, start, items)
    sizes = [len(fan.bearings) for fan in fans]

    def joint(name: str) -> FloatArray:
        return np.concatenate([np.empty(0), *(getattr(fan, name) for fan in fans)])

    return kernels.FieldView(
        elements, start, items, left, bottom, bucket, rows, cols,
        np.array([fan.origin for fan in fans]).reshape(-1, 2), np.cumsum([0, *sizes]),
        joint("bearings"), joint("passed"), joint("half_width"),
        np.concatenate([np.empty(0, np.bool_), *(fan.joined for fan in fans)]),
        z_hit, z_rand, 1.0 / max_range, z_rand / max_range,
    )  # fmt: skip
