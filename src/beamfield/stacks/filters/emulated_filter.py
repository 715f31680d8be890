"""What the emulated filters share: how they are built, started and run."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beamfield.arguments import checked, keep
from beamfield.errors import InvalidInputError
from beamfield.localization.particles import normal_poses
from beamfield.localization.replay import PoseBelief, Replay
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.motion import MotionModel
from beamfield.sensors import SensorLog
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.filters.loop import Cloud, WatchCloud, run_loop
from beamfield.stacks.filters.particles import uniform_poses
from beamfield.stacks.filters.scan_weights import ScanWeights


@dataclass(frozen=True, eq=False)
class EmulatedFilter(ABC):
    """A program's particle filter on a map: a `ReplayedFilter`.

    Parameters
    ----------
    model
        The measurement model on the map.
    seen
        The map as the program reads it, whose free cells random poses are drawn from.
    motion
        Moves the particles.
    parameters
        The rest.

    Raises
    ------
    InvalidInputError
        If the map has no free cell.
    """

    model: StackModel[Any, Any]
    seen: OccupancyGrid
    motion: MotionModel
    parameters: Any
    _weights_of: ScanWeights = field(init=False, repr=False)

    def __post_init__(self) -> None:
        keep(self, _weights_of=ScanWeights(self.model))
        if not self.seen.free.any():
            raise InvalidInputError("grid: the map has no free cell, in which a robot could be")

    @checked
    def run(
        self, log: SensorLog, start: PoseBelief | None, rng: np.random.Generator, *, watch: WatchCloud | None = None
    ) -> Replay:
        """Filter a log; see `ReplayedFilter.run`.

        Parameters
        ----------
        log, start, rng
            As there.
        watch
            Called after each update with the index of its scan, the particles (n, 3) and their weights (n,).

        Raises
        ------
        TooLittleDataError
            If no scan has odometry.
        """
        scans = self.update_scans(log)
        return run_loop(log, self._cloud(start, rng), scans, watch)

    @abstractmethod
    def update_scans(self, log: SensorLog) -> list[int]:
        """Return the scans that update the particles; raise `TooLittleDataError` if no scan has odometry."""

    @abstractmethod
    def _cloud(self, start: PoseBelief | None, rng: np.random.Generator) -> Cloud:
        """Return particles around a belief, or anywhere."""


class AmclParticles:
    """What the particles of AMCL and of Beluga share: they start from a normal distribution, all alike in weight.

    Parameters
    ----------
    filtered
        Whose particles they are.
    start
        Where; None for anywhere on free cells.
    n
        How many.
    rng
        Source of all randomness.
    """

    def __init__(self, filtered: EmulatedFilter, start: PoseBelief | None, n: int, rng: np.random.Generator) -> None:
        self._rng, self._weights_of = rng, filtered._weights_of
        self._n_updates = 0
        self.poses = uniform_poses(filtered.seen, n, rng) if start is None else normal_poses(start, n, rng)
        self.weights = np.full(n, 1.0 / n)
