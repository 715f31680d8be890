"""The model of straight lines written slowly: points on lines, one line and one pose at a time; no beamfield."""

from __future__ import annotations

import math


def seen_from(line, pose):
    """Return (rho, alpha) of a mapped line in the robot's frame, by moving two of its points there."""
    (rho, alpha), (x, y, theta) = line, pose
    points = []
    for along in (-1.0, 1.0):
        px = rho * math.cos(alpha) - along * math.sin(alpha) - x
        py = rho * math.sin(alpha) + along * math.cos(alpha) - y
        points.append((math.cos(theta) * px + math.sin(theta) * py, -math.sin(theta) * px + math.cos(theta) * py))
    (x1, y1), (x2, y2) = points
    length = math.hypot(x2 - x1, y2 - y1)
    share = -(x1 * (x2 - x1) + y1 * (y2 - y1)) / length**2
    foot_x, foot_y = x1 + share * (x2 - x1), y1 + share * (y2 - y1)
    distance = math.hypot(foot_x, foot_y)
    if distance < 1e-9:  # through the robot: either normal will do
        return 0.0, math.atan2(x2 - x1, -(y2 - y1))
    return distance, math.atan2(foot_y, foot_x)


def wrapped(angle):
    return math.atan2(math.sin(angle), math.cos(angle))


def normal_density(e, t, covariance):
    (a, b), (_, c) = covariance
    determinant = a * c - b * b
    square = (c * e * e - 2.0 * b * e * t + a * t * t) / determinant
    share = math.erf(math.pi / math.sqrt(2.0 * c))
    return math.exp(-0.5 * square) / (2.0 * math.pi * math.sqrt(determinant) * share)


def line_density(measured, line, pose, covariance):
    """p(rho, alpha | line, pose): the line is expected at (r, a) and at (-r, a + pi)."""
    rho, alpha = seen_from(line, pose)
    return sum(
        normal_density(measured[0] - r, wrapped(measured[1] - a), covariance)
        for r, a in ((rho, alpha), (-rho, alpha + math.pi))
    )


def sum_over_lines(measured, lines, pose, covariance, rate, max_range):
    none = 1.0 / (2.0 * math.pi * max_range) if measured[0] <= max_range else 0.0
    mean = sum(line_density(measured, line, pose, covariance) for line in lines) / len(lines)
    return rate * none + (1.0 - rate) * mean
