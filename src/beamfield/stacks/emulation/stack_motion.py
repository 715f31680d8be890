"""What stacks' motion models share: parameters with a program's names that say which formula moves the particles."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike

from beamfield.geometry import FloatArray
from beamfield.models.motion import MotionModel


class StackMotion(ABC):
    """A `MotionModel` whose formula follows from parameters in a program's own names; subclasses are dataclasses."""

    @property
    @abstractmethod
    def formula(self) -> MotionModel:
        """The motion model that the program runs with these parameters."""

    def sample(self, poses: ArrayLike, odometry: ArrayLike, rng: np.random.Generator) -> FloatArray:
        """Draw where each robot is after the step; see `beamfield.models.motion.MotionModel`."""
        return self.formula.sample(poses, odometry, rng)

    def log_density(self, after: ArrayLike, before: ArrayLike, odometry: ArrayLike) -> FloatArray:
        """Return log p(after | odometry, before); see `beamfield.models.motion.MotionModel`."""
        return self.formula.log_density(after, before, odometry)
