"""The particle filter that a parameter file sets up: measurement model, motion model and particles."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, cast

from beamfield.errors import FormatError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.files.parameter_file import StackFile
from beamfield.stacks.files.typed_values import checked_fields, checked_values
from beamfield.stacks.filters.emulated_filter import EmulatedFilter
from beamfield.stacks.filters.loop import scans_at_ticks
from beamfield.stacks.registry import STACKS, build_filter, build_model


@dataclass(frozen=True, eq=False)
class FilterSettings:
    """All that a parameter file says about a filter; the program's defaults where it says nothing.

    Parameters
    ----------
    stack, model
        The program, and its measurement model.
    sensor, motion, particles
        Parameters of the measurement model, of the motion model, and of the filter, under the program's names.
    path
        The file; None for the program's defaults.
    """

    stack: str
    model: str
    sensor: Any
    motion: Any
    particles: Any
    path: Path | None = field(default=None, kw_only=True)

    @property
    def update_distances(self) -> tuple[float, float]:
        """How far, metres, or by how much, radians, the robot moves between two updates; 0 for both: every scan."""
        return getattr(self.particles, "update_min_d", 0.0), getattr(self.particles, "update_min_a", 0.0)

    @property
    def recovery_rates(self) -> tuple[float, float]:
        """Rates of the slow and the fast average of the weights, whose ratio says how many poses to draw at random."""
        return getattr(self.particles, "recovery_alpha_slow", 0.0), getattr(self.particles, "recovery_alpha_fast", 0.0)

    def without_recovery(self) -> FilterSettings:
        """Return the filter that draws no poses at random; only for one that has such rates."""
        return replace(self, particles=replace(self.particles, recovery_alpha_slow=0.0, recovery_alpha_fast=0.0))

    def at_ticks(self, log: SensorLog) -> SensorLog:
        """Return the scans that a filter takes which updates by the clock; all for others."""
        rate = getattr(self.particles, "rate_hz", 0.0)
        return log.select(scans_at_ticks(log, rate)) if rate > 0.0 else log

    def emulator(self, grid: OccupancyGrid) -> StackModel[Any, Any]:
        """Return the measurement model on a map, with the program's own distances where it has such."""
        kind: Any = STACKS[self.stack].model(self.model).emulator
        options = {"distance": "brushfire"} if "distance" in {item.name for item in fields(kind)} else {}
        return build_model(self.stack, self.model, grid, self.sensor, **options)

    def filter(self, grid: OccupancyGrid) -> EmulatedFilter:
        """Return the filter on a map."""
        return self.filter_with(self.emulator(grid))

    def filter_with(self, emulator: StackModel[Any, Any]) -> EmulatedFilter:
        """Return the filter with its measurement model."""
        return cast(EmulatedFilter, build_filter(self.stack, emulator, self.motion, self.particles))


def read_filter_settings(file: StackFile) -> FilterSettings:
    """Return the settings of the filter that a file asks for.

    Parameters
    ----------
    file
        From `read_stack_file`.

    Raises
    ------
    FormatError
        If a value cannot be used (names the line), or the program's filter is not emulated.
    """
    described = file.program.filter
    if described is None:
        known = ", ".join(stack.title for stack in STACKS.values() if stack.filter is not None)
        message = f"the particle filter of {file.program.title} is not emulated, only those of {known}"
        raise FormatError(file.section.path, message)
    sensor, whole = checked_values(file), file.of_filter
    motion, particles = (checked_fields(whole, kind) for kind in (described.motion, described.parameters))
    return FilterSettings(file.stack, file.model, sensor, motion, particles, path=file.section.path)
