"""The options of ``beamfield simulate --sonar``: the ring, and the walls that mirror sound."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from beamfield.errors import InvalidInputError

if TYPE_CHECKING:
    from beamfield.sensors import RangeFinder

MAX_SENSORS = 360
DEFAULT_MAX_RANGE = 5.0
Value = tuple[str, float, str, str]
# Option, default, unit, meaning.
RING_OPTIONS: tuple[Value, ...] = (
    ("ring", 16, "N", "sensors, evenly around the robot"),
    ("ring-radius", 0.2, "M", "of the ring"),
    ("opening-angle", 30.0, "DEG", "full width of the cones"),
    ("roughness", 0.3, "P", "share of pulses that come back from walls that a sensor does not face"),
)


def add_sonar_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the ring."""
    add_values(parser.add_argument_group("--sonar: a ring among walls that mirror sound"), RING_OPTIONS)


def add_values(
    group: argparse._ActionsContainer, table: Sequence[Value], kind: Callable[[str], float] | None = None
) -> None:
    """Add options that take a number; it is of the type of its default if no other is named."""
    for name, value, unit, meaning in table:
        meaning = f"{meaning} (default: {value:g})"
        group.add_argument(f"--{name}", type=kind or type(value), default=value, metavar=unit, help=meaning)


def ring_of(arguments: argparse.Namespace) -> RangeFinder:
    """Return the ring that the command line asks for."""
    from beamfield.simulation.sonar import sonar_ring

    if not 1 <= arguments.ring <= MAX_SENSORS:
        raise InvalidInputError(f"--ring: expected 1 to {MAX_SENSORS} sensors, got {arguments.ring}")
    if not 0.0 <= arguments.opening_angle < 180.0:
        raise InvalidInputError(f"--opening-angle: expected 0 to below 180 degrees, got {arguments.opening_angle:g}")
    return sonar_ring(
        arguments.ring,
        radius=arguments.ring_radius,
        opening_angle=math.radians(arguments.opening_angle),
        max_range=DEFAULT_MAX_RANGE if arguments.max_range is None else arguments.max_range,
    )


def values_of(arguments: argparse.Namespace, table: Sequence[Value]) -> dict[str, Any]:
    """Return what was given for the options of a table, by the names of fields."""
    return {_field(name): getattr(arguments, _field(name)) for name, *_ in table}


def given_options(arguments: argparse.Namespace, table: Sequence[Value]) -> list[str]:
    """Return the options of a table that differ from their defaults, as words of the command line."""
    return [f"--{name}" for name, value, *_ in table if getattr(arguments, _field(name)) != value]


def _field(option: str) -> str:
    return option.replace("-", "_")
