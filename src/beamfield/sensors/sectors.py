"""Runs of neighbouring beams in words, and as options that mask them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, wrap_angle

# More do not help.
MOST_SECTORS = 5


def sectors(bearings: FloatArray, chosen: NDArray[np.bool_]) -> tuple[str, str]:
    """Return which beams (k,) are chosen, by number and bearing, and the options of a command that mask them.

    Examples
    --------
    >>> sectors(np.radians([0.0, 1.0, 2.0, 3.0]), np.array([False, True, False, False]))
    ('beam 1 (bearing 1 degrees)', '--mask=0.9:1.1')
    """
    beams = np.flatnonzero(chosen)
    runs = np.split(beams, np.flatnonzero(np.diff(beams) > 1) + 1)
    ends = [_ends(bearings[run]) for run in runs[:MOST_SECTORS]]
    shown = ", ".join(_named(run, bearings, *end) for run, end in zip(runs, ends, strict=False))
    more = f" and {len(runs) - MOST_SECTORS} more sectors" if len(runs) > MOST_SECTORS else ""
    noun = "beam" if len(beams) == 1 else "beams"
    return f"{noun} {shown}{more}", " ".join(f"--mask={first:g}:{last:g}" for first, last in ends)


def _named(run: NDArray[np.intp], bearings: FloatArray, first: float, last: float) -> str:
    if len(run) > 1:
        return f"{run[0]}..{run[-1]} (bearings {first:g} to {last:g} degrees)"
    return f"{run[0]} (bearing {np.degrees(wrap_angle(bearings[run[0]])).round(1) + 0.0:g} degrees)"


def _ends(bearings: FloatArray) -> tuple[float, float]:
    """Return the ends of neighbouring bearings, counter-clockwise, in degrees rounded outwards."""
    degrees = np.degrees(np.unwrap(bearings))
    first, last = math.floor(10.0 * degrees.min() - 1e-6) / 10.0, math.ceil(10.0 * degrees.max() + 1e-6) / 10.0
    return (first + 180.0) % 360.0 - 180.0, (last + 180.0) % 360.0 - 180.0
