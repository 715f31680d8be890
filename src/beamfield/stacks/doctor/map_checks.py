"""What a stack makes of the map: where its cells are, and which count."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from beamfield.calibration.reference_checks import map_findings
from beamfield.finding import Finding
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import WALL_OF_FILL, has_fill, hollowed
from beamfield.stacks.doctor.subject import Subject
from beamfield.stacks.emulation.stack_map import read_as_stack
from beamfield.stacks.files.calibration_record import MOVED_MAP

YAW_TOLERANCE = 1e-9
# More than this share of the cells changes hands, or of the free cells' neighbours is unknown.
CHANGED_SHARE = 0.02
OPEN_EDGE_SHARE = 0.002


def disagreement(subject: Subject) -> Iterator[Finding]:
    """Find that the map is not one of where the log was recorded, is mirrored, out of date, or wrong in part."""
    if subject.grid is None or subject.log is None:
        return
    for found in map_findings(subject.log, subject.grid):
        told = found.text, found.why, found.do
        if found.name == "map-disagrees":
            yield subject.finding("map-disagrees", "warning", *told, values=found.values)
        elif found.name == "map-out-of-date":
            yield subject.finding("map-out-of-date", "warning", *told, values=found.values)
        else:
            yield subject.finding("map-disagrees-in-part", "warning", *told, values=found.values)


def ignored_yaw(subject: Subject) -> Iterator[Finding]:
    """Find a map origin with a yaw that the stack does not honour."""
    why, yaw = subject.stack.turned_map, 0.0 if subject.grid is None else float(subject.grid.origin[2])
    if not why or abs(yaw) <= YAW_TOLERANCE:
        return
    yield subject.finding(
        "map-yaw-ignored", "error",
        f"the map's origin has a yaw of {math.degrees(yaw):.3g} degrees",
        why, "save the map with a yaw of 0 (rotate the picture)", values={"yaw": yaw},
    )  # fmt: skip


def half_cell(subject: Subject) -> Iterator[Finding]:
    """Report how far the stack shifts the cells of the map."""
    if subject.grid is None or not subject.stack.half_cell_low or subject.has_own_map:
        return
    shift = subject.grid.resolution / 2.0
    sigma = subject.value("sigma_hit")
    numbers = {"shift": shift} if sigma is None else {"shift": shift, "sigma": float(sigma)}
    yield subject.finding(
        "half-cell-shift", "info",
        f"{subject.file.stack} centres cell (0, 0) on the map's origin: it sees every wall {shift:g} m too low in x "
        "and y",
        "poses come out shifted with the walls; other programs on the robot (costmaps, planners) do not shift them",
        "let beamfield calibrate --stack choose values and a map for amcl alone, use a finer map, or give amcl a copy "
        f"of the map's file with {shift:g} m added to x and y of its origin",
        values=numbers,
    )  # fmt: skip


def painted_black(subject: Subject) -> Iterator[Finding]:
    """Find a map that is painted black where nothing is known, in which a field tells little."""
    if subject.grid is None or not subject.model.solids_attract(subject.parameters) or not has_fill(subject.grid):
        return
    solid = subject.grid.occupied & ~hollowed(subject.grid).occupied
    share = float(solid.mean())
    do = (
        "give amcl a map that is grey there, which means unknown: beamfield calibrate --stack writes one, and chooses "
        "values for it"
    )
    if subject.has_own_map:
        do = f"nothing where amcl takes {MOVED_MAP}: the file says that its values were chosen for that map"
    yield subject.finding(
        "map-painted-black", "info" if subject.has_own_map else "warning",
        f"{share:.0%} of the map's cells are black, but no wall: they lie more than {WALL_OF_FILL:g} m behind walls",
        "the field is as high there as on a wall: readings that end in the black cost nothing, so that poses fit which "
        "are pushed into it, and the robot gets lost",
        do,
        values={"share": share},
    )  # fmt: skip


def unknown_space(subject: Subject) -> Iterator[Finding]:
    """Report how the stack treats unknown cells that beams can reach."""
    if subject.grid is None:
        return
    share = _open_edges(subject.grid)
    if share <= OPEN_EDGE_SHARE:
        return
    seen = f"{share:.1%} of the free cells have an unknown neighbour"
    cells, attracts = subject.model.unknown_cells, subject.model.unknown_attracts
    if cells == "stop":
        yield subject.finding(
            "unknown-stops-rays", "info", seen,
            "rays stop at unknown cells as at walls: readings through open doors into unmapped rooms count against the "
            "true pose, and poses inside unknown space see walls at arm's length",
            "paint unknown cells that beams pass as free, or use a field model", values={"share": share},
        )  # fmt: skip
    elif attracts and getattr(subject.parameters, attracts):
        yield subject.finding(
            "unknown-attracts", "warning", seen,
            f"with {attracts} an end point in unknown space scores 1 / laser_max_range, more than the "
            "z_rand / laser_max_range of free space: poses gain by pointing beams there",
            "switch it off unless the robot really leaves the map",
            parameter=attracts, values={"share": share},
        )  # fmt: skip
    elif cells == "pass":
        yield subject.finding(
            "unknown-is-free", "info", seen,
            "rays pass unknown cells as free ones: readings that end in unmapped rooms count as short ones",
            "nothing, if the map covers where the robot goes", values={"share": share},
        )  # fmt: skip
    elif cells == "longest":
        yield subject.finding(
            "unknown-ends-rays", "info", seen,
            "a ray that meets an unknown cell expects the sensor's longest range: readings through open doors into "
            "unmapped rooms, and from walls behind unknown cells, count against the true pose",
            "paint unknown cells that beams pass as free, or use a field model", values={"share": share},
        )  # fmt: skip
    else:
        yield subject.finding(
            "unknown-is-free", "info", seen,
            "the field treats unknown cells as free: a pose whose readings end in unmapped space loses as much as one "
            "whose readings end in a free room",
            "nothing, if the map covers where the robot goes", values={"share": share},
        )  # fmt: skip


def lost_cells(subject: Subject) -> Iterator[Finding]:
    """Find maps of probabilities that become mostly unknown, and thresholds that turn unknown into free."""
    if subject.map_file is None or subject.grid is None:
        return
    for note in subject.map_file.notes:
        yield subject.finding(
            "unknown-read-as-free", "info", f"{subject.map_file.name}: {note}",
            "unseen space counts as free: rays pass it, and particles are spread over it",
            "set free_thresh to 0.196 in the map's file",
        )  # fmt: skip
    if subject.map_file.between_share > CHANGED_SHARE:
        share = subject.map_file.between_share
        yield subject.finding(
            "thresholds-lose-cells", "warning",
            f"{share:.1%} of the pixels of {subject.map_file.name} lie between free_thresh and occupied_thresh, not "
            "counting the grey that means unknown",
            "they become unknown: walls seen less often are not obstacles, and rarely seen space is not free",
            "move the thresholds closer together, so that probable walls count as walls",
            values={"share": share},
        )  # fmt: skip
    if not subject.stack.wants_extremes or subject.map_file.mode == "trinary":
        return
    grid = subject.grid
    seen = read_as_stack(grid, "raw") if subject.map_file.mode == "raw" else grid
    between = float((~np.isnan(grid.probability) & seen.unknown).mean())
    if between > CHANGED_SHARE:
        yield subject.finding(
            "map-mode-loses-cells", "warning",
            f"{subject.map_file.name} has mode {subject.map_file.mode}: {between:.1%} of its cells have a value "
            "strictly between free (0) and occupied (100)",
            "amcl keeps only 0 and 100; all else becomes unknown, including most walls of a probability map",
            "set mode: trinary in the map's file", values={"share": between},
        )  # fmt: skip


def no_obstacles(subject: Subject) -> Iterator[Finding]:
    """Find a map in which the stack sees no wall."""
    if subject.grid is not None and not subject.grid.occupied.any():
        yield subject.finding(
            "no-obstacles", "error", "the map has no occupied cell",
            "readings are equally far from obstacles at every pose: poses cannot be told apart",
            "check occupied_thresh, negate and the picture",
        )  # fmt: skip


def _open_edges(grid: OccupancyGrid) -> float:
    """Return the share of free cells with an unknown neighbour: places where beams leave the known map."""
    free, unknown = grid.free, np.pad(grid.unknown, 1)
    rows, cols = free.shape
    beside = np.zeros_like(free)
    for i, j in ((0, 1), (2, 1), (1, 0), (1, 2)):
        beside |= unknown[i : i + rows, j : j + cols]
    return float((free & beside).sum() / max(1, int(free.sum())))
