"""The beam table: one row per beam with its measured and its expected range; all that learning needs of a log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.data_frame import data_frame
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.indices import subset_of
from beamfield.maps.cone import make_caster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, SensorLog, usable_ranges
from beamfield.short_repr import short_repr

UnknownRule = Literal["skip", "free", "occupied"]
Progress = Callable[[int, int], None]

# Scans per call of the ray caster: keeps memory small and progress alive.
SCANS_PER_CHUNK = 256
COLUMNS = ("ranges", "expected_ranges", "scan", "beam", "stamps")
COUNTS = ("n_no_measurement", "n_unknown", "n_unsure", "n_too_close")


@dataclass(frozen=True, eq=False)
class BeamTable:
    """Beams of a log as columns of length n.

    Parameters
    ----------
    ranges
        Measured range in metres; exactly `max_range` for "no return".
    expected_ranges
        z* in metres, at most `max_range`; exactly `max_range` where the ray hits nothing.
    scan, beam
        Index of the scan in the log and of the beam in the scan.
    stamps
        Time of the scan, seconds.
    max_range
        The sensor's limit, metres.
    n_no_measurement, n_unknown
        Beams left out because they carry no measurement (NaN, too close), and because their ray enters unknown space
        before an obstacle.
    min_range
        Nearer readings are not in the table, metres; densities of what is in it start here.
    n_unsure
        Beams left out because a map drawn from the log itself does not say exactly enough where they should end.
    n_too_close
        How many of `n_no_measurement` are readings nearer than `min_range`; the others are NaN.
    """

    ranges: FloatArray
    expected_ranges: FloatArray
    scan: NDArray[np.int32]
    beam: NDArray[np.int32]
    stamps: FloatArray
    max_range: float
    n_no_measurement: int = 0
    n_unknown: int = 0
    min_range: float = 0.0
    n_unsure: int = 0
    n_too_close: int = 0

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.ranges)

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with the columns range, expected_range, scan, beam and stamp; needs pandas."""
        columns = {"range": self.ranges, "expected_range": self.expected_ranges}
        return data_frame({**columns, "scan": self.scan, "beam": self.beam, "stamp": self.stamps})

    def select(self, rows: ArrayLike) -> BeamTable:
        """Return the table with only the given rows, indices or a mask (n,), in the given order.

        Limits and numbers of beams left out stay the same.
        """
        return subset_of(self, rows, len(self), "rows", COLUMNS)

    @property
    def n_nan(self) -> int:
        """Beams left out because their reading is NaN."""
        return self.n_no_measurement - self.n_too_close

    @property
    def n_readings(self) -> int:
        """Readings of the scans, with those that are not in the table."""
        return len(self) + self.n_no_measurement + self.n_unknown + self.n_unsure

    @property
    def hits_nothing(self) -> NDArray[np.bool_]:
        """Beams whose ray meets no obstacle within `max_range`; learning leaves them out."""
        return np.asarray(self.expected_ranges >= self.max_range)


def build_beam_table(
    log: SensorLog,
    grid: OccupancyGrid,
    scans: ArrayLike,
    *,
    unknown: UnknownRule = "skip",
    progress: Progress | None = None,
) -> BeamTable:
    """Cast the beams of scans (indices or a mask) at their reference poses; cones, if the sensor has an opening angle.

    One row per beam with a measurement and an expected range, scan by scan. InvalidInputError if the map has no
    obstacle, or a scan has no finite pose.

    `unknown` says what a ray does in unknown cells: "skip" leaves out beams whose ray enters unknown space before an
    obstacle (their expected range is not known); "free" passes through; "occupied" stops there. A cone is left out if
    its axis enters unknown space nearer than its expected range: some cell beside the axis nearly always is unknown.
    """
    chosen = np.arange(len(log))[np.asarray(scans)]
    caster = BeamCaster(grid, log.finder, unknown)
    parts: list[BeamTable] = []
    for start in range(0, max(len(chosen), 1), SCANS_PER_CHUNK):
        parts.append(caster.cast(log, chosen[start : start + SCANS_PER_CHUNK]))
        if progress is not None and len(chosen):
            progress(min(start + SCANS_PER_CHUNK, len(chosen)), len(chosen))
    return join_tables(parts)


def join_tables(parts: Sequence[BeamTable]) -> BeamTable:
    """Return the beams of tables of one sensor as one table, one after the other."""
    joined: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS}
    joined |= {name: sum(getattr(part, name) for part in parts) for name in COUNTS}
    return replace(parts[0], **joined)


class BeamCaster:
    """Makes a beam table of a few scans at a time, for logs whose table would not fit into memory.

    Other sensors than the finder may be cast too, if theirs are beams or cones as well; `unknown` is that of
    `build_beam_table`. InvalidInputError if the map has no obstacle.
    """

    def __init__(self, grid: OccupancyGrid, finder: RangeFinder, unknown: UnknownRule = "skip") -> None:
        if not grid.occupied.any():
            raise InvalidInputError("the map has no occupied cell: no ray has an expected range")
        self.caster = make_caster(grid, finder, unknown="occupied" if unknown == "occupied" else "free")
        self._stopping = RayCaster(grid, unknown="occupied") if unknown == "skip" and grid.unknown.any() else None

    def cast(self, log: SensorLog, scans: NDArray[np.integer]) -> BeamTable:
        """Return the table of the scans of these indices, as `build_beam_table` does."""
        ranges = usable_ranges(log.ranges[scans], log.finder)
        expected = self.caster.expected_ranges(log.poses[scans], log.finder)
        keep = np.isfinite(ranges)
        n_no_measurement = int((~keep).sum())
        n_too_close = int((~keep & ~np.isnan(log.ranges[scans])).sum())
        n_unknown = 0
        if self._stopping is not None:
            # The ray stopped by unknown cells is shorter exactly if it enters one before the obstacle.
            doubtful = keep & (self._stopping.expected_ranges(log.poses[scans], log.finder) < expected)
            n_unknown = int(doubtful.sum())
            keep &= ~doubtful
        in_chunk, in_scan = np.nonzero(keep)
        scan = scans[in_chunk].astype(np.int32)
        return BeamTable(
            ranges[keep],
            expected[keep],
            scan,
            in_scan.astype(np.int32),
            log.stamps[scan],
            log.finder.max_range,
            n_no_measurement,
            n_unknown,
            log.finder.min_range,
            n_too_close=n_too_close,
        )
