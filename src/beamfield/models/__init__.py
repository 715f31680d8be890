"""Measurement models p(z | x, m) and motion models p(x_t | u_t, x_{t-1}), one file per model."""
