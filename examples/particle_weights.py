"""Weigh particles by a scan: the step that a particle filter takes thousands of times.

Run: python examples/particle_weights.py
"""

from __future__ import annotations

import time

import numpy as np

import beamfield as bf

N_PARTICLES = 20_000


def main() -> None:
    """Simulate a drive, score particles around one of its poses, and compare estimate and truth."""
    rng = np.random.default_rng(0)
    grid = bf.draw_floor_plan(seed=1)
    laser = bf.RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.0)), max_range=12.0, mount=(0.25, 0.0, 0.0))
    truth = bf.BeamParameters(z_hit=0.82, z_short=0.09, z_max=0.03, z_rand=0.06, sigma_hit=0.04, lambda_short=0.5)
    log = bf.simulate_log(grid, laser, truth, duration=20.0, scan_rate=2.0, seed=3).only_sensor()

    # Neighbouring beams of real scans depend on each other: few beams and an exponent keep a filter modest.
    model = bf.BeamModel(grid, truth, n_beams=30, exponent=0.2)
    index = 25
    particles = log.poses[index] + rng.normal(0.0, [0.25, 0.25, 0.05], (N_PARTICLES, 3))
    model.log_likelihood(log.scan(index), particles[:10])  # compiles the kernels
    start = time.perf_counter()
    log_weights = model.log_likelihood(log.scan(index), particles)
    seconds = time.perf_counter() - start

    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    estimate = weights @ particles
    print(f"{N_PARTICLES} particles in {seconds * 1e3:.1f} ms, {1 / (weights**2).sum():.0f} effective")
    print(f"truth    x {log.poses[index, 0]:.3f} m  y {log.poses[index, 1]:.3f} m  theta {log.poses[index, 2]:.3f} rad")
    print(f"estimate x {estimate[0]:.3f} m  y {estimate[1]:.3f} m  theta {estimate[2]:.3f} rad")


if __name__ == "__main__":
    main()
