"""How the end points of a scan are looked up in a likelihood field, and summed over beams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.geometry import FloatArray, as_poses, as_unchecked_poses, pose_rows
from beamfield.kernels import field as kernels
from beamfield.kernels import smooth_field
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.distance import DistanceField
from beamfield.models.field_tables import FieldTables, Table
from beamfield.sensors import Scan

# How many look-ups take as long as what `run_in_blocks` calls a unit of work.
LOOK_UPS_PER_WORK_UNIT = {"nearest": 30, "bilinear": 3}
# Poses whose beams' values are kept at a time where they are summed one by one.
POSES_TOGETHER = 512
# Takes poses (n, 3) and fills in what is asked for of each.
Fill = Callable[[FloatArray, FloatArray], object]


@dataclass(frozen=True, eq=False)
class FieldLookUps:
    """Look-ups in the tables of one `LikelihoodFieldModel`.

    Parameters
    ----------
    tables
        What is looked up, each made when it is asked for first.
    distances, interpolation, n_beams, device
        Of the model.
    """

    tables: FieldTables
    distances: DistanceField
    interpolation: Literal["nearest", "bilinear"]
    n_beams: int | None
    device: Literal["cpu", "cuda"]

    def sums(self, scan: Scan, poses: ArrayLike) -> FloatArray:
        """Return the sums over beams of log q (...) at poses (..., 3), which are checked here."""
        table = self.tables.table(scan.finder.max_range) if self.interpolation == "nearest" else None
        if self.device == "cuda":
            return self._sums_on_device(scan, as_poses(poses))
        if table is None or table.has_impossible:
            return self._sums_of_values(scan, as_poses(poses))
        return self._code_sums(scan, table, poses)

    def beam_values(self, scan: Scan, robot: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
        """Return which beams count, k of them, and the log q (n, k) of each at n poses (..., 3)."""
        beams, ends = self.end_points(scan)
        values = np.empty((robot.size // 3, len(beams)))
        if values.size:
            self._run(self._values(scan.finder.max_range, ends), robot, values, len(beams))
        return beams, values

    def gradient(self, scan: Scan, robot: FloatArray) -> FloatArray:
        """Return the derivatives of `sums` (..., 3) by the poses; of interpolated distances only."""
        _, ends = self.end_points(scan)
        gradient: FloatArray = np.zeros(robot.shape)
        if ends.size and gradient.size:
            frame, table, view = self.tables.centred, self.tables.smooth, self.tables.smooth_view(scan.finder.max_range)

            def work(flat: FloatArray, out: FloatArray) -> None:
                smooth_field.fill_gradient(flat, frame, ends, table, view, out)

            self._run(work, robot, gradient.reshape(-1, 3), ends.shape[1])
        return gradient

    def end_points(self, scan: Scan) -> tuple[NDArray[np.int64], FloatArray]:
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

    def distances_at(self, ends: FloatArray, poses: FloatArray) -> FloatArray:
        """Return the distances (n, k) at end points (2, k), in cells, for poses (n, 3)."""
        values: FloatArray = np.empty((len(poses), ends.shape[1]))
        poses = pose_rows(poses)
        far = self.distances.max_distance
        if self.interpolation == "bilinear":
            table = self.tables.smooth._replace(uniform=np.empty(0, np.bool_))
            smooth_field.fill_distances(poses, self.tables.centred, ends, table, far, values)
        else:
            kernels.fill_distances(poses, self.tables.frame, ends, self.distances.distance, far, values)
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
        beams, _ = self.end_points(scan)
        ranges: FloatArray = np.full(scan.finder.n_beams, np.nan)
        ranges[beams] = scan.ranges[beams]
        # As a scan's own ranges are: kernels are compiled for these alone.
        ranges.flags.writeable = False
        return ranges

    def _sums_of_values(self, scan: Scan, robot: FloatArray) -> FloatArray:
        """Return the sums over beams where `_code_sums` does not."""
        finder = scan.finder
        _, ends = self.end_points(scan)
        total = np.empty(robot.shape[:-1])
        work: Fill = partial(_add_up, self._values(finder.max_range, ends), ends.shape[1])
        if self.interpolation == "bilinear":
            frame, smooth, view = self.tables.centred, self.tables.smooth, self.tables.smooth_view(finder.max_range)
            n_factors = smooth_field.n_factors(view)
            if n_factors:
                work = lambda flat, out: smooth_field.fill_sums(flat, frame, ends, smooth, view, n_factors, out)  # noqa: E731
        self._run(work, robot, total.reshape(-1), ends.shape[1])
        return total

    def _sums_on_device(self, scan: Scan, robot: FloatArray) -> FloatArray:
        """Return the sums over beams, looked up on the GPU."""
        from beamfield.kernels import cuda_field

        table, codes = self.tables.table_on_device(scan.finder.max_range)
        _, ends = self.end_points(scan)
        total, flat = np.zeros(robot.shape[:-1]), np.ascontiguousarray(robot.reshape(-1, 3))
        if ends.size:
            singles, frame, sums = ends.astype(np.float32), self.tables.framed, total.reshape(-1)
            cuda_field.fill_scan_sums(flat, frame, singles, codes, table.codes.shape, table.low, table.step, sums)
        return total

    def _values(self, max_range: float, ends: FloatArray) -> Fill:
        """Return the function (poses (n, 3), out (n, k)) that fills in each beam."""
        if self.interpolation == "bilinear":
            centred, smooth, view = self.tables.centred, self.tables.smooth, self.tables.smooth_view(max_range)

            def work(flat: FloatArray, out: FloatArray) -> None:
                smooth_field.fill_distances(flat, centred, ends, smooth, np.nan, out)
                smooth_field.fill_values(view, out)

            return work
        table, frame, singles = self.tables.table(max_range), self.tables.framed, ends.astype(np.float32)
        return lambda flat, out: kernels.fill_beam_values(flat, frame, singles, table.codes, table.low, table.step, out)

    def _run(self, work: Fill, robot: FloatArray, out: FloatArray, n_ends: int) -> None:
        flat = pose_rows(robot)
        work_per_row = n_ends / LOOK_UPS_PER_WORK_UNIT[self.interpolation]
        run_in_blocks(lambda a, b: work(flat[a:b], out[a:b]), len(flat), work_per_row=work_per_row)


def _add_up(fill: Fill, n_ends: int, flat: FloatArray, out: FloatArray) -> None:
    """Fill out (n,) with the sums over beams of what a kernel fills in beam by beam, a part of the poses at a time."""
    each = np.empty((min(len(flat), POSES_TOGETHER), n_ends))
    for start in range(0, len(flat), POSES_TOGETHER):
        part = flat[start : start + POSES_TOGETHER]
        fill(part, each[: len(part)])
        each[: len(part)].sum(axis=1, out=out[start : start + len(part)])
