"""Measurement models p(z | x, m), one file per model."""
