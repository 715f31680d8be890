"""What the processor allows: limit.cpp, compiled where there is a g++ and AVX2, to hold our times against."""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, Scan

# Entries of the table over expected ranges, for each beam.
BINS = 1024
NO_COMPILER = "no compiler"


def cast(caster: RayCaster, poses: NDArray[np.float64], finder: RangeFinder) -> Callable[[], NDArray[Any]] | None:
    """Return a call that gives ranges in cells, of poses in a map with the origin (0, 0, 0); None without compiler."""
    library = _library()
    if library is None:
        return None
    arguments, out = _arguments(caster, poses, finder), np.empty((len(poses), finder.n_beams), np.float32)

    def call() -> NDArray[Any]:
        library.limit_cast(*map(_as_c, (*arguments, out)))
        return out

    return call


def beam(
    caster: RayCaster, poses: NDArray[np.float64], scan: Scan, parameters: BeamParameters
) -> Callable[[], NDArray[Any]] | None:
    """Return a call that gives about the logarithm of the beam model, as `cast` does; None without compiler."""
    library, finder = _library(), scan.finder
    if library is None:
        return None
    nodes = np.linspace(0.0, finder.max_range, BINS + 1)
    table = beam_log_density(np.array(scan.ranges)[:, None], nodes, finder.max_range, parameters).astype(np.float32)
    arguments, out = _arguments(caster, poses, finder), np.empty(len(poses))

    def call() -> NDArray[Any]:
        library.limit_beam(*map(_as_c, (*arguments, table, BINS, out)))
        return out

    return call


def ratio(ours: float, limits: float | None) -> str:
    """Return how many times the limit's time is ours."""
    return NO_COMPILER if limits is None else f"{ours / limits:.2f}"


@functools.cache
def _library() -> ctypes.CDLL | None:
    """Compile limit.cpp and load it; None without a compiler, or on a processor that it is not for."""
    compiler = shutil.which("g++")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder, "limit.so")
        flags = ["-O3", "-march=native", "-std=c++17", "-shared", "-fPIC", "-Wno-ignored-attributes"]
        source = Path(__file__).with_name("limit.cpp")
        done = subprocess.run([compiler, *flags, str(source), "-o", str(library)], capture_output=True, check=False)
        return None if done.returncode else ctypes.CDLL(str(library))


def _arguments(caster: RayCaster, poses: NDArray[np.float64], finder: RangeFinder) -> tuple[Any, ...]:
    """Return what both functions take first."""
    rows, cols = caster.grid.shape
    resolution = caster.grid.resolution
    bearings = np.append(finder.bearings, np.zeros(31))
    return (
        caster._rectangles,
        rows,
        cols,
        finder.max_range / resolution,
        np.ascontiguousarray(poses),
        len(poses),
        np.cos(bearings).astype(np.float32),
        np.sin(bearings).astype(np.float32),
        finder.n_beams,
        ctypes.c_double(1.0 / resolution),
    )


def _as_c(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.ctypes.data_as(ctypes.c_void_p)
    return ctypes.c_float(value) if isinstance(value, float) else value
