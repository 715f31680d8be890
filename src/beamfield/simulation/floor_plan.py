"""A floor plan of our own: an office storey with corridors, rooms, doors, furniture and pillars, drawn by code."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beamfield.arguments import as_count, checked, require
from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.simulation import furniture
from beamfield.simulation.drawing import BoolArray, Box, Canvas

Side = Literal["south", "north", "west", "east"]

OUTSIDE = 1.0  # unknown margin around the building
FACADE = 0.3
WALL = 0.15
CORRIDOR = 2.0
DOOR = 1.0
SOUTH_DEPTH, NORTH_DEPTH = 5.0, 5.6
LOBBY = 7.5
MIN_WIDTH, MIN_HEIGHT = 26.0, 20.0
# What lies deeper in solid material than this has been seen by no sensor: unknown, as in a map made by a robot.
SEEN_DEPTH = 0.16


@checked
def draw_floor_plan(
    *, seed: int = 0, width: float = 40.0, height: float = 24.0, resolution: float = 0.05, furnished: bool = True
) -> OccupancyGrid:
    """Draw one storey of an office building.

    Two long corridors and three short ones form loops around a core with meeting rooms, a kitchen and closed shafts; a
    lobby with round pillars lies in the west, offices along the south, an open-plan office and a wing of rooms along
    the north. Everything free can be reached; everything outside the walls is unknown.

    Parameters
    ----------
    seed
        Chooses how the storey is divided, where the doors are and what stands in the rooms.
    width, height
        Of the building, metres; at least 26 x 20.
    resolution
        Side of a cell in metres, at most 0.1: chair legs and door frames are thin.
    furnished
        Whether there is furniture.

    Returns
    -------
    OccupancyGrid
        Cells are free (0), occupied (1) or unknown (NaN). The map's origin lies in the lobby.

    Raises
    ------
    InvalidInputError
        If the building is too small for its rooms or the cells are too large for its walls.

    Examples
    --------
    >>> grid = draw_floor_plan(seed=3)
    >>> grid.shape, round(float(grid.free.sum()) * grid.resolution**2) > 500
    ((520, 840), True)
    """
    if not (width >= MIN_WIDTH and height >= MIN_HEIGHT and max(width, height) <= 500.0):
        raise InvalidInputError(
            f"building: expected {MIN_WIDTH:g} x {MIN_HEIGHT:g} to 500 x 500 metres, got {width:g} x {height:g}"
        )
    require(0.01 <= resolution <= 0.1, "resolution", "0.01 to 0.1 metres", resolution)
    as_count(seed, "seed", least=0)
    rng = np.random.default_rng(seed)
    canvas = Canvas(width + 2 * OUTSIDE, height + 2 * OUTSIDE, resolution)
    storey = _Storey(canvas, rng, width, height)
    rooms = storey.divide()
    if furnished:
        for room in rooms:
            _FURNISH[room.kind](canvas, room.box, room.door_side, rng)
    free = _reachable(~canvas.solid, storey.start_cell)
    depth = ndimage.distance_transform_edt(~free) * resolution
    probability = np.where(free, 0.0, np.where(depth <= SEEN_DEPTH, 1.0, np.nan)).astype(np.float32)
    lobby = storey.lobby
    origin = np.array([-round(lobby.x0 + 0.5 * lobby.width), -round(lobby.y0 + 0.5 * lobby.height), 0.0])
    return OccupancyGrid(probability, resolution, origin)


@dataclass(frozen=True)
class _Room:
    kind: str
    box: Box
    door_side: Side


class _Storey:
    """Divides the storey into rooms; lengths in metres on the canvas."""

    def __init__(self, canvas: Canvas, rng: np.random.Generator, width: float, height: float) -> None:
        self.canvas, self.rng = canvas, rng
        self.west, self.east = OUTSIDE + FACADE, OUTSIDE + width - FACADE
        self.south, self.north = OUTSIDE + FACADE, OUTSIDE + height - FACADE
        y = self.south + SOUTH_DEPTH + WALL
        top = self.north - NORTH_DEPTH - WALL
        core_west = self.west + LOBBY + WALL
        core_east = self.east - CORRIDOR - WALL
        self.south_corridor = Box(self.west, y, self.east, y + CORRIDOR)
        self.north_corridor = Box(self.west, top - CORRIDOR, self.east, top)
        self.lobby = Box(self.west, y, self.west + LOBBY, top)
        self.core = Box(core_west, y + CORRIDOR + WALL, core_east, top - CORRIDOR - WALL)
        # The north wing ends before the east end of the building, which makes its outline an L.
        self.wing_end = self.west + self._snap(0.74 * (self.east - self.west))
        self.start_cell = self._cell(self.lobby.x1 + 1.0, self.south_corridor.y0 + CORRIDOR / 2)

    def divide(self) -> list[_Room]:
        """Carve corridors and rooms, hang doors; return the rooms to be furnished."""
        core = self.core
        east_corridor = Box(core.x1 + WALL, self.south_corridor.y0, self.east, self.north_corridor.y1)
        for space in (self.south_corridor, self.north_corridor, self.lobby, east_corridor):
            self.canvas.carve(space)
        cross = self._snap(core.x0 + core.width * self.rng.uniform(0.42, 0.58))
        self.canvas.carve(Box(cross, self.south_corridor.y0, cross + CORRIDOR, self.north_corridor.y1))
        rooms = [
            _Room("lobby", self.lobby, "east"),
            *self._south_row(),
            *self._north_row(),
            *self._core_block(Box(core.x0, core.y0, cross - WALL, core.y1), ("meeting", "shaft", "kitchen")),
            *self._core_block(Box(cross + CORRIDOR + WALL, core.y0, core.x1, core.y1), ("office", "store", "meeting")),
        ]
        self._pilasters()
        return rooms

    def _south_row(self) -> list[_Room]:
        rooms = []
        for x0, x1 in self._split(self.west, self.east, 4.2):
            box = Box(x0, self.south, x1, self.south + SOUTH_DEPTH)
            kind = "meeting" if x1 - x0 > 4.9 and self.rng.random() < 0.4 else "office"
            rooms.append(self._room(kind, box, "north"))
        return rooms

    def _north_row(self) -> list[_Room]:
        open_end = self.west + self._snap((self.wing_end - self.west) * self.rng.uniform(0.48, 0.56))
        y0 = self.north_corridor.y1 + WALL
        hall = Box(self.west, y0, open_end, self.north)
        rooms = [self._room("open_plan", hall, "south", n_doors=2)]
        for x0, x1 in self._split(open_end + WALL, self.wing_end, 4.6):
            box = Box(x0, y0, x1, self.north)
            rooms.append(self._room("meeting" if self.rng.random() < 0.35 else "office", box, "south"))
        return rooms

    def _core_block(self, block: Box, kinds: tuple[str, ...]) -> list[_Room]:
        """Rooms between the corridors: some as deep as the core, others back to back."""
        rooms = []
        middle = self._snap(0.5 * (block.y0 + block.y1))
        spans = self._split(block.x0, block.x1, 4.4)
        for i, (x0, x1) in enumerate(spans):
            kind = kinds[i % len(kinds)]
            side: Side = "south" if self.rng.random() < 0.5 else "north"
            if kind == "kitchen":
                rooms.append(self._room(kind, Box(x0, block.y0, x1, block.y1), side))
            elif kind == "shaft":
                # Never entered: it becomes unknown. The room beside it is used.
                low, high = Box(x0, block.y0, x1, middle - WALL), Box(x0, middle, x1, block.y1)
                shaft, used = (high, low) if side == "south" else (low, high)
                self.canvas.carve(shaft)
                rooms.append(self._room("store", used, side))
            else:
                rooms.append(self._room(kind, Box(x0, block.y0, x1, middle - WALL), "south"))
                rooms.append(self._room(kind, Box(x0, middle, x1, block.y1), "north"))
        return rooms

    def _room(self, kind: str, box: Box, side: Side, *, n_doors: int = 1) -> _Room:
        self.canvas.carve(box)
        for i in range(n_doors):
            low = box.x0 + box.width * i / n_doors + 0.35
            high = box.x0 + box.width * (i + 1) / n_doors - 0.35 - DOOR
            self._door(box, side, self._snap(float(self.rng.uniform(low, high))))
        return _Room(kind, box, side)

    def _door(self, room: Box, side: Side, x: float) -> None:
        """Open a door in the south or north wall of a room, its leaf swung into the room."""
        inwards = 1.0 if side == "south" else -1.0
        wall = room.y0 if side == "south" else room.y1
        outer = wall - inwards * WALL
        self.canvas.carve(Box(x, min(wall, outer), x + DOOR, max(wall, outer)))
        deep = wall + inwards * 1.5
        self.canvas.reserve(Box(x - 0.15, min(wall, deep), x + DOOR + 0.15, max(wall, deep)))
        hinge_left = bool(self.rng.random() < 0.5)
        swing = np.deg2rad(self.rng.uniform(75.0, 105.0))
        angle = swing if hinge_left else np.pi - swing
        pose = np.array([x + (0.03 if hinge_left else DOOR - 0.03), wall, inwards * angle])
        self.canvas.build(Box(0.0, -0.035, 0.92, 0.035), pose)

    def _pilasters(self) -> None:
        """Thicken the long corridor walls every few metres where no door is near."""
        for corridor in (self.south_corridor, self.north_corridor):
            for x in np.arange(self.core.x0 + 2.0, self.core.x1 - 1.0, 5.4):
                for y0, y1, beyond in (
                    (corridor.y0, corridor.y0 + 0.15, corridor.y0 - 0.07),
                    (corridor.y1 - 0.15, corridor.y1, corridor.y1 + 0.07),
                ):
                    row, first = self._cell(float(x) - 0.3, beyond)
                    _, last = self._cell(float(x) + 0.7, beyond)
                    if self.canvas.solid[row, first:last].all():
                        self.canvas.build(Box(float(x), y0, float(x) + 0.4, y1))

    def _split(self, start: float, stop: float, typical: float) -> list[tuple[float, float]]:
        """Divide a length into rooms of about the typical width with walls between them."""
        n = max(1, round((stop - start + WALL) / (typical + WALL)))
        shares = self.rng.uniform(0.78, 1.22, n)
        ends = np.cumsum(shares) / shares.sum() * (stop - start + WALL)
        borders = [0.0, *(self._snap(float(e)) for e in ends[:-1]), stop - start + WALL]
        return [(start + a, start + b - WALL) for a, b in pairwise(borders)]

    def _snap(self, length: float) -> float:
        return round(length / self.canvas.resolution) * self.canvas.resolution

    def _cell(self, x: float, y: float) -> tuple[int, int]:
        return int(y / self.canvas.resolution), int(x / self.canvas.resolution)


def _reachable(free: BoolArray, start: tuple[int, int]) -> BoolArray:
    """Free cells that share an edge, step by step, with the start."""
    labels, _ = ndimage.label(free)
    return np.asarray(labels == labels[start])


def _against(box: Box, wall: Side, along: float, gap: float, jitter: float = 0.0) -> NDArray[np.float64]:
    """Pose of furniture with its back to a wall of the room, `along` metres from the wall's west or south end."""
    poses = {
        "south": (box.x0 + along, box.y0 + gap, jitter),
        "north": (box.x0 + along, box.y1 - gap, np.pi + jitter),
        "west": (box.x0 + gap, box.y0 + along, -np.pi / 2 + jitter),
        "east": (box.x1 - gap, box.y0 + along, np.pi / 2 + jitter),
    }
    return np.array(poses[wall])


OPPOSITE: dict[Side, Side] = {"south": "north", "north": "south", "west": "east", "east": "west"}


def _office(canvas: Canvas, box: Box, door: Side, rng: np.random.Generator) -> None:
    window = OPPOSITE[door]
    first: Side = "west" if rng.random() < 0.5 else "east"
    second = OPPOSITE[first]
    from_window = 1.0 if window == "south" else box.height - 1.0
    for side in (first,) if box.width < 3.6 else (first, second):
        along = from_window + (1.0 if window == "south" else -1.0) * float(rng.uniform(0.0, 0.3))
        desk = furniture.desk(width=float(rng.choice([1.4, 1.6])), drawers_left=bool(rng.random() < 0.5))
        canvas.put(desk, _against(box, side, along, float(rng.uniform(0.06, 0.12)), float(rng.normal(0, 0.02))))
        far = box.height - 1.3 if window == "south" else 1.3
        canvas.put(furniture.solid(float(rng.choice([0.8, 1.0, 1.2])), 0.45), _against(box, side, far, 0.0))
    if rng.random() < 0.6:
        canvas.put(furniture.plant(), _against(box, window, 0.35 if rng.random() < 0.5 else box.width - 0.35, 0.05))
    if rng.random() < 0.35:
        table = furniture.round_table(n_chairs=2, turn=float(rng.uniform(0, 3)))
        canvas.put(table, _against(box, window, box.width / 2, 0.4))


def _meeting(canvas: Canvas, box: Box, door: Side, rng: np.random.Generator) -> None:
    away = 1.0 if door == "south" else -1.0
    middle = np.array([0.5 * (box.x0 + box.x1), 0.5 * (box.y0 + box.y1)])
    jitter = float(rng.normal(0.0, 0.015))
    # The longest table that leaves the door free, along the room or across it, in the middle or away from the door.
    for chairs in range(5, 1, -1):
        table = furniture.meeting_table(length=0.5 + 0.8 * chairs, chairs_per_side=chairs)
        for turn in (jitter, jitter + np.pi / 2) if box.width > box.height else (jitter + np.pi / 2, jitter):
            for dx, dy in ((0.0, 0.0), (0.0, 0.25), (0.0, 0.5), (0.5, 0.5), (-0.5, 0.5), (0.5, 0.7), (-0.5, 0.7)):
                back = middle + np.array([dx + 1.2 * np.sin(turn), dy * away - 1.2 * np.cos(turn)])
                if canvas.put(table, np.array([back[0], back[1], turn])):
                    canvas.put(furniture.solid(1.6, 0.4), _against(box, OPPOSITE[door], box.width / 2, 0.0))
                    canvas.put(furniture.plant(), _against(box, OPPOSITE[door], 0.35, 0.05))
                    return


def _open_plan(canvas: Canvas, box: Box, door: Side, rng: np.random.Generator) -> None:
    x = box.x0 + 2.6
    while x + 2.2 < box.x1:
        # Islands stand across the hall; the aisle along the doors stays free.
        pose = np.array([x - 1.75, box.y1 - 1.75, -np.pi / 2 + float(rng.normal(0.0, 0.01))])
        canvas.put(furniture.desk_island(), pose)
        if x + 2.9 < box.x1:
            canvas.put(furniture.pillar(0.25), np.array([x + 2.3, box.y0 + 2.0, 0.0]))
        x += 4.6
    for along in (2.0, 3.1, 5.6):
        if rng.random() < 0.8:
            canvas.put(furniture.solid(1.0, 0.45), _against(box, door, along, 0.0))
    canvas.put(furniture.solid(0.7, 0.65), _against(box, "east", 0.6, 0.05))
    canvas.put(furniture.plant(), _against(box, "west", 0.4, 0.05))


def _kitchen(canvas: Canvas, box: Box, door: Side, rng: np.random.Generator) -> None:
    counter: Side = "west" if rng.random() < 0.5 else "east"
    canvas.put(furniture.solid(box.height - 3.4, 0.6), _against(box, counter, box.height / 2, 0.0))
    for along in (0.28, 0.54, 0.8):
        table = furniture.round_table(n_chairs=int(rng.integers(2, 5)), turn=float(rng.uniform(0.0, 3.0)))
        canvas.put(table, _against(box, OPPOSITE[counter], along * box.height, float(rng.uniform(0.3, 0.5))))
    canvas.put(furniture.solid(0.8, 0.7), _against(box, OPPOSITE[door], box.width / 2, 0.0))


def _store(canvas: Canvas, box: Box, door: Side, rng: np.random.Generator) -> None:
    walls: tuple[Side, ...] = ("west", "east")
    for wall in walls:
        shelf = furniture.solid(box.height - float(rng.uniform(0.6, 1.6)), 0.4)
        canvas.put(shelf, _against(box, wall, box.height / 2, 0.0))
    turned = float(rng.normal(0, 0.1))
    canvas.put(furniture.solid(0.6, 0.7), _against(box, OPPOSITE[door], box.width / 2, 0.05, turned))


def _lobby(canvas: Canvas, box: Box, _door: Side, rng: np.random.Generator) -> None:
    middle = 0.5 * (box.y0 + box.y1)
    for dx in (2.3, 5.6):
        for dy in (-0.31, 0.31):
            canvas.put(furniture.pillar(0.3), np.array([box.x0 + dx, middle + dy * box.height, 0.0]))
    canvas.put(furniture.reception(), np.array([box.x0 + 0.75, middle, -np.pi / 2]))
    for sign in (-1.0, 1.0):
        turn = float(rng.normal(0.0, 0.05)) + (0 if sign > 0 else np.pi)
        canvas.put(furniture.sofa(), np.array([box.x0 + 4.4, middle + sign * 1.5, turn]))
    for along in (0.4, box.height - 0.4):
        canvas.put(furniture.plant(), _against(box, "west", along, 0.05))


_FURNISH: dict[str, Callable[[Canvas, Box, Side, np.random.Generator], None]] = {
    "office": _office, "meeting": _meeting, "open_plan": _open_plan, "kitchen": _kitchen, "store": _store,
    "lobby": _lobby,
}  # fmt: skip
