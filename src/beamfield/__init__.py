"""Measurement models of probabilistic robotics: p(z | x, m) in a map, calibrated and fast."""

__version__ = "0.1.0"
