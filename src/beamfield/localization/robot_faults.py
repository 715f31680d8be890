"""Faults of the robot that look like slipping wheels, also at poses that its own filter made of it."""

OF_THE_ROBOT = ("odometry-sign", "laser-mount", "scan-delay")
