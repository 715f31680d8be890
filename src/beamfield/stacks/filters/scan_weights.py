"""The weights that a stack's measurement model gives particles, quickly."""

from __future__ import annotations

from typing import Any

from beamfield.geometry import FloatArray
from beamfield.sensors import Scan
from beamfield.stacks.emulation.emulator import FieldModel, StackModel

# Larger maps would take too much memory: 8 bytes a cell.
MOST_CELLS = 30_000_000


class ScanWeights:
    """Log-weights of one model: of a likelihood field, what each cell adds is worked out once.

    Parameters
    ----------
    model
        The stack's model on its map.
    """

    def __init__(self, model: StackModel[Any, Any]) -> None:
        self._model = model

    def __call__(self, scan: Scan, poses: FloatArray, *, converged: bool = False) -> FloatArray:
        """Return the logarithm of the weight of a scan at poses (n, 3): (n,), -inf where it is 0.

        `converged` says whether the filter has, which only some models ask.
        """
        if not isinstance(self._model, FieldModel):
            return self._model.in_filter(converged=converged).log_likelihood(scan, poses)
        model = self._model.in_filter(converged=converged)
        if not model.takes_poses_alone() or model.grid.probability.size > MOST_CELLS:
            return model.log_likelihood(scan, poses)
        ends = model.scan_ends(scan)
        # What cells add is kept by the model that was given, for all filters with it.
        sums = self._model.cell_terms(ends.max_range).sums(poses, ends.points)
        return model.log_of_sums(sums, len(ends.beams), model.parameters)
