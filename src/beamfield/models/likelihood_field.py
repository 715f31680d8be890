"""The likelihood field model of range finders: section 6.4, Table 6.3."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import InitVar, dataclass, field
from functools import partial
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, checked, keep, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, as_unchecked_poses, pose_rows
from beamfield.kernels import field as kernels
from beamfield.kernels import smooth_field
from beamfield.kernels.device import require_device
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.distance import DistanceField
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_dependence import settle_dependence
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.field_tables import FieldTables, Table
from beamfield.sensors import RangeFinder, Scan
from beamfield.short_repr import short_repr

# A hit further than this many sigma from its obstacle is lost in any z_rand; without z_rand, only beyond the second
# number does its density underflow to 0.
HIT_SIGMAS, HIT_SIGMAS_WITHOUT_RAND = 8.0, 38.6
MAX_TABLE_CELLS = 2**32 - 1
# How many look-ups take as long as what `run_in_blocks` calls a unit of work.
LOOK_UPS_PER_WORK_UNIT = {"nearest": 30, "bilinear": 3}
# Poses whose beams' values are kept at a time where they are summed one by one.
POSES_TOGETHER = 512
# Takes poses (n, 3) and fills in what is asked for of each.
Fill = Callable[[FloatArray, FloatArray], object]


class BeamProfile(NamedTuple):
    """Figure 6.9: the sensor's axis through the field, normalised."""

    ranges: FloatArray
    """(n,) metres."""
    hit: FloatArray
    """(n,) p_hit, a density over the range (6.33); all 0 if it stays below double precision all along the axis."""
    density: FloatArray
    """(n,) z_hit p_hit + z_rand p_rand (6.34), without the point mass of "no return"."""


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
        Where `log_likelihood` looks up: "cpu", or "cuda", a GPU, for "nearest" only (docs/raycasting.md). All else is
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
    _tables: FieldTables = field(init=False, repr=False)

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
        self._make_tables()

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
        table = self._tables.table(z.finder.max_range) if self.interpolation == "nearest" else None
        if self.device == "cuda":
            total = self._sums_on_device(z, as_poses(poses))
        elif table is None or table.has_impossible:
            total = self._sums(z, as_poses(poses))
        else:
            total = self._code_sums(z, table, poses)
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
        beams, ends = self._end_points(z)
        result: FloatArray = np.zeros((*robot.shape[:-1], z.finder.n_beams))
        values = np.empty((robot.size // 3, len(beams)))
        if values.size:
            self._run(self._values(z.finder.max_range, ends), robot, values, len(beams))
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
        robot = as_poses(poses)
        _, ends = self._end_points(z)
        gradient: FloatArray = np.zeros(robot.shape)
        if ends.size and gradient.size:
            frame, table = self._tables.centred, self._tables.smooth
            view = self._tables.smooth_view(z.finder.max_range)

            def work(flat: FloatArray, out: FloatArray) -> None:
                smooth_field.fill_gradient(flat, frame, ends, table, view, out)

            self._run(work, robot, gradient.reshape(-1, 3), ends.shape[1])
        return self.exponent * gradient

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
        beams, ends = self._end_points(z)
        result: FloatArray = np.full((*robot.shape[:-1], z.finder.n_beams), np.nan)
        values = self._distances(ends, robot.reshape(-1, 3))
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
        spacing = finder.max_range / n
        ranges = np.asarray((np.arange(n) + 0.5) * spacing, dtype=np.float64)
        mount = finder.mounts[beam]
        direction = np.array([np.cos(mount[2]), np.sin(mount[2])])
        axis = (mount[:2, None] + direction[:, None] * ranges) / self.distances.grid.resolution
        dist = self._distances(axis, as_poses(pose).reshape(1, 3))[0]
        hit: FloatArray = np.exp(np.square(dist / self.parameters.sigma_hit) * -0.5)
        mass = float(hit.sum()) * spacing
        if mass > 0.0:
            hit = np.asarray(hit / mass)
        density: FloatArray = self.parameters.z_hit * hit + self.parameters.z_rand / finder.max_range
        return BeamProfile(ranges, hit, density)

    def _end_points(self, scan: Scan) -> tuple[NDArray[np.int64], FloatArray]:
        """Return which beams count and their end points in the robot frame, (2, k), in cells: (6.32) at pose 0."""
        finder = scan.finder
        beams, ends = np.empty(finder.n_beams, np.int64), np.empty((2, finder.n_beams))
        n = kernels.fill_end_points(
            scan.ranges, finder.mounts, finder.min_range, finder.max_range, 1.0 / self.distances.grid.resolution,
            beams, ends,
        )  # fmt: skip
        if self.n_beams is not None and self.n_beams < n:
            chosen = np.round(np.linspace(0, n - 1, self.n_beams)).astype(np.int64)
            return beams[chosen], np.ascontiguousarray(ends[:, chosen])
        return beams[:n], np.ascontiguousarray(ends[:, :n])

    def _distances(self, ends: FloatArray, poses: FloatArray) -> FloatArray:
        """Return the distances (n, k) at end points (2, k), in cells, for poses (n, 3)."""
        values: FloatArray = np.empty((len(poses), ends.shape[1]))
        poses = pose_rows(poses)
        far = self.distances.max_distance
        if self.interpolation == "bilinear":
            table = self._tables.smooth._replace(uniform=np.empty(0, np.bool_))
            smooth_field.fill_distances(poses, self._tables.centred, ends, table, far, values)
        else:
            kernels.fill_distances(poses, self._tables.frame, ends, self.distances.distance, far, values)
        return values

    def _code_sums(self, scan: Scan, table: Table, poses: ArrayLike) -> FloatArray:
        """Return the sums over beams by a table without impossible cells: few steps, as short calls take 50 us."""
        robot, finder = as_unchecked_poses(poses), scan.finder
        flat = pose_rows(robot)
        out, all_finite = np.empty(len(flat)), []
        ranges = scan.ranges if self.n_beams is None else self._chosen_ranges(scan)
        sensor = finder.mounts, finder.min_range, finder.max_range

        def work(a: int, b: int) -> None:
            rows, sums = flat[a:b], out[a:b]
            all_finite.append(kernels.fill_range_sums(rows, table.packed, ranges, *sensor, table.codes, sums))

        run_in_blocks(work, len(flat), work_per_row=finder.n_beams / LOOK_UPS_PER_WORK_UNIT["nearest"])
        if not all(all_finite):
            as_poses(robot)  # says which
        return out.reshape(robot.shape[:-1])

    def _chosen_ranges(self, scan: Scan) -> FloatArray:
        """Return the ranges with NaN for beams that n_beams leaves out."""
        beams, _ = self._end_points(scan)
        ranges: FloatArray = np.full(scan.finder.n_beams, np.nan)
        ranges[beams] = scan.ranges[beams]
        # As a scan's own ranges are: kernels are compiled for these alone.
        ranges.flags.writeable = False
        return ranges

    def _sums(self, scan: Scan, robot: FloatArray) -> FloatArray:
        """Return the sums over beams where `_code_sums` does not."""
        finder = scan.finder
        _, ends = self._end_points(scan)
        total = np.empty(robot.shape[:-1])
        work: Fill = partial(_add_up, self._values(finder.max_range, ends), ends.shape[1])
        if self.interpolation == "bilinear":
            frame, smooth, view = self._tables.centred, self._tables.smooth, self._tables.smooth_view(finder.max_range)
            n_factors = smooth_field.n_factors(view)
            if n_factors:
                work = lambda flat, out: smooth_field.fill_sums(flat, frame, ends, smooth, view, n_factors, out)  # noqa: E731
        self._run(work, robot, total.reshape(-1), ends.shape[1])
        return total

    def _sums_on_device(self, scan: Scan, robot: FloatArray) -> FloatArray:
        """Return the sums over beams, looked up on the GPU."""
        from beamfield.kernels import cuda_field

        table, codes = self._tables.table_on_device(scan.finder.max_range)
        _, ends = self._end_points(scan)
        total, flat = np.zeros(robot.shape[:-1]), np.ascontiguousarray(robot.reshape(-1, 3))
        if ends.size:
            singles, frame, sums = ends.astype(np.float32), self._tables.framed, total.reshape(-1)
            cuda_field.fill_scan_sums(flat, frame, singles, codes, table.codes.shape, table.low, table.step, sums)
        return total

    def _values(self, max_range: float, ends: FloatArray) -> Fill:
        """Return the function (poses (n, 3), out (n, k)) that fills in each beam."""
        if self.interpolation == "bilinear":
            centred, smooth, view = self._tables.centred, self._tables.smooth, self._tables.smooth_view(max_range)

            def work(flat: FloatArray, out: FloatArray) -> None:
                smooth_field.fill_distances(flat, centred, ends, smooth, np.nan, out)
                smooth_field.fill_values(view, out)

            return work
        table, frame, singles = self._tables.table(max_range), self._tables.framed, ends.astype(np.float32)
        return lambda flat, out: kernels.fill_beam_values(flat, frame, singles, table.codes, table.low, table.step, out)

    def _run(self, work: Fill, robot: FloatArray, out: FloatArray, n_ends: int) -> None:
        flat = pose_rows(robot)
        work_per_row = n_ends / LOOK_UPS_PER_WORK_UNIT[self.interpolation]
        run_in_blocks(lambda a, b: work(flat[a:b], out[a:b]), len(flat), work_per_row=work_per_row)

    def _make_tables(self) -> None:
        uniform = self.unknown == "uniform"
        keep(self, _tables=FieldTables(self.distances, self.parameters, unknown_is_uniform=uniform))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the tables: they are quick to make again."""
        return {name: value for name, value in self.__dict__.items() if name != "_tables"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._make_tables()


def _add_up(fill: Fill, n_ends: int, flat: FloatArray, out: FloatArray) -> None:
    """Fill out (n,) with the sums over beams of what a kernel fills in beam by beam, a part of the poses at a time."""
    each = np.empty((min(len(flat), POSES_TOGETHER), n_ends))
    for start in range(0, len(flat), POSES_TOGETHER):
        part = flat[start : start + POSES_TOGETHER]
        fill(part, each[: len(part)])
        each[: len(part)].sum(axis=1, out=out[start : start + len(part)])


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
