"""The landmark model of range and bearing sensors: sections 6.6.2 and 6.6.3, Table 6.4."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import as_generator, checked
from beamfield.detections import Detections
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose, wrap_angle
from beamfield.kernels import landmark as kernels
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.correspondence import Correspondence, CorrespondenceModel, Given, Tables
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.landmark_signatures import (
    LOG_2PI,
    check_signature_noise,
    sample_signatures,
    signature_log_density,
)
from beamfield.models.wrapped_normal import log_share_on_circle, sample_wrapped
from beamfield.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class LandmarkModel(CorrespondenceModel[Detections]):
    """p(f(z) | x, m) of features with range, bearing and signature: Gaussian noise around the geometry (6.40).

    Features are independent given pose and map (6.39). For a feature of landmark j::

        r   = scale |m_j - x|                 + range bias   + noise(sigma_r)
        phi = atan2(m_jy - y, m_jx - x) - theta + bearing bias + noise(sigma_phi)   wrapped
        s   = s_j                             + noise(sigma_s)

    What a feature has not (NaN) adds nothing: range-only and bearing-only sensors are the same model.

    Use it for features that a detector finds one by one: tags, reflectors, trees, beacons. It says nothing about
    landmarks that were *not* seen.

    Parameters
    ----------
    landmarks
        The map.
    parameters
        The noise.
    correspondence
        What to do with features whose id is unknown: "known", "nearest", "sum" or "assignment", as
        `CorrespondenceModel` says.
    mount
        As for `CorrespondenceModel`.

    Raises
    ------
    InvalidInputError
        If the parameters do not fit the map's signatures, or correspondence has no such value. With an observation: if
        signatures do not fit the map's, a feature of no landmark has a range and there is no max_range, or a value is
        measured whose sigma is None.

    Notes
    -----
    Line 4 of Table 6.4 lacks the ``- theta`` of (6.40); it is here. Residuals of bearings are wrapped to (-pi, pi], and
    the normal density is cut off there and normalised, so that it is a density on the circle for any sigma_phi. A
    landmark at the sensor itself counts as straight ahead.

    A feature of no landmark (c = N + 1) has a range uniform on [0, max_range], any bearing, any type with the same
    probability, and a number or vector that is normal with the mean of the map's signatures and their covariance plus
    the noise's.

    References
    ----------
    Probabilistic Robotics, 6.6.2 and 6.6.3: (6.38) to (6.40), Table 6.4.

    Examples
    --------
    >>> landmarks = LandmarkMap([[2.0, 0.0], [0.0, 3.0]])
    >>> noise = LandmarkParameters(sigma_range=0.1, sigma_bearing=0.05)
    >>> model = LandmarkModel(landmarks, noise, correspondence="known")
    >>> seen = Detections([2.0, 3.0], [0.0, np.pi / 2], ids=[1, 2])
    >>> model.log_likelihood(seen, [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]).round(2).tolist()
    [6.92, 6.2]
    """

    landmarks: LandmarkMap
    parameters: LandmarkParameters
    feature_name: ClassVar[str] = "feature"
    _kernels: ClassVar[ModuleType] = kernels

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            landmarks: LandmarkMap,
            parameters: LandmarkParameters,
            *,
            correspondence: Correspondence,
            mount: ArrayLike = ...,
        ) -> None: ...

    __repr__ = short_repr

    def __post_init__(self) -> None:
        super().__post_init__()
        check_signature_noise(self.landmarks, self.parameters)

    @property
    def is_normalized(self) -> bool:
        """Whether it is a density over the features' values; a best correspondence makes it none."""
        return self.correspondence in ("known", "sum")

    @checked
    def expected(self, poses: ArrayLike) -> FloatArray:
        """Return range and bearing (6.40) of every landmark without noise, biases included.

        Parameters
        ----------
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (..., N, 2) metres, and radians in (-pi, pi]; the bearing of a landmark right at the sensor is the bias alone.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        sensor = compose(as_poses(poses), self.mount)[..., None, :]
        away = self.landmarks.positions - sensor[..., :2]
        ranges = np.hypot(away[..., 0], away[..., 1])
        bearings = np.arctan2(away[..., 1], away[..., 0]) - sensor[..., 2]
        bearings = np.where(ranges == 0.0, 0.0, bearings)
        p = self.parameters
        return np.stack([p.range_scale * ranges + p.range_bias, wrap_angle(bearings + p.bearing_bias)], axis=-1)

    @checked
    def sample(
        self, poses: ArrayLike, rng: np.random.Generator | int | None = None, *, ids: ArrayLike | None = None
    ) -> list[Detections]:
        """Draw one observation per pose, given the correspondences; the features carry their ids.

        What the sensor never measures (its sigma is None) is NaN.

        Parameters
        ----------
        poses
            (..., 3) robot poses.
        rng
            Source of randomness, a seed, or None for other numbers each time.
        ids
            (k,) ids of the landmarks that are seen, any number of times; None sees every landmark once, however far.

        Returns
        -------
        n observations for n poses; a range is negative where the noise makes it so.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), or the map has no such id.
        """
        rng = as_generator(rng)
        robot = as_poses(poses).reshape(-1, 3)
        seen = self.landmarks.ids if ids is None else np.asarray(ids, dtype=np.int64)
        which = self.landmarks.indices_of(seen)
        noise_free = self.expected(robot)[:, which]
        shape = noise_free.shape[:2]
        ranges, bearings = np.full(shape, np.nan), np.full(shape, np.nan)
        if self.parameters.sigma_range is not None:
            ranges = noise_free[..., 0] + self.parameters.sigma_range * rng.standard_normal(shape)
        if self.parameters.sigma_bearing is not None:
            bearings = wrap_angle(noise_free[..., 1] + sample_wrapped(self.parameters.sigma_bearing, shape, rng))
        signatures = sample_signatures(np.broadcast_to(which, shape), self.landmarks, self.parameters, rng)
        return [
            Detections(ranges[i], bearings[i], None if signatures is None else signatures[i], seen)
            for i in range(len(robot))
        ]

    @property
    def _map_features(self) -> LandmarkMap:
        return self.landmarks

    @property
    def _spurious_rate(self) -> float:
        return self.parameters.spurious_rate

    def _tables(self, z: Detections, given: Given) -> Tables:
        p = self.parameters
        _check_measurable(z.ranges, p.sigma_range, "sigma_range")
        _check_measurable(z.bearings, p.sigma_bearing, "sigma_bearing")
        if p.max_range is None and not np.isnan(z.ranges[given.spurious]).all():
            raise InvalidInputError("max_range: a spurious feature needs max_range, got None")
        logs = signature_log_density(z.signatures, len(z), self.landmarks, p)
        features = np.empty((len(z), 5))
        kernels.describe_features(z.ranges, z.bearings, self._noise, features, logs)
        return Tables(self.landmarks.positions, features, logs[:, :-1], logs[:, -1])

    @cached_property
    def _noise(self) -> kernels.Noise:
        p = self.parameters
        # Any sigma where nothing is measured.
        sigma_range, sigma_bearing = float(p.sigma_range or 1.0), float(p.sigma_bearing or 1.0)
        limit = math.inf if p.max_range is None else float(p.max_range)
        return kernels.Noise(
            range_bias=float(p.range_bias),
            range_scale=float(p.range_scale),
            bearing_bias=float(p.bearing_bias),
            range_weight=p.range_scale / sigma_range,
            bearing_weight=1.0 / sigma_bearing,
            log_range=-math.log(sigma_range) - 0.5 * LOG_2PI,
            log_bearing=-math.log(sigma_bearing) - 0.5 * LOG_2PI - log_share_on_circle(sigma_bearing),
            max_range=limit,
            log_max_range=math.log(limit),
        )


def _check_measurable(values: FloatArray, sigma: float | None, name: str) -> None:
    """Refuse values that the sensor never measures."""
    if sigma is None and not np.isnan(values).all():
        first = int(np.isnan(values).argmin())
        raise InvalidInputError(f"{name}: feature {first} has a measured value, but the sigma is None")
