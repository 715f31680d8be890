"""The one interface of all measurement models, and what those add that weigh poses together."""

from __future__ import annotations

import math
from typing import Protocol, TypeVar, runtime_checkable

from numpy.typing import ArrayLike

from beamfield.arguments import as_floats, as_writeable
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray

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


def checked_log_likelihood(model: MeasurementModel[Z_contra], z: Z_contra, poses: FloatArray) -> FloatArray:
    """Return log p(z | x, m) (n,) at poses (n, 3) as kernels take it; refuse what no model must return."""
    values = as_writeable(as_floats(model.log_likelihood(z, poses), "log_likelihood"))
    if values.shape != (len(poses),):
        raise InvalidInputError(f"model: expected one log-likelihood per pose, {len(poses)}, got shape {values.shape}")
    largest = float(values.max(initial=-math.inf))
    if math.isnan(largest):
        raise InvalidInputError("model: expected log-likelihoods, got NaN")
    if largest == math.inf:
        raise InvalidInputError("model: expected log-likelihoods below +inf")
    return values


@runtime_checkable
class JointModel(Protocol):
    """A model that may weigh poses together: what it gives one depends on which others are asked for."""

    def takes_poses_alone(self) -> bool:
        """Whether it does not, with the parameters it has."""
        ...


def check_takes_poses_alone(model: object) -> None:
    """Refuse a model whose value at a pose depends on the other poses (`JointModel`): it has no value over a map."""
    if isinstance(model, JointModel) and not model.takes_poses_alone():
        raise InvalidInputError(
            "model: expected one that weighs each pose alone, got one whose beam skipping looks at all poses; "
            "switch beam skipping off"
        )
