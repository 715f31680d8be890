"""Tables of the beam model's log density over the expected range, for one scan at very many poses."""

from __future__ import annotations

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.kernels.beam import BeamView
from beamfield.kernels.many_beams import fill_log_density
from beamfield.kernels.mixture_table import DEGREE, PIECES, MixtureTable
from beamfield.kernels.threads import run_in_blocks
from beamfield.models.beam_density import read_only

# A table takes as long as the formulas take longer than looking up at 1,200 to 3,000 poses of 60 beams.
POSES_WITH_TABLE = 10_000
# A piece may be so far off, in nats, at the two shares of it where that is measured; elsewhere it is off a little more.
CLOSE_ENOUGH = 2e-5
MEASURED_AT = np.array([0.21, 0.79])
# Short pieces reach so many sigma from the reading. With at least LEAST_RAND, hits beyond are below 1e-6 of the other
# readings; with an offset or a slope beyond the others, pieces as long could be off unnoticed.
SIGMAS = 8.0
LEAST_RAND, MOST_SIGMAS_OFF, MOST_SLOPE = 1e-8, 2.0, 1.0
# No rounding then puts what is before the end of a part into the next.
ROUNDED_DOWN = 1.0 - 1e-14

# Chebyshev's points with both ends: the polynomial through these is off about as little as one of its degree can be.
_SHARES = 0.5 - 0.5 * np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
_POINTS = np.append(_SHARES, MEASURED_AT)
_INDEX = np.concatenate([np.arange(n) for n in PIECES])
_COEFFICIENTS = np.linalg.inv(np.vander(_SHARES, increasing=True))
_VALUES = np.vander(MEASURED_AT, DEGREE + 1, increasing=True) @ _COEFFICIENTS


def mixture_table(ranges: FloatArray, view: BeamView) -> MixtureTable | None:
    """Return the log density of a scan's readings (k,) over z*, within 1e-4 nats for each.

    Readings are counted from `view.min_range`. None for parameters that would need more pieces: with next to no random
    readings, for example.
    """
    if (
        view.z_rand * view.sigma_hit < LEAST_RAND * view.z_hit * view.max_range
        or abs(view.range_offset) > MOST_SIGMAS_OFF * view.sigma_hit
        or view.sigma_slope > MOST_SLOPE
    ):
        return None
    z = np.minimum(ranges, view.max_range)
    reach = SIGMAS * np.hypot(view.sigma_hit, view.sigma_slope * (view.min_range + z))
    near = np.maximum(z - max(view.range_offset, 0.0) - reach, 0.0)
    far = np.minimum(z - min(view.range_offset, 0.0) + reach, view.max_range)
    edges = np.array([np.zeros_like(z), near, z, far, np.sqrt(far * view.max_range), np.full_like(z, view.max_range)]).T
    starts, lengths, ends = edges[:, :-1], np.diff(edges) / PIECES, edges[:, 1:].copy()
    # Up to the last number before z: from there on, the reading can be short.
    ends[:, 1] = np.maximum(np.nextafter(z, 0.0), near)
    start, length, end = (np.repeat(each, PIECES, axis=1) for each in (starts, lengths, ends))
    points = length * (_INDEX + _POINTS[:, None, None])
    points += start
    np.minimum(points, end, out=points)
    # Of one reading that would be a view without strides, for which kernels are compiled anew.
    measured = read_only(np.ascontiguousarray(np.broadcast_to(ranges[:, None], points.shape).reshape(-1)))
    expected, values = read_only(points.reshape(-1)), np.empty(points.size)
    run_in_blocks(lambda a, b: fill_log_density(measured[a:b], expected[a:b], view, values[a:b]), values.size)
    nodes, check = np.split(values.reshape(len(_POINTS), -1), [DEGREE + 1])
    # What cannot be is -inf, and its piece NaN.
    with np.errstate(invalid="ignore", divide="ignore"):
        # Less the first, so that a constant stays one to the last bit.
        first = nodes[0].copy()
        nodes -= first
        check -= first
        coefficients = nodes.T @ _COEFFICIENTS.T
        coefficients[:, 0] += first
        off = np.abs(_VALUES @ nodes - check).max(axis=0)
        coefficients[~(off <= CLOSE_ENOUGH)] = np.nan
        per_metre = np.where(lengths > 0.0, ROUNDED_DOWN / lengths, 0.0)
    return MixtureTable(np.ascontiguousarray(starts), np.ascontiguousarray(per_metre), coefficients.reshape(-1))
