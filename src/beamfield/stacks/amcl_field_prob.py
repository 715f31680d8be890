"""AMCL's likelihood_field_prob with beam skipping: what nav2 and ROS 1 share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.stacks.amcl_field import AmclField
from beamfield.stacks.beam_selection import Indices, ceil_step_beams
from beamfield.stacks.emulator import OFF_MAP, FieldEvidence
from beamfield.stacks.nav2_parameters import AmclParameters, Nav2Parameters

P = TypeVar("P", bound=AmclParameters)


@dataclass(frozen=True, eq=False)
class AmclFieldProb(AmclField[P]):
    """``w = exp(sum log p)`` with the p of `AmclField`, over the beams that enough particles agree with.

    With do_beamskip a beam counts if more than beam_skip_threshold of the particles have its end point closer than
    beam_skip_distance to an obstacle of the map; end points off the map disagree. If beam_skip_error_threshold of
    max_beams or more would be left out, beams without reading among them, all beams count.

    **With beam skipping a pose's weight depends on all poses of the call**, which are taken as the particle set.

    Parameters
    ----------
    grid, parameters, distance, map_mode, threads
        As for `AmclField`.

    Notes
    -----
    Where all beams count after all, the program also multiplies in what its buffer holds for beams without a reading:
    zeros, so that every weight becomes 0, or what an earlier scan left there. Here such beams count nothing. The
    program's weights underflow to 0 where the logarithms here do not.
    """

    model: ClassVar[str] = "likelihood_field_prob"

    def selected_beams(self, n_beams: int) -> Indices:
        """Return the indices of the beams that the program looks at in a scan of n_beams."""
        return ceil_step_beams(n_beams, self.parameters.as_nav2().max_beams)

    def beam_terms(self, evidence: FieldEvidence, parameters: P | None = None) -> FloatArray:
        """Return log p of each beam that counts without beam skipping, (n, k)."""
        p = self.beam_values(evidence, parameters)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(p, out=p))

    def log_of_sums(self, sums: FloatArray, n_beams: int | NDArray[np.int64], parameters: P) -> FloatArray:  # noqa: ARG002
        """Return the sums; see `FieldModel.log_of_sums`."""
        return sums

    def log_weights(self, evidence: FieldEvidence, parameters: P | None = None) -> FloatArray:
        """Return the sum of log p over the beams that count, (n,); see `StackModel.log_weights`."""
        terms = self.beam_terms(evidence, parameters)
        values = (self.parameters if parameters is None else parameters).as_nav2()
        if values.do_beamskip:
            terms = terms[:, counted_beams(evidence, values)]
        return np.asarray(terms.sum(axis=1))

    def weighs_alone(self) -> bool:
        """Whether a pose's weight is the same whatever other poses are asked for: not with beam skipping."""
        return not self.parameters.as_nav2().do_beamskip


def counted_beams(evidence: FieldEvidence, parameters: Nav2Parameters) -> slice | Indices:
    """Return which columns of the evidence count with beam skipping."""
    nearest = np.minimum(evidence.distances, parameters.laser_likelihood_max_dist)
    agrees = (nearest < parameters.beam_skip_distance) & (evidence.places != OFF_MAP)
    share = agrees.sum(axis=0) / max(1, len(agrees))
    counted = np.flatnonzero(share > parameters.beam_skip_threshold)
    left_out = parameters.max_beams - len(counted)
    if left_out >= parameters.beam_skip_error_threshold * parameters.max_beams:
        return slice(None)
    return counted
