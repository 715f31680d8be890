"""Odometry calibrated against a trajectory: its systematic errors, and the noise of motion models."""
