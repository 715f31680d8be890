"""The options of commands that record for viewers what they did."""

from __future__ import annotations

import argparse
import importlib.util
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli.options import check_output, output_file
from beamfield.errors import InvalidInputError, MissingDependencyError

if TYPE_CHECKING:
    from beamfield.geometry import FloatArray
    from beamfield.io.recordings.recording import Recording
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.sensors import SensorLog

    Numbers = Mapping[str, FloatArray]

# Option, ending of its file, module that writes it, package of that, extra that brings the package.
KINDS = (("rerun", ".rrd", "rerun", "rerun-sdk", "rerun"), ("mcap", ".mcap", "rosbags", "rosbags", "ros"))


def add_recordings(parser: argparse.ArgumentParser) -> None:
    """Add --rerun and --mcap."""
    group = parser.add_argument_group("recordings, to look at over time")
    group.add_argument("--rerun", type=output_file, metavar="FILE", help="write an .rrd for the Rerun viewer")
    group.add_argument("--mcap", type=output_file, metavar="FILE", help="write an .mcap for Foxglove or RViz")


def wants_recording(arguments: argparse.Namespace) -> bool:
    """Return whether one is to be written."""
    return arguments.rerun is not None or arguments.mcap is not None


def check_recordings(arguments: argparse.Namespace) -> None:
    """Refuse now what could not be written after the work."""
    for option, ending, module, package, extra in KINDS:
        path = getattr(arguments, option)
        if path is not None and importlib.util.find_spec(module) is None:
            raise MissingDependencyError(package, extra, f"--{option}")
        check_output(path, option, ending)
    if arguments.mcap is not None:
        from beamfield.io.read_log import folder_of_log

        for log in arguments.logs if "logs" in arguments else [arguments.log]:
            folder = folder_of_log(log)
            if folder is not None and os.path.realpath(folder) == os.path.realpath(arguments.mcap.parent):
                raise InvalidInputError(
                    f"--mcap: {arguments.mcap} would lie in the folder of the log, and be read as part of it; write it "
                    "elsewhere"
                )


def write_recordings(arguments: argparse.Namespace, record: Callable[[], Recording]) -> list[Path]:
    """Write what was asked for, all or nothing, and return the files; within the block that writes the results."""
    if not wants_recording(arguments):
        return []
    from beamfield.io.files.atomic import atomic_files
    from beamfield.io.recordings.mcap_file import write_mcap
    from beamfield.io.recordings.rerun_file import write_rerun

    asked = [(path, write) for path, write in ((arguments.rerun, write_rerun), (arguments.mcap, write_mcap)) if path]
    recording, paths = record(), [path for path, _ in asked]
    with atomic_files(paths) as parts:
        for part, (_, write) in zip(parts, asked, strict=True):
            write(part, recording)
    return paths


def beam_recording(
    parameters: BeamParameters, log: SensorLog, grid: OccupancyGrid, numbers: Numbers | None = None
) -> Recording:
    """Return a recording of scans at their reference poses, each reading coloured by its most likely cause."""
    import numpy as np

    from beamfield.io.recordings.recording import Recording
    from beamfield.models.sonar import model_of_sensor

    model = model_of_sensor(log.finder)(grid, parameters)
    causes = np.full(log.ranges.shape, -1, np.int8)
    fits = np.full(len(log), np.nan)
    for i in np.flatnonzero(np.isfinite(log.poses).all(axis=1)):
        shares = model.responsibilities(log[int(i)], log.poses[i])
        known = shares.sum(axis=-1) > 0.0
        causes[i, known] = shares[known].argmax(axis=-1)
        if known.any():
            fits[i] = model.beam_log_likelihood(log[int(i)], log.poses[i])[known].mean()
    numbers = {"mean log likelihood of a beam [nats]": fits, **(numbers or {})}
    return Recording(grid, log, {"pose": log.poses}, numbers=numbers, causes=causes)
