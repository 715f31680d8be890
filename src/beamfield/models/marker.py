"""The measurement model of markers on the ceiling: exercise 1 of section 6.10 with noise."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import (
    SMALLEST,
    as_count,
    as_generator,
    check_fields,
    check_magnitude,
    checked,
    keep,
    require,
    restore,
)
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose, invert, pose_rows, wrap_angle
from beamfield.kernels.marker import NEGLIGIBLE, CameraView, fill_detection_log_density, fill_scan_log_density
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.markers import MarkerId, MarkerMap, as_ids
from beamfield.models.ceiling_camera import CeilingCamera
from beamfield.models.heading_density import HeadingDensity
from beamfield.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class MarkerDetections:
    """One measurement z: the markers found in an image.

    Parameters
    ----------
    ids
        (k,) which marker each is. An id may come more than once, as when several images are taken as one measurement.
    image
        (k, 3) u, v in pixels and theta_i in radians, any turn, in the conventions of `CeilingCamera`; NaN as angle for
        a marker of which only the place is known.
    stamp
        Seconds.

    Raises
    ------
    InvalidInputError
        If there are not as many ids as rows, a place is not finite or an angle is infinite.

    Examples
    --------
    Two markers, one of unknown direction:

    >>> len(MarkerDetections([7, "door"], [[372.2, 349.3, -1.971], [120.0, 80.5, np.nan]]))
    2
    """

    ids: Sequence[MarkerId]
    image: FloatArray
    stamp: float = 0.0

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(self, ids: Sequence[MarkerId], image: ArrayLike, stamp: float = 0.0) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        ids, image = as_ids(self.ids), np.array(self.image, dtype=np.float64, order="C")
        if not ids and image.size == 0:
            image = image.reshape(0, 3)
        require(image.shape == (len(ids), 3), "image", f"shape ({len(ids)}, 3) for {len(ids)} ids", image.shape)
        for name, row in zip(ids, image.tolist(), strict=True):
            if not np.isfinite(row[:2]).all():
                raise InvalidInputError(f"image: expected finite u and v, got {row[:2]} for marker {name!r}")
            if np.isinf(row[2]):
                raise InvalidInputError(f"image: expected a finite angle or NaN, got {row[2]} for marker {name!r}")
        keep(self, ids=ids, image=image)

    def __len__(self) -> int:
        return len(self.ids)


@checked
def image_of_corners(corners: ArrayLike) -> FloatArray:
    """Return the image coordinates (..., 3) of square markers from their corners.

    Parameters
    ----------
    corners
        (..., 4, 2) u, v in pixels without lens distortion, clockwise as seen in the image and starting with the
        marker's own upper left corner, as detectors of ArUco and AprilTag give them.

    Returns
    -------
    u, v of the marker's centre, where the diagonals cross (also if the camera tilts), and the direction of its upper
    and lower edge, radians in (-pi, pi] from +u to +v.

    Raises
    ------
    InvalidInputError
        If they are not finite (..., 4, 2), or a marker's diagonals do not cross between its corners.

    Examples
    --------
    >>> image_of_corners([[10.0, 10.0], [30.0, 10.0], [30.0, 30.0], [10.0, 30.0]]).tolist()
    [20.0, 20.0, 0.0]
    """
    given = np.asarray(corners, dtype=np.float64)
    if given.shape[-2:] != (4, 2) or not np.isfinite(given).all():
        raise InvalidInputError(f"corners: expected finite numbers of shape (..., 4, 2), got shape {given.shape}")
    a, b, c, d = np.moveaxis(given, -2, 0)
    down, up, across = c - a, d - b, b - a
    with np.errstate(divide="ignore", invalid="ignore"):
        share_down = _cross(across, up) / _cross(down, up)
        share_up = _cross(across, down) / _cross(down, up)
    crossing = (share_down > 0.0) & (share_down < 1.0) & (share_up > 0.0) & (share_up < 1.0)
    if not crossing.all():
        raise InvalidInputError(f"corners: expected a convex four-sided marker, got {given[~crossing][0].tolist()}")
    right = (b + c) - (a + d)
    place = a + share_down[..., None] * down
    angle = wrap_angle(np.arctan2(right[..., 1], right[..., 0]))
    return np.concatenate([place, angle[..., None]], axis=-1)


def _cross(one: FloatArray, two: FloatArray) -> FloatArray:
    return np.asarray(one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0])


@dataclass(frozen=True)
class MarkerParameters:
    """The noise of a marker's place and angle in the image.

    Parameters
    ----------
    sigma_pixel
        Standard deviation of u and of v, pixels.
    sigma_angle
        Standard deviation of the angle in the image, radians, at most pi. An angle that says nothing is better left out
        of the detections, as NaN.

    Raises
    ------
    InvalidInputError
        If a standard deviation is not positive and finite, or sigma_angle exceeds pi.
    """

    sigma_pixel: float
    sigma_angle: float

    def __post_init__(self) -> None:
        check_fields(self)
        check_magnitude("sigma_pixel", self.sigma_pixel)
        require(SMALLEST <= self.sigma_angle <= np.pi, "sigma_angle", "radians in (0, pi]", self.sigma_angle)


@dataclass(frozen=True, eq=False)
class MarkerModel:
    """p(z | x, m) of the markers found in the image of a camera that looks up at the ceiling.

    For each marker, the place in the image is that of `CeilingCamera.image_of` with independent normal noise on u and
    v, and the angle has normal noise of which only the direction shows::

        p(u, v, theta_i | x, m) = N(u; u*, sigma_pixel) N(v; v*, sigma_pixel)
                                  sum_k N(theta_i + 2 pi k; theta*, sigma_angle)

    The noise is independent between markers given the pose. Markers name themselves, so there is no unknown
    correspondence.

    Use it with fiducials on the ceiling (ArUco, AprilTag), where one marker gives the whole pose. Beware of two things
    that are not noise, and to which a normal density gives no quarter: a camera that tilts as the robot brakes, and a
    wrong marker pose in the map.

    Parameters
    ----------
    markers
        The map.
    parameters
        The noise.
    camera
        The camera.

    Notes
    -----
    It is a density over image coordinates of those markers that were detected: per pixel^2 and radian for each, per
    pixel^2 where the angle is NaN. That a marker is in view and is found, or not, has no probability here.

    Instances are immutable, can be pickled and may be used from several threads.

    References
    ----------
    Probabilistic Robotics, section 6.10, exercise 1; independence as in (6.39).

    Examples
    --------
    >>> camera = CeilingCamera(focal_length=500.0, height=2.5, principal_point=(320.0, 240.0))
    >>> model = MarkerModel(MarkerMap([7], [[3.5, 1.0, 0.0]]), MarkerParameters(2.0, 0.05), camera)
    >>> z = MarkerDetections([7], [[420.0, 240.0, 0.0]])
    >>> model.log_likelihood(z, [[3.0, 1.0, 0.0], [3.1, 1.0, 0.0]]).round(2).tolist()
    [-1.15, -51.15]
    """

    is_normalized: ClassVar[bool] = True

    markers: MarkerMap
    parameters: MarkerParameters
    camera: CeilingCamera

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)

    @checked
    def log_likelihood(self, z: MarkerDetections, poses: ArrayLike) -> FloatArray:
        """Return log p(z | x, m) of the detections of one image at many poses.

        Parameters
        ----------
        z
            The detections.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats; never NaN, and -inf only where float64 ends. Without detections it is 0.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), or a detected marker is not in the map.
        """
        return self._filled(fill_scan_log_density, z, as_poses(poses), ())

    def detection_log_likelihood(self, z: MarkerDetections, poses: ArrayLike) -> FloatArray:
        """Return what each detection contributes to `log_likelihood`; its sum over detections is that value.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.

        Returns
        -------
        (..., k) nats; never NaN, and -inf only where float64 ends.

        Raises
        ------
        InvalidInputError
            As for `log_likelihood`.
        """
        return self._filled(fill_detection_log_density, z, as_poses(poses), (len(z),))

    def _filled(
        self, fill: Callable[..., object], z: MarkerDetections, robot: FloatArray, each: tuple[int, ...]
    ) -> FloatArray:
        """Return what a kernel fills in at each pose, of the shape `each`."""
        rows = pose_rows(robot)
        image, seen, view = self._relative_image(z), self._seen(z), self._view()
        out: FloatArray = np.zeros((len(rows), *each))
        work_per_row = 1 + len(z)
        run_in_blocks(lambda a, b: fill(rows[a:b], image, seen, view, out[a:b]), len(rows), work_per_row=work_per_row)
        return out.reshape((*robot.shape[:-1], *each))

    @checked
    def expected(self, poses: ArrayLike) -> FloatArray:
        """Return where the image shows all markers of the map, in view or not.

        Parameters
        ----------
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (..., N, 3) u, v in pixels and theta_i in radians, without noise.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        return self.camera.image_of(self.markers.poses, as_poses(poses)[..., None, :])

    @checked
    def sample(self, poses: ArrayLike, rng: np.random.Generator | int | None = None) -> list[MarkerDetections]:
        """Draw the detections of one image at each pose.

        Parameters
        ----------
        poses
            (n, 3) robot poses, metres and radians.
        rng
            Source of randomness, a seed, or None for other numbers each time.

        Returns
        -------
        n measurements: every marker whose expected place is in the image, all markers if the camera has no
        `image_size`. Noise may carry a place over the image's edge.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        expected = self.expected(as_poses(poses).reshape(-1, 3))
        noisy = self._add_noise(expected, as_generator(rng))
        in_view = self.camera.sees(expected)
        return [
            MarkerDetections(tuple(self.markers.ids[j] for j in np.flatnonzero(seen).tolist()), image[seen])
            for seen, image in zip(in_view, noisy, strict=True)
        ]

    @checked
    def sample_poses(self, z: MarkerDetections, n: int, rng: np.random.Generator) -> FloatArray:
        """Draw robot poses from p(x | z, m) for one or more detections and a uniform prior, exactly.

        All poses have the same weight. Unlike range and bearing (Table 6.5), the places of markers in an image are a
        rotated and scaled copy of the map, with the same scale for all headings. So, with b_j a place in metres on the
        ceiling seen from the camera and R(theta) its rotation:

        - given the heading, every detection puts the camera at m_j - R(theta) b_j with the same round normal, and k of
          them at the mean of these, with 1 / k of the variance;
        - the heading has the density exp(kappa cos(theta - theta_0)) prod_j p(theta_j | theta), where kappa and theta_0
          come from how the markers lie to each other. It is drawn by rejection from a histogram that lies above it.

        Parameters
        ----------
        z
            At least one detection. With one that has NaN as angle, the robot is anywhere on a circle around the marker,
            with any heading that fits its place there; two such fix the pose.
        n
            Number of poses.
        rng
            Source of randomness.

        Returns
        -------
        (n, 3) poses, metres and radians.

        Raises
        ------
        InvalidInputError
            If z has no detection, a marker is not in the map, or n is below 0.
        """
        as_count(n, "n", least=0)
        if len(z) == 0:
            raise InvalidInputError("z: expected at least one detection, got none")
        image, seen = self._relative_image(z), self._seen(z)
        ceiling = image[:, :2] @ [1.0, 1.0j] / self.camera.scale
        markers = seen[:, :2] @ [1.0, 1.0j]
        turns = (seen[:, 2] - image[:, 2])[~np.isnan(image[:, 2])]
        sigma = self.parameters.sigma_pixel / self.camera.scale
        moment = np.sum((markers - markers.mean()) * np.conj(ceiling - ceiling.mean())) / sigma**2
        density = HeadingDensity(complex(moment), turns, float(self.parameters.sigma_angle), self._view().n_turns)
        theta = density.sample(n, rng)
        place = markers.mean() - np.exp(1j * theta) * ceiling.mean()
        place = place + rng.normal(0.0, sigma / np.sqrt(len(z)), (n, 2)) @ [1.0, 1.0j]
        lenses = np.column_stack([place.real, place.imag, wrap_angle(theta)])
        return compose(lenses, invert(self.camera.mount))

    def _add_noise(self, image: FloatArray, rng: np.random.Generator) -> FloatArray:
        p = self.parameters
        noisy = image + rng.normal(0.0, [p.sigma_pixel, p.sigma_pixel, p.sigma_angle], image.shape)
        noisy[..., 2] = wrap_angle(noisy[..., 2])
        return noisy

    def _relative_image(self, z: MarkerDetections) -> FloatArray:
        """Return image coordinates from the principal point, angles in (-pi, pi]."""
        image = np.empty((len(z), 3))
        image[:, :2] = z.image[:, :2] - self.camera.principal_point
        image[:, 2] = wrap_angle(z.image[:, 2])
        return image

    def _seen(self, z: MarkerDetections) -> FloatArray:
        """Return the poses (k, 3) of the detected markers."""
        return np.ascontiguousarray(self.markers.poses[self.markers.index_of(z.ids)])

    def _view(self) -> CameraView:
        x, y, theta = np.asarray(self.camera.mount).tolist()
        pixel, angle = float(self.parameters.sigma_pixel), float(self.parameters.sigma_angle)
        # How many turns matter: at half a turn, the k-th is exp(-2 pi^2 k (k - 1) / sigma^2) of the nearest.
        n_turns = int(np.ceil(0.5 + np.sqrt(0.25 + NEGLIGIBLE * angle**2 / (2.0 * np.pi**2))))
        constants = float(-np.log(2.0 * np.pi * pixel**2)), float(-0.5 * np.log(2.0 * np.pi * angle**2))
        return CameraView(x, y, theta, self.camera.scale, pixel, angle, *constants, n_turns)
