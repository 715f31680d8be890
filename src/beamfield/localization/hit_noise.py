"""Where hits lie about a map's walls: on their face, or anywhere in the cells that are painted as occupied."""

from __future__ import annotations

import math

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.kernels.trajectory import HitNoise, Walls

# Hits are looked for this near the walls, metres, or cells if they are larger; others are not about these walls.
REACH, REACH_CELLS = 0.5, 5.0
LEAST_SIGMA = 0.01
# Weight of readings that have nothing to do with the map, relative to a hit on the wall, is kept within these.
CLUTTER_LIMITS = (0.005, 0.3)
MOST_RESIDUALS = 6_000
EM_STEPS = 25
# Nats per reading by which the faces must fit better than the middle of the cells.
CLEARLY = 0.05
SQRT_2PI = math.sqrt(2.0 * math.pi)


def painted_walls(sigma: float, clutter: float, walls: Walls) -> HitNoise:
    """Return the noise of hits whose wall stands anywhere in its painted cells; sigma is in metres.

    Clutter is how likely a reading is that has nothing to do with the map, relative to a hit.
    """
    return HitNoise(sigma, clutter, -walls.deepest, 0.5 * walls.resolution)


def stand_on_faces(signed: FloatArray, walls: Walls) -> bool:
    """Return whether hits lie on the faces of the outermost cells rather than somewhere in them.

    A plan, or a simulator's map, has its walls' faces where the outermost cells end. In a map drawn from scans the wall
    stands somewhere in its painted cells, which are as wide as the poses were uncertain.
    """
    near, reach = _near(signed, walls)
    face = 0.5 * walls.resolution
    return len(near) > 0 and _fitted(near, face, face, reach)[1] > _fitted(near, 0.0, 0.0, reach)[1] + CLEARLY


def fit_hits(signed: FloatArray, walls: Walls, on_faces: bool) -> HitNoise:
    """Fit the noise of hits to signed distances (m,) of end points to the middle of the outermost cells.

    Poses are known. Hits lie on the faces of walls, or else anywhere in the painted cells.
    """
    near, reach = _near(signed, walls)
    if not len(near):
        return painted_walls(walls.resolution, CLUTTER_LIMITS[1], walls)
    face = 0.5 * walls.resolution
    return _fitted(near, face if on_faces else -walls.deepest, face, reach)[0]


def off_band(signed: FloatArray, noise: HitNoise) -> FloatArray:
    """Return how far hits lie from where they may, metres."""
    return np.asarray(np.maximum(signed - noise.high, 0.0) + np.minimum(signed - noise.low, 0.0))


def _near(signed: FloatArray, walls: Walls) -> tuple[FloatArray, float]:
    """Return the distances of end points that may be hits, not too many, and how far that is."""
    reach = max(REACH, REACH_CELLS * walls.resolution)
    near = signed[np.abs(signed) < reach]
    return near[:: max(1, len(near) // MOST_RESIDUALS)], reach


def _fitted(near: FloatArray, low: float, high: float, reach: float) -> tuple[HitNoise, float]:
    """Fit sigma and the share of hits by expectation maximisation; return them and the mean log-likelihood."""
    residual = off_band(near, HitNoise(1.0, 0.0, low, high))
    # In a coarse map, all clean readings may end before the plateau.
    width = max(0.0, high - max(low, float(near.min())))
    sigma, share, elsewhere = 0.1, 0.8, 0.5 / reach
    for _ in range(EM_STEPS):
        peak = share / (width + SQRT_2PI * sigma)
        hit = peak * np.exp(-0.5 * (residual / sigma) ** 2)
        weight = hit / (hit + (1.0 - share) * elsewhere)
        total = max(float(weight.sum()), 1e-9)
        square, share = float(weight @ residual**2) / total, min(total / len(near), 1.0 - 1e-6)
        sigma = _best_sigma(square, width)
    likelihood = float(np.log(hit + (1.0 - share) * elsewhere).mean())
    clutter = float(np.clip((1.0 - share) * elsewhere / peak, *CLUTTER_LIMITS))
    return HitNoise(sigma, clutter, low, high), likelihood


def _best_sigma(square: float, width: float) -> float:
    """Return the likeliest sigma of a plateau with Gaussian edges, whose mean square beyond the plateau is known."""
    sigma = LEAST_SIGMA
    for _ in range(20):
        sigma = max(LEAST_SIGMA, (square * (width / SQRT_2PI + sigma)) ** (1.0 / 3.0))
    return sigma
