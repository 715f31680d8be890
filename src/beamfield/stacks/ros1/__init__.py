"""ROS 1's amcl."""
