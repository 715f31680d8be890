"""Ways of sound by following many rays: slow, approximate, and unlike mirror images."""

from __future__ import annotations

import numpy as np


def returning_ways(
    walls: np.ndarray, sensor: np.ndarray, half: float, *, n_rays: int = 20_001, near: float = 2e-3
) -> dict[tuple[int, ...], float]:
    """Follow rays from a sensor over up to three walls, and note where they pass the sensor again from the front.

    Parameters
    ----------
    walls
        (m, 4) x0, y0, x1, y1.
    sensor
        (3,) x, y, theta.
    half
        Half the opening angle.
    n_rays
        Rays over the cone.
    near
        How closely a ray must pass the sensor, metres.

    Returns
    -------
    The length of the way by the walls that it meets in turn.
    """
    angle = sensor[2] + np.linspace(-half, half, n_rays)
    place = np.tile(sensor[:2], (n_rays, 1))
    way = np.column_stack([np.cos(angle), np.sin(angle)])
    length, history, alive = np.zeros(n_rays), [()] * n_rays, np.ones(n_rays, bool)
    found: dict[tuple[int, ...], list[tuple[float, float]]] = {}
    for order in range(4):
        hit, wall = first_hits(walls, place, way)
        if order > 0:
            to_sensor = sensor[:2] - place
            along = (to_sensor * way).sum(axis=1)
            beside = np.abs(to_sensor[:, 0] * way[:, 1] - to_sensor[:, 1] * way[:, 0])
            came_from = np.arctan2(-way[:, 1], -way[:, 0]) - sensor[2]
            front = np.abs(np.arctan2(np.sin(came_from), np.cos(came_from))) <= half
            for i in np.flatnonzero(alive & (along > 0) & (along < hit) & (beside < near) & front):
                found.setdefault(history[i], []).append((beside[i], length[i] + along[i]))
        alive &= np.isfinite(hit)
        for i in np.flatnonzero(alive):
            history[i] = (*history[i], int(wall[i]))
        reach = np.where(alive, hit, 0.0)
        length += reach
        place = place + reach[:, None] * way
        tangent = walls[wall, 2:] - walls[wall, :2]
        tangent = tangent / np.hypot(*tangent.T)[:, None]
        way = 2.0 * (way * tangent).sum(axis=1)[:, None] * tangent - way
    return {chain: min(candidates)[1] for chain, candidates in found.items()}


def first_hits(walls: np.ndarray, place: np.ndarray, way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far each ray goes to the first wall, and which that is."""
    side = walls[:, 2:] - walls[:, :2]
    between = walls[None, :, :2] - place[:, None]
    cross = way[:, None, 0] * side[None, :, 1] - way[:, None, 1] * side[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (between[..., 0] * side[None, :, 1] - between[..., 1] * side[None, :, 0]) / cross
        share = (between[..., 0] * way[:, None, 1] - between[..., 1] * way[:, None, 0]) / cross
    far = np.where((far > 1e-9) & (share >= 0.0) & (share <= 1.0), far, np.inf)
    wall = np.argmin(far, axis=1)
    return far[np.arange(len(far)), wall], wall
