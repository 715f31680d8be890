"""The one interface of all measurement models."""

from __future__ import annotations

from typing import Protocol, TypeVar

from numpy.typing import ArrayLike

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
