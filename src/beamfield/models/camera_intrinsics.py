"""A real camera's pixels as those of the pinhole camera that the ceiling model needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import check_fields, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.models.ceiling_camera import CeilingCamera

# Fixed-point steps that take lens distortion out; five are enough for ordinary lenses.
MAX_STEPS = 50
# Of normalised image coordinates: a ten thousandth of a pixel.
TOLERANCE = 1e-7


@dataclass(frozen=True, eq=False)
class CameraIntrinsics:
    """Focal lengths, principal point and lens distortion, as a calibration gives them (sensor_msgs/CameraInfo).

    Parameters
    ----------
    matrix
        (3, 3) K: focal lengths in pixels on the diagonal, principal point in the last column.
    distortion
        (5,) k1, k2, p1, p2, k3 of the "plumb bob" model, or fewer (the rest is 0).
    image_size
        (2,) width and height in pixels.

    Raises
    ------
    InvalidInputError
        If a number is not finite, a focal length or a size is not positive, or the matrix is of another form.

    Notes
    -----
    A point (x, y) at distance 1 shows, with r^2 = x^2 + y^2, at::

        x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
        y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

    Examples
    --------
    >>> camera = CameraIntrinsics([[500.0, 0.0, 320.0], [0.0, 400.0, 240.0], [0.0, 0.0, 1.0]], (), (640.0, 480.0))
    >>> camera.ideal_pixels([420.0, 320.0]).tolist()
    [420.0, 340.0]
    """

    matrix: FloatArray
    distortion: FloatArray
    image_size: FloatArray

    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        matrix, distortion, size = (
            np.array(value, dtype=np.float64) for value in (self.matrix, self.distortion, self.image_size)
        )
        require(matrix.shape == (3, 3) and np.isfinite(matrix).all(), "matrix", "3 x 3 finite numbers", matrix.tolist())
        if matrix[0, 1] != 0.0 or matrix[1, 0] != 0.0 or matrix[2].tolist() != [0.0, 0.0, 1.0]:
            raise InvalidInputError(f"matrix: expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], got {matrix.tolist()}")
        if not (np.diag(matrix)[:2] > 0.0).all():
            raise InvalidInputError(f"matrix: expected positive focal lengths, got {np.diag(matrix)[:2].tolist()}")
        if distortion.ndim != 1 or len(distortion) > 5 or not np.isfinite(distortion).all():
            raise InvalidInputError(f"distortion: expected at most 5 finite numbers, got {distortion.tolist()}")
        if size.shape != (2,) or not ((size > 0.0) & np.isfinite(size)).all():
            raise InvalidInputError(f"image_size: expected two positive numbers of pixels, got {size.tolist()}")
        distortion = np.concatenate([distortion, np.zeros(5 - len(distortion))])
        keep(self, matrix=matrix, distortion=distortion, image_size=size)

    def ceiling_camera(self, height: float, mount: ArrayLike = (0.0, 0.0, 0.0)) -> CeilingCamera:
        """Return the pinhole camera under a ceiling `height` metres above the lens whose pixels are `ideal_pixels`.

        Parameters
        ----------
        height, mount
            As for `CeilingCamera`.

        Returns
        -------
        A camera with fx as its focal length, and the principal point and the image size of this one.

        Raises
        ------
        InvalidInputError
            As for `CeilingCamera`.
        """
        principal_point = np.array(self.matrix[:2, 2])
        return CeilingCamera(
            float(self.matrix[0, 0]), height, np.asarray(mount, dtype=np.float64), principal_point,
            np.array(self.image_size),
        )  # fmt: skip

    def ideal_pixels(self, pixels: ArrayLike) -> FloatArray:
        """Return where places of the image would be without distortion, and with fx as the focal length both ways.

        Parameters
        ----------
        pixels
            (..., 2) u, v in the image as the camera delivers it.

        Returns
        -------
        (..., 2) u, v in pixels; they may lie outside of the image.

        Raises
        ------
        InvalidInputError
            If they are not finite (..., 2), or lie so far out that the distortion has no inverse there.
        """
        given = np.asarray(pixels, dtype=np.float64)
        if given.ndim == 0 or given.shape[-1] != 2 or not np.isfinite(given).all():
            raise InvalidInputError(f"pixels: expected finite numbers of shape (..., 2), got {given.tolist()}")
        seen = (given - self.matrix[:2, 2]) / np.diag(self.matrix)[:2]
        place = seen
        for _ in range(MAX_STEPS):
            scale, shift = self._distort(place)
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                following = (seen - shift) / scale
                moved = np.abs(following - place)
            place = following
            if not moved.size or moved.max() < TOLERANCE:
                return np.asarray(self.matrix[0, 0] * place + self.matrix[:2, 2])
            if not np.isfinite(place).all():
                break
        lost = given[~(moved < TOLERANCE).all(axis=-1)]
        raise InvalidInputError(f"pixels: the distortion has no inverse at {lost[:2].tolist()}")

    def _distort(self, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the factor (..., 1) and the shift (..., 2) of the distortion."""
        k1, k2, p1, p2, k3 = self.distortion.tolist()
        x, y = place[..., 0], place[..., 1]
        square = x * x + y * y
        scale = 1.0 + square * (k1 + square * (k2 + square * k3))
        shift = np.stack(
            [2.0 * p1 * x * y + p2 * (square + 2.0 * x * x), p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y], axis=-1
        )
        return scale[..., None], shift
