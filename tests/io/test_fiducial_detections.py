"""Camera calibrations, images and markers from bags, also from hostile ones."""

from __future__ import annotations

import io
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.PngImagePlugin import PngImageFile
from rosbags.typesys import get_types_from_msg

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.bags.fiducial_detections import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    CORNERS,
    POSES,
    read_camera,
    read_camera_images,
    read_fiducials,
)
from tests.io.mini_bag import MiniBag, types_of
from tests.io.test_map_image import png_with_header

DEFINITIONS = {
    "fiducial_msgs/msg/Fiducial": "int32 fiducial_id\nint32 direction\n"
    + "\n".join(f"float64 {axis}{i}" for i in range(4) for axis in "xy"),
    CORNERS: "std_msgs/Header header\nint32 image_seq\nfiducial_msgs/Fiducial[] fiducials",
    "fiducial_msgs/msg/FiducialTransform": "int32 fiducial_id\ngeometry_msgs/Transform transform\n"
    "float64 image_error\nfloat64 object_error\nfloat64 fiducial_area",
    POSES: "std_msgs/Header header\nint32 image_seq\nfiducial_msgs/FiducialTransform[] transforms",
}
K = (500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0)
SQUARE = (10.0, 20.0, 30.0, 20.0, 30.0, 40.0, 10.0, 40.0)


class CameraBag(MiniBag):
    """A small bag of a camera."""

    def __init__(self, storage: str = "ros1") -> None:
        super().__init__(storage)
        for name, text in DEFINITIONS.items():
            self.types.register(get_types_from_msg(text, name))

    def camera(self, stamp: float = 1.0, *, matrix=K, distortion=(0.1, -0.2, 0.0, 0.001, 0.0), width=640, height=480,
               model="plumb_bob", topic="/camera_info", binning=0, offset=0) -> CameraBag:  # fmt: skip
        letters = "KDRP" if self.ros1 else "kdrp"
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=offset, y_offset=0, height=0, width=0, do_rectify=False
        )
        values = (np.array(matrix), np.array(distortion), np.eye(3).ravel(), np.zeros(12))
        message = self.make(
            CAMERA_INFO, header=self.header(stamp, "camera"), height=height, width=width, distortion_model=model,
            binning_x=binning, binning_y=0, roi=roi, **dict(zip(letters, values, strict=True)),
        )  # fmt: skip
        return self.add(topic, CAMERA_INFO, message, stamp)

    def corners(self, stamp: float, *markers, topic="/fiducial_vertices") -> CameraBag:
        names = [f"{axis}{i}" for i in range(4) for axis in "xy"]
        fiducials = [
            self.make("fiducial_msgs/msg/Fiducial", fiducial_id=name, direction=0,
                      **dict(zip(names, values, strict=True)))
            for name, values in markers
        ]  # fmt: skip
        message = self.make(CORNERS, header=self.header(stamp, "camera"), image_seq=3, fiducials=fiducials)
        return self.add(topic, CORNERS, message, stamp)

    def poses(self, stamp: float, *markers) -> CameraBag:
        transforms = []
        for name, (x, y, z), (qx, qy, qz, qw) in markers:
            transform = self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                rotation=self.make("geometry_msgs/msg/Quaternion", x=qx, y=qy, z=qz, w=qw),
            )
            transforms.append(
                self.make("fiducial_msgs/msg/FiducialTransform", fiducial_id=name, transform=transform,
                          image_error=0.1, object_error=0.1, fiducial_area=9.0)
            )  # fmt: skip
        message = self.make(POSES, header=self.header(stamp, "camera"), image_seq=3, transforms=transforms)
        return self.add("/fiducial_transforms", POSES, message, stamp)

    def image(self, stamp: float, data: bytes) -> CameraBag:
        message = self.make(
            COMPRESSED_IMAGE, header=self.header(stamp, "camera"), format="jpg", data=np.frombuffer(data, np.uint8)
        )
        return self.add("/image/compressed", COMPRESSED_IMAGE, message, stamp)


def picture(kind: str, grey: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(grey).save(buffer, kind)
    return buffer.getvalue()


@pytest.mark.parametrize("storage", ["ros1", "mcap"])
def test_calibration_corners_poses_and_images_are_read(tmp_path, storage):
    grey = np.arange(48, dtype=np.uint8).reshape(6, 8)
    bag = CameraBag(storage).camera(1.0).camera(2.0)
    bag.corners(1.5, (7, SQUARE), (9, tuple(2 * v for v in SQUARE))).corners(2.5)
    bag.poses(1.5, (7, (0.1, -0.2, 2.4), (1.0, 0.0, 0.0, 0.0))).image(3.25, picture("PNG", grey))
    path = bag.write(tmp_path)

    camera = read_camera(path)
    assert camera.matrix.ravel().tolist() == list(K)
    assert camera.distortion.tolist() == [0.1, -0.2, 0.0, 0.001, 0.0]
    assert camera.image_size.tolist() == [640.0, 480.0]
    two, none = read_fiducials(path, "fiducial_vertices")
    assert (two.stamp, two.ids.tolist(), len(none)) == (1.5, [7, 9], 0)
    assert two.corners[0].tolist() == [[10.0, 20.0], [30.0, 20.0], [30.0, 40.0], [10.0, 40.0]]
    assert np.isnan(two.positions).all()
    assert none.corners.shape == (0, 4, 2)
    [posed] = read_fiducials(path, "/fiducial_transforms")
    assert (posed.ids.tolist(), posed.positions.tolist()) == ([7], [[0.1, -0.2, 2.4]])
    assert posed.rotations.tolist() == [[1.0, 0.0, 0.0, 0.0]]
    assert np.isnan(posed.corners).all()
    [(stamp, image)] = read_camera_images(path)
    assert stamp == 3.25
    np.testing.assert_array_equal(image, grey)


def test_a_jpeg_in_colour_becomes_grey(tmp_path):
    colour = np.full((16, 16, 3), 128, dtype=np.uint8)
    [(_, image)] = read_camera_images(CameraBag().image(1.0, picture("JPEG", colour)).write(tmp_path))
    assert image.shape == (16, 16)
    assert np.abs(image.astype(int) - 128).max() <= 2


def test_a_camera_without_distortion_may_have_no_model(tmp_path):
    path = CameraBag().camera(model="", distortion=()).write(tmp_path)
    assert read_camera(path).distortion.tolist() == [0.0] * 5


BAD_CAMERAS = {
    "not calibrated": ({"matrix": (0.0,) * 9}, "K: the camera is not calibrated"),
    "nan": ({"matrix": (np.nan, *K[1:])}, r"matrix: expected 3 x 3 finite numbers, got \[\[nan"),
    "negative": ({"matrix": (-1.0, *K[1:])}, "matrix: expected positive focal lengths, got .-1.0, 510.0"),
    "skewed": ({"matrix": (500.0, 3.0, *K[2:])}, "matrix: expected .*fx, 0, cx.*got .*3.0"),
    "fisheye": ({"model": "equidistant"}, "distortion_model: expected 'plumb_bob', got 'equidistant'"),
    "eight": ({"distortion": (0.1,) * 8}, "distortion: expected at most 5 finite numbers, got"),
    "infinite": ({"distortion": (np.inf,)}, r"distortion: expected at most 5 finite numbers, got \[inf\]"),
    "no width": ({"width": 0}, "expected a width and height of 1 to 16384 pixels, got 0 x 480"),
    "vast": ({"height": 2**31}, "expected a width and height of 1 to 16384 pixels, got 640 x 2147483648"),
    "binned": ({"binning": 2}, "binning: expected none, got 2 x 0"),
    "cut out": ({"offset": 5}, "roi: expected whole images, got an offset of 5, 0"),
}


@pytest.mark.parametrize("case", BAD_CAMERAS)
def test_cameras_that_make_no_sense_are_refused_by_message_and_value(tmp_path, case):
    options, message = BAD_CAMERAS[case]
    path = CameraBag().camera(0.5).camera(1.0, **options).write(tmp_path)
    with pytest.raises(FormatError, match=f"/camera_info, message 2: .*{message}"):
        read_camera(path)


def test_a_calibration_that_changes_is_refused(tmp_path):
    path = CameraBag().camera(1.0).camera(2.0, matrix=(501.0, *K[1:])).write(tmp_path)
    with pytest.raises(FormatError, match="/camera_info, message 2: the calibration differs"):
        read_camera(path)


BAD_MARKERS = {
    "negative id": (lambda bag: bag.corners(1.0, (-4, SQUARE)), "fiducial_id: expected a number >= 0, got -4"),
    "nan corner": (
        lambda bag: bag.corners(1.0, (3, SQUARE), (4, (np.nan, *SQUARE[1:]))),
        r"marker 4: expected finite corners, got \[\[nan, 20.0\]",
    ),
    "nan position": (
        lambda bag: bag.poses(1.0, (3, (0.0, np.nan, 1.0), (0.0, 0.0, 0.0, 1.0))),
        r"marker 3: expected a finite position in front of the camera, got \[0.0, nan, 1.0\]",
    ),
    "behind": (
        lambda bag: bag.poses(1.0, (3, (0.0, 0.0, -1.0), (0.0, 0.0, 0.0, 1.0))),
        "marker 3: expected a finite position in front of the camera, got .*-1.0",
    ),
    "no rotation": (
        lambda bag: bag.poses(1.0, (3, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 0.0))),
        "marker 3: expected a quaternion of length 1, got",
    ),
    "infinite rotation": (
        lambda bag: bag.poses(1.0, (3, (0.0, 0.0, 1.0), (np.inf, 0.0, 0.0, 1e300))),
        "marker 3: expected a quaternion of length 1, got .inf",
    ),
    "too many": (
        lambda bag: bag.corners(1.0, *((i, SQUARE) for i in range(10_001))),
        "expected at most 10000 markers in an image, got 10001",
    ),
}


@pytest.mark.parametrize("case", BAD_MARKERS)
def test_markers_that_make_no_sense_are_refused_by_id_and_value(tmp_path, case):
    fill, message = BAD_MARKERS[case]
    with pytest.raises(FormatError, match=f"message 1: .*{message}"):
        read_fiducials(fill(CameraBag()).write(tmp_path))


BAD_IMAGES = {
    "no image": (b"GIF89a....", "expected a JPEG or PNG image, it starts with b'GIF89a"),
    "empty": (b"", "expected a JPEG or PNG image, it starts with b''"),
    "cut": (picture("PNG", np.random.default_rng(0).integers(0, 255, (90, 90), np.uint8))[:2000], "image is damaged"),
    "cut JPEG": (picture("JPEG", np.zeros((90, 90), np.uint8))[:300], "the image is damaged"),
    "only a beginning": (b"\x89PNG\r\n\x1a\n", "the image is damaged"),
}


@pytest.mark.parametrize("case", BAD_IMAGES)
def test_damaged_images_are_refused(tmp_path, case):
    data, message = BAD_IMAGES[case]
    with pytest.raises(FormatError, match=f"/image/compressed, message 1: .*{message}"):
        list(read_camera_images(CameraBag().image(1.0, data).write(tmp_path)))


def test_a_damaged_animation_is_left_out_in_silence(tmp_path):
    grey = np.arange(64, dtype=np.uint8).reshape(8, 8)
    content = picture("PNG", grey)
    chunk = b"acTL" + bytes(8)
    animated = content[:33] + (8).to_bytes(4, "big") + chunk + zlib.crc32(chunk).to_bytes(4, "big") + content[33:]
    ((_, found),) = read_camera_images(CameraBag().image(1.0, animated).write(tmp_path))
    np.testing.assert_array_equal(found, grey)


def test_a_bomb_is_refused_before_it_is_decoded(tmp_path):
    """A PNG of a few kilobytes that claims a gigapixel."""
    small = bytearray(picture("PNG", np.zeros((8, 8), np.uint8)))
    small[16:24] = (60_000).to_bytes(4, "big") * 2
    small[29:33] = zlib.crc32(small[12:29]).to_bytes(4, "big")
    with pytest.raises(FormatError, match="expected at most 67108864 pixels, got 60000 x 60000"):
        list(read_camera_images(CameraBag().image(1.0, bytes(small)).write(tmp_path)))


def test_a_png_with_missing_rows_is_refused_before_room_is_made_for_it(tmp_path, monkeypatch):
    ((_, whole),) = read_camera_images(
        CameraBag().image(1.0, png_with_header(3, 2, 8, 0, b"\0abc\0def")).write(tmp_path, "whole")
    )
    assert whole.tolist() == [[97, 98, 99], [100, 101, 102]]
    monkeypatch.setattr(PngImageFile, "load", lambda *_: pytest.fail("room was made"))
    for number, (width, height) in enumerate([(3, 3), (8000, 8000)]):
        bag = CameraBag().image(1.0, png_with_header(width, height, 8, 0, b"\0abc\0def"))
        with pytest.raises(FormatError, match=f"message 1: .*truncated, {width} x {height} pixels take"):
            list(read_camera_images(bag.write(tmp_path, str(number))))


def test_a_type_of_that_name_with_other_fields_is_refused(tmp_path):
    bag = MiniBag("ros1")
    bag.types = types_of.__wrapped__("ros1")  # not those that other bags share
    bag.types.register(get_types_from_msg("std_msgs/Header header\nint32 nothing", CORNERS))
    bag.add("/v", CORNERS, bag.make(CORNERS, header=bag.header(1.0, ""), nothing=3), 1.0)
    with pytest.raises(FormatError, match="/v, message 1: not a valid fiducial_msgs/msg/FiducialArray"):
        read_fiducials(bag.write(tmp_path))


def test_topics_are_chosen_by_name_or_are_the_only_ones(tmp_path):
    path = CameraBag().corners(1.0, topic="/a").corners(1.0, topic="/b").camera().write(tmp_path)
    with pytest.raises(InvalidInputError, match=r"several topics; choose one: the bag has '/a', '/b'"):
        read_fiducials(path)
    assert len(read_fiducials(path, "b")) == 1
    with pytest.raises(InvalidInputError, match="'/camera_info' holds sensor_msgs/msg/CameraInfo, expected fiducial"):
        read_fiducials(path, "camera_info")
    with pytest.raises(FormatError, match="no topic of type sensor_msgs/msg/CompressedImage in this bag; it has '/a'"):
        list(read_camera_images(path))
    empty = CameraBag().declare("/camera_info", CAMERA_INFO).declare("/v", CORNERS).write(tmp_path, "empty")
    with pytest.raises(FormatError, match="/camera_info: the topic holds no message"):
        read_camera(empty)
    with pytest.raises(FormatError, match="/v: the topic holds no message"):
        read_fiducials(empty)


@pytest.mark.real
def test_the_markers_of_a_real_camera(data: Path):
    folder = data / "fiducial_ceiling"
    camera = read_camera(folder / "aruco_images.bag")
    assert camera.image_size.tolist() == [1280.0, 960.0]
    assert camera.matrix[0, 0] == pytest.approx(1014.3431, abs=1e-4)
    [(stamp, image)] = read_camera_images(folder / "aruco_images.bag")
    assert image.shape == (960, 1280)
    [found] = read_fiducials(folder / "aruco_transforms.bag")
    assert found.stamp == stamp
    assert found.ids.tolist() == [103, 100, 111, 107, 112, 106, 110]
    assert found.positions[2].tolist() == pytest.approx([-0.3257, -0.0379, 1.1963], abs=1e-4)
