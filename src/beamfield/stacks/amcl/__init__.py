"""AMCL: what nav2 and ROS 1 share."""
