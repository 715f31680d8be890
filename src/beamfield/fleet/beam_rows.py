"""The rows of a run's beams: cast some scans at a time, as `BeamTable` does, with where and how beams meet walls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamCaster, BeamTable
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.maps.wall_normals import wall_normals
from beamfield.sensors import SensorLog

# Rows that are in memory at once: some 100 bytes each.
ROWS_PER_PART = 500_000


@dataclass(frozen=True, eq=False)
class PosedBeams:
    """Scans, of all or some of a sensor's beams, with the poses at which these are to be judged.

    Parameters
    ----------
    log
        The scans, with poses.
    beams
        (k,) number of each beam among all of the sensor's.
    """

    log: SensorLog
    beams: NDArray[np.int32]


class BeamRows:
    """Makes the columns of a run's beams.

    Parameters
    ----------
    parts
        The same scans, of different beams.
    grid
        The map.
    covariances
        (t, 3, 3) of the poses; None: not known.
    held_out
        (t,) scans that are kept from learning.
    """

    def __init__(
        self, parts: tuple[PosedBeams, ...], grid: OccupancyGrid, covariances: FloatArray | None,
        held_out: NDArray[np.bool_],
    ) -> None:  # fmt: skip
        self._parts = parts
        self._covariances = np.zeros((len(held_out), 3, 3)) if covariances is None else covariances
        self._held_out = held_out
        self._caster = BeamCaster(grid, parts[0].log.finder)
        self._normals = wall_normals(grid)
        # Readings without an expected range, by reason.
        self.left_out = {"no measurement": 0, "too close": 0, "unknown space": 0}

    def of_scans(self, scans: NDArray[np.int64]) -> Iterator[dict[str, NDArray[Any]]]:
        """Yield the columns of scans, some at a time, by scan and beam; all but `run`."""
        step = max(ROWS_PER_PART // max(sum(len(part.beams) for part in self._parts), 1), 1)
        for start in range(0, len(scans), step):
            columns = [self._columns(part, scans[start : start + step]) for part in self._parts]
            joined = {name: np.concatenate([one[name] for one in columns]) for name in columns[0]}
            if len(columns) > 1:
                order = np.lexsort((joined["beam"], joined["scan"]))
                joined = {name: values[order] for name, values in joined.items()}
            if len(joined["scan"]):
                yield joined

    def _columns(self, part: PosedBeams, scans: NDArray[np.int64]) -> dict[str, NDArray[Any]]:
        log, table = part.log, self._caster.cast(part.log, scans)
        self.left_out["no measurement"] += table.n_nan
        self.left_out["too close"] += table.n_too_close
        self.left_out["unknown space"] += table.n_unknown
        scan, poses, covariances = table.scan, log.poses[table.scan], self._covariances[table.scan]
        bearings = log.finder.bearings[table.beam]
        cells = self._cells(log, table, scans)
        met = cells[:, 0] >= 0
        normals = np.where(met, self._normals[tuple(np.where(met[:, None], cells, 0).T)], np.nan)
        # A wall's normal has no sign.
        incidence = np.arccos(np.minimum(np.abs(np.cos(poses[:, 2] + bearings - normals)), 1.0))
        return {
            "stamp": table.stamps,
            "scan": scan,
            "beam": part.beams[table.beam],
            "bearing": bearings.astype(np.float32),
            "range": table.ranges.astype(np.float32),
            "expected_range": table.expected_ranges.astype(np.float32),
            "incidence": incidence.astype(np.float32),
            "hit_row": cells[:, 0],
            "hit_col": cells[:, 1],
            "x": poses[:, 0],
            "y": poses[:, 1],
            "heading": poses[:, 2],
            "var_x": covariances[:, 0, 0].astype(np.float32),
            "var_y": covariances[:, 1, 1].astype(np.float32),
            "var_heading": covariances[:, 2, 2].astype(np.float32),
            "cov_xy": covariances[:, 0, 1].astype(np.float32),
            "held_out": self._held_out[scan],
        }

    def _cells(self, log: SensorLog, table: BeamTable, scans: NDArray[np.int64]) -> NDArray[np.int32]:
        """Return the cell (n, 2) that each beam meets; -1 for none, and for cones, which meet several."""
        if not isinstance(self._caster.caster, RayCaster):
            return np.full((len(table), 2), -1, np.int32)
        # Scans are numbered upwards.
        hits = self._caster.caster.expected_hits(log.poses[scans], log.finder)
        cells = hits[np.searchsorted(scans, table.scan), table.beam]
        cells[table.hits_nothing] = -1
        return np.ascontiguousarray(cells)


def days_of(stamps: FloatArray) -> NDArray[np.int64] | None:
    """Return the day (UTC) of each stamp, counted from 1970-01-01; None if one is in no year from 1970 to 9999."""
    days = np.floor(stamps / 86_400.0)
    if not (np.isfinite(days).all() and (days >= 0).all() and (days < 2_932_897).all()):
        return None
    return days.astype(np.int64)


def for_float32(log: SensorLog) -> SensorLog:
    """Return a log whose sensor has limits that float32 holds, so that "no return" is exactly max_range there too."""
    finder = log.finder
    low = np.float32(finder.min_range)
    if low > finder.min_range:
        low = np.nextafter(low, np.float32(0.0))
    return replace(log, finder=replace(finder, max_range=float(np.float32(finder.max_range)), min_range=float(low)))
