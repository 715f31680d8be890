"""The options of ``beamfield simulate --sensor sonar``: the ring, and how sound is reflected and heard."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from beamfield.errors import InvalidInputError

if TYPE_CHECKING:
    from beamfield.sensors import RangeFinder
    from beamfield.simulation.sonar import SonarPhysics, SonarReadings

MAX_SENSORS = 360
DEFAULT_MAX_RANGE = 5.0
# Option, default, unit, meaning; those of the second table are fields of `SonarPhysics`.
RING_OPTIONS: tuple[tuple[str, float, str, str], ...] = (
    ("ring", 16, "N", "sensors, evenly around the robot"),
    ("ring-radius", 0.2, "M", "of the ring"),
    ("opening-deg", 30.0, "DEG", "full width of the cones"),
)
PHYSICS_OPTIONS: tuple[tuple[str, float, str, str], ...] = (
    ("roughness", 0.3, "P", "share of pulses that surfaces scatter; 1: the nearest thing in the cone is always heard"),
    ("corner-echo", 0.9, "P", "share of inner corners that are heard"),
    ("edge-echo", 0.2, "P", "share of edges that are heard"),
    ("second-echo", 0.7, "P", "share of echoes over several walls that are heard"),
    ("dropout", 0.01, "P", "share of readings that miss their echo"),
    ("sigma", 0.02, "M", "noise of a range"),
    ("cross-talk", 0.3, "P", "share of the other sensors' echoes that are taken for one's own"),
    ("firing-groups", 4, "N", "sensors k, k + N, k + 2 N ... fire at once"),
    ("firing-interval", 0.01, "S", "from one group to the next"),
    ("objects", 0.0, "P", "share of readings that a person may stand before"),
    ("object-rate", 0.5, "R", "rate of the distance of persons, 1/metre"),
    ("phantoms", 0.005, "P", "share of readings without any reason"),
)


def add_sonar_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the ring and of the acoustics."""
    sonar = parser.add_argument_group("--sensor sonar: a ring among walls that mirror sound")
    for name, value, unit, meaning in (*RING_OPTIONS, *PHYSICS_OPTIONS):
        sonar.add_argument(
            f"--{name}", type=type(value), default=value, metavar=unit, help=f"{meaning} (default: {value:g})"
        )


def ring_of(arguments: argparse.Namespace) -> RangeFinder:
    """Return the ring that the command line asks for."""
    from beamfield.simulation.sonar import sonar_ring

    if not 1 <= arguments.ring <= MAX_SENSORS:
        raise InvalidInputError(f"--ring: expected 1 to {MAX_SENSORS} sensors, got {arguments.ring}")
    if not 0.0 <= arguments.opening_deg < 180.0:
        raise InvalidInputError(f"--opening-deg: expected 0 to below 180 degrees, got {arguments.opening_deg:g}")
    return sonar_ring(
        arguments.ring,
        radius=arguments.ring_radius,
        opening_angle=math.radians(arguments.opening_deg),
        max_range=DEFAULT_MAX_RANGE if arguments.max_range is None else arguments.max_range,
    )


def physics_of(arguments: argparse.Namespace) -> SonarPhysics:
    """Return the acoustics that the command line asks for."""
    from beamfield.simulation.sonar import SonarPhysics

    return SonarPhysics(**{_field(name): getattr(arguments, _field(name)) for name, *_ in PHYSICS_OPTIONS})


def cause_shares(readings: SonarReadings) -> dict[str, float]:
    """Return the share of readings of each cause by its name."""
    from beamfield.simulation.sonar import EchoCause

    return {cause.name.lower(): round(float((readings.causes == cause).mean()), 6) for cause in EchoCause}


def given_options(arguments: argparse.Namespace) -> list[str]:
    """Return the sonar's options that differ from their defaults, as words of the command line."""
    options = (*RING_OPTIONS, *PHYSICS_OPTIONS)
    return [f"--{name}" for name, value, *_ in options if getattr(arguments, _field(name)) != value]


def _field(option: str) -> str:
    return option.replace("-", "_")
