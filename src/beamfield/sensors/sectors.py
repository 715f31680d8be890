"""Runs of neighbouring beams in words, and as options that mask them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray

# More do not help.
MOST_SECTORS = 5


def sectors(bearings: FloatArray, chosen: NDArray[np.bool_]) -> tuple[str, str]:
    """Return which beams (k,) are chosen, by number and bearing, and the options of a command that mask them."""
    beams = np.flatnonzero(chosen)
    runs = np.split(beams, np.flatnonzero(np.diff(beams) > 1) + 1)
    ends = [_ends(bearings[run]) for run in runs[:MOST_SECTORS]]
    shown = ", ".join(
        f"{run[0]}..{run[-1]} (bearings {first:g} to {last:g} degrees)"
        for run, (first, last) in zip(runs, ends, strict=False)
    )
    more = f" and {len(runs) - MOST_SECTORS} more sectors" if len(runs) > MOST_SECTORS else ""
    return shown + more, " ".join(f"--mask={first:g}:{last:g}" for first, last in ends)


def _ends(bearings: FloatArray) -> tuple[float, float]:
    """Return the ends of neighbouring bearings, counter-clockwise, in degrees rounded outwards."""
    degrees = np.degrees(np.unwrap(bearings))
    first, last = math.floor(10.0 * degrees.min() - 1e-6) / 10.0, math.ceil(10.0 * degrees.max() + 1e-6) / 10.0
    return (first + 180.0) % 360.0 - 180.0, (last + 180.0) % 360.0 - 180.0
