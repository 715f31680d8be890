"""Furniture as a range finder 20 to 30 cm above the floor sees it: legs, panels and bases rather than table tops.

All lengths are metres, all angles radians; the frames are those of `Thing`.
"""

from __future__ import annotations

import numpy as np

from beamfield.simulation.drawing import Arc, Box, Shape, Thing

# Thinnest thing drawn, in metres: at least one cell of a 5 cm grid wherever it falls.
LEG = 0.06


def leg(x: float, y: float) -> Box:
    """Return a table's or chair's leg around (x, y), metres."""
    return Box(x - LEG / 2, y - LEG / 2, x + LEG / 2, y + LEG / 2)


def chair(x: float, y: float) -> tuple[Shape, ...]:
    """Return the four legs of a chair around (x, y), metres."""
    return tuple(leg(x + dx, y + dy) for dx in (-0.2, 0.2) for dy in (-0.2, 0.2))


def desk(*, width: float, drawers_left: bool) -> Thing:
    """Return a desk with its panel at the back, drawers at one side and a swivel chair in front; `width` in metres."""
    side = -1.0 if drawers_left else 1.0
    inner, outer = side * (width / 2 - 0.45), side * width / 2
    return Thing(
        (
            Box(-width / 2, 0.05, width / 2, 0.11),
            Box(min(inner, outer), 0.1, max(inner, outer), 0.7),
            leg(-outer + side * 0.05, 0.7),
            Arc(-side * 0.15, 1.05, 0.14),
        ),
        Box(-width / 2, 0.0, width / 2, 1.4),
    )


def desk_island() -> Thing:
    """Return four desks face to face in two rows; the footprint is centred on x, the back row faces -y."""
    shapes: list[Shape] = []
    width, total = 1.6, 3.2
    for x0 in (-width, 0.0):
        shapes += [Box(x0 + 0.05, 0.75, x0 + 0.5, 1.35), Box(x0 + width - 0.5, 2.15, x0 + width - 0.05, 2.75)]
        shapes += [Arc(x0 + 0.95, 0.4, 0.14), Arc(x0 + 0.65, 3.1, 0.14)]
    shapes.append(Box(-total / 2, 1.72, total / 2, 1.78))
    shapes += [leg(sign * (total / 2 - 0.05), y) for sign in (-1, 1) for y in (0.98, 2.5)]
    return Thing(tuple(shapes), Box(-total / 2, 0.0, total / 2, 3.5))


def meeting_table(*, length: float, chairs_per_side: int) -> Thing:
    """Return a long table on two columns with chairs along both sides; its long axis is x."""
    shapes: list[Shape] = [Box(sign * length / 3 - 0.25, 1.0, sign * length / 3 + 0.25, 1.4) for sign in (-1, 1)]
    for x in np.linspace(-length / 2 + 0.5, length / 2 - 0.5, chairs_per_side):
        shapes += [*chair(float(x), 0.4), *chair(float(x), 2.0)]
    return Thing(tuple(shapes), Box(-length / 2, 0.0, length / 2, 2.4))


def round_table(*, n_chairs: int, turn: float) -> Thing:
    """Return a bistro table on one foot with chairs around it."""
    shapes: list[Shape] = [Arc(0.0, 0.9, 0.22)]
    for i in range(n_chairs):
        angle = turn + 2.0 * np.pi * i / n_chairs
        shapes += chair(0.7 * float(np.cos(angle)), 0.9 + 0.7 * float(np.sin(angle)))
    return Thing(tuple(shapes), Box(-0.9, 0.0, 0.9, 1.8))


def solid(width: float, depth: float) -> Thing:
    """Return a closed box against a wall, sizes in metres: cabinet, shelf, counter, copier."""
    box = Box(-width / 2, 0.0, width / 2, depth)
    return Thing((box,), box)


def sofa() -> Thing:
    """Return a sofa: back and two arms around a seat that is closed to the floor."""
    return Thing((Box(-1.0, 0.05, 1.0, 0.8),), Box(-1.0, 0.0, 1.0, 1.2))


def plant() -> Thing:
    """Return a plant pot."""
    return Thing((Arc(0.0, 0.3, 0.2),), Box(-0.25, 0.05, 0.25, 0.55))


def pillar(radius: float) -> Thing:
    """Return a round pillar around the origin of its frame."""
    return Thing((Arc(0.0, 0.0, radius),), Box(-radius, -radius, radius, radius))


def reception() -> Thing:
    """Return a counter bent around a clerk who looks along +y."""
    counter = Arc(0.0, 0.0, 2.0, 1.55, 0.1 * np.pi, 0.9 * np.pi)
    return Thing((counter, Arc(0.0, 0.7, 0.14)), Box(-2.0, -0.3, 2.0, 2.0))
