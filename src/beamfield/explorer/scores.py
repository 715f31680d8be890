"""Which model explains a scan better: scores that can be compared between models of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from beamfield.calibration.context.posterior_judge import judge_weights
from beamfield.calibration.pose_windows import WindowOptions, draw_rivals
from beamfield.geometry import FloatArray, compose
from beamfield.localization.particles import free_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan

# One scan at a time.
OPTIONS = WindowOptions(scans=1, travel=0.0, turn=0.0)


class PoseScores:
    """How well models tell the reference pose from others, by one scan.

    The score is the log of the posterior's density at the reference pose over the prior's, in nats: 0 for a model that
    says nothing, negative for one that is sure of another pose. The prior is half 0.25 m (each axis) and 0.1 rad wide
    around the reference, half anywhere on the map; the reference is off by 4 cm (each axis) and 0.01 rad itself. In the
    mean it is largest for a model that is as sure as it is right, so that exponents and other programs' weights, which
    are no densities of the scan, compare with densities.

    Parameters
    ----------
    grid
        The map, on whose free cells the robot may be elsewhere.
    """

    def __init__(self, grid: OccupancyGrid) -> None:
        self._rivals = draw_rivals(OPTIONS, grid)
        rng = np.random.default_rng(OPTIONS.seed)
        self._far = free_poses(grid, OPTIONS.far, rng) if grid.free.any() else np.empty((0, 3))

    def __call__(self, models: Sequence[Any], scan: Scan, reference: FloatArray) -> list[float]:
        """Return the score of each model for a scan and the pose (3,) where it was taken, nats."""
        near = compose(reference, self._rivals.offsets)
        poses = np.concatenate([near, self._far])
        weights = np.array([[model.log_likelihood(scan, poses) for model in models]])
        return [float(one.log_score[0]) for one in judge_weights(weights, len(near), self._rivals)]
