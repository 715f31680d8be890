"""What a log file says: the logs of its sensors, and the robot's odometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from beamfield.data_frame import data_frame
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.sensors.sensor_log import SensorLog
from beamfield.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class Track:
    """A trajectory: poses with stamps.

    Parameters
    ----------
    stamps
        (t,) seconds, not decreasing.
    poses
        (t, 3) metres and radians.
    """

    stamps: FloatArray
    poses: FloatArray

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.stamps)

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with the columns stamp, x, y and theta; needs pandas."""
        return data_frame({"stamp": self.stamps, **dict(zip(("x", "y", "theta"), self.poses.T, strict=True))})


@dataclass(frozen=True, eq=False)
class ScanLog:
    """What a log file says: one entry per sensor, the odometry at its own rate, and notes on how it was read.

    Parameters
    ----------
    sensors
        The logs of the sensors by name (message or topic name), in the order of the file.
    odometry
        The robot's odometry at its own rate; None if the log has none.
    source
        Name of the file.
    notes
        What a user should know about how the file was read; one sentence each.
    parameters
        Parameters that the file itself carries (CARMEN's PARAM lines, for example).
    frames
        Names of all coordinate frames of the robot, if the file seems to have them: its transforms that hold at all
        times, and others.
    """

    sensors: Mapping[str, SensorLog]
    odometry: Track | None = None
    source: str = ""
    notes: tuple[str, ...] = ()
    parameters: Mapping[str, str] = field(default_factory=dict)
    frames: tuple[str, ...] = ()

    __repr__ = short_repr

    def __getitem__(self, name: str) -> SensorLog:
        """Return the log of a sensor by its name."""
        if not isinstance(name, str):
            raise InvalidInputError(f"expected the name of a sensor, got {name!r}; .only_sensor()[...] chooses scans")
        return self.only_sensor(name)

    def only_sensor(self, name: str | None = None) -> SensorLog:
        """Return the sensor of that name, or the only one there is.

        Parameters
        ----------
        name
            Topic or message name; None if the log has one sensor.

        Returns
        -------
        The scans of that sensor.

        Raises
        ------
        InvalidInputError
            If there is no such sensor, or no name was given and there are several.
        """
        known = ", ".join(repr(n) for n in self.sensors) or "none"
        if name is None:
            if len(self.sensors) != 1:
                raise InvalidInputError(f"{self.source}: which sensor? name one, the log has {known}")
            return next(iter(self.sensors.values()))
        if name not in self.sensors:
            raise InvalidInputError(f"{self.source}: no sensor {name!r}; the log has {known}")
        return self.sensors[name]
