"""The one interface of all emulators: another program's weight of a scan, as that program computes it.

`StackModel.evidence` does what is slow and does not depend on the parameters that are fitted (look-ups in the map, ray
casting); `StackModel.log_weights` does the rest. A fit makes the evidence once and asks for thousands of parameters:

    evidence = model.evidence(scan, poses)
    for parameters in candidates:
        log_weights = model.log_weights(evidence, parameters)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Generic, NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.emulation.beam_selection import Indices
from beamfield.stacks.emulation.field_table import CellTerms, FieldTable

# What an end point lies in: values of `FieldEvidence.places`.
KNOWN, UNKNOWN, OFF_MAP = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a scan and poses say before the parameters that are fitted come in.

    Parameters
    ----------
    beams
        (k,) indices into the scan of the beams that the stack looks at, in its order.
    max_range
        The range limit that the stack divides by, metres.
    settings
        The parameters that the evidence depends on, by name (max_beams, for example); `log_weights` refuses others.
    """

    beams: NDArray[np.int64]
    max_range: float
    settings: dict[str, Any] = field(default_factory=dict, kw_only=True)


@dataclass(frozen=True, eq=False)
class FieldEvidence(Evidence):
    """Evidence of a likelihood field.

    Parameters
    ----------
    distances
        (n, k) metres from each end point's cell to the nearest obstacle, not cut off; +inf off the map and in a map
        without obstacles. In the precision in which the stack keeps them.
    places
        (n, k) `KNOWN`, `UNKNOWN` or `OFF_MAP`.
    """

    distances: NDArray[np.floating[Any]]
    places: NDArray[np.int8]


class ScanEnds(NamedTuple):
    """The end points of a scan that a likelihood field looks up."""

    beams: Indices
    """(k,) which beams they are of."""
    max_range: float
    """The range limit that the stack divides by, metres."""
    points: FloatArray
    """(2, k) in the robot frame, metres."""


@dataclass(frozen=True, eq=False)
class RayEvidence(Evidence):
    """Evidence of a beam model.

    Parameters
    ----------
    ranges
        (k,) the ranges as the stack sees them, metres: after its node has replaced special readings.
    expected_ranges
        (n, k) metres; max_range where nothing is met.
    """

    ranges: FloatArray
    expected_ranges: FloatArray


P = TypeVar("P")
E = TypeVar("E", bound=Evidence)


class StackModel(ABC, Generic[P, E]):
    """One measurement model of another program: a `MeasurementModel` over scans.

    A member is a frozen dataclass with at least the fields `grid` and `parameters`. Weights are those that the program
    multiplies a particle's weight by, before its filter normalises them; only ratios between poses mean anything.

    Attributes
    ----------
    stack, model
        How users call them: "nav2" and "likelihood_field", for example.
    is_normalized
        False: no stack's weight is a density over scans.
    evidence_settings
        Names of the parameters that the evidence depends on. With all others free, one evidence serves.
    fitted_parameters
        Names of the numbers that a fit varies: factors, widths and rates that this model uses.
    tests_nan
        Whether the program leaves out readings that are NaN.
    """

    is_normalized: ClassVar[bool] = False
    stack: ClassVar[str]
    model: ClassVar[str]
    evidence_settings: ClassVar[tuple[str, ...]]
    fitted_parameters: ClassVar[tuple[str, ...]]
    tests_nan: ClassVar[bool] = True

    grid: OccupancyGrid
    parameters: P

    __setstate__ = restore

    @staticmethod
    def beam_rule(n_beams: int, max_beams: int) -> Indices | None:  # noqa: ARG004
        """Return which of n_beams a program with a parameter max_beams looks at; None if it steps by another."""
        return None

    def with_parameters(self, parameters: P) -> Self:
        """Return the model with other parameters and the same map, options and tables."""
        return self._sharing(parameters=parameters)

    @abstractmethod
    def evidence(self, z: Scan, poses: ArrayLike) -> E:
        """Return what the weights of one scan at poses (..., 3) depend on beside the free parameters.

        The stack's own selection of beams applies. InvalidInputError if the poses are not finite, or the program itself
        would not return.
        """

    @abstractmethod
    def log_weights(self, evidence: E, parameters: P | None = None) -> FloatArray:
        """Return the logarithm of the stack's weight of each pose.

        Parameters
        ----------
        evidence
            From `evidence` of this model or one with the same map and options.
        parameters
            By default the model's own.

        Returns
        -------
        (n,) nats; -inf where the stack's weight is 0, never NaN.

        Raises
        ------
        InvalidInputError
            If the parameters differ in one that the evidence depends on.
        """

    def in_filter(self, *, converged: bool) -> Self:  # noqa: ARG002
        """Return the model as it weighs the particles of a filter that has converged, or has not."""
        return self

    def takes_poses_alone(self) -> bool:
        """Whether a pose's weight is the same whatever other poses are asked for (not so with beam skipping)."""
        return True

    def log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return the logarithm of the stack's weight of one scan at poses (..., 3), shape (...)."""
        robot = as_poses(poses)
        return self.log_weights(self.evidence(z, robot)).reshape(robot.shape[:-1])

    def _sharing(self, **changes: Any) -> Self:
        """Return a copy with other fields that keeps the tables."""
        other = object.__new__(type(self))
        for name, value in {**self.__dict__, **changes}.items():
            object.__setattr__(other, name, value)
        return other

    def _settings(self) -> dict[str, Any]:
        """Return the settings for an `Evidence` that this model makes."""
        return {name: getattr(self.parameters, name) for name in self.evidence_settings}

    def _parameters_for(self, evidence: Evidence, parameters: P | None) -> P:
        """Return the parameters to use; raise if the evidence was made with others."""
        chosen = self.parameters if parameters is None else parameters
        for name, value in evidence.settings.items():
            if getattr(chosen, name) != value:
                raise InvalidInputError(
                    f"{name}: expected {value!r} as in the evidence, got {getattr(chosen, name)!r}; "
                    "make new evidence with model.with_parameters(parameters)"
                )
        return chosen


class RayModel(StackModel[P, RayEvidence], Generic[P]):
    """A model of ranges along rays."""

    @abstractmethod
    def beam_log_values(self, evidence: RayEvidence, parameters: P | None = None) -> FloatArray:
        """Return the logarithm of the stack's value p of each beam that counts, (n, k)."""


class FieldModel(StackModel[P, FieldEvidence], Generic[P]):
    """A likelihood field: each beam's value depends on its end point alone, the weight on the sum over beams.

    Attributes
    ----------
    is_product
        Whether the weight is the product of p over beams; otherwise it is 1 + the sum of p^3.
    """

    is_product: ClassVar[bool] = False
    _table: FieldTable

    @abstractmethod
    def scan_ends(self, z: Scan) -> ScanEnds:
        """Return the end points that the program looks up for a scan."""

    def evidence(self, z: Scan, poses: ArrayLike) -> FieldEvidence:
        """Return distances of end points; see `StackModel.evidence`."""
        robot = as_poses(poses).reshape(-1, 3)
        ends = self.scan_ends(z)
        return self._evidence_of(ends.beams, ends.max_range, *self._table.look_up(robot, ends.points))

    def with_parameters(self, parameters: P) -> Self:
        """Return the model with other parameters; see `StackModel.with_parameters`."""
        made = super().with_parameters(parameters)
        made.__dict__.pop("_terms", None)
        return made

    def __getstate__(self) -> dict[str, Any]:
        # Other processes work out what the cells add sooner than they get it.
        return {name: value for name, value in self.__dict__.items() if name != "_terms"}

    @cached_property
    def _terms(self) -> dict[float, CellTerms]:
        return {}

    def cell_terms(self, max_range: float) -> CellTerms:
        """Return what `beam_terms` has for an end point in each cell, with the model's own parameters.

        max_range is that of `scan_ends`. It is worked out once, for all filters with this model.
        """
        if max_range not in self._terms:
            self._terms[max_range] = self._cell_terms(max_range)
        return self._terms[max_range]

    def _cell_terms(self, max_range: float) -> CellTerms:
        table = self._table
        distances = np.append(table.distance.ravel(), table.distance.dtype.type(np.inf))
        places = np.append(np.where(table.unknown.ravel(), UNKNOWN, KNOWN), OFF_MAP).astype(np.int8)
        cells = np.arange(len(places))
        return CellTerms(
            table.grid, self.beam_terms(self._evidence_of(cells, max_range, distances[None], places[None]))[0]
        )

    @abstractmethod
    def beam_values(self, evidence: FieldEvidence, parameters: P | None = None) -> FloatArray:
        """Return the stack's value p of each beam that counts, (n, k)."""

    def beam_terms(self, evidence: FieldEvidence, parameters: P | None = None) -> FloatArray:
        """Return what is summed over beams, (n, k): log p of a product, else p^3."""
        p = self.beam_values(evidence, parameters)
        if not self.is_product:
            return np.asarray(p * p * p)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(p, out=p))

    def log_of_sums(self, sums: FloatArray, n_beams: int | NDArray[np.int64], parameters: P) -> FloatArray:  # noqa: ARG002
        """Return log-weights of sums over n_beams beams, of the same shape: of 1 + sum p^3 unless it is a product."""
        return sums if self.is_product else np.asarray(np.log1p(sums))

    def log_weights(self, evidence: FieldEvidence, parameters: P | None = None) -> FloatArray:
        """Return the logarithm of the stack's weight of each pose; see `StackModel.log_weights`."""
        values = self._parameters_for(evidence, parameters)
        terms = self.beam_terms(evidence, values)
        return self.log_of_sums(terms.sum(axis=1), terms.shape[1], values)

    def _evidence_of(
        self, beams: Indices, max_range: float, distances: NDArray[np.floating[Any]], places: NDArray[np.int8]
    ) -> FieldEvidence:
        """Return what was looked up, as evidence."""
        return FieldEvidence(beams, max_range, distances, places, settings=self._settings())
