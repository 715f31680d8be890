"""The one interface of all measurement models, and what only some of them can do."""

from __future__ import annotations

from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.sensors import Scan

Z = TypeVar("Z")
Z_contra = TypeVar("Z_contra", contravariant=True)


class MeasurementModel(Protocol[Z_contra]):
    """p(z | x, m) with the map m and the parameters fixed at construction."""

    @property
    def is_normalized(self) -> bool:
        """Whether it is a density over z (a beam model is; a likelihood field is not). A class may fix it for good."""
        ...

    def log_likelihood(self, z: Z_contra, poses: ArrayLike) -> FloatArray:
        """Return log p(z | x, m) of one measurement at many poses.

        Parameters
        ----------
        z
            The measurement: a scan, a local map, detections.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats, up to a constant where the model is not normalised; -inf where impossible, never NaN.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), or the measurement is not what the model needs.
        """
        ...


@runtime_checkable
class GenerativeModel(Protocol[Z]):
    """A model that measurements can be drawn from."""

    def sample(self, poses: ArrayLike, *, rng: np.random.Generator | int | None = None) -> list[Z]:
        """Draw one measurement at each of the poses (n, 3); the class says what else it takes."""
        ...


@runtime_checkable
class ExpectingModel(Protocol):
    """A model that knows what it expects to measure."""

    def expected(self, poses: ArrayLike) -> FloatArray:
        """Return the noise-free measurement at poses (..., 3); the class says in which shape."""
        ...


@runtime_checkable
class BeamwiseModel(Protocol):
    """A model whose log-likelihood of a scan is a sum over beams."""

    def beam_log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return the terms (..., k) of the beams, before the exponent."""
        ...


@runtime_checkable
class JointModel(Protocol):
    """A model that may weigh poses together: what it gives one depends on which others are asked for."""

    def takes_poses_alone(self) -> bool:
        """Whether it does not, with the parameters it has."""
        ...


def check_takes_poses_alone(model: object) -> None:
    """Refuse a model whose value at a pose depends on the other poses: it has no value over a map.

    Raises
    ------
    InvalidInputError
        If the model says so of itself (`JointModel`).
    """
    if isinstance(model, JointModel) and not model.takes_poses_alone():
        raise InvalidInputError(
            "model: expected one that weighs each pose alone, got one whose beam skipping looks at all poses; "
            "switch beam skipping off"
        )
