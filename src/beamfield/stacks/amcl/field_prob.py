"""AMCL's likelihood_field_prob with beam skipping: what nav2 and ROS 1 share."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Self, TypeVar

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.stacks.amcl.field import AmclField
from beamfield.stacks.amcl.parameters import AmclParameters, AsAmcl
from beamfield.stacks.emulation.beam_selection import Indices, ceil_step_beams
from beamfield.stacks.emulation.emulator import OFF_MAP, FieldEvidence

P = TypeVar("P", bound=AsAmcl)


@dataclass(frozen=True, eq=False)
class AmclFieldProb(AmclField[P]):
    """``w = exp(sum log p)`` with the p of `AmclField`, over the beams that enough particles agree with.

    With do_beamskip, and while the particle filter has converged, a beam counts if more than beam_skip_threshold of the
    particles have its end point closer than beam_skip_distance to an obstacle of the map; end points off the map
    disagree. If beam_skip_error_threshold of max_beams or more would be left out, the program multiplies all of its
    max_beams places, and those without a reading hold 0: every weight is 0 then unless all places have one.

    **With beam skipping a pose's weight depends on all poses of the call**, which are taken as the particle set.

    Parameters
    ----------
    grid, parameters, distance, map_mode
        As for `AmclField`.
    converged
        Whether the particle filter has converged, without which it skips no beam: all particles are within 0.5 m of
        their mean in x and in y. True unless said otherwise, whatever the poses of a call.

    Notes
    -----
    The places without a reading are those for which the scan has too few beams, and beams with NaN or without return.
    The latter hold 0 at the first update and whenever the number of particles grows, and otherwise what an earlier scan
    left there for another set of particles, which is not emulated. The program's weights underflow to 0 where the
    logarithms here do not.
    """

    model: ClassVar[str] = "likelihood_field_prob"
    is_product: ClassVar[bool] = True
    beam_rule = staticmethod(ceil_step_beams)

    converged: bool = field(default=True, kw_only=True)

    def log_weights(self, evidence: FieldEvidence, parameters: P | None = None) -> FloatArray:
        """Return the sum of log p over the beams that count, (n,); see `StackModel.log_weights`."""
        terms = self.beam_terms(evidence, parameters)
        values = (self.parameters if parameters is None else parameters).as_amcl()
        if values.do_beamskip and self.converged:
            counted = self._agreed_beams(evidence, values)
            if values.max_beams - len(counted) < values.beam_skip_error_threshold * values.max_beams:
                terms = terms[:, counted]
            elif terms.shape[1] < values.max_beams:
                return np.full(len(terms), -np.inf)
        return np.asarray(terms.sum(axis=1))

    def in_filter(self, *, converged: bool) -> Self:
        """Return the model as it weighs particles; see `StackModel.in_filter`."""
        return self if converged == self.converged else self._sharing(converged=converged)

    def takes_poses_alone(self) -> bool:
        """Whether a pose's weight is the same whatever other poses are asked for: not with beam skipping."""
        return not (self.parameters.as_amcl().do_beamskip and self.converged)

    def _agreed_beams(self, evidence: FieldEvidence, values: AmclParameters) -> Indices:
        """Return the columns of the evidence that enough particles agree with."""
        agrees = self._cut_distances(evidence, values) < values.beam_skip_distance
        agrees &= evidence.places != OFF_MAP
        share = agrees.sum(axis=0) / max(1, len(agrees))
        return np.asarray(np.flatnonzero(share > values.beam_skip_threshold))
