"""Beluga's likelihood_field_prob, emulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.stacks.beluga.field import BelugaField
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.beluga.scan import SCAN_SETTINGS
from beamfield.stacks.emulation.emulator import FieldEvidence


@dataclass(frozen=True, eq=False)
class BelugaFieldProb(BelugaField):
    """``w = exp(sum log p)`` with the p of `BelugaField`.

    The node hands neither model_unknown_space nor only_obstacle_boundaries to this model: unknown cells are as free
    ones, and all occupied cells count.

    Parameters
    ----------
    grid, parameters, distance, no_return, map_mode
        As for `BelugaField`.

    Notes
    -----
    The program's weights underflow to 0 where the logarithms here do not.
    """

    model: ClassVar[str] = "likelihood_field_prob"
    evidence_settings: ClassVar[tuple[str, ...]] = SCAN_SETTINGS
    has_map_options: ClassVar[bool] = False

    def beam_terms(self, evidence: FieldEvidence, parameters: BelugaParameters | None = None) -> FloatArray:
        """Return log p of each beam that counts, (n, k)."""
        p = self.beam_values(evidence, parameters)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(p, out=p))

    def log_of_sums(
        self,
        sums: FloatArray,
        n_beams: int | NDArray[np.int64],  # noqa: ARG002
        parameters: BelugaParameters,  # noqa: ARG002
    ) -> FloatArray:
        """Return the sums; see `FieldModel.log_of_sums`."""
        return sums
