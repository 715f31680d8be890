"""What a filter did on a log, in files: where it took the robot to be, and its particles."""

from __future__ import annotations

import gzip
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beamfield.arguments import check_fields
from beamfield.geometry import FloatArray
from beamfield.io.files.atomic import write_file
from beamfield.io.trajectory import read_poses, read_trajectory
from beamfield.sensors import Track
from beamfield.short_repr import short_repr

TRAJECTORY, PARTICLES = "trajectory.tum", "particles.csv.gz"


@dataclass(frozen=True, eq=False)
class FilterRun:
    """A filter's run over a log: the poses that it published, and its updates' stamps (u,), increasing, with particles.

    The particles are poses (n, 3) after each update; a choice of them in which each counts alike.
    """

    track: Track
    stamps: FloatArray
    particles: tuple[FloatArray, ...]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)


def read_run(path: str | Path) -> FilterRun:
    """Read the folder that ``beamfield localize`` wrote, or a trajectory alone, of any program."""
    source = Path(path)
    if not source.is_dir():
        return FilterRun(read_trajectory(source), np.empty(0), ())
    track, cloud = read_trajectory(source / TRAJECTORY), source / PARTICLES
    if not cloud.exists():
        return FilterRun(track, np.empty(0), ())
    every = read_poses(cloud)
    stamps, first = np.unique(every.stamps, return_index=True)
    return FilterRun(track, stamps, tuple(np.split(every.poses, first[1:])))


def write_particles(path: Path, clouds: Iterable[tuple[float, FloatArray]]) -> None:
    """Write particles as CSV, one a row, compressed with gzip, whole or not at all.

    Clouds are stamps, seconds, and poses (n, 3), in the order of time; poses are written to a tenth of a millimetre and
    of a milliradian.
    """
    packed = io.BytesIO()
    # Without a time or a name in it, the same run writes the same bytes.
    with gzip.GzipFile(filename="", mode="wb", fileobj=packed, mtime=0) as stream:
        stream.write(b"t,x,y,theta\n")
        for stamp, poses in clouds:
            rows = (f"{stamp:.9f},{x:.4f},{y:.4f},{theta:.4f}\n" for x, y, theta in poses.tolist())
            stream.write("".join(rows).encode())
    write_file(path, packed.getvalue())
