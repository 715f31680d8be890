"""Maps for a log that has none: each half of the scans is judged by the map that the other half drew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable, UnknownRule, build_beam_table
from beamfield.calibration.finding import Finding
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.mapping import build_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.thread_count import check_threads

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
    """

    halves: tuple[OccupancyGrid, OccupancyGrid]
    half: NDArray[np.int8]
    whole: OccupancyGrid


def build_cross_fit_maps(
    log: SensorLog, *, resolution: float = 0.05, group_scans: int = GROUP_SCANS, progress: Progress | None = None
) -> CrossFitMaps:
    """Draw a map from each half of a log's scans.

    Parameters
    ----------
    log
        Scans with reference poses.
    resolution
        Side of a cell, metres.
    group_scans
        So many consecutive scans go to one half, the next to the other.
    progress
        Called with (stage, done, total).

    Returns
    -------
    The two maps, the half of each scan, and a map of all scans.

    Raises
    ------
    InvalidInputError
        If the log has no reference poses or an option is out of range.
    TooLittleDataError
        If there are too few scans for two halves.
    """
    if group_scans < 1:
        raise InvalidInputError(f"group_scans: expected at least 1, got {group_scans}")
    if not log.has_poses:
        raise InvalidInputError(
            f"{log.finder.name or 'log'}: no scan has a reference pose, so no map can be drawn; "
            "give poses with a file or topic"
        )
    if len(log) < 2 * group_scans:
        raise TooLittleDataError(f"{len(log)} scans; two maps need at least {2 * group_scans}")
    half = ((np.arange(len(log)) // group_scans) % 2).astype(np.int8)

    def draw(name: str, scans: NDArray[np.bool_]) -> OccupancyGrid:
        def show(done: int, total: int) -> None:
            if progress is not None:
                progress(f"drawing {name}", done, total)

        return build_map(log, resolution=resolution, scans=scans, progress=show)

    return CrossFitMaps(
        (draw("the first half's map", half == 0), draw("the second half's map", half == 1)),
        half,
        draw("the whole map", np.ones(len(log), dtype=np.bool_)),
    )


def cross_fit_table(
    log: SensorLog,
    maps: CrossFitMaps,
    scans: NDArray[np.bool_],
    *,
    unknown: UnknownRule = "skip",
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> BeamTable:
    """Cast each scan's beams in the map of the other half.

    Parameters
    ----------
    log, maps
        The log, and what `build_cross_fit_maps` made of it.
    scans
        (t,) mask of the scans to use.
    unknown, threads, progress
        As for `build_beam_table`.

    Returns
    -------
    One row per beam, in the order of the scans.

    Raises
    ------
    InvalidInputError
        As for `build_beam_table`.
    """
    check_threads(threads)
    total = int(scans.sum())
    parts: list[BeamTable] = []
    done = 0
    for half in (0, 1):
        chosen = scans & (maps.half == half)
        if not chosen.any():
            continue

        def show(in_half: int, _: int, before: int = done) -> None:
            if progress is not None:
                progress(before + in_half, total)

        parts.append(
            build_beam_table(log, maps.halves[1 - half], chosen, unknown=unknown, threads=threads, progress=show)
        )
        done += int(chosen.sum())
    return _in_order_of_scans(parts)


def _in_order_of_scans(parts: list[BeamTable]) -> BeamTable:
    scan = np.concatenate([part.scan for part in parts])
    order = np.argsort(scan, kind="stable")
    return BeamTable(
        np.concatenate([part.ranges for part in parts])[order],
        np.concatenate([part.expected_ranges for part in parts])[order],
        scan[order],
        np.concatenate([part.beam for part in parts])[order],
        np.concatenate([part.stamps for part in parts])[order],
        parts[0].max_range,
        sum(part.n_no_measurement for part in parts),
        sum(part.n_unknown for part in parts),
        parts[0].min_range,
    )


def cross_fit_finding(maps: CrossFitMaps, table: BeamTable) -> Finding:
    """Say that the map comes from the log itself, and what that means; `table` is what `cross_fit_table` returned."""
    known = len(table) / max(1, len(table) + table.n_unknown)
    return Finding(
        "cross-fitted-map",
        "info",
        "No map was given. Each half of the scans was judged by a map drawn from the other half, so no beam met a wall "
        f"that it drew itself; {known:.0%} of the beams stay within what the other half has seen. What the map and the "
        "poses get wrong together does not show: sigma_hit is the repeatability of the sensor at these poses, on a "
        f"grid of {maps.whole.resolution:g} m.",
        {"resolution": maps.whole.resolution, "share_known": known},
    )
