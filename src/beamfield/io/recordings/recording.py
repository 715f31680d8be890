"""What a viewer shows over the time of a log."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_fields
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.maps.end_points import end_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.short_repr import short_repr

# Of paths in their order, and of a scan's points by cause: Okabe and Ito's, which colour-blind readers tell apart.
COLOURS = tuple(
    (int(code[0:2], 16), int(code[2:4], 16), int(code[4:6], 16))
    for code in ("0072B2", "D55E00", "009E73", "CC79A7", "E69F00", "56B4E9")
)


@dataclass(frozen=True, eq=False)
class Recording:
    """A log in its map, with what a filter or a model said about it.

    Parameters
    ----------
    grid
        The map.
    log
        The scans, t of them.
    paths
        Poses (t, 3) at the scans by name, NaN where unknown. The first path carries the scans.
    covariances
        (t, 3, 3) of the first path, NaN where unknown; None for none.
    particles
        Index of a scan and poses (n, 3), in the order of time.
    numbers
        Values (t,) at the scans by name, NaN where there is none. Names end in the unit, in brackets.
    causes
        (t, k) most likely cause of each reading, by its place in `CAUSES`, -1 for none; None draws all alike.

    Raises
    ------
    InvalidInputError
        If there is no path, or a shape does not fit the log.
    """

    grid: OccupancyGrid
    log: SensorLog
    paths: Mapping[str, FloatArray]
    covariances: FloatArray | None = None
    particles: Sequence[tuple[int, FloatArray]] = ()
    numbers: Mapping[str, FloatArray] = field(default_factory=dict)
    causes: NDArray[np.int8] | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.paths:
            raise InvalidInputError("paths: expected at least one, got none")
        n, k = len(self.log), self.log.finder.n_beams
        for name, values, shape in (
            *((f"paths[{name!r}]", poses, (n, 3)) for name, poses in self.paths.items()),
            *((f"numbers[{name!r}]", values, (n,)) for name, values in self.numbers.items()),
            ("covariances", self.covariances, (n, 3, 3)),
            ("causes", self.causes, (n, k)),
        ):
            if values is not None and np.shape(values) != shape:
                raise InvalidInputError(f"{name}: expected shape {shape} for the scans, got {np.shape(values)}")

    @property
    def carrier(self) -> FloatArray:
        """(t, 3) the path that carries the scans."""
        return next(iter(self.paths.values()))

    def scan_points(self, i: int) -> tuple[FloatArray, NDArray[np.int8] | None]:
        """Return where the beams of scan i end in the map, (n, 2) metres, and their causes (n,)."""
        points = end_points(self.log.ranges[i], self.log.finder, self.carrier[i])
        known = np.isfinite(points).all(axis=1)
        return points[known], None if self.causes is None else self.causes[i, known]


def entity(name: str) -> str:
    """Return a name as viewers take it in paths and topics: letters, digits and underscores.

    Examples
    --------
    >>> entity("position error [m]")
    'position_error_m'
    """
    return re.sub(r"[^0-9A-Za-z]+", "_", name).strip("_")
