"""The model of straight lines as landmarks: section 6.6.2, Crowley (1989)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import erf

from beamfield.detections import SPURIOUS, UNKNOWN
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose, invert, wrap_angle
from beamfield.kernels import line as kernels
from beamfield.kernels.landmark import fill_sums
from beamfield.kernels.threads import run_in_slices
from beamfield.maps.lines import LineMap, normal_form
from beamfield.models.assignment import assign_exclusively
from beamfield.models.landmark import sample_wrapped
from beamfield.models.landmark_signatures import LOG_2PI
from beamfield.models.line_detections import LineDetections

# Values per pose, feature and line in memory at a time: 8 MB.
VALUES_PER_CHUNK = 1_000_000


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
    """

    sigma_rho: float
    sigma_alpha: float
    spurious_rate: float = 0.0
    max_range: float | None = None

    def __post_init__(self) -> None:
        for name in ("sigma_rho", "sigma_alpha"):
            if not 0.0 <= getattr(self, name) < np.inf:
                raise InvalidInputError(f"{name}: expected a finite number >= 0, got {getattr(self, name)}")
        if self.max_range is not None and not 0.0 < self.max_range < np.inf:
            raise InvalidInputError(f"max_range: expected a positive, finite number, got {self.max_range}")
        if not 0.0 <= self.spurious_rate < 1.0:
            raise InvalidInputError(f"spurious_rate: expected a probability in [0, 1), got {self.spurious_rate}")
        if self.spurious_rate > 0.0 and self.max_range is None:
            raise InvalidInputError("max_range: expected a limit where spurious_rate > 0, got None")


class _Tables(NamedTuple):
    """What the kernels need of one observation."""

    known: NDArray[np.int64]
    """Lines whose correspondence is known."""
    which: NDArray[np.int64]
    """The index of their mapped lines."""
    unknown: NDArray[np.int64]
    spurious: NDArray[np.int64]
    features: FloatArray
    """(k, 5) as in the kernels."""
    base: FloatArray
    """(k,) constants of the density."""
    log_spurious: FloatArray
    """(k,) log density given no mapped line."""


@dataclass(frozen=True, eq=False)
class LineModel:
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
        What to do with lines whose id is unknown; ids that are given are always used.

        - "known": refuse them.
        - "nearest": the mapped line (or none) at the least Mahalanobis distance. Not a density.
        - "sum": the sum over all correspondences, ``spurious_rate p(f | none) + (1 - spurious_rate) / N sum_j p(f |
          j)``. A density.
        - "assignment": as "nearest", for all lines of unknown id together, and no mapped line explains two of them.
          -inf if there is no such choice. Not a density. Walls that are seen in pieces need another.
    min_overlap
        Share, in [0, 1], of a measured segment's length that must lie beside a mapped segment; others are no
        candidates for it. It needs end points of map and detections, concerns only unknown correspondences, and makes
        the model no density. None does not look at end points: lines are endless.
    mount
        (3,) pose of the sensor on the robot, metres and radians; zero for lines in the robot's frame.
    threads
        Number of threads; None uses what pays. It changes no bit of any result.

    Raises
    ------
    InvalidInputError
        If correspondence has no such value, min_overlap is outside [0, 1], or the map has no end points for it.

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
    correspondence: Literal["known", "nearest", "sum", "assignment"] = field(kw_only=True)
    min_overlap: float | None = field(default=None, kw_only=True)
    mount: FloatArray = field(default_factory=lambda: np.zeros(3), kw_only=True)
    threads: int | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        if self.correspondence not in ("known", "nearest", "sum", "assignment"):
            raise InvalidInputError(
                f"correspondence: expected 'known', 'nearest', 'sum' or 'assignment', got {self.correspondence!r}"
            )
        if self.min_overlap is not None:
            if not 0.0 <= self.min_overlap <= 1.0:
                raise InvalidInputError(f"min_overlap: expected a share in [0, 1], got {self.min_overlap}")
            if self.lines.segments is None:
                raise InvalidInputError("min_overlap: expected a map with end points, got one without")
        mount = np.array(as_poses(self.mount, "mount"))
        if mount.shape != (3,):
            raise InvalidInputError(f"mount: expected shape (3,), got {mount.shape}")
        mount.flags.writeable = False
        object.__setattr__(self, "mount", mount)

    @property
    def is_normalized(self) -> bool:
        """Whether it is a density over (rho, alpha); a best correspondence or a look at end points makes it none."""
        return self.correspondence == "known" or (self.correspondence == "sum" and self.min_overlap is None)

    def log_likelihood(self, z: LineDetections, poses: ArrayLike) -> FloatArray:
        """Return log p(f(z) | x, m) of the lines of one observation at many poses.

        Parameters
        ----------
        z
            The lines.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats; -inf where nothing explains a line, never NaN. No lines give 0.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), an id is not in the map, an id is unknown while the correspondence is
            "known", neither detections nor parameters have a noise, end points are missing, or a line is of no mapped
            one and there is no max_range.
        """
        robot = as_poses(poses)
        tables = self._tables(z)
        total: FloatArray = np.zeros(robot.shape[:-1])
        total += tables.log_spurious[tables.spurious].sum()
        if len(tables.known) and total.size:
            total += self._known(tables, robot.reshape(-1, 3), each=False).reshape(total.shape)
        if len(tables.unknown) and total.size:
            total += self._unknown(z, tables, robot.reshape(-1, 3))[0].sum(axis=1).reshape(total.shape)
        return total

    def detection_log_likelihood(self, z: LineDetections, poses: ArrayLike) -> FloatArray:
        """Return what each line contributes to `log_likelihood`, (..., k).

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.
        """
        return self._evaluate(z, poses)[0]

    def correspondences(self, z: LineDetections, poses: ArrayLike) -> NDArray[np.int64]:
        """Return the id of the mapped line that each line is taken for, or `SPURIOUS`, (..., k).

        Parameters
        ----------
        z, poses
            As for `log_likelihood`. With correspondence "sum" it is the most probable line. `UNKNOWN` where nothing
            explains a line.
        """
        return self._evaluate(z, poses)[1]

    def expected(self, poses: ArrayLike) -> FloatArray:
        """Return rho and alpha, without noise, of every mapped line in the sensor's frame, (..., N, 2).

        Parameters
        ----------
        poses
            (..., 3) robot poses.
        """
        sensor = compose(as_poses(poses), self.mount)[..., None, :]
        rho, alpha = self.lines.lines[:, 0], self.lines.lines[:, 1]
        signed = rho - sensor[..., 0] * np.cos(alpha) - sensor[..., 1] * np.sin(alpha)
        return normal_form(np.stack([signed, alpha - sensor[..., 2]], axis=-1))

    def sample(
        self,
        poses: ArrayLike,
        rng: np.random.Generator,
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
            Source of randomness; the same state gives the same lines.
        ids
            (k,) ids of the mapped lines that are seen, any number of times; None sees every one once, however far.
        covariances
            (k, 2, 2) or (2, 2) that the detections bring; None leaves the parameters' noise alone.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), the map has no such id, or there is no noise.
        """
        robot = as_poses(poses).reshape(-1, 3)
        seen = self.lines.ids if ids is None else np.asarray(ids, dtype=np.int64)
        noise_free = self.expected(robot)[:, self.lines.indices_of(seen)]
        shape = noise_free.shape[:2]
        brought = LineDetections(np.zeros((len(seen), 2)), covariances).covariances  # type: ignore[arg-type]
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

    def _evaluate(self, z: LineDetections, poses: ArrayLike) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return values and ids, each (..., k)."""
        robot = as_poses(poses)
        flat = robot.reshape(-1, 3)
        tables = self._tables(z)
        values: FloatArray = np.zeros((len(flat), len(z)))
        ids = np.full((len(flat), len(z)), SPURIOUS, dtype=np.int64)
        values[:, tables.spurious] = tables.log_spurious[tables.spurious]
        if len(tables.known):
            values[:, tables.known] = self._known(tables, flat, each=True)
            ids[:, tables.known] = self.lines.ids[tables.which]
        if len(tables.unknown):
            values[:, tables.unknown], chosen = self._unknown(z, tables, flat)
            # Index N means none, N + 1 unknown.
            ids[:, tables.unknown] = np.append(self.lines.ids, [SPURIOUS, UNKNOWN])[chosen]
        shape = (*robot.shape[:-1], len(z))
        return values.reshape(shape), ids.reshape(shape)

    def _known(self, tables: _Tables, flat: FloatArray, *, each: bool) -> FloatArray:
        features, base = tables.features[tables.known], tables.base[tables.known]
        out = np.empty((len(flat), len(features) if each else 1))
        first = 0 if each else -1
        mount, lines = self._mount_in_sensor_axes(), self._line_table()[tables.which]
        run_in_slices(
            lambda a, b: kernels.fill_known(flat[a:b], mount, features, lines, base, first, out[a:b]),
            len(flat),
            threads=self.threads,
            work_per_row=1 + len(features) // 2,
        )
        return out

    def _unknown(self, z: LineDetections, tables: _Tables, flat: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return values and indices of lines (N for none, N + 1 where there is no room), each (n, unknown)."""
        k, n_lines = len(tables.unknown), len(self.lines)
        values = np.empty((len(flat), k))
        chosen = np.empty((len(flat), k), dtype=np.int64)
        rows = max(1, VALUES_PER_CHUNK // (k * (n_lines + 1)))
        mapped = np.ascontiguousarray(self._line_table().T)

        def work(start: int, stop: int) -> None:
            for a in range(start, stop, rows):
                b = min(a + rows, stop)
                self._choose(z, tables, mapped, flat[a:b], values[a:b], chosen[a:b])

        run_in_slices(work, len(flat), threads=self.threads, work_per_row=k * n_lines)
        return values, chosen

    def _choose(
        self,
        z: LineDetections,
        tables: _Tables,
        mapped: FloatArray,
        flat: FloatArray,
        values: FloatArray,
        chosen: NDArray[np.int64],
    ) -> None:
        eps, n_lines = self.parameters.spurious_rate, len(self.lines)
        prior = math.log1p(-eps) - (math.log(n_lines) if self.correspondence == "sum" else 0.0)
        none = tables.log_spurious[tables.unknown] + (math.log(eps) if eps > 0.0 else -math.inf)
        each = np.empty((len(flat), len(tables.unknown), n_lines))
        mount = self._mount_in_sensor_axes()
        kernels.fill_candidates(flat, mount, tables.features[tables.unknown], mapped, tables.base[tables.unknown], each)
        if self.min_overlap is not None and z.segments is not None:
            extents = np.ascontiguousarray(self.lines.extents().T)
            kernels.exclude_apart(flat, mount, z.segments[tables.unknown], mapped, extents, self.min_overlap, each)
        if self.correspondence == "assignment":
            # Taken by a feature whose id is known.
            each[..., tables.which] = -np.inf
            assign_exclusively(each + prior, none, values, chosen)
            return
        chosen[...] = each.argmax(axis=-1)
        values[...] = each.max(axis=-1) + prior
        chosen[none > values] = n_lines
        chosen[np.maximum(values, none) == -np.inf] = n_lines + 1
        if self.correspondence == "sum":
            fill_sums(each, prior, none, values)
        else:
            np.maximum(values, none, out=values)

    def _tables(self, z: LineDetections) -> _Tables:
        n = len(z)
        ids = np.full(n, UNKNOWN) if z.ids is None else z.ids
        known, unknown, spurious = (np.flatnonzero(mask) for mask in (ids >= 0, ids == UNKNOWN, ids == SPURIOUS))
        if len(unknown) and self.correspondence == "known":
            raise InvalidInputError(
                f"ids: correspondence 'known' needs an id of every line, got none for line {unknown[0]}"
            )
        if len(unknown) and self.min_overlap is not None and z.segments is None:
            raise InvalidInputError("segments: min_overlap needs end points of every line, got none")
        covariances = self._total_covariances(z.covariances, n)
        determinant = covariances[:, 0, 0] * covariances[:, 1, 1] - covariances[:, 0, 1] ** 2
        features = np.column_stack(
            [
                z.lines,
                covariances[:, 1, 1] / determinant,
                -2.0 * covariances[:, 0, 1] / determinant,
                covariances[:, 0, 0] / determinant,
            ]
        )
        # The share of the noise of alpha that lies in (-pi, pi].
        share = erf(np.pi / np.sqrt(2.0 * covariances[:, 1, 1]))
        base = -0.5 * np.log(determinant) - LOG_2PI - np.log(share)
        may_be_spurious = len(spurious) or (len(unknown) and self.parameters.spurious_rate > 0.0)
        log_spurious = self._log_spurious(z, spurious) if may_be_spurious else np.full(n, -np.inf)
        return _Tables(known, self.lines.indices_of(ids[known]), unknown, spurious, features, base, log_spurious)

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

    def _log_spurious(self, z: LineDetections, spurious: NDArray[np.int64]) -> FloatArray:
        """Return log p(rho, alpha | no mapped line), (k,)."""
        limit = self.parameters.max_range
        if limit is None:
            if len(spurious):
                raise InvalidInputError("max_range: a line of no mapped line needs a limit, got None")
            return np.zeros(len(z))
        return np.where(z.lines[:, 0] > limit, -np.inf, -LOG_2PI - math.log(limit))

    def _line_table(self) -> FloatArray:
        """Return (N, 4) as the kernels take mapped lines."""
        rho, alpha = self.lines.lines.T
        return np.column_stack([np.cos(alpha), np.sin(alpha), rho, alpha])

    def _mount_in_sensor_axes(self) -> FloatArray:
        turn = np.array([0.0, 0.0, self.mount[2]])
        offset = compose(invert(turn), np.array([self.mount[0], self.mount[1], 0.0]))
        return np.array([offset[0], offset[1], self.mount[2]])
