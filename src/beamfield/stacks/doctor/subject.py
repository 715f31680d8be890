"""What the doctor looks at: a parameter file, and if there are, a map and a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from beamfield.finding import Finding, Severity
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.files.parameter_file import StackFile
from beamfield.stacks.files.typed_values import TypedValues
from beamfield.stacks.ros1.parameters import ros1_name

# What checks call a parameter, and what MRPT and F1TENTH call it where they differ from nav2.
_MRPT = {
    "z_hit": "LF_zHit", "z_rand": "LF_zRandom", "sigma_hit": "LF_stdHit", "laser_max_range": "LF_maxRange",
    "laser_likelihood_max_dist": "LF_maxCorrsDistance", "beam_step": "LF_decimation",
}  # fmt: skip
_MRPT_RAYS = {"sigma_hit": "rayTracing_stdHit", "beam_step": "rayTracing_decimation"}
_F1TENTH = {"laser_max_range": "max_range", "beam_step": "angle_step"}


@dataclass(frozen=True)
class MapFile:
    """What a map_server file says besides its cells.

    Parameters
    ----------
    name
        The file's name.
    mode
        "trinary", "scale" or "raw".
    yaw
        Of the origin, radians.
    notes
        What its reader noticed.
    between_share
        Share of the pixels between its two thresholds, without those that a map saver writes for unknown.
    """

    name: str
    mode: str = "trinary"
    yaw: float = 0.0
    notes: tuple[str, ...] = ()
    between_share: float = 0.0


@dataclass(frozen=True, eq=False)
class Subject:
    """Everything that a check may look at.

    Parameters
    ----------
    file
        The parameter file.
    typed
        Its values as the stack's parameters.
    grid, map_file
        The map and what its file says; None without.
    log
        The scans, with reference poses if it has them; None without.
    """

    file: StackFile
    typed: TypedValues
    grid: OccupancyGrid | None = None
    map_file: MapFile | None = None
    log: SensorLog | None = None

    @property
    def is_amcl(self) -> bool:
        """Whether the stack descends from amcl, and shares its models."""
        return self.file.stack in ("nav2", "ros1", "beluga")

    @property
    def is_field(self) -> bool:
        """Whether the model looks up distances to obstacles."""
        return self.file.model in ("likelihood_field", "likelihood_field_prob", "LF_Thrun")

    @property
    def parameters(self) -> Any:
        """The stack's parameters."""
        return self.typed.parameters

    def name_of(self, parameter: str) -> str:
        """Return what the file calls a parameter, given nav2's name."""
        return self.file.name_in_file(self._stack_name(parameter))

    def value(self, parameter: str) -> Any:
        """Return a parameter's value by nav2's name, a default if the file says nothing.

        None if there is no such parameter, or the file has something for it that cannot be used.
        """
        if any(item.name == self.name_of(parameter) and not item.is_clear for item in self.typed.unusable):
            return None
        return getattr(self.parameters, self._stack_name(parameter), None)

    def _stack_name(self, parameter: str) -> str:
        if self.file.stack == "ros1":
            return ros1_name(parameter)
        if self.file.stack == "mrpt":
            return (_MRPT if self.is_field else _MRPT_RAYS).get(parameter, parameter)
        if self.file.stack == "f1tenth":
            return _F1TENTH.get(parameter, parameter)
        return parameter

    def finding(
        self,
        name: str,
        severity: Severity,
        seen: str,
        why: str,
        do: str,
        *,
        parameter: str = "",
        own: str = "",
        values: Mapping[str, float] | None = None,
    ) -> Finding:
        """Return a finding; the parameter is given by nav2's name, or as `own` by the file's."""
        own = own or self.name_of(parameter)
        entry = self.file.section.entries.get(own)
        line = None if entry is None else entry.line
        return Finding(name, severity, seen, values or {}, why=why, do=do, parameter=own, line=line)
