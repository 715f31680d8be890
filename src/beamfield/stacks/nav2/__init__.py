"""nav2's AMCL."""
