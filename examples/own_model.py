"""Write a measurement model of your own, and use it wherever beamfield takes one.

A compass and a height sensor would do; this one is a range-only beacon: z is the distance to it, with normal noise.

Run: python examples/own_model.py
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

import beamfield as bf


@dataclass(frozen=True)
class BeaconModel:
    """p(z | x, m) of a distance to a beacon at (x, y), with standard deviation sigma, all in metres."""

    x: float
    y: float
    sigma: float
    is_normalized: bool = True

    def log_likelihood(self, z: float, poses: ArrayLike) -> np.ndarray:
        """Return log p(z | x, m) at poses (..., 3), shape (...)."""
        robots = np.asarray(poses)
        off = (z - np.hypot(robots[..., 0] - self.x, robots[..., 1] - self.y)) / self.sigma
        return -0.5 * off**2 - np.log(self.sigma * np.sqrt(2.0 * np.pi))


def main() -> None:
    """Drive past the beacon with a particle filter that knows odometry and distances only."""
    rng = np.random.default_rng(0)
    truth = np.column_stack([np.linspace(0.0, 8.0, 41), np.zeros(41), np.zeros(41)])
    beacon = BeaconModel(4.0, 3.0, sigma=0.1)
    particle_filter = bf.ParticleFilter(
        beacon, bf.GaussianMotion(), bf.localization.FilterOptions(n_particles=2000), rng=0
    )
    particle_filter.start(truth[0] + rng.normal(0.0, [0.5, 0.5, 0.1], (2000, 3)))
    for pose in truth:
        z = np.hypot(pose[0] - beacon.x, pose[1] - beacon.y) + rng.normal(0.0, beacon.sigma)
        particle_filter.update(float(z), pose)  # the odometry is right here
    print(f"truth    x {truth[-1, 0]:.2f} m  y {truth[-1, 1]:.2f} m")
    print(f"estimate x {particle_filter.pose[0]:.2f} m  y {particle_filter.pose[1]:.2f} m")


if __name__ == "__main__":
    main()
