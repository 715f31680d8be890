"""What the kernels of likelihood fields read: frames, the logarithm of each cell's value, and framed distances."""

from __future__ import annotations

import math
import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.kernels import field as kernels
from beamfield.kernels import smooth_field
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.distance import DistanceField
from beamfield.models.field_parameters import LikelihoodFieldParameters

# From the distance on where a hit's share of a beam's value is this, the share is left out.
NEGLIGIBLE_HIT = 1e-11
# Tables are kept for so many different ranges of "no return".
MAX_TABLES = 4


class Table(NamedTuple):
    """Logarithms of all cells' values for one max_range, as integers: low + step * code nats."""

    codes: NDArray[np.int32]
    """(rows + 2, cols + 2), with a frame of one cell for what lies off the field."""
    low: float
    step: float
    has_impossible: bool
    """Whether some code is IMPOSSIBLE, which stands for -inf."""
    packed: FloatArray
    """The frame of the table, low and step, (9,): as `fill_range_sums` takes them."""


class FieldTables:
    """Tables of one field under one set of parameters, each made when it is asked for first; safe between threads.

    Parameters
    ----------
    distances, parameters
        Of the model.
    unknown_is_uniform
        Whether unknown cells and all that lies off the map are worth 1 / z_max (6.4.2).
    """

    def __init__(
        self, distances: DistanceField, parameters: LikelihoodFieldParameters, *, unknown_is_uniform: bool
    ) -> None:
        self._distances, self._parameters = distances, parameters
        self.uniform: NDArray[np.bool_] = np.empty((0, 0), np.bool_)
        """Cells whose value is 1 / z_max; without any element if there is none."""
        if unknown_is_uniform:
            self.uniform = np.pad(distances.grid.unknown, distances.margin_cells, constant_values=True)
        self.frame = self._make_frame(0)
        """How the map frame becomes positions in the field."""
        self.framed = self._make_frame(1)
        """How the map frame becomes positions in a table, which has a frame of one cell around the field."""
        self.centred = self._make_frame(0.5)
        """How the map frame becomes positions from the first centre of the table of distances."""
        self._tables: dict[float, Table] = {}
        self._on_device: dict[float, tuple[Table, Any]] = {}
        self._smooth: smooth_field.Table | None = None
        self._smooth_views: dict[float, smooth_field.SmoothView] = {}
        self._lock = threading.Lock()

    def view(self, max_range: float) -> kernels.FieldView:
        """Return the parameters as the kernels take them, for scans with this limit."""
        p = self._parameters
        rand = p.z_rand / max_range
        log_rand, reach = -math.inf, math.inf
        if rand > 0.0:
            log_rand = math.log(rand)
            ratio = p.z_hit * kernels.INV_SQRT_2PI / p.sigma_hit / (rand * NEGLIGIBLE_HIT)
            reach = p.sigma_hit * math.sqrt(2.0 * math.log(ratio)) if ratio > 1.0 else 0.0
        return kernels.FieldView(p.z_hit, p.sigma_hit, rand, log_rand, reach)

    def smooth_view(self, max_range: float) -> smooth_field.SmoothView:
        """Return the parameters as the kernels of interpolated distances take them."""
        view = self._smooth_views.get(max_range)
        if view is None:
            view = self._make_smooth_view(max_range)
            if len(self._smooth_views) < MAX_TABLES:
                self._smooth_views[max_range] = view
        return view

    @property
    def smooth(self) -> smooth_field.Table:
        """The table of distances, which serves for all scans."""
        if self._smooth is None:
            with self._lock:
                if self._smooth is None:
                    self._smooth = self._make_smooth()
        return self._smooth

    def table(self, max_range: float) -> Table:
        """Return the table for scans with this limit."""
        table = self._tables.get(max_range)
        if table is None:
            with self._lock:
                table = self._tables.get(max_range)
                if table is None:
                    table = self._make_table(max_range)
                    while len(self._tables) >= MAX_TABLES:
                        del self._tables[next(iter(self._tables))]
                    self._tables[max_range] = table
        return table

    def table_on_device(self, max_range: float) -> tuple[Table, Any]:
        """Return the table for scans with this limit, and its codes in the GPU's memory, flat."""
        kept = self._on_device.get(max_range)
        if kept is None:
            from beamfield.kernels.cuda_target import upload

            table = self.table(max_range)
            with self._lock:
                while len(self._on_device) >= MAX_TABLES:
                    del self._on_device[next(iter(self._on_device))]
                kept = self._on_device[max_range] = table, upload(table.codes.ravel())
        return kept

    def _make_smooth_view(self, max_range: float) -> smooth_field.SmoothView:
        p, view = self._parameters, self.view(max_range)
        peak = p.z_hit * kernels.INV_SQRT_2PI / p.sigma_hit
        steep = -1.0 / p.sigma_hit / p.sigma_hit
        far = kernels.log_value(self._distances.max_distance, view)
        return smooth_field.SmoothView(
            log_peak=math.log(peak) if peak > 0.0 else -math.inf,
            log_rand=view.log_rand,
            log_off=-math.log(max_range) if self.uniform.size else far,
            ratio=peak / view.rand if view.rand > 0.0 else math.inf,
            quotient=view.rand / peak if peak > 0.0 else math.inf,
            steep=steep,
            bits=0.5 * steep / math.log(2.0),
            reach=view.reach,
        )

    def _make_smooth(self) -> smooth_field.Table:
        rows, cols = self._distances.distance.shape
        distance = np.empty((rows + 2 + smooth_field.OFF_ROWS, cols + 2), np.float32)
        distance[1 : rows + 1, 1:-1] = self._distances.distance
        distance[0, 1:-1], distance[rows + 1, 1:-1] = distance[1, 1:-1], distance[rows, 1:-1]
        distance[:, 0], distance[:, -1] = distance[:, 1], distance[:, -2]
        distance[rows + 2 :] = 0.0  # any, as long as all are alike
        uniform = self.uniform
        if uniform.size:
            uniform = np.pad(uniform, ((1, 1 + smooth_field.OFF_ROWS), (1, 1)), constant_values=True)
        return smooth_field.Table(rows + 2 + smooth_field.OFF_ROWS, cols + 2, distance.ravel(), uniform.ravel())

    def _make_frame(self, border: float) -> kernels.FrameView:
        grid = self._distances.grid
        x, y, yaw = grid.origin.tolist()
        offset = float(self._distances.margin_cells + border)
        return kernels.FrameView(x, y, math.cos(yaw), math.sin(yaw), yaw, 1.0 / grid.resolution, offset)

    def _make_table(self, max_range: float) -> Table:
        view, log_uniform = self.view(max_range), -math.log(max_range)
        distance, uniform = self._distances.distance, self.uniform
        peak = kernels.log_value(0.0, view)
        ends = [peak, log_uniform if uniform.size else peak]
        ends.append(view.log_rand if view.rand > 0.0 else peak + kernels.SMALLEST_EXPONENT)
        low, high = min(ends), max(ends)
        step = (high - low) / kernels.LARGEST_CODE or 1.0
        rows, cols = distance.shape
        resolution = self._distances.grid.resolution
        off = log_uniform if uniform.size else kernels.log_value(self._distances.max_distance, view)
        codes = np.full((rows + 2, cols + 2), kernels.encode(off, low, step), np.int32)
        inner = codes[1:-1, 1:-1]

        def work(a: int, b: int) -> None:
            kernels.fill_codes(distance[a:b], resolution, view, low, step, inner[a:b])

        run_in_blocks(work, rows, work_per_row=cols)
        if uniform.size:
            inner[uniform] = kernels.encode(log_uniform, low, step)
        packed = np.array([*self.framed, low, step])
        return Table(codes, low, step, view.rand == 0.0 and bool(codes.min() < 0), packed)
