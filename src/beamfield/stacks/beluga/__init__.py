"""Beluga's AMCL."""
