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

    def contains(self, points: FloatArray) -> BoolArray:
        """Return which points (..., 2), metres in the box's frame, lie in it, its lower edges included; shape (...)."""
        x, y = points[..., 0], points[..., 1]
        return np.asarray((x >= self.x0) & (x < self.x1) & (y >= self.y0) & (y < self.y1))

    @property
    def reach(self) -> float:
        """Radius of a circle around the frame's origin that holds the shape."""
        return float(np.hypot(max(abs(self.x0), abs(self.x1)), max(abs(self.y0), abs(self.y1))))

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

    def contains(self, points: FloatArray) -> BoolArray:
        """Return which points (..., 2), metres, lie in the part of the ring, its edges included; shape (...)."""
        dx, dy = points[..., 0] - self.x, points[..., 1] - self.y
        distance, angle = np.hypot(dx, dy), np.arctan2(dy, dx)
        in_ring = (distance >= self.inner) & (distance <= self.outer)
        return np.asarray(in_ring & (angle >= self.start) & (angle <= self.stop))

    @property
    def reach(self) -> float:
        """Radius of a circle around the frame's origin that holds the shape."""
        return float(np.hypot(self.x, self.y) + self.outer)


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
        self._row, self._col = np.indices(shape, dtype=np.int32)

    def carve(self, room: Box) -> None:
        """Make a room of solid material."""
        self.solid[self._block(room)] = False

    def reserve(self, room: Box) -> None:
        """Keep a region free of furniture."""
        self.reserved[self._block(room)] = True

    def build(self, shape: Shape, pose: FloatArray | None = None) -> None:
        """Add solid material, whatever is there.

        Parameters
        ----------
        shape
            What is solid.
        pose
            (3,) of the shape's frame on the canvas, metres and radians; None: the canvas's own frame.
        """
        pose = np.zeros(3) if pose is None else pose
        window, points = self._window(shape, pose)
        self.solid[window] |= shape.contains(points)

    def put(self, thing: Thing, pose: FloatArray) -> bool:
        """Put a piece of furniture where there is room for it: neither solid material nor a region kept free.

        Parameters
        ----------
        thing
            The thing; its footprint is kept free of others from then on.
        pose
            (3,) of its frame on the canvas, metres and radians.

        Returns
        -------
        bool
            Whether there was room; if not, nothing has changed.
        """
        window, points = self._window(thing.footprint, pose)
        floor = thing.footprint.contains(points)
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

    def _window(self, shape: Shape, pose: FloatArray) -> tuple[tuple[slice, slice], FloatArray]:
        """Cells that the shape may touch, and their centres in the shape's frame."""
        low = np.floor((pose[:2] - shape.reach) / self.resolution).astype(int) - 1
        high = np.ceil((pose[:2] + shape.reach) / self.resolution).astype(int) + 1
        low, high = np.maximum(low, 0), np.maximum(high, 0)
        window = (slice(low[1], high[1]), slice(low[0], high[0]))
        centres = np.stack([self._col[window] + 0.5, self._row[window] + 0.5], axis=-1) * self.resolution
        return window, transform_points(invert(pose), centres)
