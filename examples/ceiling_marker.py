"""Find a robot by markers on the ceiling: exercise 1 of the chapter, with noise.

Run: python examples/ceiling_marker.py [IMAGES.bag POSES.bag]

Two bags of the ROS package fiducials, one with CameraInfo and images, one with the poses that its detector found in
them, show the same on real images: corners are found anew by OpenCV, and answer (a) is compared with those poses.
"""

from __future__ import annotations

import sys

import numpy as np

import beamfield as bf
from beamfield.io.bags.fiducial_detections import read_camera, read_camera_images, read_fiducials
from beamfield.models.marker import image_of_corners

N_POSES = 20_000


def main() -> None:
    """Answer the exercise's questions for a simulated robot, or for a camera whose bags are given."""
    if len(sys.argv) == 3:
        look_at_bags(*sys.argv[1:])
    else:
        simulate()


def simulate() -> None:
    """Answer the three questions, then draw the poses that one marker allows, and those that all of them do."""
    rng = np.random.default_rng(0)
    # 640 x 480 pixels, 0.2 m before the robot's centre, the image's upper edge to the front, ceiling 2.4 m above.
    camera = bf.CeilingCamera(600.0, 2.4, (0.2, 0.0, np.pi / 2), (320.0, 240.0), (640.0, 480.0))
    markers = bf.MarkerMap([1, 2, 3], [[1.2, 2.0, 0.0], [2.3, 1.4, np.pi / 2], [1.9, 2.6, np.pi]])
    robot = np.array([1.5, 1.9, 0.4])

    image = camera.image_of(markers.poses[0], robot)
    print(f"(b) marker 1 shows at u {image[0]:.1f} px  v {image[1]:.1f} px  theta {image[2]:+.3f} rad")
    show("(a) that image puts the marker at", camera.marker_poses(image, robot))
    show("(c) and the robot, given the marker, at", camera.robot_poses(image, markers.poses[0]))

    model = bf.MarkerModel(markers, bf.MarkerParameters(sigma_pixel=3.0, sigma_angle=0.03), camera)
    seen = model.sample(robot[None], rng)[0]
    print(f"with noise, the image shows the markers {', '.join(map(str, seen.ids))}")
    one = bf.MarkerDetections(seen.ids[:1], seen.image[:1])
    for label, z in ((f"by marker {one.ids[0]} alone", one), ("by all of them", seen)):
        poses = model.sample_poses(z, N_POSES, rng)
        show(label, poses.mean(axis=0), poses.std(axis=0))
    show("truth", robot)


def look_at_bags(images: str, poses: str) -> None:
    """Find markers in the images of a bag and say where they are, beside what another detector said."""
    # Only for images, and no dependency of beamfield: pip install opencv-python-headless
    import cv2

    intrinsics = read_camera(images)
    others = {detections.stamp: detections for detections in read_fiducials(poses)}
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_1000))
    for stamp, grey in read_camera_images(images):
        corners, ids, _ = detector.detectMarkers(grey)
        if ids is None or stamp not in others:
            print(f"image at {stamp:.3f} s: no marker, or nothing to compare with")
            continue
        other = others[stamp]
        image = image_of_corners(intrinsics.ideal_pixels(np.array(corners)[:, 0]))
        print(f"image at {stamp:.3f} s: markers {', '.join(map(str, np.sort(ids.ravel())))}")
        for name, place in sorted(zip(ids.ravel().tolist(), image, strict=True), key=lambda pair: pair[0]):
            for position in other.positions[other.ids == name]:
                # These markers do not hang on one ceiling: each has its own height above the lens.
                camera = intrinsics.ceiling_camera(position[2])
                found = camera.marker_poses(place, np.zeros(3))
                apart = 1e3 * np.hypot(*(found[:2] - position[:2]))
                show(f"(a) marker {name}, {position[2]:.2f} m up, is at", found)
                print(f"    {apart:.1f} mm from where the other detector has it")


def show(label: str, pose: np.ndarray, deviation: np.ndarray | None = None) -> None:
    """Print a pose, and its standard deviations where there are any."""
    text = f"{label}: x {pose[0]:.3f} m  y {pose[1]:.3f} m  theta {pose[2]:+.3f} rad"
    if deviation is not None:
        text += f"  (+- {deviation[0]:.3f} m, {deviation[1]:.3f} m, {deviation[2]:.3f} rad)"
    print(text)


if __name__ == "__main__":
    main()
