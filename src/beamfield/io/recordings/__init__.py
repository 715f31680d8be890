"""Recordings of what happened over a log, for viewers: Rerun, and Foxglove or RViz by a bag."""
