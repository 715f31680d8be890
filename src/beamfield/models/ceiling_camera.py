"""A camera that looks straight up at markers on the ceiling: the three answers of exercise 1, section 6.10."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import check_fields, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_mount, as_poses, between, compose, invert


@dataclass(frozen=True, eq=False)
class CeilingCamera:
    r"""A pinhole camera on the robot that looks straight up at a level ceiling.

    ::

        from the side                           the image, as cameras store it

        ceiling ====[marker]=====|====          (0, 0) ---------> u, columns
                          \      |                |
                           \     |                |        + principal point
                            \    | h              |         \
                             \   |                |          [marker]  theta_i turns
                              \  |                |                    from +u to +v
                               \ |                v
        lens     ---------------(o)----         v, rows
                                 | f            d metres on the ceiling are
        image    ----------------+--.-          d f / h pixels

        from above, as in the map: +v is 90 degrees counter-clockwise of +u

             v ^                      map_from_camera = map_from_robot (+) mount
               |                      theta_camera    = theta_robot + theta_mount
        camera o---> u
            .-----.
            |robot|---> theta_robot
            '-----'

    The image is upright, as camera drivers deliver it: columns to the right, rows downwards. (u, v, viewing direction)
    is a right-handed frame and the viewing direction is up, so nothing is mirrored: (u, v) lies on the floor plan as an
    ordinary frame that is turned against the map by theta_camera.

    Parameters
    ----------
    focal_length
        f in pixels.
    height
        h: from the lens up to the ceiling, metres.
    mount
        (3,) the camera in the robot frame: the lens in metres, and the direction of +u in radians. With the image's
        upper edge towards the robot's front it is pi/2, with the lower edge -pi/2, with the right edge 0.
    principal_point
        (2,) u and v of the point straight above the lens, pixels.
    image_size
        (2,) width and height in pixels; None for an image without bounds. It decides which markers `sees`.

    Raises
    ------
    InvalidInputError
        If the focal length, the height or the image size are not positive and finite, or the mount or the principal
        point are not finite.

    Notes
    -----
    The exercise leaves the coordinate systems to the reader; these are those of images (u right, v down) and of
    REP 103 (theta counter-clockwise seen from above). Lens distortion must be taken out before, and a tilted camera
    is another model.

    References
    ----------
    Probabilistic Robotics, section 6.10, exercise 1.

    Examples
    --------
    >>> camera = CeilingCamera(focal_length=500.0, height=2.5, principal_point=(320.0, 240.0))
    >>> camera.image_of([3.5, 1.0, 0.0], [3.0, 1.0, 0.0]).tolist()
    [420.0, 240.0, 0.0]
    """

    focal_length: float
    height: float
    mount: FloatArray | tuple[float, float, float] = (0.0, 0.0, 0.0)
    principal_point: FloatArray | tuple[float, float] = (0.0, 0.0)
    image_size: FloatArray | tuple[float, float] | None = None

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            focal_length: float,
            height: float,
            mount: ArrayLike = (0.0, 0.0, 0.0),
            principal_point: ArrayLike = (0.0, 0.0),
            image_size: ArrayLike | None = None,
        ) -> None: ...

    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        for name, unit in (("focal_length", "pixels"), ("height", "metres")):
            value = getattr(self, name)
            require(0.0 < value < np.inf, name, f"a positive, finite number of {unit}", value)
            keep(self, **{name: float(value)})
        point = _pair(self.principal_point, "principal_point")
        keep(self, mount=as_mount(self.mount), principal_point=point)
        if self.image_size is not None:
            size = _pair(self.image_size, "image_size")
            require((size > 0.0).all(), "image_size", "positive numbers of pixels", size.tolist())
            keep(self, image_size=size)

    @property
    def scale(self) -> float:
        """Pixels per metre on the ceiling, f / h."""
        return self.focal_length / self.height

    def marker_poses(self, image: ArrayLike, poses: ArrayLike) -> FloatArray:
        """Return where a marker is that shows at given image coordinates: answer (a).

        With the camera at (x_c, y_c, theta_c) and a = (u - u_0) h / f, b = (v - v_0) h / f::

            x_m = x_c + a cos theta_c - b sin theta_c
            y_m = y_c + a sin theta_c + b cos theta_c
            theta_m = theta_i + theta_c

        Parameters
        ----------
        image
            (..., 3) u, v in pixels, theta_i in radians.
        poses
            (..., 3) robot poses, metres and radians. The arguments broadcast.

        Returns
        -------
        (..., 3) marker poses in the map, metres and radians in (-pi, pi].

        Raises
        ------
        InvalidInputError
            If an argument is not finite (..., 3), or the arguments do not broadcast.
        """
        marker = self._camera_from_marker(image)
        return compose(_beside(self.map_from_camera(poses), marker, "poses and image"), marker)

    def image_of(self, markers: ArrayLike, poses: ArrayLike) -> FloatArray:
        """Return the image coordinates at which a marker shows: answer (b).

        With the camera at (x_c, y_c, theta_c) and dx = x_m - x_c, dy = y_m - y_c::

            u = u_0 + f / h ( dx cos theta_c + dy sin theta_c)
            v = v_0 + f / h (-dx sin theta_c + dy cos theta_c)
            theta_i = theta_m - theta_c

        Parameters
        ----------
        markers
            (..., 3) marker poses in the map, metres and radians.
        poses
            (..., 3) robot poses, metres and radians. The arguments broadcast.

        Returns
        -------
        (..., 3) u, v in pixels, also outside the image, and theta_i in (-pi, pi].

        Raises
        ------
        InvalidInputError
            If an argument is not finite (..., 3), or the arguments do not broadcast.
        """
        there = as_poses(markers, "markers")
        image = between(_beside(self.map_from_camera(poses), there, "poses and markers"), there)
        image[..., :2] = self.principal_point + self.scale * image[..., :2]
        return image

    def robot_poses(self, image: ArrayLike, markers: ArrayLike) -> FloatArray:
        """Return where the robot is that sees a known marker at given image coordinates: answer (c).

        theta_c = theta_m - theta_i, and with a = (u - u_0) h / f, b = (v - v_0) h / f::

            x_c = x_m - a cos theta_c + b sin theta_c
            y_c = y_m - a sin theta_c - b cos theta_c

        and the robot is at (x_c, y_c, theta_c) (+) the inverse of the mount.

        Parameters
        ----------
        image
            (..., 3) u, v in pixels, theta_i in radians.
        markers
            (..., 3) marker poses in the map, metres and radians. The arguments broadcast.

        Returns
        -------
        (..., 3) robot poses, metres and radians in (-pi, pi].

        Raises
        ------
        InvalidInputError
            If an argument is not finite (..., 3), or the arguments do not broadcast.
        """
        seen = invert(self._camera_from_marker(image))
        map_from_camera = compose(_beside(as_poses(markers, "markers"), seen, "markers and image"), seen)
        return compose(map_from_camera, invert(self.mount))

    def map_from_camera(self, poses: ArrayLike) -> FloatArray:
        """Return where the camera is in the map, and where its +u points.

        Parameters
        ----------
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (..., 3) metres and radians in (-pi, pi].

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        return compose(as_poses(poses), self.mount)

    def sees(self, image: ArrayLike) -> np.ndarray:
        """Return whether image coordinates lie in the image, [0, width) x [0, height); all do if it has no bounds.

        Parameters
        ----------
        image
            (..., 3) u, v in pixels and theta_i in radians.

        Returns
        -------
        (...) bool.

        Raises
        ------
        InvalidInputError
            If the coordinates are not finite (..., 3).
        """
        place = as_poses(image, "image")[..., :2]
        if self.image_size is None:
            return np.ones(place.shape[:-1], dtype=np.bool_)
        return np.asarray(((place >= 0.0) & (place < self.image_size)).all(axis=-1))

    def _camera_from_marker(self, image: ArrayLike) -> FloatArray:
        marker = np.array(as_poses(image, "image"))
        marker[..., :2] = (marker[..., :2] - self.principal_point) / self.scale
        return marker


def _beside(poses: FloatArray, others: FloatArray, names: str) -> FloatArray:
    """Return the poses, whose shape must broadcast with that of the others."""
    try:
        np.broadcast_shapes(poses.shape, others.shape)
    except ValueError:
        raise InvalidInputError(
            f"{names}: expected shapes that broadcast, got {poses.shape} and {others.shape}"
        ) from None
    return poses


def _pair(value: ArrayLike, name: str) -> FloatArray:
    pair = np.array(value, dtype=np.float64)
    require(pair.shape == (2,) and np.isfinite(pair).all(), name, "two finite numbers of pixels", pair.tolist())
    return pair
