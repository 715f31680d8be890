"""Find a robot by markers on the ceiling: exercise 1 of the chapter, with noise.

Run: python examples/ceiling_marker.py
"""

from __future__ import annotations

import numpy as np

from beamfield.maps.markers import MarkerMap
from beamfield.models.ceiling_camera import CeilingCamera
from beamfield.models.marker import MarkerDetections, MarkerModel

N_PARTICLES = 20_000


def main() -> None:
    """Answer the exercise's three questions, then weigh the poses that one marker allows by all of them."""
    rng = np.random.default_rng(0)
    # 640 x 480 pixels, 0.2 m before the robot's centre, the image's upper edge to the front, ceiling 2.4 m above.
    camera = CeilingCamera(600.0, 2.4, (0.2, 0.0, np.pi / 2), (320.0, 240.0), (640.0, 480.0))
    markers = MarkerMap([1, 2, 3], [[1.2, 2.0, 0.0], [2.3, 1.4, np.pi / 2], [1.9, 2.6, np.pi]])
    robot = np.array([1.5, 1.9, 0.4])

    image = camera.image_of(markers.poses[0], robot)
    print(f"(b) marker 1 shows at u {image[0]:.1f} px  v {image[1]:.1f} px  theta {image[2]:+.3f} rad")
    show("(a) that image puts the marker at", camera.marker_poses(image, robot))
    show("(c) and the robot, given the marker, at", camera.robot_poses(image, markers.poses[0]))

    model = MarkerModel(markers, camera, sigma_pixel=3.0, sigma_angle=0.03)
    seen = model.sample(robot[None], rng)[0]
    print(f"with noise, the image shows the markers {', '.join(map(str, seen.ids))}")
    one = MarkerDetections(seen.ids[:1], seen.image[:1])
    others = MarkerDetections(seen.ids[1:], seen.image[1:])
    poses = model.sample_poses(one, N_PARTICLES, rng)
    show(f"by marker {one.ids[0]} alone", poses.mean(axis=0), poses.std(axis=0))
    log_weights = model.log_likelihood(others, poses)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    mean = weights @ poses
    show("by all of them", mean, np.sqrt(weights @ (poses - mean) ** 2))
    show("truth", robot)


def show(label: str, pose: np.ndarray, deviation: np.ndarray | None = None) -> None:
    """Print a pose, and its standard deviations where there are any."""
    text = f"{label}: x {pose[0]:.3f} m  y {pose[1]:.3f} m  theta {pose[2]:+.3f} rad"
    if deviation is not None:
        text += f"  (+- {deviation[0]:.3f} m, {deviation[1]:.3f} m, {deviation[2]:.3f} rad)"
    print(text)


if __name__ == "__main__":
    main()
