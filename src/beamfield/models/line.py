"""The model of straight lines as landmarks: section 6.6.2, Crowley (1989)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from types import ModuleType
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from beamfield.arguments import LARGEST, as_generator, check_fields, checked, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose, wrap_angle
from beamfield.kernels import line as kernels
from beamfield.maps.lines import LineMap, normal_form
from beamfield.models.correspondence import Correspondence, CorrespondenceModel, Given, Tables
from beamfield.models.landmark_signatures import LOG_2PI
from beamfield.models.line_detections import LineDetections
from beamfield.models.wrapped_normal import sample_wrapped
from beamfield.short_repr import short_repr


@dataclass(frozen=True)
class LineParameters:
    """The noise of measured lines, and how often one is of no mapped line.

    Parameters
    ----------
    sigma_rho, sigma_alpha
        Standard deviations, metres and radians, >= 0. They are *added* (as variances) to the covariance that a
        detection brings, for what it does not know: errors of the map. Where detections bring none they are all.
    spurious_rate
        Probability that a line belongs to none of the map (c = N + 1), in [0, 1).
    max_range
        Lines of no mapped line have a rho uniform on [0, max_range], metres; needed where there are any.

    Raises
    ------
    InvalidInputError
        If a value is out of its range, or `max_range` is missing where spurious_rate > 0.

    Examples
    --------
    >>> LineParameters(sigma_rho=0.02, sigma_alpha=0.01).spurious_rate
    0.0
    """

    sigma_rho: float
    sigma_alpha: float
    spurious_rate: float = 0.0
    max_range: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("sigma_rho", "sigma_alpha"):
            require(0.0 <= getattr(self, name) <= LARGEST, name, f"a number from 0 to {LARGEST:g}", getattr(self, name))
        if self.max_range is not None and not 0.0 < self.max_range < np.inf:
            raise InvalidInputError(f"max_range: expected a positive, finite number, got {self.max_range}")
        require(0.0 <= self.spurious_rate < 1.0, "spurious_rate", "a probability in [0, 1)", self.spurious_rate)
        if self.spurious_rate > 0.0 and self.max_range is None:
            raise InvalidInputError("max_range: expected a limit where spurious_rate > 0, got None")


@dataclass(frozen=True, eq=False)
class LineModel(CorrespondenceModel[LineDetections]):
    """p(f(z) | x, m) of straight lines: Gaussian noise in (rho, alpha) around the mapped line as the robot sees it.

    A mapped line (rho_j, alpha_j) lies, seen from a sensor at (x, y, theta), at::

        d     = rho_j - x cos(alpha_j) - y sin(alpha_j)
        alpha = alpha_j - theta

    and a measured line is (d, alpha) plus noise with a 2 x 2 covariance. Lines are independent given pose and map, as
    in (6.39).

    A line has no direction: (d, alpha) and (-d, alpha + pi) are the same, and a sensor reports the pair with rho >= 0.
    Near a line the noise decides which one that is. The density is therefore the sum over both pairs; angles wrap. It
    integrates to 1 over rho >= 0 and the circle.

    Use it for walls that `beamfield.features.lines.find_lines` extracts. One wall says nothing about where along it the
    robot is. Lines that were *not* seen are not counted against a pose.

    Parameters
    ----------
    lines
        The map.
    parameters
        The noise.
    correspondence
        What to do with lines whose id is unknown: "known", "nearest", "sum" or "assignment", as `CorrespondenceModel`
        says.
    min_overlap
        Share, in [0, 1], of a measured segment's length that must lie beside a mapped segment; others are no
        candidates for it. It needs end points of map and detections, concerns only unknown correspondences, and makes
        the model no density. None does not look at end points: lines are endless.
    mount
        As for `CorrespondenceModel`.

    Raises
    ------
    InvalidInputError
        If correspondence has no such value, min_overlap is outside [0, 1], or the map has no end points for it. With
        an observation: if neither detections nor parameters have a noise, end points are missing, or a line is of no
        mapped one and there is no max_range.

    Notes
    -----
    The noise of alpha is cut off at a half turn and normalised. A line of the map that goes through the sensor has
    d = 0, in either direction. A line of no mapped line has a rho uniform on [0, max_range] and any alpha.

    References
    ----------
    J. L. Crowley, "World modeling and position estimation for a mobile robot using ultrasonic ranging", IEEE
    International Conference on Robotics and Automation, 1989. Probabilistic Robotics, sections 6.6.2, 6.6.3 and 6.9.

    Examples
    --------
    >>> walls = LineMap([[2.0, 0.0], [3.0, np.pi / 2]])
    >>> model = LineModel(walls, LineParameters(0.02, 0.01), correspondence="known")
    >>> seen = LineDetections([[2.0, 0.0], [3.0, np.pi / 2]], ids=[1, 2])
    >>> model.log_likelihood(seen, [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]]).round(2).tolist()
    [13.36, 12.86]
    """

    lines: LineMap
    parameters: LineParameters
    min_overlap: float | None = field(default=None, kw_only=True)
    feature_name: ClassVar[str] = "line"
    _kernels: ClassVar[ModuleType] = kernels

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            lines: LineMap,
            parameters: LineParameters,
            *,
            correspondence: Correspondence,
            mount: ArrayLike = ...,
            min_overlap: float | None = None,
        ) -> None: ...

    __repr__ = short_repr

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_overlap is not None:
            require(0.0 <= self.min_overlap <= 1.0, "min_overlap", "a share in [0, 1]", self.min_overlap)
            if self.lines.segments is None:
                raise InvalidInputError("min_overlap: expected a map with end points, got one without")

    @property
    def is_normalized(self) -> bool:
        """Whether it is a density over (rho, alpha); a best correspondence or a look at end points makes it none."""
        return self.correspondence == "known" or (self.correspondence == "sum" and self.min_overlap is None)

    @checked
    def expected(self, poses: ArrayLike) -> FloatArray:
        """Return rho and alpha of every mapped line in the sensor's frame, without noise.

        Parameters
        ----------
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (..., N, 2) metres >= 0, and radians in (-pi, pi].

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        sensor = compose(as_poses(poses), self.mount)[..., None, :]
        rho, alpha = self.lines.lines[:, 0], self.lines.lines[:, 1]
        signed = rho - sensor[..., 0] * np.cos(alpha) - sensor[..., 1] * np.sin(alpha)
        return normal_form(np.stack([signed, alpha - sensor[..., 2]], axis=-1))

    @checked
    def sample(
        self,
        poses: ArrayLike,
        rng: np.random.Generator | int | None = None,
        *,
        ids: ArrayLike | None = None,
        covariances: ArrayLike | None = None,
    ) -> list[LineDetections]:
        """Draw one observation per pose, given the correspondences; the lines carry their ids.

        Parameters
        ----------
        poses
            (..., 3) robot poses.
        rng
            Source of randomness, a seed, or None for other numbers each time.
        ids
            (k,) ids of the mapped lines that are seen, any number of times; None sees every one once, however far.
        covariances
            (k, 2, 2) or (2, 2) that the detections bring; None leaves the parameters' noise alone.

        Returns
        -------
        n observations for n poses, without segments.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), the map has no such id, or there is no noise.
        """
        rng = as_generator(rng)
        robot = as_poses(poses).reshape(-1, 3)
        seen = self.lines.ids if ids is None else np.asarray(ids, dtype=np.int64)
        noise_free = self.expected(robot)[:, self.lines.indices_of(seen)]
        shape = noise_free.shape[:2]
        brought = LineDetections(np.zeros((len(seen), 2)), covariances).covariances
        total = self._total_covariances(brought, len(seen))
        sigma_alpha = np.sqrt(total[:, 1, 1])
        turn = np.stack([sample_wrapped(float(s), shape[:1], rng) for s in sigma_alpha], axis=1).reshape(shape)
        slope = total[:, 0, 1] / total[:, 1, 1]
        rest = np.sqrt(total[:, 0, 0] - slope * total[:, 0, 1])
        rho = noise_free[..., 0] + slope * turn + rest * rng.standard_normal(shape)
        # Beyond the line, noise is that of the other pair, mirrored: see the density.
        alpha = noise_free[..., 1] + np.where(rho < 0.0, np.pi - turn, turn)
        measured = np.stack([np.abs(rho), wrap_angle(alpha)], axis=-1)
        return [LineDetections(lines, brought, ids=seen) for lines in measured]

    @property
    def _map_features(self) -> LineMap:
        return self.lines

    @property
    def _spurious_rate(self) -> float:
        return self.parameters.spurious_rate

    def _tables(self, z: LineDetections, given: Given) -> Tables:
        n = len(z)
        if len(given.unknown) and self.min_overlap is not None and z.segments is None:
            raise InvalidInputError("segments: min_overlap needs end points of every line, got none")
        covariances = self._total_covariances(z.covariances, n)
        determinant = covariances[:, 0, 0] * covariances[:, 1, 1] - covariances[:, 0, 1] ** 2
        quadratic = covariances[:, 1, 1], -2.0 * covariances[:, 0, 1], covariances[:, 0, 0]
        features = np.column_stack([z.lines, *(entry / determinant for entry in quadratic)])
        # The share of the noise of alpha that lies in (-pi, pi].
        share = erf(np.pi / np.sqrt(2.0 * covariances[:, 1, 1]))
        base = -0.5 * np.log(determinant) - LOG_2PI - np.log(share)
        log_spurious = self._log_spurious(z, given)
        return Tables(self._seen_from_origin, features, base, log_spurious)

    @cached_property
    def _seen_from_origin(self) -> FloatArray:
        """(N, 4) the map as the kernels take it."""
        rho, alpha = self.lines.lines.T
        table = np.column_stack([np.cos(alpha), np.sin(alpha), rho, alpha])
        table.flags.writeable = False  # as `restore` makes it
        return table

    def _exclude(self, z: LineDetections, given: Given, flat: FloatArray, mount: FloatArray, map_features: FloatArray,
                 each: FloatArray) -> None:  # fmt: skip
        if self.min_overlap is None or z.segments is None:
            return
        extents, ends = np.ascontiguousarray(self.lines.extents().T), z.segments[given.unknown]
        kernels.exclude_apart(flat, mount, ends, map_features, extents, self.min_overlap, each)

    def _total_covariances(self, brought: FloatArray | None, k: int) -> FloatArray:
        """Return (k, 2, 2) what detections bring plus the parameters' noise."""
        p = self.parameters
        if brought is None and k and not (p.sigma_rho > 0.0 and p.sigma_alpha > 0.0):
            raise InvalidInputError(
                "covariances: lines without covariance need sigma_rho and sigma_alpha > 0, "
                f"got {p.sigma_rho} and {p.sigma_alpha}"
            )
        added = np.diag([p.sigma_rho**2, p.sigma_alpha**2])
        return np.broadcast_to(added, (k, 2, 2)) if brought is None else np.asarray(brought + added)

    def _log_spurious(self, z: LineDetections, given: Given) -> FloatArray:
        """Return log p(rho, alpha | no mapped line), (k,)."""
        limit = self.parameters.max_range
        if limit is None:
            if len(given.spurious):
                raise InvalidInputError("max_range: a spurious line needs max_range, got None")
            return np.zeros(len(z))
        return np.where(z.lines[:, 0] > limit, -np.inf, -LOG_2PI - math.log(limit))
