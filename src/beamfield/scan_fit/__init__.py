"""Whether a scan fits the map, and whether the robot is lost."""
