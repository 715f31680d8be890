"""Settings of a stack's filter, and their runs on stretches of a log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from beamfield.calibration.pose_windows import WindowOptions
from beamfield.localization.parallel_runs import run_each
from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import hollowed
from beamfield.sensors import SensorLog
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.fit.kept_runs import KeptRuns
from beamfield.stacks.stack import Stack

Progress = Callable[[str, int, int], None]

HOLLOW = "hollow"

# A run starts as a filter that tracks, with the windows' prior, metres and radians. From nav2's 0.5 m and 15 degrees a
# lead-in along a corridor is too short to gather particles, and errors tell of that more than of tracking.
SPREAD = WindowOptions.spread, WindowOptions.turn_spread
# Of all models that are kept, whose tables take some 20 bytes a cell.
MOST_CELLS = 50_000_000


class Key(NamedTuple):
    """What tells settings apart."""

    sensor: str
    """Name of the sensor's values: "before" for the user's."""
    motion: str
    """Name of the motion's values: "before" for the user's."""
    origin: float
    """What is added to the map's x and y origin, metres."""
    recovery: str
    """Whether poses are drawn at random when the weights drop: "before" as the user has it, or "off"."""
    solids: str = "before"
    """What is inside the map's solids: "before" as the user has it, or "hollow"."""


@dataclass(frozen=True, eq=False)
class ReplaySetting:
    """One setting of everything that is chosen: where its values come from, and all parameters."""

    key: Key
    filter: FilterSettings

    @property
    def changes_map(self) -> bool:
        """Whether the filter's map is another than the user's."""
        return bool(self.key.origin) or self.key.solids == HOLLOW

    def map_of(self, grid: OccupancyGrid) -> OccupancyGrid:
        """Return the filter's map, given the user's."""
        return shifted_map(hollowed(grid) if self.key.solids == HOLLOW else grid, self.key.origin)


class Replays:
    """Runs of settings on all stretches, none made twice."""

    def __init__(
        self, stretches: Sequence[SensorLog], grid: OccupancyGrid, n_seeds: int, first_seed: int, kept: KeptRuns
    ) -> None:
        self._stretches, self._first, self._kept = stretches, first_seed, kept
        self._run = _RunsOnStretches(grid, stretches)
        self.n_seeds = n_seeds
        self._runs: dict[Key, list[ReplayTrials]] = {}

    def of(
        self, settings: Iterable[ReplaySetting], n_seeds: int, stage: str = "", progress: Progress | None = None
    ) -> dict[Key, list[ReplayTrials]]:
        """Return the runs of settings with so many seeds on each stretch."""
        chosen = {one.key: one for one in settings}
        asked = [
            _Asked(one, i, seeds)
            for one in chosen.values()
            if (seeds := range(self._first + self._n_known(one.key), self._first + n_seeds))
            for i in range(len(self._stretches))
        ]
        # Those with the same model one after the other: of large maps few are kept.
        asked.sort(key=lambda one: one.model)
        found = {one: trials for one in asked if (trials := self._kept.find(one.key)) is not None}
        missing = [one for one in asked if one not in found]
        made = run_each(
            self._run,
            missing,
            None if progress is None or not stage else partial(progress, f"replay: {stage}"),
            lambda one, trials: self._kept.keep(one.key, trials),
        )
        found.update(zip(missing, made, strict=True))
        for one in asked:
            known = self._runs.setdefault(one.setting.key, [])
            if one.stretch < len(known):
                known[one.stretch] = _joined(known[one.stretch], found[one])
            else:
                known.append(found[one])
        return {key: [_first_of(trials, n_seeds) for trials in self._runs[key]] for key in chosen}

    def _n_known(self, key: Key) -> int:
        known = self._runs.get(key)
        return len(known[0]) if known else 0


class _Asked(NamedTuple):
    """Runs of a setting on a stretch."""

    setting: ReplaySetting
    stretch: int
    seeds: range

    @property
    def key(self) -> tuple[object, ...]:
        """What tells them from others."""
        return self.stretch, self.setting.key, self.seeds

    @property
    def model(self) -> tuple[str, float, str]:
        """What tells measurement models on their maps apart."""
        key = self.setting.key
        return key.sensor, key.origin, key.solids


class _RunsOnStretches:
    """Makes them. A model's table of a map takes as long as a run: settings with the same sensor and map share it."""

    def __init__(self, grid: OccupancyGrid, stretches: Sequence[SensorLog]) -> None:
        self._grid, self._stretches = grid, stretches
        self._emulators: dict[tuple[str, float, str], StackModel[Any, Any]] = {}

    def __getstate__(self) -> dict[str, Any]:
        # Other processes make models of large maps sooner than they get them.
        return self.__dict__ | {"_emulators": {}}

    def __call__(self, asked: _Asked) -> ReplayTrials:
        setting, i, seeds = asked
        if asked.model not in self._emulators:
            while self._emulators and (len(self._emulators) + 1) * self._grid.probability.size > MOST_CELLS:
                del self._emulators[next(iter(self._emulators))]
            self._emulators[asked.model] = setting.filter.emulator(setting.map_of(self._grid))
        replayed = setting.filter.filter_with(self._emulators[asked.model])
        return run_trials(replayed, self._stretches[i], seeds, name=f"stretch {i + 1}", spread=SPREAD)


def _first_of(trials: ReplayTrials, n: int) -> ReplayTrials:
    return replace(trials, seeds=trials.seeds[:n], errors=trials.errors[:n])


def _joined(one: ReplayTrials, other: ReplayTrials) -> ReplayTrials:
    return replace(one, seeds=one.seeds + other.seeds, errors=one.errors + other.errors)


def shifted_map(grid: OccupancyGrid, shift: float) -> OccupancyGrid:
    """Return the map with another origin."""
    return replace(grid, origin=grid.origin + np.array([shift, shift, 0.0])) if shift else grid


def half_cell_shift(stack: Stack, grid: OccupancyGrid) -> float:
    """Return what sets a map's x and y origin right for a program, metres: half a cell where it is off by that."""
    return 0.5 * grid.resolution if stack.half_cell_low and grid.origin[2] == 0.0 else 0.0
