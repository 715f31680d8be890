"""Runs of neighbouring beams by their bearings, and as options that mask them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, wrap_angle

# More do not help.
MOST_SECTORS = 5


def sectors(bearings: FloatArray, chosen: NDArray[np.bool_]) -> tuple[str, str]:
    """Return where the chosen beams (k,) are, and the options of a command that mask them.

    Not by number: where poses are fitted, only every second beam of the sensor is looked at.

    Examples
    --------
    >>> sectors(np.radians([0.0, 1.0, 2.0, 3.0]), np.array([True, False, True, True]))
    ('bearings 0, 1.9 to 3.1 degrees', '--mask=-0.1:0.1 --mask=1.9:3.1')
    """
    beams = np.flatnonzero(chosen)
    runs = np.split(beams, np.flatnonzero(np.diff(beams) > 1) + 1)
    ends = [_ends(bearings[run]) for run in runs[:MOST_SECTORS]]
    only = np.degrees(wrap_angle(bearings)).round(1) + 0.0
    shown = ", ".join(
        f"{first:g} to {last:g}" if len(run) > 1 else f"{only[run[0]]:g}"
        for run, (first, last) in zip(runs, ends, strict=False)
    )
    more = f" and {len(runs) - MOST_SECTORS} more sectors" if len(runs) > MOST_SECTORS else ""
    noun = "bearing" if len(beams) == 1 else "bearings"
    return f"{noun} {shown} degrees{more}", " ".join(f"--mask={first:g}:{last:g}" for first, last in ends)


def _ends(bearings: FloatArray) -> tuple[float, float]:
    """Return the ends of neighbouring bearings, counter-clockwise, in degrees rounded outwards."""
    degrees = np.degrees(np.unwrap(bearings))
    first, last = math.floor(10.0 * degrees.min() - 1e-6) / 10.0, math.ceil(10.0 * degrees.max() + 1e-6) / 10.0
    return (first + 180.0) % 360.0 - 180.0, (last + 180.0) % 360.0 - 180.0
