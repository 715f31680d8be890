"""What ``beamfield inspect`` says about a map, a log or poses, as plain values; units are in the names."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.cli.provenance import recorded
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import has_fill
from beamfield.printable import printable
from beamfield.sensors import RangeFinder, ScanLog, SensorLog, Track
from beamfield.sensors.robot_in_sight import robot_in_sight

Facts = dict[str, Any]

# Occupied cells to a free one: up to 4.8 in maps that people use (unknown space painted black), 33 in an inverted one.
INVERTED = 8.0
PAINTED_BLACK = (
    "most of what is occupied is no wall, but painted black: amcl's likelihood fields lose robots there; beamfield "
    "calibrate --stack writes amcl a map"
)


def map_facts(grid: OccupancyGrid, notes: Sequence[str] = ()) -> Facts:
    """Return size, place and categories of a map, with what its reader should know about the file."""
    rows, cols = grid.shape
    cells = {}
    for name, mask in (("free", grid.free), ("occupied", grid.occupied), ("unknown", grid.unknown)):
        count = int(mask.sum())
        cells[name] = {"count": count, "share": count / mask.size, "area_m2": count * grid.resolution**2}
    return {
        "kind": "map",
        "rows": rows,
        "cols": cols,
        "resolution_m": grid.resolution,
        "width_m": cols * grid.resolution,
        "height_m": rows * grid.resolution,
        "origin": {"x_m": float(grid.origin[0]), "y_m": float(grid.origin[1]), "yaw_rad": float(grid.origin[2])},
        "occupied_thresh": grid.occupied_thresh,
        "free_thresh": grid.free_thresh,
        "cells": cells,
        "notes": [*notes, *(map_notes(grid) or ([PAINTED_BLACK] if has_fill(grid) else []))],
    }


def log_facts(log: ScanLog) -> Facts:
    """Return what a log holds: each sensor, the odometry, the notes of its reader."""
    odometry = None
    if log.odometry is not None:
        odometry = {"poses": len(log.odometry), **_timing(log.odometry.stamps), **_path(log.odometry.poses)}
    seen = [(name, found) for name, sensor in log.sensors.items() for found in robot_in_sight(sensor)]
    return {
        "kind": "log",
        "sensors": {name: _sensor_facts(sensor) for name, sensor in log.sensors.items()},
        "odometry": odometry,
        "notes": [*log.notes, *(f"{name}: {found.full_text}" for name, found in seen)],
        "parameters": dict(log.parameters),
    }


def poses_facts(track: Track) -> Facts:
    """Return what a file of poses holds: time, path and extent."""
    low, high = track.poses[:, :2].min(axis=0), track.poses[:, :2].max(axis=0)
    return {
        "kind": "poses",
        "poses": len(track),
        **_timing(track.stamps),
        "path_length_m": path_length(track.poses),
        "extent": {"x_m": [float(low[0]), float(high[0])], "y_m": [float(low[1]), float(high[1])]},
    }


def path_length(poses: FloatArray) -> float:
    """Return the sum of the distances between neighbouring known poses, in metres."""
    known = poses[np.isfinite(poses).all(axis=-1)]
    return float(np.hypot(*np.diff(known[:, :2], axis=0).T).sum())


def map_notes(grid: OccupancyGrid) -> list[str]:
    """Return what makes a map look wrong, one sentence each."""
    notes = []
    if not grid.occupied.any():
        notes.append("no cell is occupied: occupied_thresh, negate or the picture is wrong")
    if not grid.free.any():
        notes.append("no cell is free: no pose is plausible in this map")
    elif (times := grid.occupied.sum() / grid.free.sum()) > INVERTED:
        notes.append(f"occupied cells outnumber free ones {times:.0f} to 1: inverted (negate), or unknown space black?")
    if abs(grid.origin[2]) > 2.0 * math.pi:
        notes.append(f"the origin's yaw is {grid.origin[2]:g} radians: are these degrees?")
    return notes


def _sensor_facts(sensor: SensorLog) -> Facts:
    return {
        "scans": len(sensor),
        **_timing(sensor.stamps),
        "beams": _beam_facts(sensor.finder),
        "min_range_m": sensor.finder.min_range,
        "max_range_m": sensor.finder.max_range,
        "readings": _reading_facts(sensor.ranges, sensor.finder),
        "no_return": {
            "values_m": [recorded(value) for value in sensor.no_return.values],
            "origin": sensor.no_return.origin,
            "explanation": sensor.no_return.explanation,
        },
        "reference_poses": _path(sensor.poses),
        "odometry": _path(sensor.odometry),
    }


def _timing(stamps: FloatArray) -> Facts:
    duration = float(stamps[-1] - stamps[0]) if len(stamps) else 0.0
    return {
        "start_s": float(stamps[0]) if len(stamps) else None,
        "duration_s": duration,
        "rate_hz": (len(stamps) - 1) / duration if duration > 0 else None,
    }


def _beam_facts(finder: RangeFinder) -> Facts:
    turns = np.asarray(wrap_angle(np.diff(finder.bearings)))
    origins = np.unique(finder.mounts[:, :2].round(6), axis=0)
    uniform = bool(len(turns)) and float(np.ptp(turns)) <= 1e-3 * float(np.abs(turns).max()) + 1e-6
    return {
        "count": finder.n_beams,
        "first_bearing_rad": float(finder.bearings[0]) if finder.n_beams else None,
        "last_bearing_rad": float(finder.bearings[-1]) if finder.n_beams else None,
        "span_rad": float(np.abs(turns).sum()),
        "step_rad": float(np.median(turns)) if uniform else None,
        "opening_angle_rad": finder.opening_angle,
        "origins_m": origins.tolist(),
    }


def _reading_facts(ranges: FloatArray, finder: RangeFinder) -> Facts:
    def share(mask: NDArray[np.bool_]) -> float:
        return float(mask.mean()) if mask.size else 0.0

    with np.errstate(invalid="ignore"):
        no_return, too_close = ranges >= finder.max_range, ranges < finder.min_range
        measured = ranges[(ranges >= finder.min_range) & ~no_return]
    return {
        "count": ranges.size,
        "measured_share": measured.size / ranges.size if ranges.size else 0.0,
        "no_return_share": share(no_return),
        "no_measurement_share": share(np.isnan(ranges)),
        "too_close_share": share(too_close),
        "scans_without_measurement": int((~np.isfinite(ranges)).all(axis=1).sum()),
        "shortest_m": float(measured.min()) if measured.size else None,
        "median_m": float(np.median(measured)) if measured.size else None,
        "longest_m": float(measured.max()) if measured.size else None,
    }


def _path(poses: FloatArray) -> Facts:
    known = np.isfinite(poses).all(axis=-1)
    return {"known": int(known.sum()), "path_length_m": path_length(poses) if known.any() else None}


# ----------------------------------------------------------------------------------------------------------------- text


def map_text(facts: Mapping[str, Any]) -> str:
    """Return the facts of a map as lines to read."""
    origin, resolution = facts["origin"], facts["resolution_m"]
    lines = [
        (
            f"map of {facts['cols']} x {facts['rows']} cells of {resolution:.6g} m: "
            f"{facts['width_m']:.2f} m x {facts['height_m']:.2f} m"
        ),
        (
            f"  origin      x {origin['x_m']:.6g} m, y {origin['y_m']:.6g} m, "
            f"yaw {math.degrees(origin['yaw_rad']):.6g} degrees"
        ),
        f"  thresholds  occupied from {facts['occupied_thresh']:.6g}, free up to {facts['free_thresh']:.6g}",
    ]
    for name, cell in facts["cells"].items():
        lines.append(f"  {name:<10}{cell['count']:>12,} cells {cell['share']:>7.2%} {cell['area_m2']:>10.1f} m2")
    return "\n".join(lines + _note_lines(facts))


def poses_text(facts: Mapping[str, Any]) -> str:
    """Return the facts of a file of poses as lines to read."""
    (left, right), (bottom, top) = facts["extent"]["x_m"], facts["extent"]["y_m"]
    return "\n".join(
        [
            f"{facts['poses']:,} poses{_when(facts)}, {_length(facts)}",
            f"  time    from {facts['start_s']:.3f} s on",
            f"  extent  x {left:.2f} m to {right:.2f} m, y {bottom:.2f} m to {top:.2f} m",
            "  use     as reference poses of a log: --poses",
        ]
    )


def log_text(facts: Mapping[str, Any]) -> str:
    """Return the facts of a log as lines to read."""
    sensors = facts["sensors"]
    lines = [f"log with {len(sensors)} sensor{'' if len(sensors) == 1 else 's'}"]
    for name, sensor in sensors.items():
        lines += ["", f"sensor {name!r}", *(f"  {key:<18}{value}" for key, value in _sensor_rows(sensor))]
    odometry = facts["odometry"]
    if odometry is not None:
        lines += ["", f"odometry            {odometry['poses']:,} poses{_when(odometry)}, {_length(odometry)}"]
    return "\n".join(lines + _note_lines(facts))


def _sensor_rows(sensor: Mapping[str, Any]) -> list[tuple[str, str]]:
    readings = sensor["readings"]
    rows = [
        ("scans", f"{sensor['scans']:,}{_when(sensor)}"),
        ("beams", _beams_row(sensor["beams"])),
        ("mounted at", _mount_row(sensor["beams"])),
        ("limits", f"{sensor['min_range_m']:.4g} m to {sensor['max_range_m']:.4g} m"),
        ("readings", (f"{readings['count']:,}: {readings['measured_share']:.2%} measured, "
                     f"{readings['no_return_share']:.2%} no return, {readings['no_measurement_share']:.2%} NaN, "
                     f"{readings['too_close_share']:.2%} too close")),
        ("no return", printable(sensor["no_return"]["explanation"])),
    ]  # fmt: skip
    if readings["shortest_m"] is not None:
        rows.append(
            ("measured ranges", (f"{readings['shortest_m']:.3f} m to {readings['longest_m']:.3f} m, "
                                f"median {readings['median_m']:.3f} m"))
        )  # fmt: skip
    if readings["scans_without_measurement"]:
        rows.append(("empty scans", f"{readings['scans_without_measurement']:,} scans measured nothing"))
    for title, key in (("reference poses", "reference_poses"), ("odometry", "odometry")):
        poses = sensor[key]
        text = f"{poses['known']:,} of {sensor['scans']:,} scans, {_length(poses)}" if poses["known"] else "none"
        rows.append((title, text))
    return rows


def _when(timing: Mapping[str, Any]) -> str:
    rate = timing["rate_hz"]
    return f" in {timing['duration_s']:.1f} s" + (f" ({rate:.3g} per second)" if rate is not None else "")


def _length(poses: Mapping[str, Any]) -> str:
    length = poses["path_length_m"]
    return "no pose known" if length is None else f"path of {length:.1f} m"


def _beams_row(beams: Mapping[str, Any]) -> str:
    if beams["count"] < 2:
        return f"{beams['count']}"
    first, last, span = (math.degrees(beams[f"{k}_rad"]) for k in ("first_bearing", "last_bearing", "span"))
    cone = math.degrees(beams["opening_angle_rad"])
    if beams["step_rad"] is None:
        text = f"{beams['count']} from {first:.1f} to {last:.1f} degrees, spanning {span:.1f}, unevenly spaced"
    else:
        step = math.degrees(beams["step_rad"])
        # Counted on from the first: "from -89 to -90 degrees" would hide that they go all the way around.
        last = first + math.copysign(span, step)
        # A laser that begins at -180 degrees is stored as beginning at 180: it does not end at 539.
        turns = 360.0 * round((first + last) / 720.0)
        first, last = first - turns, last - turns
        text = f"{beams['count']} from {first:.1f} to {last:.1f} degrees, spanning {span:.1f}, every {abs(step):.3g}"
        text += f", {'clockwise' if step < 0 else 'counter-clockwise'}"
    return text + (f", cones of {cone:.1f} degrees" if cone else "")


def _mount_row(beams: Mapping[str, Any]) -> str:
    origins = beams["origins_m"]
    if len(origins) != 1:
        return f"{len(origins)} places on the robot"
    return f"x {origins[0][0]:.3f} m, y {origins[0][1]:.3f} m on the robot"


def _note_lines(facts: Mapping[str, Any]) -> list[str]:
    notes = facts["notes"]
    return ["", "notes", *(f"  - {printable(note)}" for note in notes)] if notes else []
