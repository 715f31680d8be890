"""What ``beamfield localize`` keeps of a filter's updates, to be looked at."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.localization.resampling import systematic_indices

if TYPE_CHECKING:
    from beamfield.localization.particle_filter import Update

# Particles kept of an update, at most; of them in a file; pictures of an animation.
KEPT, IN_FILE, FRAMES = 500, 200, 150


class Film:
    """Particles over time, and how well the scans fitted.

    Parameters
    ----------
    n_scans
        Of the log.
    seed
        Of the choice of particles.
    """

    def __init__(self, n_scans: int, seed: int) -> None:
        self.particles: list[tuple[int, FloatArray]] = []
        self.log_evidence = np.full(n_scans, math.nan)
        self.effective = np.full(n_scans, math.nan)
        self._rng = np.random.default_rng(seed)

    def add(self, i: int, update: Update) -> None:
        """Keep an update of our filter by scan i."""
        self.log_evidence[i] = update.log_evidence
        self.effective[i] = update.effective
        self.add_cloud(i, update.belief.poses, update.belief.weights)

    def add_cloud(self, i: int, poses: FloatArray, weights: FloatArray) -> None:
        """Keep particles (n, 3) after scan i, chosen by their weights (n,)."""
        chosen = systematic_indices(weights, min(KEPT, len(poses)), self._rng)
        self.particles.append((i, poses[chosen]))

    @property
    def frames(self) -> list[tuple[int, FloatArray]]:
        """The particles for an animation's pictures."""
        return self.particles[:: max(1, -(-len(self.particles) // FRAMES))]

    def clouds(self, stamps: FloatArray) -> list[tuple[float, FloatArray]]:
        """Return the particles for a file, with the stamps of their scans."""
        return [(float(stamps[i]), poses[:: -(-len(poses) // IN_FILE)]) for i, poses in self.particles]
