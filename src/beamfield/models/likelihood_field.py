"""The likelihood field model of range finders: section 6.4, Table 6.3."""

from __future__ import annotations

from dataclasses import InitVar, dataclass, field
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import check_fields, checked, keep, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses
from beamfield.indices import as_indices
from beamfield.kernels.device import require_device
from beamfield.maps.distance import DistanceField
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_dependence import settle_dependence
from beamfield.models.field_look_ups import FieldLookUps
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.field_tables import FieldTables
from beamfield.sensors import RangeFinder, Scan
from beamfield.short_repr import short_repr

# A hit further than this many sigma from its obstacle is lost in any z_rand; without z_rand, only beyond the second
# number does its density underflow to 0.
HIT_SIGMAS, HIT_SIGMAS_WITHOUT_RAND = 8.0, 38.6
MAX_TABLE_CELLS = 2**32 - 1


class BeamProfile(NamedTuple):
    """Figure 6.9: the sensor's axis through the field, normalised."""

    ranges: FloatArray
    """(n,) metres."""
    hit: FloatArray
    """(n,) p_hit, a density over the range (6.33); all 0 if it stays below double precision all along the axis."""
    density: FloatArray
    """(n,) z_hit p_hit + z_rand p_rand (6.34), without the point mass of "no return"."""

    def __repr__(self) -> str:
        return short_repr(self)


@dataclass(frozen=True, eq=False)
class LikelihoodFieldModel:
    """q(z | x, m) of a range scan by the distance of its end points to the nearest obstacles (Table 6.3).

    Each beam's end point is placed in the map (6.32). Its value is ``z_hit prob(dist, sigma_hit) + z_rand / z_max``
    with the normal density of the distance to the nearest obstacle; readings of max_range are left out, the others
    multiplied.

    Use it for tracking, scan matching and in clutter: it is smooth in the pose and quick. It sees through walls, and
    knows nothing of people. It is **not a density over scans**: values of different scans, or under different
    parameters, cannot be compared; see `profile` for one beam made a density.

    Parameters
    ----------
    grid
        The map.
    parameters
        z_hit, z_rand and sigma_hit; or what `read_likelihood_field` returns, which brings exponent and n_beams too.
    max_distance
        Distances are cut off here, metres, at least one cell; None leaves them. Nearly nothing changes from
        8 sigma_hit on.
    only_boundaries
        Count only the boundary of thick walls as obstacles; see `distance_to_obstacles`.
    off_map
        "continued": past the map's edges the distance is measured on, as far as a hit reaches, so that a wall on the
        edge has two sides. "far": everything off the map has the distance max_distance (as in AMCL).
    distances
        Distances to obstacles; worked out from the map by default.
    unknown
        What an end point in an unknown cell, or off the map, is worth.

        - "free": what its distance to the nearest obstacle says, as in free space. Nothing happens at the edge of the
          known: a wall looks the same from both of its sides, and unknown space is worth as much as free space equally
          far from obstacles. Neither attracts a pose. Off the map the same holds as far as the field goes
          (as `off_map` says); beyond, the distance is the field's max_distance.
        - "uniform": 1 / z_max in unknown cells and everywhere off the map (6.4.2). **This is biased.** 1 / z_max is
          more than the z_rand / z_max of free space, so poses gain log(1 / z_rand) for each beam they can point into
          the unknown instead of into free space; and next to a wall with the unknown behind it, it cuts off one side
          of the Gaussian, so that poses are pushed off. Any constant has the second fault: docs/likelihood_field.md.
    interpolation
        "nearest" takes the distance of the cell that holds the end point. "bilinear" interpolates it between the
        centres of cells: slower, continuous, with a gradient.
    exponent
        Power of each beam's value (the alpha of 6.3.4), because neighbouring beams are dependent; None: 1, or what
        the parameters bring.
    n_beams
        Use only so many beams of each scan: about equally spaced among those that have an end point, so that NaN, too
        close and max-range readings do not use up the number. None: all, or what the parameters bring.
    device
        Where `log_likelihood` looks up: "cpu", or "cuda", a GPU, for "nearest" only (docs/gpu.md). All else is
        computed on the CPU.

    Raises
    ------
    InvalidInputError
        If the exponent is not positive and finite, n_beams < 1, an option has no such value, max_distance is not
        finite or shorter than a cell, so that all places off the obstacles would be alike, or device is "cuda" and
        there is no GPU.
    MissingDependencyError
        If device is "cuda" and numba-cuda is not installed.

    Notes
    -----
    z_max of Table 6.3 is the max_range of the scan's finder. A map without obstacles gives every end point the value
    z_rand / z_max. Without z_rand, an end point whose density is 0 in double precision (38 sigma from any obstacle)
    makes the scan impossible: -inf.

    For "nearest", the logarithm of a beam's value is kept for each cell as a 32-bit integer (`table_bytes`), made at
    the first scan with a given max_range. Errors against double precision: 1e-8 nats a beam from the codes (7e-7
    without z_rand), none from distances up to 1024 cells, and end points are placed within 5e-7 times the larger of the
    table's width, its height and the distance to the pose; an end point closer than that to the border of its cell may
    read the neighbour.

    "bilinear" computes in double precision, but its distances between centres are single-precision numbers. What it
    makes of them is within 1e-9 nats a beam, and a beam's gradient within 1e-9 of its size and 1e-10 / sigma_hit. Its
    table, the distances in a frame, is made at the first scan.

    Instances are immutable, can be pickled and may be used from several threads.

    References
    ----------
    Probabilistic Robotics, section 6.4: (6.32) to (6.34), Table 6.3, 6.4.2; 6.3.4 for exponent and n_beams.

    Examples
    --------
    >>> room = np.zeros((40, 40))
    >>> room[[0, -1]] = 100
    >>> room[:, [0, -1]] = 100
    >>> grid = OccupancyGrid.from_ros(room, resolution=0.1)
    >>> model = LikelihoodFieldModel(grid, LikelihoodFieldParameters(z_hit=0.8, z_rand=0.1, sigma_hit=0.1))
    >>> finder = RangeFinder.from_bearings([0.0, np.pi / 2], max_range=8.0)
    >>> scan = Scan([1.98, 0.98], finder)
    >>> model.log_likelihood(scan, [[1.95, 2.95, 0.0], [2.95, 1.95, 0.0]]).round(2).tolist()
    [2.33, -8.76]
    """

    is_normalized: ClassVar[bool] = False

    grid: OccupancyGrid
    parameters: LikelihoodFieldParameters
    max_distance: InitVar[float | None] = field(default=None, kw_only=True)
    only_boundaries: InitVar[bool] = field(default=False, kw_only=True)
    off_map: InitVar[Literal["continued", "far"]] = field(default="continued", kw_only=True)
    distances: DistanceField = field(default=None, kw_only=True)  # type: ignore[assignment]  # always there once constructed
    unknown: Literal["free", "uniform"] = field(default="free", kw_only=True)
    interpolation: Literal["nearest", "bilinear"] = field(default="nearest", kw_only=True)
    exponent: float = field(default=None, kw_only=True)  # type: ignore[assignment]  # the same
    n_beams: int | None = field(default=None, kw_only=True)
    device: Literal["cpu", "cuda"] = field(default="cpu", kw_only=True)
    _look_ups: FieldLookUps = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(
        self, max_distance: float | None, only_boundaries: bool, off_map: Literal["continued", "far"]
    ) -> None:
        check_fields(self)
        settle_dependence(self)
        for name, known in (("unknown", ("free", "uniform")), ("interpolation", ("nearest", "bilinear"))):
            if getattr(self, name) not in known:
                raise InvalidInputError(f"{name}: expected {known[0]!r} or {known[1]!r}, got {getattr(self, name)!r}")
        require_device(self.device)
        if self.device == "cuda" and self.interpolation != "nearest":
            raise InvalidInputError(f"interpolation: device='cuda' needs 'nearest', got {self.interpolation!r}")
        if self.distances is None:
            made = _distances_for(self.grid, self.parameters, max_distance, only_boundaries, off_map)
            keep(self, distances=made)
        elif self.distances.grid is not self.grid:
            raise InvalidInputError("distances: expected distances of the model's map, got those of another map")
        rows, cols = self.distances.distance.shape
        if (rows + 2) * (cols + 2) > MAX_TABLE_CELLS:
            raise InvalidInputError(f"distances: expected fewer than 2^32 cells, got {rows} x {cols}")
        self._make_look_ups()

    @property
    def table_bytes(self) -> int:
        """Memory of the table for one max_range: four bytes per cell of the field, and a frame of one cell.

        With "bilinear", that of the distances in such a frame, for all scans: two rows more, and a byte more per cell
        if unknown is "uniform".
        """
        rows, cols = self.distances.distance.shape
        if self.interpolation == "nearest":
            return 4 * int(rows + 2) * int(cols + 2)
        return (5 if self.unknown == "uniform" else 4) * int(rows + 4) * int(cols + 2)

    @checked
    def log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return log q of one scan at many poses: Table 6.3 in log space.

        Parameters
        ----------
        z
            The scan.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats, times the exponent; -inf only without z_rand, never NaN. A scan without any end point gives 0.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        total = self._look_ups.sums(z, poses)
        return total if self.exponent == 1.0 else np.asarray(self.exponent * total)

    @checked
    def beam_log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return what each beam contributes to `log_likelihood`, (..., k); its sum over beams is that value.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.

        Returns
        -------
        (..., k) nats, times the exponent; 0 for beams without end point and those that n_beams leaves out.
        """
        robot = as_poses(poses)
        beams, values = self._look_ups.beam_values(z, robot)
        result: FloatArray = np.zeros((*robot.shape[:-1], z.finder.n_beams))
        result[..., beams] = self.exponent * values.reshape(*robot.shape[:-1], len(beams))
        return result

    def log_likelihood_gradient(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return the derivative of `log_likelihood` with respect to the pose; interpolation "bilinear" only.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.

        Returns
        -------
        (..., 3) nats per metre, metre and radian, times the exponent. Along lines between cells' centres, where the
        interpolation has a bend, it is the derivative to one side; off the field, and in unknown space if that is
        "uniform", a beam adds nothing.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), or the model's interpolation is "nearest".
        """
        if self.interpolation != "bilinear":
            raise InvalidInputError(f"interpolation: a gradient needs 'bilinear', got {self.interpolation!r}")
        return self.exponent * self._look_ups.gradient(z, as_poses(poses))

    def distances_to_obstacles(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return the distance of each beam's end point to the nearest obstacle, metres: dist of Table 6.3.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.

        Returns
        -------
        (..., k); NaN for beams without end point. Unknown space counts as free here.
        """
        robot = as_poses(poses)
        beams, ends = self._look_ups.end_points(z)
        result: FloatArray = np.full((*robot.shape[:-1], z.finder.n_beams), np.nan)
        values = self._look_ups.distances_at(ends, robot.reshape(-1, 3))
        result[..., beams] = values.reshape(*robot.shape[:-1], len(beams))
        return result

    @checked
    def profile(self, pose: ArrayLike, finder: RangeFinder, beam: int = 0, *, n: int = 2000) -> BeamProfile:
        """Return p(z^k | x, m) along one beam, made a density: (6.33) and (6.34), Figure 6.9.

        The model itself does not do this: p_hit is the field along the sensor's axis divided by its integral.

        Parameters
        ----------
        pose
            (3,) the robot's pose.
        finder
            The sensor.
        beam
            Index of the beam.
        n
            Number of ranges, the midpoints of equal pieces of [0, max_range].
        """
        require(n >= 1, "n", "at least 1", n)
        (beam,) = as_indices([beam], finder.n_beams, "beam")
        spacing = finder.max_range / n
        ranges = np.asarray((np.arange(n) + 0.5) * spacing, dtype=np.float64)
        mount = finder.mounts[beam]
        direction = np.array([np.cos(mount[2]), np.sin(mount[2])])
        axis = (mount[:2, None] + direction[:, None] * ranges) / self.distances.grid.resolution
        dist = self._look_ups.distances_at(axis, as_poses(pose).reshape(1, 3))[0]
        hit: FloatArray = np.exp(np.square(dist / self.parameters.sigma_hit) * -0.5)
        mass = float(hit.sum()) * spacing
        if mass > 0.0:
            hit = np.asarray(hit / mass)
        density: FloatArray = self.parameters.z_hit * hit + self.parameters.z_rand / finder.max_range
        return BeamProfile(ranges, hit, density)

    def _make_look_ups(self) -> None:
        tables = FieldTables(self.distances, self.parameters, unknown_is_uniform=self.unknown == "uniform")
        keep(self, _look_ups=FieldLookUps(tables, self.distances, self.interpolation, self.n_beams, self.device))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the tables: they are quick to make again."""
        return {name: value for name, value in self.__dict__.items() if name != "_look_ups"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._make_look_ups()


@checked
def _distances_for(
    grid: OccupancyGrid, parameters: LikelihoodFieldParameters, max_distance: float | None, only_boundaries: bool,
    off_map: str,
) -> DistanceField:  # fmt: skip
    """Return the distances over a map and, if continued, as far past its edges as a hit reaches."""
    if max_distance is not None and 0.0 < max_distance < grid.resolution:
        raise InvalidInputError(
            f"max_distance: expected at least one cell, {grid.resolution:g} m, or None, got {max_distance}"
        )
    require(off_map in ("continued", "far"), "off_map", "'continued' or 'far'", off_map)
    margin = 0.0
    if off_map == "continued":
        margin = parameters.sigma_hit * (HIT_SIGMAS if parameters.z_rand > 0.0 else HIT_SIGMAS_WITHOUT_RAND)
        if max_distance is not None and 0.0 < max_distance < margin:
            margin = max_distance
        margin += grid.resolution  # the interpolation's neighbour
    return DistanceField.from_grid(grid, max_distance=max_distance, only_boundaries=only_boundaries, margin=margin)
