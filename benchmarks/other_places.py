"""What `calibrate --stack nav2` does in places that are no offices, in maps that are right and half out of date.

As `other_robots.py`, whose scanner of 360 degrees and 12 m, worn wheels, two drives and ten seeds these are. In maps
that are half out of date half of the small things (pallets, cars' wheels, furniture) are gone, boxes have come, and
walls are 3 cm off.

Run: python benchmarks/other_places.py [SEED]     (12; ten minutes on two processors)
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy import ndimage

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.simulation.drawing import Box, Canvas
from other_robots import USUAL, outcome
from tables import print_table

RESOLUTION = 0.05
# Around the place, and how deep a laser sees into what is solid, in metres.
MARGIN, SEEN = 1.0, 0.16
KEPT, BOX_PER_M2 = 0.5, 1.0 / 20.0


def room(width: float, height: float) -> Canvas:
    """Return an empty room; its lower left corner lies at (MARGIN, MARGIN), metres."""
    canvas = Canvas(width + 2.0 * MARGIN, height + 2.0 * MARGIN, RESOLUTION)
    canvas.carve(Box(MARGIN, MARGIN, MARGIN + width, MARGIN + height))
    return canvas


def block(canvas: Canvas, x: float, y: float, width: float, height: float) -> None:
    canvas.build(Box(x, y, x + width, y + height))


def warehouse(rng: np.random.Generator) -> Canvas:
    """Six rows of racks: posts every 2.6 m, and pallets in half of the places."""
    canvas = room(50.0, 36.0)
    for y in np.arange(5.0, 32.0, 4.6):
        for x in np.arange(7.0, 44.0, 2.7):
            for dx in (0.0, 2.6):
                for dy in (0.0, 1.1):
                    block(canvas, x + dx, y + dy, 0.1, 0.1)
            for dx in (0.15, 1.35):
                if rng.random() < 0.5:
                    block(canvas, x + dx, y + 0.1 + rng.uniform(0.0, 0.1), 1.05, 0.9)
    return canvas


def garage(rng: np.random.Generator) -> Canvas:
    """Pillars, and the wheels of cars in two of three places."""
    canvas = room(60.0, 34.0)
    for x in np.arange(5.0, 60.0, 7.6):
        for y in (6.2, 17.5, 29.0):
            block(canvas, x, y, 0.4, 0.4)
    for x in np.arange(2.0, 59.0, 2.55):
        for y in (1.2, 12.5, 18.2, 29.8):
            if rng.random() < 0.65:
                for dx in (0.0, 1.5):
                    for dy in (0.7, 3.3):
                        block(canvas, x + dx, y + dy, 0.25, 0.65)
    return canvas


def ward(_: np.random.Generator) -> Canvas:
    """A corridor with fourteen equal rooms on each side, two equal beds in each."""
    canvas = Canvas(74.0, 16.0, RESOLUTION)
    canvas.carve(Box(1.0, 7.0, 71.0, 9.4))
    for x in np.arange(1.0, 71.0, 5.0):
        for inside, door, bed in ((1.0, 6.8, 2.0), (9.55, 9.35, 11.5)):
            canvas.carve(Box(x, inside, x + 4.85, inside + 5.5))
            canvas.carve(Box(x + 2.0, min(door, inside + 5.0), x + 3.1, door + 0.25))
            block(canvas, x + 0.3, bed, 2.0, 0.9)
            block(canvas, x + 4.0, bed + 0.2, 0.5, 0.5)
    return canvas


def hall(_: np.random.Generator) -> Canvas:
    """Twenty equal pillars 10 m apart; from the middle no wall is in sight."""
    canvas = room(60.0, 50.0)
    for x in np.arange(10.0, 60.0, 10.0):
        for y in np.arange(10.0, 50.0, 10.0):
            block(canvas, x, y, 0.5, 0.5)
    block(canvas, 20.0, 1.0, 6.0, 3.0)
    block(canvas, 40.0, 47.0, 10.0, 4.0)
    return canvas


def tunnel(_: np.random.Generator) -> Canvas:
    """100 m long and 2.6 m wide; equal niches every 15 m and one room."""
    canvas = Canvas(102.0, 9.6, RESOLUTION)
    canvas.carve(Box(1.0, 1.0, 101.0, 3.6))
    for x in np.arange(8.0, 98.0, 15.0):
        canvas.carve(Box(x, 0.5, x + 1.5, 1.0))
    canvas.carve(Box(40.0, 3.5, 46.0, 7.5))
    return canvas


def home(rng: np.random.Generator) -> Canvas:
    """Six rooms, with tables and chairs on legs and cupboards."""
    canvas = room(11.0, 8.5)
    walls = Box(4.5, 1.0, 4.65, 9.5), Box(8.0, 1.0, 8.15, 9.5), Box(1.0, 5.2, 12.0, 5.35)
    doors = [Box(x - 0.2, y, x + 0.4, y + 0.9) for x, y in ((4.5, 2.0), (8.0, 3.2), (4.5, 7.0), (8.0, 6.4))]
    doors += [Box(x, 4.9, x + 0.9, 5.7) for x in (2.5, 6.2, 9.5)]
    for wall in walls:
        canvas.build(wall)
    for _ in range(14):
        x, y = rng.uniform(1.2, 11.0), rng.uniform(1.2, 8.6)
        if rng.random() < 0.5:
            for dx in (0.0, 0.5):
                for dy in (0.0, 0.5):
                    block(canvas, x + dx, y + dy, 0.05, 0.05)
        else:
            block(canvas, x, y, rng.uniform(0.3, 0.9), rng.uniform(0.3, 0.5))
    for door in doors:
        canvas.carve(door)
    return canvas


PLACES: dict[str, Callable[[np.random.Generator], Canvas]] = {
    "warehouse": warehouse,
    "garage": garage,
    "ward of equal rooms": ward,
    "hall, 60 x 50 m": hall,
    "tunnel of 100 m": tunnel,
    "home": home,
}


def mapped(canvas: Canvas) -> OccupancyGrid:
    """Return the map of the largest free region: unknown is what no laser there sees."""
    regions, _ = ndimage.label(~canvas.solid)
    free = regions == np.bincount(regions[regions > 0]).argmax()
    depth = ndimage.distance_transform_edt(~free) * RESOLUTION
    return OccupancyGrid(np.where(free, 0.0, np.where(depth <= SEEN, 1.0, np.nan)).astype(np.float32), RESOLUTION)


def main(seed: int) -> None:
    """Calibrate and run the robot in every place, and print the table."""
    rows = []
    for name, drawn in PLACES.items():
        plan = mapped(drawn(np.random.default_rng(seed)))
        boxes = round(plan.free.sum() * RESOLUTION**2 * BOX_PER_M2)
        for state, changes in (("right", None), ("half moved", (KEPT, boxes))):
            with tempfile.TemporaryDirectory() as folder:
                rows.append({"place": name, "map": state} | outcome(USUAL, changes, seed, Path(folder), plan=plan))
            print(rows[-1], file=sys.stderr, flush=True)
    print_table(rows)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
