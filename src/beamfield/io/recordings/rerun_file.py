"""Write a recording for the Rerun viewer."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from beamfield.errors import needs
from beamfield.geometry import FloatArray
from beamfield.io.files.atomic import atomic_file
from beamfield.io.recordings.recording import COLOURS, Recording, entity
from beamfield.maps.occupancy import OccupancyGrid

if TYPE_CHECKING:
    import rerun

# Seconds from the first scan ("log_time" is a name of the viewer's own).
TIMELINE = "time"
# Grey of free, unknown and occupied cells.
FREE, UNKNOWN, OCCUPIED = 254, 205, 0
# Above the map, in metres: what lies at one height flickers.
PATH_HEIGHT, SCAN_HEIGHT, PARTICLE_HEIGHT, ROBOT_HEIGHT = 0.02, 0.04, 0.06, 0.08
PARTICLE_COLOUR = (86, 180, 233)
ELLIPSE_POINTS = 48
# A point on the 95% ellipse is so many standard deviations out.
ELLIPSE_RADIUS = 2.4477


def write_rerun(path: str | Path, recording: Recording) -> None:
    """Write a recording as an .rrd file, which ``rerun FILE`` opens, whole or not at all.

    The viewer opens with the map and what lies on it (`/map`, `/paths`, `/robot`, `/scan`, `/particles`) beside a curve
    for each number. Time is that of the log, in seconds from its first scan. MissingDependencyError if the Rerun SDK is
    not installed.
    """
    with needs("rerun-sdk", "rerun", "writing a recording for Rerun"):
        import rerun
    with atomic_file(path) as part:
        stream = rerun.RecordingStream("beamfield", send_properties=False)
        stream.save(part, default_blueprint=_layout(recording))
        try:
            _write(stream, recording)
        finally:
            stream.flush()
            stream.disconnect()


def _layout(recording: Recording) -> Any:
    """Return the map seen from above beside the curves, one below the other."""
    import rerun.blueprint as blueprint

    known = recording.carrier[np.isfinite(recording.carrier).all(axis=1)]
    middle = known[:, :2].mean(axis=0) if len(known) else np.zeros(2)
    width = float(np.ptp(known[:, :2], axis=0).max()) if len(known) else 0.0
    above = [*middle.tolist(), 1.2 * width + 12.0]
    eye = blueprint.EyeControls3D(position=above, look_target=[*middle.tolist(), 0.0], eye_up=(0.0, 1.0, 0.0))
    views: list[Any] = [blueprint.Spatial3DView(origin="/", name="map", eye_controls=eye)]
    curves = [blueprint.TimeSeriesView(origin=f"numbers/{entity(name)}", name=name) for name in recording.numbers]
    if curves:
        views.append(blueprint.Vertical(*curves))
    return blueprint.Blueprint(blueprint.Horizontal(*views, column_shares=[2, 1][: len(views)]), collapse_panels=True)


def _write(stream: rerun.RecordingStream, recording: Recording) -> None:
    log = recording.log
    time = log.stamps - log.stamps[0] if len(log) else log.stamps
    _write_map(stream, recording.grid)
    for (name, poses), colour in zip(recording.paths.items(), cycle(COLOURS), strict=False):
        _write_path(stream, name, poses, colour)
    _write_robot(stream, recording, time)
    _write_scans(stream, recording, time)
    _write_particles(stream, recording, time)
    for name, values in recording.numbers.items():
        _write_numbers(stream, name, values, time)


def _write_map(stream: rerun.RecordingStream, grid: OccupancyGrid) -> None:
    import rerun

    pixels = np.full(grid.shape, UNKNOWN, np.uint8)
    pixels[grid.free] = FREE
    pixels[grid.occupied] = OCCUPIED
    rows, cols = grid.shape
    x, y, yaw = (float(value) for value in grid.origin)
    archetype = rerun.GridMap(
        # An image's first row is its uppermost.
        data=np.ascontiguousarray(pixels[::-1]).tobytes(),
        format=rerun.components.ImageFormat(
            width=cols, height=rows, color_model=rerun.ColorModel.L, channel_datatype=rerun.ChannelDatatype.U8
        ),
        cell_size=grid.resolution,
        translation=(x, y, 0.0),
        colormap=rerun.components.Colormap.Grayscale,
        rotation_axis_angle=rerun.RotationAxisAngle(axis=(0.0, 0.0, 1.0), radians=yaw),
    )
    stream.log("map", archetype, static=True)


def _write_path(stream: rerun.RecordingStream, name: str, poses: FloatArray, colour: tuple[int, int, int]) -> None:
    import rerun

    known = np.isfinite(poses).all(axis=1)
    # A line over a gap would claim that the robot was there.
    parts = [part[:, :2] for part in np.split(poses, np.flatnonzero(np.diff(known)) + 1) if np.isfinite(part).all()]
    strips = [_raised(part, PATH_HEIGHT) for part in parts if len(part) > 1]
    stream.log(f"paths/{entity(name)}", rerun.LineStrips3D(strips, colors=[colour], labels=[name]), static=True)


def _write_robot(stream: rerun.RecordingStream, recording: Recording, time: FloatArray) -> None:
    import rerun

    for i, pose in enumerate(recording.carrier):
        if not np.isfinite(pose).all():
            continue
        stream.set_time(TIMELINE, duration=float(time[i]))
        ahead = 0.6 * np.array([np.cos(pose[2]), np.sin(pose[2]), 0.0])
        origin = [pose[0], pose[1], ROBOT_HEIGHT]
        stream.log("robot", rerun.Arrows3D(origins=[origin], vectors=[ahead], colors=[COLOURS[0]]))
        if recording.covariances is not None and np.isfinite(recording.covariances[i]).all():
            ring = _ellipse(pose[:2], recording.covariances[i, :2, :2])
            stream.log("robot/region_95", rerun.LineStrips3D([_raised(ring, ROBOT_HEIGHT)], colors=[COLOURS[0]]))


def _ellipse(middle: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return points (n, 2) of the 95% ellipse of a normal distribution."""
    values, vectors = np.linalg.eigh(covariance)
    angles = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
    circle = ELLIPSE_RADIUS * np.stack([np.cos(angles), np.sin(angles)])
    return np.asarray(middle + (vectors * np.sqrt(np.maximum(values, 0.0)) @ circle).T)


def _write_scans(stream: rerun.RecordingStream, recording: Recording, time: FloatArray) -> None:
    import rerun

    palette = np.array(COLOURS, np.uint8)
    for i in range(len(recording.log)):
        points, causes = recording.scan_points(i)
        stream.set_time(TIMELINE, duration=float(time[i]))
        colours = palette[[1]] if causes is None else palette[np.maximum(causes, 0)]
        stream.log("scan", rerun.Points3D(_raised(points, SCAN_HEIGHT), colors=colours, radii=[0.03]))


def _write_particles(stream: rerun.RecordingStream, recording: Recording, time: FloatArray) -> None:
    import rerun

    for i, poses in recording.particles:
        stream.set_time(TIMELINE, duration=float(time[i]))
        points = _raised(poses[:, :2], PARTICLE_HEIGHT)
        stream.log("particles", rerun.Points3D(points, colors=[PARTICLE_COLOUR], radii=[0.02]))


def _write_numbers(stream: rerun.RecordingStream, name: str, values: FloatArray, time: FloatArray) -> None:
    import rerun

    place = f"numbers/{entity(name)}"
    known = np.isfinite(values)
    stream.log(place, rerun.SeriesLines(names=name), static=True)
    index = rerun.TimeColumn(TIMELINE, duration=time[known])
    stream.send_columns(place, indexes=[index], columns=rerun.Scalars.columns(scalars=values[known]))


def _raised(points: FloatArray, height: float) -> FloatArray:
    return np.column_stack([points, np.full(len(points), height)])
