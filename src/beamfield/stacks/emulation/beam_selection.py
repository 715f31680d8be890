"""Which beams of a scan a program looks at."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError

Indices = NDArray[np.int64]


def floor_step_beams(n_beams: int, max_beams: int, *, least_step: int) -> Indices:
    """Return every floor((n - 1) / (max_beams - 1))-th beam, from the first on (AMCL's beam and likelihood_field).

    There may be nearly twice max_beams of them. The least step is 1 where the program sees to it, as likelihood_field
    does, 0 where it does not, as beam: InvalidInputError if the step is 0, where the program stays at the first beam
    for ever.
    """
    step = max((n_beams - 1) // (max_beams - 1), least_step)
    if step < 1:
        raise InvalidInputError(
            f"max_beams: expected at most the number of beams in the scan, {n_beams}, got {max_beams}: "
            "the program's beam step becomes 0 and it never returns"
        )
    return np.arange(0, n_beams, step)


def ceil_step_beams(n_beams: int, max_beams: int) -> Indices:
    """Return every ceil(n / max_beams)-th beam, from the first on (AMCL's likelihood_field_prob).

    There are at most max_beams of them, and may be little more than half as many.
    """
    return np.arange(0, n_beams, max(1, math.ceil(n_beams / max_beams)))


def even_beams(n_beams: int, max_beams: int) -> Indices:
    """Return max_beams beams spread evenly from the first to the last, or all if there are no more (Beluga)."""
    if max_beams >= n_beams:
        return np.arange(n_beams)
    if max_beams == 1:
        return np.zeros(1, np.int64)
    return np.ceil(np.arange(max_beams) * (n_beams - 1) / (max_beams - 1)).astype(np.int64)
