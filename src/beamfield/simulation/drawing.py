"""A raster to draw a building on: solid material, rooms carved out of it, furniture put into rooms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, invert, transform_points

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Box:
    """An axis-parallel box in the frame of the piece of furniture that it is part of; metres."""

    x0: float
    y0: float
    x1: float
    y1: float

    def contains(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Return which points, metres in the box's frame, lie in it, its lower edges included; of their shape."""
        return np.asarray((x >= self.x0) & (x < self.x1) & (y >= self.y0) & (y < self.y1))

    @property
    def circle(self) -> tuple[float, float, float]:
        """Centre and radius of a circle that holds the shape, metres in its frame."""
        return (self.x0 + self.x1) / 2.0, (self.y0 + self.y1) / 2.0, float(np.hypot(self.width, self.height)) / 2.0

    @property
    def width(self) -> float:
        """Extent along x."""
        return self.x1 - self.x0

    @property
    def height(self) -> float:
        """Extent along y."""
        return self.y1 - self.y0


@dataclass(frozen=True)
class Arc:
    """Part of a ring around (x, y): a disc if `inner` is 0 and the angles span a full turn; metres and radians."""

    x: float
    y: float
    outer: float
    inner: float = 0.0
    start: float = -np.pi
    stop: float = np.pi

    def contains(self, x: FloatArray, y: FloatArray) -> BoolArray:
        """Return which points, metres, lie in the part of the ring, its edges included; of their shape."""
        dx, dy = x - self.x, y - self.y
        distance, angle = np.hypot(dx, dy), np.arctan2(dy, dx)
        in_ring = (distance >= self.inner) & (distance <= self.outer)
        return np.asarray(in_ring & (angle >= self.start) & (angle <= self.stop))

    @property
    def circle(self) -> tuple[float, float, float]:
        """Centre and radius of a circle that holds the shape, metres in its frame."""
        return self.x, self.y, self.outer


Shape = Box | Arc


@dataclass(frozen=True)
class Thing:
    """Something that stands in a room: what a range finder near the floor sees of it, and the floor that it takes.

    The back of the thing lies on the x axis of its frame and its front looks along +y.
    """

    shapes: tuple[Shape, ...]
    footprint: Box


class Canvas:
    """Material on a raster.

    Parameters
    ----------
    width, height
        Size in metres; all of it is solid at first.
    resolution
        Side of a cell in metres.
    """

    def __init__(self, width: float, height: float, resolution: float) -> None:
        self.resolution = resolution
        shape = (round(height / resolution), round(width / resolution))
        self.solid = np.ones(shape, dtype=bool)
        self.reserved = np.zeros(shape, dtype=bool)
        """Free cells where nothing may be put."""

    def carve(self, room: Box) -> None:
        """Make a room of solid material."""
        self.solid[self._block(room)] = False

    def reserve(self, room: Box) -> None:
        """Keep a region free of furniture."""
        self.reserved[self._block(room)] = True

    def build(self, shape: Shape, pose: FloatArray | None = None) -> None:
        """Add solid material, whatever is there; the pose (3,) is that of the shape's frame on the canvas, or None."""
        pose = np.zeros(3) if pose is None else pose
        window, x, y = self._window(shape, pose)
        self.solid[window] |= shape.contains(x, y)

    def put(self, thing: Thing, pose: FloatArray) -> bool:
        """Put a piece of furniture where there is room for it: neither solid material nor a region kept free.

        The pose (3,) is of its frame on the canvas; its footprint is kept free of others from then on. Return whether
        there was room; if not, nothing has changed.
        """
        window, x, y = self._window(thing.footprint, pose)
        floor = thing.footprint.contains(x, y)
        if ((self.solid[window] | self.reserved[window]) & floor).any():
            return False
        for shape in thing.shapes:
            self.build(shape, pose)
        self.reserved[window] |= floor
        return True

    def _block(self, room: Box) -> tuple[slice, slice]:
        """Cells whose lower-left corner lies in an axis-parallel box on the canvas."""
        x0, y0, x1, y1 = (max(0, round(v / self.resolution)) for v in (room.x0, room.y0, room.x1, room.y1))
        return slice(y0, y1), slice(x0, x1)

    def _window(self, shape: Shape, pose: FloatArray) -> tuple[tuple[slice, slice], FloatArray, FloatArray]:
        """Cells that the shape may touch, and x and y of their centres in the shape's frame."""
        *centre, radius = shape.circle
        middle = transform_points(pose, centre)
        low = np.maximum(np.floor((middle - radius) / self.resolution).astype(int) - 1, 0)
        high = np.maximum(np.ceil((middle + radius) / self.resolution).astype(int) + 1, 0)
        rows, cols = self.solid.shape
        col, row = np.arange(low[0], min(high[0], cols)), np.arange(low[1], min(high[1], rows))
        x, y = (col + 0.5) * self.resolution, (row[:, None] + 0.5) * self.resolution
        left, down, turn = invert(pose)
        cos, sin = np.cos(turn), np.sin(turn)
        window = (slice(low[1], high[1]), slice(low[0], high[0]))
        return window, left + cos * x - sin * y, down + sin * x + cos * y
