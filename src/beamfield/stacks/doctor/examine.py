"""Examine a parameter file: every check, worst first."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from beamfield.finding import Finding, worst_first
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.doctor import (
    beam_checks,
    log_checks,
    map_checks,
    motion_checks,
    range_checks,
    sharpness,
    value_checks,
    weight_checks,
)
from beamfield.stacks.doctor.calibration_check import SETTLED, calibrated, is_calibrated
from beamfield.stacks.doctor.subject import MapFile, Subject
from beamfield.stacks.files.parameter_file import StackFile
from beamfield.stacks.files.typed_values import typed_values

CHECKS: tuple[Callable[[Subject], Iterator[Finding]], ...] = (
    value_checks.unusable_values,
    value_checks.beyond_limits,
    value_checks.missing_ros_key,
    value_checks.given_again,
    log_checks.unknown_frames,
    log_checks.other_topic,
    log_checks.silent_program,
    map_checks.no_obstacles,
    map_checks.disagreement,
    map_checks.ignored_yaw,
    map_checks.painted_black,
    beam_checks.beam_count,
    beam_checks.nan_readings,
    weight_checks.value_above_one,
    weight_checks.weights_sum,
    weight_checks.no_random,
    weight_checks.sigma_against_resolution,
    weight_checks.distance_limit,
    range_checks.range_limits,
    beam_checks.usable_beams,
    beam_checks.own_body,
    # What may make scans say too little comes before.
    sharpness.sharpness,
    motion_checks.no_motion_noise,
    motion_checks.motion_noise,
    range_checks.short_limit,
    range_checks.unreachable_z_max,
    map_checks.lost_cells,
    map_checks.unknown_space,
    map_checks.half_cell,
    value_checks.foreign_names,
    beam_checks.many_beams_in_product,
    weight_checks.unused_weights,
    motion_checks.sideways_motion,
    motion_checks.updates_and_particles,
    motion_checks.random_poses,
    value_checks.loaded_elsewhere,
    calibrated,
)


def examine(
    file: StackFile,
    *,
    grid: OccupancyGrid | None = None,
    map_file: MapFile | None = None,
    log: SensorLog | None = None,
    frames: tuple[str, ...] = (),
) -> tuple[Finding, ...]:
    """Return everything that is wrong with a parameter file, or worth knowing, worst first.

    Parameters
    ----------
    file
        From `read_stack_file`.
    grid, map_file
        The map that the robot uses and what its file says; None leaves out what needs it.
    log
        Scans of the robot; None leaves out what needs them.
    frames
        All coordinate frames of the robot (`ScanLog.frames`); () leaves out what needs them.
    """
    subject = Subject(file, typed_values(file), grid, map_file, log, frames)
    found = [item for check in (*CHECKS, *subject.stack.checks) for item in check(subject)]
    if is_calibrated(subject):
        found = [item for item in found if item.name not in SETTLED]
    return worst_first(found)


def hopeless_notes(file: StackFile, grid: OccupancyGrid, log: SensorLog) -> list[str]:
    """Return in words why a filter loses robots on a map, such as weights that are all zero."""
    found = examine(file, grid=grid, log=log)
    told = [finding for finding in found if finding.severity == "error" or finding.name == "map-painted-black"]
    return [f"{finding.text}: {finding.why}" for finding in told]
