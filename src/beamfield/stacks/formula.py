"""A stack's model without a map: what its formula makes of given distances, or of given ranges."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.emulation.emulator import KNOWN, FieldEvidence, RayEvidence
from beamfield.stacks.stack import Model, Stack

# Cells so small that cutting distances off at whole ones changes nothing, metres.
FINE = 1e-5


class Formula(NamedTuple):
    """A stack's model with its parameters."""

    stack: Stack
    model: Model
    parameters: Any

    def value(self, name: str) -> Any:
        """Return a parameter by nav2's name; None if there is none such."""
        return self.model.value(self.parameters, name)

    def longest_range(self, max_range: float | None) -> float | None:
        """Return what random readings are divided by with a sensor of max_range, metres; None if that is not known."""
        own = self.value("laser_max_range")
        if own is None:
            return max_range
        if not self.stack.takes_lesser_limit:
            return float(own)
        if own <= 0.0:
            return max_range
        return float(own) if max_range is None else min(float(own), max_range)

    def field_weights(self, distances: FloatArray, limit: float, cell: float | None = None) -> FloatArray:
        """Return the log-weights (n,) of a field, by the distances (n, k) from end points to obstacles, metres.

        The limit is what random readings are divided by. Some programs cut distances off at a whole number of the map's
        cells; None for none.
        """
        made, settings = self._emulator(FINE if cell is None else cell)
        places = np.full(distances.shape, KNOWN, np.int8)
        evidence = FieldEvidence(np.arange(distances.shape[1]), limit, distances, places, settings=settings)
        return np.asarray(made.log_weights(evidence))

    def ray_weights(self, ranges: FloatArray, expected: FloatArray, max_range: float, cell: float) -> FloatArray:
        """Return the log-weights (n,) of a beam model, by readings (k,) and expected ranges (n, k), metres.

        The cell is the side of the map's cells, in which some programs count.
        """
        made, settings = self._emulator(cell)
        return np.asarray(
            made.log_weights(RayEvidence(np.arange(len(ranges)), max_range, ranges, expected, settings=settings))
        )

    def beam_log_values(self, ranges: FloatArray, expected: FloatArray, max_range: float, cell: float) -> FloatArray:
        """Return log p (k,) of single beams by a beam model; see `ray_weights`."""
        made, settings = self._emulator(cell)
        evidence = RayEvidence(np.arange(len(ranges)), max_range, ranges, expected[None, :], settings=settings)
        return np.asarray(made.beam_log_values(evidence)[0])

    def _emulator(self, cell: float) -> tuple[Any, dict[str, Any]]:
        grid = OccupancyGrid.from_ros(np.zeros((2, 2)), resolution=float(np.float32(cell)))
        made = self.model.emulator(grid, self.parameters)  # type: ignore[call-arg]
        return made, {name: getattr(self.parameters, name) for name in made.evidence_settings}
