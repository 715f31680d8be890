"""What a camera saw of coded markers, from ROS bags: its calibration, images, corners and poses of the markers."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from beamfield.arguments import require
from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.bags.bag_file import BagFile, BagMessage
from beamfield.io.files.png_pixels import DAMAGE, require_all_pixels
from beamfield.models.camera_intrinsics import CameraIntrinsics

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CORNERS = "fiducial_msgs/msg/FiducialArray"
POSES = "fiducial_msgs/msg/FiducialTransformArray"

MAX_SIDE = 16_384
MAX_PIXELS = 64 * 2**20
MAX_FIDUCIALS = 10_000
IMAGE_READERS = {b"\xff\xd8\xff": JpegImageFile, b"\x89PNG\r\n\x1a\n": PngImageFile}
NO_DISTORTION = ("", "none")


@dataclass(frozen=True, eq=False)
class FiducialDetections:
    """The markers that were found in one image.

    Parameters
    ----------
    stamp
        Of the image, seconds.
    ids
        (k,) which marker each is.
    corners
        (k, 4, 2) u, v of the corners in pixels of the delivered image, clockwise as seen in it, starting with the
        marker's own upper left one; NaN where the bag has poses only.
    positions
        (k, 3) centre in the camera's optical frame (x right, y down, z forward), metres; NaN where the bag has corners
        only.
    rotations
        (k, 4) camera_from_marker as quaternion x, y, z, w; NaN where the bag has corners only.
    """

    stamp: float
    ids: NDArray[np.int64]
    corners: FloatArray
    positions: FloatArray
    rotations: FloatArray

    def __len__(self) -> int:
        return len(self.ids)


def read_camera(path: str | Path, topic: str | None = None) -> CameraIntrinsics:
    """Read the calibration of a camera from the sensor_msgs/CameraInfo messages of a bag.

    Parameters
    ----------
    path
        As for `beamfield.io.bags.reader.read_bag`.
    topic
        The topic; if None the only one of that type.

    Raises
    ------
    FormatError
        If there is no such message, the camera is not calibrated or has another distortion model than "plumb_bob",
        images are cut out or binned, a number makes no sense, or the messages differ from each other.
    InvalidInputError
        If the topic is not there, holds something else, or there are several to choose from.
    """
    camera: CameraIntrinsics | None = None
    with BagFile(path) as bag:
        chosen = bag.only_topic("topic", topic, CAMERA_INFO)
        for message in bag.messages([chosen]):
            with bag.quoting(message):
                found = _camera(message)
                if camera is not None and not _same(camera, found):
                    raise InvalidInputError("the calibration differs from that of earlier messages")
            camera = found
    if camera is None:
        raise FormatError(path, "the topic holds no message", field=chosen)
    return camera


def read_fiducials(path: str | Path, topic: str | None = None) -> list[FiducialDetections]:
    """Read the markers that a detector found: corners (FiducialArray) or poses (FiducialTransformArray).

    Parameters
    ----------
    path
        As for `beamfield.io.bags.reader.read_bag`. ROS 1 bags bring the definition of these types along.
    topic
        The topic; if None the only one of these types.

    Returns
    -------
    One entry per image, in the order of recording; those without any marker too.

    Raises
    ------
    FormatError
        If there is no message, an id is negative, a corner or position is not finite, a marker is behind the camera, a
        quaternion is not of length 1, or there are more than 10,000 markers; topic and message are named.
    InvalidInputError
        If the topic is not there, holds something else, or there are several to choose from.
    """
    found = []
    with BagFile(path) as bag:
        chosen = bag.only_topic("topic", topic, CORNERS, POSES)
        for message in bag.messages([chosen]):
            with bag.quoting(message):
                found.append(_with_corners(message) if message.msgtype == CORNERS else _with_poses(message))
    if not found:
        raise FormatError(path, "the topic holds no message", field=chosen)
    return found


def read_camera_images(path: str | Path, topic: str | None = None) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Yield stamps in seconds and images (rows, columns) in grey from sensor_msgs/CompressedImage, JPEG or PNG.

    Parameters
    ----------
    path
        As for `beamfield.io.bags.reader.read_bag`.
    topic
        The topic; if None the only one of that type.

    Raises
    ------
    FormatError
        If an image is neither JPEG nor PNG, is damaged, or has more than 64 million pixels; none is decoded before its
        size is known.
    InvalidInputError
        If the topic is not there, holds something else, or there are several to choose from.
    """
    with BagFile(path) as bag:
        for message in bag.messages([bag.only_topic("topic", topic, COMPRESSED_IMAGE)]):
            with bag.quoting(message):
                stamp, grey = message.stamp, _decode(bytes(message.content.data))
            yield stamp, grey


def _camera(message: BagMessage) -> CameraIntrinsics:
    content = message.content
    # ROS 1 has capital letters, ROS 2 small ones.
    matrix, distortion = (
        np.asarray(getattr(content, name if hasattr(content, name) else name.lower()), dtype=np.float64)
        for name in ("K", "D")
    )
    if not (0 < content.width <= MAX_SIDE and 0 < content.height <= MAX_SIDE):
        raise InvalidInputError(
            f"expected a width and height of 1 to {MAX_SIDE} pixels, got {content.width} x {content.height}"
        )
    if content.distortion_model in NO_DISTORTION and not distortion.any():
        distortion = np.zeros(0)
    elif content.distortion_model != "plumb_bob":
        raise InvalidInputError(f"distortion_model: expected 'plumb_bob', got {str(content.distortion_model)[:40]!r}")
    if content.binning_x > 1 or content.binning_y > 1:
        raise InvalidInputError(f"binning: expected none, got {content.binning_x} x {content.binning_y}")
    if content.roi.x_offset or content.roi.y_offset:
        raise InvalidInputError(
            f"roi: expected whole images, got an offset of {content.roi.x_offset}, {content.roi.y_offset}"
        )
    require(matrix.shape == (9,), "K", "9 numbers", matrix.size)
    if not matrix.any():
        raise InvalidInputError("K: the camera is not calibrated, all numbers are 0")
    return CameraIntrinsics(
        matrix.reshape(3, 3), distortion, np.array([content.width, content.height], dtype=np.float64)
    )


def _same(one: CameraIntrinsics, two: CameraIntrinsics) -> bool:
    names = ("matrix", "distortion", "image_size")
    return all(np.array_equal(getattr(one, name), getattr(two, name)) for name in names)


def _with_corners(message: BagMessage) -> FiducialDetections:
    fiducials, ids = _limited(message.content.fiducials)
    corners = np.array(
        [[(f.x0, f.y0), (f.x1, f.y1), (f.x2, f.y2), (f.x3, f.y3)] for f in fiducials], dtype=np.float64
    ).reshape(-1, 4, 2)
    finite = np.asarray(np.isfinite(corners.reshape(-1, 8)).all(axis=1))
    _check(finite, "finite corners", corners, ids)
    k = len(ids)
    return FiducialDetections(message.stamp, ids, corners, np.full((k, 3), np.nan), np.full((k, 4), np.nan))


def _with_poses(message: BagMessage) -> FiducialDetections:
    fiducials, ids = _limited(message.content.transforms)
    places = [f.transform.translation for f in fiducials]
    turns = [f.transform.rotation for f in fiducials]
    positions = np.array([(p.x, p.y, p.z) for p in places], dtype=np.float64).reshape(-1, 3)
    rotations = np.array([(q.x, q.y, q.z, q.w) for q in turns], dtype=np.float64).reshape(-1, 4)
    in_front = np.isfinite(positions).all(axis=1) & (positions[:, 2] > 0.0)
    _check(in_front, "a finite position in front of the camera", positions, ids)
    with np.errstate(over="ignore", invalid="ignore"):
        proper = np.abs(np.linalg.norm(rotations, axis=1) - 1.0) < 0.01
    _check(proper, "a quaternion of length 1", rotations, ids)
    return FiducialDetections(message.stamp, ids, np.full((len(ids), 4, 2), np.nan), positions, rotations)


def _limited(fiducials: list[Any]) -> tuple[list[Any], NDArray[np.int64]]:
    if len(fiducials) > MAX_FIDUCIALS:
        raise InvalidInputError(f"expected at most {MAX_FIDUCIALS} markers in an image, got {len(fiducials)}")
    ids = np.array([f.fiducial_id for f in fiducials], dtype=np.int64)
    if (ids < 0).any():
        raise InvalidInputError(f"fiducial_id: expected a number >= 0, got {ids.min()}")
    return fiducials, ids


def _check(good: NDArray[np.bool_], expected: str, values: FloatArray, ids: NDArray[np.int64]) -> None:
    if not good.all():
        i = int(np.argmin(good))
        raise InvalidInputError(f"marker {ids[i]}: expected {expected}, got {values[i].tolist()}")


def _decode(data: bytes) -> NDArray[np.uint8]:
    kind = next((reader for magic, reader in IMAGE_READERS.items() if data.startswith(magic)), None)
    if kind is None:
        raise InvalidInputError(f"expected a JPEG or PNG image, it starts with {data[:8]!r}")
    try:
        # The readers themselves, for Image.open would warn of sizes that are checked here; they warn of chunks that
        # are not needed, such as an animation that is damaged.
        file = io.BytesIO(data)
        with warnings.catch_warnings(action="ignore"), kind(file) as image:
            if image.width * image.height > MAX_PIXELS:
                raise InvalidInputError(f"expected at most {MAX_PIXELS} pixels, got {image.width} x {image.height}")
            if isinstance(image, PngImageFile):
                require_all_pixels(file, image)
            return np.asarray(image.convert("L"))
    except InvalidInputError:
        raise
    except DAMAGE as error:
        raise InvalidInputError(f"the image is damaged: {str(error)[:200]}") from error
