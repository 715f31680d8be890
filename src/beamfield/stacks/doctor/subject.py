"""What the doctor looks at: a parameter file, and if there are, a map and a log."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from beamfield.finding import Finding, Severity
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.files.calibration_record import goes_with_moved_map
from beamfield.stacks.files.parameter_file import StackFile
from beamfield.stacks.files.typed_values import TypedValues
from beamfield.stacks.stack import Model, Stack


@dataclass(frozen=True)
class MapFile:
    """What a map_server file says besides its cells.

    Parameters
    ----------
    name
        The file's name.
    mode
        "trinary", "scale" or "raw".
    notes
        What its reader noticed.
    between_share
        Share of the pixels between its two thresholds, without those that a map saver writes for unknown.
    """

    name: str
    mode: str = "trinary"
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
    frames
        The robot's coordinate frames, as `ScanLog` has them.
    """

    file: StackFile
    typed: TypedValues
    grid: OccupancyGrid | None = None
    map_file: MapFile | None = None
    log: SensorLog | None = None
    frames: tuple[str, ...] = ()

    @property
    def stack(self) -> Stack:
        """The program whose file it is."""
        return self.file.program

    @property
    def model(self) -> Model:
        """The measurement model that the file chooses."""
        return self.file.described_model

    @property
    def parameters(self) -> Any:
        """The stack's parameters."""
        return self.typed.parameters

    @property
    def has_own_map(self) -> bool:
        """Whether the file says that its values go with a map for the program alone, which undoes what it misreads."""
        return goes_with_moved_map(self.file.section.text)

    def name_of(self, parameter: str) -> str:
        """Return what the file calls a parameter, given nav2's name."""
        return self.file.name_in_file(self.model.own_name(parameter))

    def value(self, parameter: str) -> Any:
        """Return a parameter's value by nav2's name, a default if the file says nothing.

        None if there is no such parameter, or the file has something for it that cannot be used.
        """
        if any(item.name == self.name_of(parameter) and not item.is_clear for item in self.typed.unusable):
            return None
        return self.model.value(self.parameters, parameter)

    def beams_used(self) -> int | None:
        """Return how many beams of a scan the file asks for; None if it does not say, or without a log not for sure."""
        asked, step = self.value("max_beams"), self.value("beam_step")
        if asked is not None or step is None or self.log is None:
            return None if asked is None else int(asked)
        return math.ceil(self.log.finder.n_beams / int(step))

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
