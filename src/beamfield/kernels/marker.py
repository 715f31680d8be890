"""The density of a marker's image coordinates given the robot's pose: exercise 1 of section 6.10.

Notation: (u, v) is a marker's place in the image from the principal point, in pixels; the camera looks straight up, so
its place on the floor plan is a pose like the robot's.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]

TWO_PI = 2.0 * math.pi
# exp(-40) is lost beside 1 in float64.
NEGLIGIBLE = 40.0


class CameraView(NamedTuple):
    """The camera in the robot's frame, pixels per metre, and the noise.

    `log_peak_place` and `log_peak_angle` are the logarithms of the two normal densities at 0; `n_turns` is how many
    full turns to either side matter to the wrapped angle.
    """

    x: float
    y: float
    theta: float
    scale: float
    sigma_pixel: float
    sigma_angle: float
    log_peak_place: float
    log_peak_angle: float
    n_turns: int


@kernel
def fill_scan_log_density(poses: Floats, image: Floats, markers: Floats, camera: CameraView, out: Floats) -> None:
    """Fill out (n,) with the sum over detections, for poses (n, 3), image (k, 3) and the seen markers (k, 3)."""
    for i in range(len(poses)):
        x, y, theta = camera_pose(poses[i, 0], poses[i, 1], poses[i, 2], camera)
        cos, sin = math.cos(theta), math.sin(theta)
        total = 0.0
        for j in range(len(image)):
            total += detection_log_density(x, y, theta, cos, sin, image, markers, j, camera)
        out[i] = total


@kernel
def fill_detection_log_density(poses: Floats, image: Floats, markers: Floats, camera: CameraView, out: Floats) -> None:
    """Fill out (n, k) with the log density of each detection at each pose."""
    for i in range(len(poses)):
        x, y, theta = camera_pose(poses[i, 0], poses[i, 1], poses[i, 2], camera)
        cos, sin = math.cos(theta), math.sin(theta)
        for j in range(len(image)):
            out[i, j] = detection_log_density(x, y, theta, cos, sin, image, markers, j, camera)


@kernel
def camera_pose(x: float, y: float, theta: float, camera: CameraView) -> tuple[float, float, float]:
    """Return the camera's pose in the map for a robot pose."""
    cos, sin = math.cos(theta), math.sin(theta)
    return x + cos * camera.x - sin * camera.y, y + sin * camera.x + cos * camera.y, theta + camera.theta


@kernel
def detection_log_density(
    x: float, y: float, theta: float, cos: float, sin: float, image: Floats, markers: Floats, j: int, camera: CameraView
) -> float:
    """Return the log density of detection j, for the camera at (x, y, theta); a NaN angle says nothing."""
    dx, dy = markers[j, 0] - x, markers[j, 1] - y
    du = (image[j, 0] - camera.scale * (cos * dx + sin * dy)) / camera.sigma_pixel
    dv = (image[j, 1] - camera.scale * (cos * dy - sin * dx)) / camera.sigma_pixel
    value: float = camera.log_peak_place - 0.5 * (du * du + dv * dv)
    if not math.isnan(image[j, 2]):
        value += wrapped_normal_log_density(image[j, 2] - markers[j, 2] + theta, camera)
    return value


@kernel
def wrapped_normal_log_density(turn: float, camera: CameraView) -> float:
    """Return the log density of a normal angle error of which only the direction is seen."""
    # Mostly one turn is enough; a remainder here costs a third of the whole density.
    if turn > math.pi:
        turn -= TWO_PI
    elif turn < -math.pi:
        turn += TWO_PI
    if abs(turn) > math.pi:
        turn %= TWO_PI
        if turn > math.pi:
            turn -= TWO_PI
    variance = camera.sigma_angle * camera.sigma_angle
    value: float = camera.log_peak_angle - 0.5 * turn * turn / variance
    # The nearest turn is taken out of the sum, so that nothing underflows.
    if TWO_PI * (math.pi - abs(turn)) < NEGLIGIBLE * variance:
        others = 0.0
        for k in range(1, camera.n_turns + 1):
            others += math.exp(-TWO_PI * k * (math.pi * k + turn) / variance)
            others += math.exp(-TWO_PI * k * (math.pi * k - turn) / variance)
        value += math.log1p(others)
    return value
