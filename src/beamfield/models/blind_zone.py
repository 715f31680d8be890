"""The blind zone before a range finder: readings below its min_range are dropped, so the model is that of the rest.

Each cause is conditioned on a reading of min_range or more. The exponential has no memory, the uniform stays uniform
and the Gaussian is cut anyway: so this is the mixture (6.12) with all ranges counted from min_range, and the functions
here are all there is to it. The weights are then shares of the readings that can be observed. Only the growth of a
hit's noise keeps the whole expected range (`sigma_slope`); an obstacle in the blind zone counts as one at its end.
"""

from __future__ import annotations

import numpy as np

from beamfield.arguments import LARGEST, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.sensors import SHORTEST_SPAN


def check_limits(max_range: float, min_range: float) -> None:
    """Raise if a sensor's limits are not valid: 0 <= min_range < max_range <= 1e9, metres."""
    # First of all: each call for a scan comes here, and texts of errors take longer than its checks.
    if 0.0 <= min_range < max_range <= LARGEST and max_range - min_range >= SHORTEST_SPAN:
        return
    require(0.0 < max_range <= LARGEST, "max_range", f"a positive number of metres up to {LARGEST:g}", max_range)
    require(0.0 <= min_range < max_range, "min_range", f"metres in [0, max_range = {max_range})", min_range)
    raise InvalidInputError(
        f"min_range: expected at least {SHORTEST_SPAN:g} m less than max_range = {max_range}, got {min_range}"
    )


def counted_from(min_range: float, ranges: FloatArray, max_range: float) -> FloatArray:
    """Return measured ranges counted from min_range; the array itself, if there is no blind zone.

    They are below max_range - min_range exactly where the range is below max_range, negative where nothing can be
    measured, NaN where the range is.
    """
    if min_range == 0.0:
        return ranges
    counted = np.asarray(ranges - min_range)
    # A rounding must not turn a range into "no return".
    farthest = np.nextafter(max_range - min_range, 0.0)
    return np.minimum(counted, farthest, out=counted, where=ranges < max_range)


def expected_from(min_range: float, expected_ranges: FloatArray) -> FloatArray:
    """Return expected ranges z* counted from min_range; the array itself, if there is no blind zone.

    0 where the obstacle is in the blind zone, NaN where the range is.

    >>> expected_from(0.5, np.array([0.2, 2.0])).tolist()
    [0.0, 1.5]
    """
    return expected_ranges if min_range == 0.0 else np.asarray(np.maximum(expected_ranges - min_range, 0.0))
