"""Shared by models of features: which map feature each one belongs to, known or not (6.6.3)."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from types import ModuleType
from typing import ClassVar, Generic, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, checked, keep, require, restore
from beamfield.detections import SPURIOUS, UNKNOWN, Detections
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_mount, as_poses, pose_rows
from beamfield.kernels.correspondence import fill_sums, sort_by_id
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.models.assignment import assign_exclusively
from beamfield.models.line_detections import LineDetections

Correspondence = Literal["known", "nearest", "sum", "assignment"]
# Values per pose, feature and map feature in memory at a time: 8 MB.
VALUES_PER_CHUNK = 1_000_000
_NO_FEATURES = np.empty(0, dtype=np.int64)


Z = TypeVar("Z", bound=Detections | LineDetections)


class Given(NamedTuple):
    """What is given of the correspondences of one observation, as indices of features."""

    known: NDArray[np.int64]
    """Features whose map feature is known."""
    which: NDArray[np.int64]
    """The index of that map feature."""
    unknown: NDArray[np.int64]
    """Features whose correspondence is unknown."""
    spurious: NDArray[np.int64]
    """Features known to be of nothing in the map."""


class Tables(NamedTuple):
    """What the kernels need of map and observation."""

    map_features: FloatArray
    """(N, c) the map."""
    features: FloatArray
    """(k, 5) the features."""
    base: FloatArray
    """(k, N) constants given each map feature, or (k,) where they are the same for all."""
    log_spurious: FloatArray
    """(k,) log density given nothing in the map."""


@dataclass(frozen=True, eq=False)
class CorrespondenceModel(ABC, Generic[Z]):
    """p(f(z) | x, m) of features, each of one map feature or of none; independent given pose and map (6.39).

    A model of landmarks or lines says how likely a feature is given its map feature; what follows from that is here.

    Parameters
    ----------
    correspondence
        What to do with features whose id is unknown; ids that are given are always used, and `without_ids` of the
        features takes them off.

        - "known": refuse them.
        - "sum": the sum over all correspondences, ``spurious_rate p(f | none) + (1 - spurious_rate) / N sum_j p(f |
          j)``: each of the N map features is as likely as any other before the feature is seen. A density.
        - "nearest": the largest term of that sum, the most probable map feature or none. With equal noise for all of
          them the best one is that of the least Mahalanobis distance over all that was measured. Not a density over
          features.
        - "assignment": as "nearest", for all features of unknown id together, and no map feature explains two of them
          (those that known ids name are taken). -inf if there are more features than map features and spurious_rate is
          0. Not a density over features. A wall that is seen in pieces needs another.
    mount
        (3,) pose of the sensor on the robot, metres and radians; zero for features in the robot's frame.

    Raises
    ------
    InvalidInputError
        If correspondence has no such value, or the mount is not a pose.

    Notes
    -----
    Instances are immutable, can be pickled and may be used from several threads.

    References
    ----------
    Probabilistic Robotics, 6.6.2 and 6.6.3: (6.38) to (6.40).
    """

    correspondence: Correspondence = field(kw_only=True)
    mount: FloatArray = field(default_factory=lambda: np.zeros(3), kw_only=True)

    feature_name: ClassVar[str]
    """What a feature is called in errors."""
    _kernels: ClassVar[ModuleType]
    """Has add_known and fill_candidates, with the parameters of those in `kernels.landmark`, and fill_nearest where
    nothing is excluded and the best candidate can be found without the values of all."""

    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        named = self.correspondence in get_args(Correspondence)
        require(named, "correspondence", "'known', 'nearest', 'sum' or 'assignment'", self.correspondence)
        keep(self, mount=as_mount(self.mount))

    @checked
    def log_likelihood(self, z: Z, poses: ArrayLike) -> FloatArray:
        """Return log p(f(z) | x, m) of one observation at many poses: (6.39).

        Parameters
        ----------
        z
            The features.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats; -inf where nothing explains a feature, never NaN. No features give 0.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), an id is not in the map, an id is unknown while the correspondence is
            "known", or the features are not what the model needs, see its class.
        """
        robot = as_poses(poses)
        given, tables = self._prepare(z)
        total: FloatArray = np.zeros(robot.shape[:-1])
        if len(given.spurious):
            total += tables.log_spurious[given.spurious].sum()
        if len(given.known) and total.size:
            self._add_known(given, tables, pose_rows(robot), total.reshape(-1, 1), each=False)
        if len(given.unknown) and total.size:
            total += self._unknown(z, given, tables, pose_rows(robot))[0].sum(axis=1).reshape(total.shape)
        return total

    @checked
    def detection_log_likelihood(self, z: Z, poses: ArrayLike) -> FloatArray:
        """Return what each feature contributes to `log_likelihood`; its sum over features is that value.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.

        Returns
        -------
        (..., k) nats; -inf where nothing explains the feature or, with correspondence "assignment", there is no
        assignment.

        Raises
        ------
        InvalidInputError
            As for `log_likelihood`.
        """
        return self._evaluate(z, poses)[0]

    @checked
    def correspondences(self, z: Z, poses: ArrayLike) -> NDArray[np.int64]:
        """Return the id of the map feature that each feature is taken for.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.

        Returns
        -------
        (..., k) ids; `SPURIOUS` for nothing in the map. With correspondence "sum" it is the most probable map feature
        of each feature. Where nothing explains a feature (a type that no landmark can show, no room for an assignment),
        `UNKNOWN`.

        Raises
        ------
        InvalidInputError
            As for `log_likelihood`.
        """
        return self._evaluate(z, poses)[1]

    @property
    @abstractmethod
    def _map_features(self) -> LandmarkMap | LineMap:
        """The map."""

    @property
    @abstractmethod
    def _spurious_rate(self) -> float:
        """Probability that a feature is of nothing in the map."""

    @abstractmethod
    def _tables(self, z: Z, given: Given) -> Tables:
        """Return what the kernels need, or refuse features that are not what the model needs."""

    def _exclude(
        self, z: Z, given: Given, flat: FloatArray, mount: FloatArray, map_features: FloatArray, each: FloatArray
    ) -> None:
        """Set candidates (n, unknown, N) that are none to -inf; poses, mount, map_features (c, N): see the kernels."""

    def _prepare(self, z: Z) -> tuple[Given, Tables]:
        given = self._given(z.ids, len(z))
        if len(given.unknown) and self.correspondence == "known":
            raise InvalidInputError(
                f"ids: correspondence 'known' needs an id of every {self.feature_name}, "
                f"got none for {self.feature_name} {given.unknown[0]}"
            )
        return given, self._tables(z, given)

    def _given(self, ids: NDArray[np.int64] | None, n: int) -> Given:
        if ids is None:
            return Given(_NO_FEATURES, _NO_FEATURES, np.arange(n), _NO_FEATURES)
        places = np.empty((4, n), dtype=np.int64)
        known, unknown, spurious = sort_by_id(ids, self._map_features.ids, self._map_features.by_id, UNKNOWN, places)
        if known < 0:
            self._map_features.indices_of(ids[-1 - known])  # which says so
        return Given(places[0, :known], places[1, :known], places[2, :unknown], places[3, :spurious])

    def _evaluate(self, z: Z, poses: ArrayLike) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return values and ids, each (..., k)."""
        robot = as_poses(poses)
        flat = pose_rows(robot)
        given, tables = self._prepare(z)
        values: FloatArray = np.zeros((len(flat), len(z)))
        ids = np.full((len(flat), len(z)), SPURIOUS, dtype=np.int64)
        values[:, given.spurious] = tables.log_spurious[given.spurious]
        if len(given.known):
            self._add_known(given, tables, flat, values, each=True)
            ids[:, given.known] = self._map_features.ids[given.which]
        if len(given.unknown):
            values[:, given.unknown], chosen = self._unknown(z, given, tables, flat)
            # Index N means none, N + 1 unknown.
            ids[:, given.unknown] = np.append(self._map_features.ids, [SPURIOUS, UNKNOWN])[chosen]
        shape = (*robot.shape[:-1], len(z))
        return values.reshape(shape), ids.reshape(shape)

    def _add_known(self, given: Given, tables: Tables, flat: FloatArray, out: FloatArray, *, each: bool) -> None:
        """Add the features whose map features are known to out: each to its own column of (n, k), or all to (n, 1)."""
        mount, (map_features, features, base, _) = self._mount_in_sensor_axes, tables

        def work(a: int, b: int) -> None:
            self._kernels.add_known(
                flat[a:b], mount, features, map_features, base, given.known, given.which, each, out[a:b]
            )

        run_in_blocks(work, len(flat), work_per_row=1 + len(given.known) // 2)

    def _unknown(self, z: Z, given: Given, tables: Tables, flat: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return values and indices of map features (N for none, N + 1 where there is no room), each (n, unknown)."""
        k, n_map_features = len(given.unknown), len(self._map_features)
        values = np.empty((len(flat), k))
        chosen = np.empty((len(flat), k), dtype=np.int64)
        features, base = (table.take(given.unknown, axis=0) for table in (tables.features, tables.base))
        none = tables.log_spurious.take(given.unknown) + _log(self._spurious_rate)
        map_features, mount = tables.map_features.T.copy(), self._mount_in_sensor_axes
        if self.correspondence == "nearest" and hasattr(self._kernels, "fill_nearest"):
            prior = self._log_share_of_map_feature()

            def nearest(a: int, b: int) -> None:
                self._kernels.fill_nearest(
                    flat[a:b], mount, features, map_features, base, prior, none, values[a:b], chosen[a:b]
                )

            run_in_blocks(nearest, len(flat), work_per_row=1 + k * n_map_features // 8)
            return values, chosen
        rows = max(1, VALUES_PER_CHUNK // (k * (n_map_features + 1)))

        def chunk(a: int, b: int) -> None:
            each = np.empty((b - a, k, n_map_features))
            self._kernels.fill_candidates(flat[a:b], mount, features, map_features, base, each)
            self._exclude(z, given, flat[a:b], mount, map_features, each)
            self._choose(each, none, given.which, values[a:b], chosen[a:b])

        def work(start: int, stop: int) -> None:
            for a in range(start, stop, rows):
                # Its memory is free again before the next one asks for it.
                chunk(a, min(a + rows, stop))

        run_in_blocks(work, len(flat), work_per_row=k * n_map_features)
        return values, chosen

    def _choose(
        self,
        each: FloatArray,
        none: FloatArray,
        taken: NDArray[np.int64],
        values: FloatArray,
        chosen: NDArray[np.int64],
    ) -> None:
        n_map_features = each.shape[-1]
        prior = self._log_share_of_map_feature()
        if self.correspondence == "assignment":
            # Taken by a feature whose id is known.
            each[..., taken] = -np.inf
            assign_exclusively(each + prior, none, values, chosen)
            return
        chosen[...] = each.argmax(axis=-1)
        values[...] = each.max(axis=-1) + prior
        chosen[none > values] = n_map_features
        chosen[np.maximum(values, none) == -np.inf] = n_map_features + 1
        if self.correspondence == "sum":
            fill_sums(each, prior, none, values)
        else:
            np.maximum(values, none, out=values)

    def _log_share_of_map_feature(self) -> float:
        """Return the log probability that a feature is of one certain map feature, before it is seen."""
        return math.log1p(-self._spurious_rate) - math.log(len(self._map_features))

    @cached_property
    def _mount_in_sensor_axes(self) -> FloatArray:
        x, y, theta = self.mount.tolist()
        cos, sin = math.cos(theta), math.sin(theta)
        mount = np.array([cos * x + sin * y, cos * y - sin * x, theta])
        mount.flags.writeable = False  # as `restore` makes it
        return mount


def _log(probability: float) -> float:
    return math.log(probability) if probability > 0.0 else -math.inf
