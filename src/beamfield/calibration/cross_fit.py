"""Maps for a log that has none: each half of the scans is judged by the map that the other half drew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import checked
from beamfield.calibration.beam_table import BeamTable, UnknownRule, build_beam_table, join_tables
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.drawn_walls import CLUTTER, LINE, NOTHING, UNSEEN, UNSURE, ranges_to_walls
from beamfield.maps.hit_counts import FREE_AFTER_ONE_PASS, HitCounts, count_hits, grid_of_counts
from beamfield.maps.mapping import build_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog, usable_ranges
from beamfield.short_repr import short_repr

Progress = Callable[[str, int, int], None]

# Scans that follow each other see the same surfaces with the same errors of the pose: whole groups of them change
# sides. Too long a group would leave places that only one half has seen.
GROUP_SCANS = 5


@dataclass(frozen=True, eq=False)
class CrossFitMaps:
    """Maps drawn from the two halves of a log, and from all of it.

    Parameters
    ----------
    halves
        Map of the even groups of scans, map of the odd ones.
    half
        (t,) 0 or 1: which of the two maps a scan helped to draw.
    whole
        Map of all scans: for pictures and for choosing scans, never for judging beams.
    counts
        What the two maps were drawn from; None for a sensor with an opening angle, whose maps are drawn from cones.
    """

    halves: tuple[OccupancyGrid, OccupancyGrid]
    half: NDArray[np.int8]
    whole: OccupancyGrid
    counts: tuple[HitCounts, HitCounts] | None = None

    __repr__ = short_repr


@checked
def build_cross_fit_maps(log: SensorLog, *, resolution: float = 0.05, progress: Progress | None = None) -> CrossFitMaps:
    """Draw a map from each half of a log's scans: five in a row go to one half, the next five to the other.

    `progress` is called with (stage, done, total). InvalidInputError if the log has no reference poses or the
    resolution is no size of a cell; TooLittleDataError if there are too few scans for two halves.
    """
    if not log.has_poses:
        raise InvalidInputError(
            f"{log.finder.name or 'log'}: no scan has a reference pose, so no map can be drawn; "
            "give poses with a file or topic"
        )
    if len(log) < 2 * GROUP_SCANS:
        raise TooLittleDataError(f"{len(log)} scans; two maps need at least {2 * GROUP_SCANS}")
    half = ((np.arange(len(log)) // GROUP_SCANS) % 2).astype(np.int8)

    names = "the first half's map", "the second half's map"
    if log.finder.opening_angle > 0.0:
        first, second, whole = (
            replace(
                build_map(log, resolution=resolution, scans=scans, progress=_drawing(progress, name)),
                free_thresh=FREE_AFTER_ONE_PASS,
            )
            for name, scans in zip((*names, "the whole map"), (half == 0, half == 1, half >= 0), strict=True)
        )
        return CrossFitMaps((first, second), half, whole)
    even, odd = (
        count_hits(log, half == i, resolution, progress=_drawing(progress, name)) for i, name in enumerate(names)
    )
    whole = grid_of_counts(even.hits + odd.hits, even.passes + odd.passes, even.first, resolution)
    return CrossFitMaps((even.to_grid(), odd.to_grid()), half, whole, (even, odd))


def _drawing(progress: Progress | None, name: str) -> Callable[[int, int], None] | None:
    return None if progress is None else partial(progress, f"drawing {name}")


def cross_fit_table(
    log: SensorLog,
    maps: CrossFitMaps,
    scans: NDArray[np.bool_],
    *,
    unknown: UnknownRule = "skip",
    progress: Callable[[int, int], None] | None = None,
) -> tuple[BeamTable, BeamTable | None]:
    """Cast each scan's beams in the map of the other half; the mask (t,) says of which scans.

    "skip" takes expected ranges from the end points that drew the walls, see `ranges_to_walls`, and leaves out beams
    that enter unseen space or meet something that the map is not sure of. Otherwise, and for a sensor with an opening
    angle, expected ranges are those of cells as in `build_beam_table`.

    Return beams that meet a wall's line, or nothing, and those that meet clutter, whose expected ranges are less exact
    (None where expected ranges are those of cells); one row per beam, in the order of the scans. The first table counts
    beams that are not in it. InvalidInputError as for `build_beam_table`.
    """
    total = int(scans.sum())
    parts: list[tuple[BeamTable, BeamTable | None]] = []
    done = 0
    for half in (0, 1):
        chosen = scans & (maps.half == half)
        if not chosen.any():
            continue

        def show(in_half: int, _: int, before: int = done) -> None:
            if progress is not None:
                progress(before + in_half, total)

        if maps.counts is not None and unknown == "skip":
            parts.append(_tables_of_walls(log, maps.counts[1 - half], chosen))
            show(int(chosen.sum()), total)
        else:
            grid = maps.halves[1 - half]
            parts.append((build_beam_table(log, grid, chosen, unknown=unknown, progress=show), None))
        done += int(chosen.sum())
    clutter = [part[1] for part in parts if part[1] is not None]
    return _in_order_of_scans([part[0] for part in parts]), _in_order_of_scans(clutter) if clutter else None


def _tables_of_walls(log: SensorLog, counts: HitCounts, scans: NDArray[np.bool_]) -> tuple[BeamTable, BeamTable]:
    """Return the beams that meet a line, or nothing, and those that meet clutter."""
    chosen = np.flatnonzero(scans)
    expected, met = ranges_to_walls(counts, log.poses[chosen], log.finder)
    ranges = usable_ranges(log.ranges[chosen], log.finder)
    measured = np.isfinite(ranges)

    def table(keep: NDArray[np.bool_]) -> BeamTable:
        scan, beam = np.nonzero(keep)
        return BeamTable(
            ranges[keep],
            expected[keep],
            chosen[scan].astype(np.int32),
            beam.astype(np.int32),
            log.stamps[chosen[scan]],
            log.finder.max_range,
            min_range=log.finder.min_range,
        )

    lines = replace(
        table(measured & ((met == LINE) | (met == NOTHING))),
        n_no_measurement=int((~measured).sum()),
        n_unknown=int((measured & (met == UNSEEN)).sum()),
        n_unsure=int((measured & np.isin(met, (UNSURE, CLUTTER))).sum()),
        n_too_close=int((~measured & ~np.isnan(log.ranges[chosen])).sum()),
    )
    return lines, table(measured & (met == CLUTTER))


def _in_order_of_scans(parts: list[BeamTable]) -> BeamTable:
    joined = join_tables(parts)
    return joined.select(np.argsort(joined.scan, kind="stable"))
