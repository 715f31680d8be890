"""The landmark model of range and bearing sensors: sections 6.6.2 and 6.6.3, Table 6.4."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from beamfield.detections import SPURIOUS, UNKNOWN, Detections
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose, invert, wrap_angle
from beamfield.kernels import landmark as kernels
from beamfield.kernels.threads import run_in_slices
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.assignment import assign_exclusively
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.landmark_signatures import (
    LOG_2PI,
    check_signature_noise,
    sample_signatures,
    signature_log_density,
)

Correspondence = Literal["known", "nearest", "sum", "assignment"]
# Values per pose, feature and landmark in memory at a time: 8 MB.
VALUES_PER_CHUNK = 1_000_000


class _Tables(NamedTuple):
    """What the kernels need of one observation."""

    known: NDArray[np.int64]
    """Features whose landmark is known."""
    which: NDArray[np.int64]
    """The index of that landmark."""
    unknown: NDArray[np.int64]
    """Features whose correspondence is unknown."""
    spurious: NDArray[np.int64]
    """Features known to be of no landmark."""
    features: FloatArray
    """(k, 5) as in the kernels."""
    base: FloatArray
    """(k, N) constants and signature, given each landmark."""
    log_spurious: FloatArray
    """(k,) log density given no landmark."""


@dataclass(frozen=True, eq=False)
class LandmarkModel:
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
        What to do with features whose id is unknown; ids that are given are always used, and
        `Detections.without_ids` takes them off.

        - "known": refuse them.
        - "nearest": the landmark (or none) that explains the feature best. With equal noise for all landmarks that is
          the least Mahalanobis distance over range, bearing and signature. Not a density over features.
        - "sum": the sum over all correspondences, ``spurious_rate p(f | none) + (1 - spurious_rate) / N sum_j p(f |
          j)``: every landmark is as likely as any other before the feature is seen. A density.
        - "assignment": as "nearest", for all features of unknown id together, and no landmark explains two of them
          (landmarks that known ids name are taken). -inf if there are more features than landmarks and
          spurious_rate is 0. Not a density over features.
    mount
        (3,) pose of the sensor on the robot, metres and radians.
    threads
        Number of threads; None uses what pays. It changes no bit of any result.

    Raises
    ------
    InvalidInputError
        If the parameters do not fit the map's signatures, or correspondence has no such value.

    Notes
    -----
    Line 4 of Table 6.4 lacks the ``- theta`` of (6.40); it is here. Residuals of bearings are wrapped to (-pi, pi], and
    the normal density is cut off there and normalised, so that it is a density on the circle for any sigma_phi. A
    landmark at the sensor itself counts as straight ahead.

    A feature of no landmark (c = N + 1) has a range uniform on [0, max_range], any bearing, any type with the same
    probability, and a number or vector that is normal with the mean of the map's signatures and their covariance plus
    the noise's.

    For "nearest" and "assignment", a landmark's value is weighted with (1 - spurious_rate) and no landmark's with
    spurious_rate. Instances are immutable, can be pickled and may be used from several threads.

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
    correspondence: Correspondence = field(kw_only=True)
    mount: FloatArray = field(default_factory=lambda: np.zeros(3), kw_only=True)
    threads: int | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.correspondence not in ("known", "nearest", "sum", "assignment"):
            raise InvalidInputError(
                f"correspondence: expected 'known', 'nearest', 'sum' or 'assignment', got {self.correspondence!r}"
            )
        check_signature_noise(self.landmarks, self.parameters)
        mount = np.array(as_poses(self.mount, "mount"))
        if mount.shape != (3,):
            raise InvalidInputError(f"mount: expected shape (3,), got {mount.shape}")
        mount.flags.writeable = False
        object.__setattr__(self, "mount", mount)

    @property
    def is_normalized(self) -> bool:
        """Whether it is a density over the features' values; a best correspondence makes it none."""
        return self.correspondence in ("known", "sum")

    def log_likelihood(self, z: Detections, poses: ArrayLike) -> FloatArray:
        """Return log p(f(z) | x, m) of one observation at many poses: (6.39).

        Parameters
        ----------
        z
            The features.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats; -inf where a type is impossible, or "assignment" finds no room, never NaN. No features give 0.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), an id is not in the map, an id is unknown while the correspondence is
            "known", signatures do not fit the map's, a feature of no landmark has a range and there is no
            max_range, or a value is measured whose sigma is None.
        """
        robot = as_poses(poses)
        tables = self._tables(z)
        total: FloatArray = np.zeros(robot.shape[:-1])
        total += tables.log_spurious[tables.spurious].sum()
        if len(tables.known) and total.size:
            total += self._known(tables, robot.reshape(-1, 3), each=False).reshape(total.shape)
        if len(tables.unknown) and total.size:
            total += self._unknown(tables, robot.reshape(-1, 3))[0].sum(axis=1).reshape(total.shape)
        return total

    def detection_log_likelihood(self, z: Detections, poses: ArrayLike) -> FloatArray:
        """Return what each feature contributes to `log_likelihood`, (..., k).

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.
        """
        return self._evaluate(z, poses)[0]

    def correspondences(self, z: Detections, poses: ArrayLike) -> NDArray[np.int64]:
        """Return the id of the landmark that each feature is taken for, or `SPURIOUS`, (..., k).

        Parameters
        ----------
        z, poses
            As for `log_likelihood`. With correspondence "sum" it is the most probable landmark of each feature. Where
            nothing explains a feature (a type that no landmark can show, no room for an assignment), `UNKNOWN`.
        """
        return self._evaluate(z, poses)[1]

    def expected(self, poses: ArrayLike) -> FloatArray:
        """Return range and bearing (6.40) without noise, biases included, of every landmark, (..., N, 2).

        Parameters
        ----------
        poses
            (..., 3) robot poses.
        """
        sensor = compose(as_poses(poses), self.mount)[..., None, :]
        away = self.landmarks.positions - sensor[..., :2]
        ranges = np.hypot(away[..., 0], away[..., 1])
        bearings = np.arctan2(away[..., 1], away[..., 0]) - sensor[..., 2]
        bearings = np.where(ranges == 0.0, 0.0, bearings)
        return np.stack(
            [
                self.parameters.range_scale * ranges + self.parameters.range_bias,
                wrap_angle(bearings + self.parameters.bearing_bias),
            ],
            axis=-1,
        )

    def sample(self, poses: ArrayLike, rng: np.random.Generator, *, ids: ArrayLike | None = None) -> list[Detections]:
        """Draw one observation per pose, given the correspondences; the features carry their ids.

        What the sensor never measures (its sigma is None) is NaN.

        Parameters
        ----------
        poses
            (..., 3) robot poses.
        rng
            Source of randomness; the same state gives the same features.
        ids
            (k,) ids of the landmarks that are seen, any number of times; None sees every landmark once, however far.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), or the map has no such id.
        """
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

    def _evaluate(self, z: Detections, poses: ArrayLike) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return values and ids, each (..., k)."""
        robot = as_poses(poses)
        flat = robot.reshape(-1, 3)
        tables = self._tables(z)
        values: FloatArray = np.zeros((len(flat), len(z)))
        ids = np.full((len(flat), len(z)), SPURIOUS, dtype=np.int64)
        values[:, tables.spurious] = tables.log_spurious[tables.spurious]
        if len(tables.known):
            values[:, tables.known] = self._known(tables, flat, each=True)
            ids[:, tables.known] = self.landmarks.ids[tables.which]
        if len(tables.unknown):
            values[:, tables.unknown], chosen = self._unknown(tables, flat)
            # Index N means none, N + 1 unknown.
            ids[:, tables.unknown] = np.append(self.landmarks.ids, [SPURIOUS, UNKNOWN])[chosen]
        shape = (*robot.shape[:-1], len(z))
        return values.reshape(shape), ids.reshape(shape)

    def _known(self, tables: _Tables, flat: FloatArray, *, each: bool) -> FloatArray:
        features, landmarks = tables.features[tables.known], self.landmarks.positions[tables.which]
        base = tables.base[tables.known, tables.which]
        out = np.empty((len(flat), len(features) if each else 1))
        first = 0 if each else -1
        mount = self._mount_in_sensor_axes()
        run_in_slices(
            lambda a, b: kernels.fill_known(flat[a:b], mount, features, landmarks, base, first, out[a:b]),
            len(flat),
            threads=self.threads,
            work_per_row=1 + len(features) // 2,
        )
        return out

    def _unknown(self, tables: _Tables, flat: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return values and indices of landmarks (N for none, N + 1 where there is no room), each (n, unknown)."""
        k, n_landmarks = len(tables.unknown), len(self.landmarks)
        values = np.empty((len(flat), k))
        chosen = np.empty((len(flat), k), dtype=np.int64)
        rows = max(1, VALUES_PER_CHUNK // (k * (n_landmarks + 1)))

        def work(start: int, stop: int) -> None:
            for a in range(start, stop, rows):
                b = min(a + rows, stop)
                self._choose(tables, flat[a:b], values[a:b], chosen[a:b])

        run_in_slices(work, len(flat), threads=self.threads, work_per_row=k * n_landmarks)
        return values, chosen

    def _choose(self, tables: _Tables, flat: FloatArray, values: FloatArray, chosen: NDArray[np.int64]) -> None:
        eps, n_landmarks = self.parameters.spurious_rate, len(self.landmarks)
        prior = math.log1p(-eps) - (math.log(n_landmarks) if self.correspondence == "sum" else 0.0)
        none = tables.log_spurious[tables.unknown] + (math.log(eps) if eps > 0.0 else -math.inf)
        each = np.empty((len(flat), len(tables.unknown), n_landmarks))
        kernels.fill_candidates(
            flat,
            self._mount_in_sensor_axes(),
            tables.features[tables.unknown],
            np.ascontiguousarray(self.landmarks.positions.T),
            tables.base[tables.unknown],
            each,
        )
        if self.correspondence == "assignment":
            # Taken by a feature whose id is known.
            each[..., tables.which] = -np.inf
            assign_exclusively(each + prior, none, values, chosen)
            return
        chosen[...] = each.argmax(axis=-1)
        values[...] = each.max(axis=-1) + prior
        chosen[none > values] = n_landmarks
        chosen[np.maximum(values, none) == -np.inf] = n_landmarks + 1
        if self.correspondence == "sum":
            kernels.fill_sums(each, prior, none, values)
        else:
            np.maximum(values, none, out=values)

    def _tables(self, z: Detections) -> _Tables:
        p, n = self.parameters, len(z)
        ids = np.full(n, UNKNOWN) if z.ids is None else z.ids
        known, unknown, spurious = (np.flatnonzero(mask) for mask in (ids >= 0, ids == UNKNOWN, ids == SPURIOUS))
        if len(unknown) and self.correspondence == "known":
            raise InvalidInputError(
                f"ids: correspondence 'known' needs an id of every feature, got none for feature {unknown[0]}"
            )
        has_range, has_bearing = ~np.isnan(z.ranges), ~np.isnan(z.bearings)
        sigma_range = _needed(p.sigma_range, has_range, "sigma_range")
        sigma_bearing = _needed(p.sigma_bearing, has_bearing, "sigma_bearing")
        phi = np.where(has_bearing, z.bearings - p.bearing_bias, 0.0) + 0.0
        features = np.column_stack(
            [
                np.where(has_range, (z.ranges - p.range_bias) / p.range_scale, 0.0),
                np.cos(phi),
                np.sin(phi),
                has_range * p.range_scale / sigma_range,
                has_bearing / sigma_bearing,
            ]
        )
        signature = signature_log_density(z.signatures, n, self.landmarks, p)
        constant = has_range * (-math.log(sigma_range) - 0.5 * LOG_2PI)
        constant -= has_bearing * (math.log(sigma_bearing) + 0.5 * LOG_2PI + _log_share_on_circle(sigma_bearing))
        which = self.landmarks.indices_of(ids[known])
        may_be_spurious = len(spurious) or (len(unknown) and p.spurious_rate > 0.0)
        log_spurious = self._log_spurious(z, spurious) if may_be_spurious else np.full(n, -np.inf)
        log_spurious = log_spurious + signature[:, -1]
        return _Tables(known, which, unknown, spurious, features, constant[:, None] + signature[:, :-1], log_spurious)

    def _log_spurious(self, z: Detections, spurious: NDArray[np.int64]) -> FloatArray:
        """Return log p(r, phi | no landmark), (k,)."""
        has_range, limit = ~np.isnan(z.ranges), self.parameters.max_range
        value: FloatArray = np.where(np.isnan(z.bearings), 0.0, -LOG_2PI)
        if limit is None:
            if has_range[spurious].any():
                raise InvalidInputError("max_range: a feature of no landmark has a range, got no limit")
            return value
        outside = has_range & ((z.ranges < 0.0) | (z.ranges > limit))
        return np.asarray(np.where(outside, -np.inf, value - has_range * math.log(limit)))

    def _mount_in_sensor_axes(self) -> FloatArray:
        turn = np.array([0.0, 0.0, self.mount[2]])
        offset = compose(invert(turn), np.array([self.mount[0], self.mount[1], 0.0]))
        return np.array([offset[0], offset[1], self.mount[2]])


def _needed(sigma: float | None, measured: NDArray[np.bool_], name: str) -> float:
    """Return the sigma, or any where nothing was measured."""
    if sigma is None and measured.any():
        raise InvalidInputError(f"{name}: feature {int(measured.argmax())} has a measured value, and there is no sigma")
    return 1.0 if sigma is None else sigma


def sample_wrapped(sigma: float, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
    """Draw angles of a normal with mean 0, cut off at -pi and pi."""
    below = float(ndtr(-np.pi / sigma))
    # The lower half alone, with a random sign: ndtri is exact there.
    lower = below + rng.random(shape) * (0.5 - below)
    sign = np.where(rng.random(shape) < 0.5, 1.0, -1.0)
    with np.errstate(divide="ignore"):
        return np.asarray(sign * np.minimum(-sigma * ndtri(lower), np.pi))


def _log_share_on_circle(sigma: float) -> float:
    """Return the log of the share of a normal of mean 0 that lies in (-pi, pi]."""
    return math.log(math.erf(math.pi / (sigma * math.sqrt(2.0))))
