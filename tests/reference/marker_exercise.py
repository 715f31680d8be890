"""Exercise 1 of section 6.10, point by point with complex numbers and no code of beamfield."""

from __future__ import annotations

import cmath
import math


def image_by_projection(marker, robot, mount, focal_length, height, principal_point):
    """Project the marker's centre and the tip of an arrow on it through a pinhole in three dimensions."""
    lens = complex(robot[0], robot[1]) + cmath.exp(1j * robot[2]) * complex(mount[0], mount[1])
    u_axis = cmath.exp(1j * (robot[2] + mount[2]))
    forward = (0.0, 0.0, 1.0)
    right = (u_axis.real, u_axis.imag, 0.0)
    down = cross(forward, right)  # rows run downwards: right, down, forward is right-handed

    def project(point: complex) -> complex:
        ray = (point.real - lens.real, point.imag - lens.imag, height)
        depth = dot(ray, forward)
        return complex(focal_length * dot(ray, right) / depth, focal_length * dot(ray, down) / depth)

    centre = complex(marker[0], marker[1])
    tip = centre + 0.1 * cmath.exp(1j * marker[2])
    place, arrow = project(centre), project(tip) - project(centre)
    return place.real + principal_point[0], place.imag + principal_point[1], math.atan2(arrow.imag, arrow.real)


def wrapped_normal_density(angle: float, sigma: float) -> float:
    """Add up the normal densities of all turns."""
    return sum(
        math.exp(-0.5 * ((angle + 2.0 * math.pi * k) / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi))
        for k in range(-40, 41)
    )


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))
