"""Finding the robot's pose with the measurement models."""
