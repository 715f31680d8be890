"""Other programs' motion models, one particle at a time, from their published sources; normals are given."""

from __future__ import annotations

from math import atan2, cos, fabs, hypot, pi, sin, sqrt


def normalize(angle):
    return atan2(sin(angle), cos(angle))


def angle_diff(a, b):
    return normalize(normalize(a) - normalize(b))


def amcl_differential(pose, odometry, alphas, normals, deviation=sqrt):
    """nav2 and ROS 1 "diff-corrected"; with deviation = identity ROS 1 "diff"."""
    a1, a2, a3, a4 = alphas
    before, after = odometry
    dx, dy = after[0] - before[0], after[1] - before[1]
    turn = angle_diff(after[2], before[2])
    trans = sqrt(dx * dx + dy * dy)
    rot1 = 0.0 if trans < 0.01 else angle_diff(atan2(dy, dx), before[2])
    rot2 = angle_diff(turn, rot1)
    noise1 = min(fabs(angle_diff(rot1, 0.0)), fabs(angle_diff(rot1, pi)))
    noise2 = min(fabs(angle_diff(rot2, 0.0)), fabs(angle_diff(rot2, pi)))
    # The programs subtract their draws: these are the draws with the other sign.
    rot1_hat = angle_diff(rot1, -normals[0] * deviation(a1 * noise1 * noise1 + a2 * trans * trans))
    trans_hat = trans + normals[1] * deviation(a3 * trans * trans + a4 * noise1 * noise1 + a4 * noise2 * noise2)
    rot2_hat = angle_diff(rot2, -normals[2] * deviation(a1 * noise2 * noise2 + a2 * trans * trans))
    x = pose[0] + trans_hat * cos(pose[2] + rot1_hat)
    y = pose[1] + trans_hat * sin(pose[2] + rot1_hat)
    return x, y, pose[2] + rot1_hat + rot2_hat


def amcl_omni(pose, odometry, factors, normals, deviation=sqrt):
    """nav2 and ROS 1; factors are those of (trans, rot) in the variances along, across and of the heading."""
    before, after = odometry
    dx, dy = after[0] - before[0], after[1] - before[1]
    trans, rot = sqrt(dx * dx + dy * dy), angle_diff(after[2], before[2])
    along, across, heading = (deviation(of_trans * trans * trans + of_rot * rot * rot) for of_trans, of_rot in factors)
    bearing = angle_diff(atan2(dy, dx), before[2]) + pose[2]
    trans_hat, strafe_hat, rot_hat = trans + along * normals[0], across * normals[1], rot + heading * normals[2]
    x = pose[0] + trans_hat * cos(bearing) + strafe_hat * sin(bearing)
    y = pose[1] + trans_hat * sin(bearing) - strafe_hat * cos(bearing)
    return x, y, pose[2] + rot_hat


def nav2_omni_factors(a1, a2, a3, a4, a5):
    return (a3, a4), (a5, a4), (a2, a1)


def ros1_omni_factors(a1, a2, a3, a4, a5):
    return (a3, a1), (a5, a1), (a2, a4)


def beluga_variance(rotation):
    delta = min(fabs(normalize(rotation)), fabs(normalize(rotation + pi)))
    return delta * delta


def se2(a, b):
    return a[0] + cos(a[2]) * b[0] - sin(a[2]) * b[1], a[1] + sin(a[2]) * b[0] + cos(a[2]) * b[1], a[2] + b[2]


def beluga_differential(pose, odometry, alphas, normals):
    a1, a2, a3, a4 = alphas
    before, after = odometry
    dx, dy = after[0] - before[0], after[1] - before[1]
    distance = hypot(dx, dy)
    first = normalize(atan2(dy, dx) - before[2]) if distance > 0.01 else 0.0
    second = normalize(after[2] - before[2] - first)
    first_hat = first + normals[0] * sqrt(a1 * beluga_variance(first) + a2 * distance**2)
    of_rotations = beluga_variance(first) + beluga_variance(second)
    distance_hat = distance + normals[1] * sqrt(a3 * distance**2 + a4 * of_rotations)
    second_hat = second + normals[2] * sqrt(a1 * beluga_variance(second) + a2 * distance**2)
    turned = se2(pose, (0.0, 0.0, first_hat))
    return se2(turned, (distance_hat, 0.0, second_hat))


def beluga_omnidirectional(pose, odometry, alphas, normals):
    a1, a2, a3, a4, a5 = alphas
    before, after = odometry
    dx, dy = after[0] - before[0], after[1] - before[1]
    distance, rotation = hypot(dx, dy), normalize(after[2] - before[2])
    first = normalize(atan2(dy, dx) - before[2]) if distance > 0.01 else 0.0
    rotation_hat = rotation + normals[2] * sqrt(a1 * beluga_variance(rotation) + a2 * distance**2)
    along = distance + normals[0] * sqrt(a3 * distance**2 + a4 * beluga_variance(rotation))
    strafe = normals[1] * sqrt(a5 * distance**2 + a4 * beluga_variance(rotation))
    turned = se2(pose, (0.0, 0.0, first))
    return se2(turned, (along, -strafe, rotation_hat - first))


def mrpt_thrun(pose, odometry, alfas, added_xy, added_phi, normals):
    a1, a2, a3, a4 = alfas
    before, after = odometry
    dx, dy = after[0] - before[0], after[1] - before[1]
    x, y = cos(before[2]) * dx + sin(before[2]) * dy, -sin(before[2]) * dx + cos(before[2]) * dy
    rot1 = atan2(y, x) if (x != 0 or y != 0) else 0.0
    trans = hypot(x, y)
    rot2 = normalize(after[2] - before[2] - rot1)
    rot1_draw = rot1 + (a1 * fabs(rot1) + a2 * trans) * normals[0]
    trans_draw = trans + (a3 * trans + a4 * (fabs(rot1) + fabs(rot2))) * normals[1]
    rot2_draw = rot2 + (a1 * fabs(rot2) + a2 * trans) * normals[2]
    # The increment is drawn in the robot's frame, and so is its noise.
    increment = (
        trans_draw * cos(rot1_draw) + added_xy * normals[3],
        trans_draw * sin(rot1_draw) + added_xy * normals[4],
        rot1_draw + rot2_draw + added_phi * normals[5],
    )
    return se2(pose, increment)


def velocity(pose, v, w, alphas, duration, normals):
    """Table 5.3."""
    a1, a2, a3, a4, a5, a6 = alphas
    v_hat = v + sqrt(a1 * v * v + a2 * w * w) * normals[0]
    w_hat = w + sqrt(a3 * v * v + a4 * w * w) * normals[1]
    gamma_hat = sqrt(a5 * v * v + a6 * w * w) * normals[2]
    x, y, theta = pose
    radius = v_hat / w_hat
    x = x - radius * sin(theta) + radius * sin(theta + w_hat * duration)
    y = y + radius * cos(theta) - radius * cos(theta + w_hat * duration)
    return x, y, theta + w_hat * duration + gamma_hat * duration


def f1tenth(pose, odometry, dispersions, normals) -> list[float]:
    """The step of odometry in the car's axes, turned into the map's; then noise of the map's axes."""
    (x0, y0, t0), (x1, y1, t1) = odometry
    ahead = cos(-t0) * (x1 - x0) - sin(-t0) * (y1 - y0)
    left = sin(-t0) * (x1 - x0) + cos(-t0) * (y1 - y0)
    moved = [
        pose[0] + cos(pose[2]) * ahead - sin(pose[2]) * left,
        pose[1] + sin(pose[2]) * ahead + cos(pose[2]) * left,
        pose[2] + t1 - t0,
    ]
    return [value + width * normal for value, width, normal in zip(moved, dispersions, normals, strict=True)]
