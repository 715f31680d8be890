"""What a CARMEN log says about a laser: where its beams point, where it is on the robot, and how far it sees."""

from __future__ import annotations

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray
from beamfield.io.logs.carmen_messages import CarmenMessages
from beamfield.io.logs.carmen_writer import OPENING_ANGLE, RING_RADIUS

# First beam and step of a SICK LMS in degrees, by the number of beams. Checked on public logs: the right convention
# gives the sharpest map.
SICK_BEARINGS = {180: (-90.0, 1.0), 181: (-90.0, 1.0), 360: (-90.0, 0.5), 361: (-90.0, 0.5)}
RING_LIMIT = 100.0  # metres: no robot is larger


def bearings(content: CarmenMessages, name: str, n_beams: int, notes: list[str]) -> FloatArray:
    """Return the directions of the beams on the laser, (n_beams,) radians; notes say what had to be assumed."""
    index = np.arange(n_beams, dtype=np.float64)
    if name in content.geometry:
        start, span, step = content.geometry[name]
        if n_beams > 1 and not 0.0 < abs(step) * (n_beams - 1) < 2.1 * np.pi:
            step = span / (n_beams - 1)
            notes.append(
                f"{name}: the resolution is implausible, {np.degrees(step):.4g} degrees from the field of view"
            )
        return np.asarray(start + step * index)
    side = {"FLASER": "front", "RLASER": "rear"}.get(name, name.lower())
    start_angle = content.number(f"laser_{side}_laser_start_angle")
    step_deg = content.number(f"laser_{side}_laser_resolution")
    if start_angle is not None and step_deg is not None and step_deg > 0.0:
        return np.asarray(start_angle + np.radians(step_deg) * index)
    if n_beams in SICK_BEARINGS:
        start_deg, step_deg = SICK_BEARINGS[n_beams]
        return np.asarray(np.radians(start_deg + step_deg * index))
    span_or_none = content.number(f"laser_{side}_laser_fov")
    span = np.pi if span_or_none is None or not 0.0 < span_or_none <= 2.0 * np.pi else span_or_none
    notes.append(
        f"{name}: {n_beams} beams is an unusual number and the log does not give their bearings: assumed to span "
        f"{np.degrees(span):.4g} degrees, from right to left"
    )
    return np.linspace(-span / 2.0, span / 2.0, n_beams)


def declared_mount(content: CarmenMessages, name: str) -> FloatArray:
    """Return the pose of the laser on the robot, (3,) metres and radians, as the PARAM lines say; else 0."""
    if name in ("RLASER", "RAWLASER2"):
        return np.array([content.number("robot_rearlaser_offset") or 0.0, 0.0, np.pi])
    front = name in ("FLASER", "RAWLASER1")
    return np.array([(content.number("robot_frontlaser_offset") or 0.0) if front else 0.0, 0.0, 0.0])


def declared_max(content: CarmenMessages, name: str) -> float | None:
    """Return the longest range in metres, None if the log is silent."""
    if name in content.limits:
        return content.limits[name]
    side = {"FLASER": "front", "RLASER": "rear"}.get(name)
    limit = content.number(f"robot_{side}_laser_max") if side else None
    return limit if limit is not None and limit > 0.0 else None


def ring_and_cone(content: CarmenMessages, name: str) -> tuple[float, float]:
    """Return how far from the sensor's origin its beams start, and how wide they are; 0 and 0 if the log is silent."""
    if name != "FLASER":
        return 0.0, 0.0
    values = []
    for parameter, limit in ((RING_RADIUS, RING_LIMIT), (OPENING_ANGLE, np.pi)):
        value = 0.0
        if parameter in content.parameters:
            known = content.number(parameter)
            value = np.nan if known is None else known
        # A negative radius is that of a ring of sensors that look inwards.
        if not (abs(value) < limit and (value >= 0.0 or parameter == RING_RADIUS)):
            raise FormatError(
                content.path,
                f"expected a number below {limit:.6g}, got {content.parameters[parameter][:40]!r}",
                field=parameter,
            )
        values.append(value)
    return values[0], values[1]
