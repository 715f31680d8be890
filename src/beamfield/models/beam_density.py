"""The beam model on arrays of measured and expected ranges (6.3.1): densities, causes and distribution functions.

For whoever has expected ranges already, as learning has: no map, no poses, no scans. All functions take millions of
beams, use several threads, and allocate nothing but their result if both arrays are float64 of one shape and there is
no min_range.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import checked
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels.beam import BeamView, fill_cdf, fill_components, fill_responsibilities
from beamfield.kernels.many_beams import fill_log_density
from beamfield.kernels.threads import run_in_blocks
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.blind_zone import check_limits, counted_from, expected_from

CAUSES = ("hit", "short", "max", "rand")
"""The four causes of a reading (6.3.1), in the order of every axis of length 4."""

Fill = Callable[[FloatArray, FloatArray, BeamView, FloatArray], object]


@checked
def beam_log_density(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
    *,
    min_range: float = 0.0,
) -> FloatArray:
    """Return the logarithm of the mixture (6.12) for each beam.

    For a range z in [min_range, max_range) it is the logarithm of a density,
    z_hit p_hit(z) + z_short p_short(z) + z_rand / (max_range - min_range); for z >= max_range ("no return") that of the
    probability z_max. The density integrates to 1 - z_max over [min_range, max_range).

    Parameters
    ----------
    ranges
        Measured ranges in metres; NaN and values below `min_range` are not measurements.
    expected_ranges
        Expected ranges z* in metres, broadcast against `ranges`; values above `max_range` count as `max_range` (the ray
        hits nothing), values below `min_range` as `min_range`, NaN as not known.
    max_range
        The sensor's limit in metres.
    parameters
        Weights and shapes of the four densities.
    min_range
        Nearer readings are dropped, metres: each density is cut to [min_range, max_range], and the weights are shares
        of the readings that are left. 0: all readings are seen.

    Returns
    -------
    Nats, of the broadcast shape; 0 where there is no measurement, -inf where the parameters make the range impossible
    (for z >= max_range with z_max = 0, for example), never NaN.

    Raises
    ------
    InvalidInputError
        If the shapes do not broadcast, an expected range is negative, or the limits are not 0 <= min_range < max_range.

    Notes
    -----
    Where the chapter leaves something open:

    - At z = max_range only the point mass counts. Read literally, (6.4) puts a density there as well; a sum of a
      probability and a density has no meaning, and it makes the fitted z_max smaller than the share of such readings.
    - p_short has the support [0, z*]. For z* -> 0 it tends to a point mass at 0; its support is never taken shorter
      than a micrometre, so that the model is a finite density for every z*, a pose inside a wall (z* = 0) included.
    - If the ray hits nothing, z* = max_range: p_hit is then the lower half of a normal distribution.
    - With `range_offset` b and `sigma_slope` s, p_hit is N(z; z* + b, sigma_hit^2 + (s z*)^2) cut to [0, max_range].
    - The chapter's sensor has no `min_range`. With one, densities are cut there as well: p_short has the support
      [min_range, z*], with the same shape there, as exponentials have no memory.

    References
    ----------
    Probabilistic Robotics, section 6.3.1, equations (6.4) to (6.12).

    Examples
    --------
    >>> from beamfield.models.beam_parameters import BeamParameters
    >>> parameters = BeamParameters(z_hit=0.7, z_short=0.1, z_max=0.1, z_rand=0.1, sigma_hit=0.1, lambda_short=0.5)
    >>> beam_log_density([3.0, 1.0, 8.0, float("nan")], 3.0, 8.0, parameters).round(3).tolist()
    [1.037, -2.965, -2.303, 0.0]
    """
    return _fill(fill_log_density, ranges, expected_ranges, max_range, parameters, min_range, ())


@checked
def beam_responsibilities(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
    *,
    min_range: float = 0.0,
) -> FloatArray:
    """Return the posterior probability of each cause of each reading.

    P(cause | z) = z_cause p_cause(z) / (6.12), with the weights; (6.27) leaves them out.

    Parameters
    ----------
    ranges, expected_ranges, max_range, parameters, min_range
        As for `beam_log_density`.

    Returns
    -------
    (..., 4) hit, short, max, rand; they sum to 1, or are all 0 where there is no measurement or the range is
    impossible.
    """
    return _fill(fill_responsibilities, ranges, expected_ranges, max_range, parameters, min_range, (4,))


@checked
def beam_components(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
    *,
    min_range: float = 0.0,
) -> FloatArray:
    """Return p_hit, p_short, p_max and p_rand one by one, without their weights: Figure 6.3.

    ``components @ parameters.weights`` is the mixture (6.12), Figure 6.4.

    Parameters
    ----------
    ranges, expected_ranges, max_range, parameters, min_range
        As for `beam_log_density`.

    Returns
    -------
    (..., 4): densities in 1/metre, but p_max, which is a probability: 1 for z >= max_range, where the densities are 0.
    All 0 where there is no measurement.
    """
    return _fill(fill_components, ranges, expected_ranges, max_range, parameters, min_range, (4,))


@checked
def beam_cdf(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
    *,
    min_range: float = 0.0,
) -> FloatArray:
    """Return P(reading <= z | z*): 0 at min_range, continuous below max_range, with a step of height z_max to 1 there.

    Parameters
    ----------
    ranges, expected_ranges, max_range, parameters, min_range
        As for `beam_log_density`.

    Returns
    -------
    Probabilities of the broadcast shape; NaN where there is no measurement.
    """
    return _fill(fill_cdf, ranges, expected_ranges, max_range, parameters, min_range, ())


@checked
def beam_pit(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
    rng: np.random.Generator,
    *,
    min_range: float = 0.0,
) -> FloatArray:
    """Return the randomised probability integral transform: uniform on [0, 1] if the model is right.

    It is `beam_cdf`, but for readings at max_range, which are spread evenly over the step, [1 - z_max, 1].

    Parameters
    ----------
    ranges, expected_ranges, max_range, parameters, min_range
        As for `beam_log_density`.
    rng
        Spreads the readings at max_range.

    Returns
    -------
    Values in [0, 1] of the broadcast shape; NaN where there is no measurement.
    """
    pit = beam_cdf(ranges, expected_ranges, max_range, parameters, min_range=min_range)
    no_return = np.broadcast_to(np.asarray(ranges, dtype=np.float64) >= max_range, pit.shape) & ~np.isnan(pit)
    # np.asarray: a single beam comes as a 0-d array, which a mask indexes as well.
    pit[no_return] = 1.0 - parameters.z_max * rng.random(int(no_return.sum()))
    return pit


def as_view(parameters: BeamParameters, max_range: float, min_range: float = 0.0) -> BeamView:
    """Return the form in which kernels take the parameters and the sensor's limits: ranges counted from min_range."""
    check_limits(max_range, min_range)
    return BeamView(
        parameters.z_hit,
        parameters.z_short,
        parameters.z_max,
        parameters.z_rand,
        parameters.sigma_hit,
        parameters.lambda_short,
        parameters.range_offset,
        parameters.sigma_slope,
        float(max_range) - float(min_range),
        float(min_range),
    )


def as_expected_ranges(expected_ranges: ArrayLike) -> FloatArray:
    """Return expected ranges as float64; raise if one is negative."""
    expected = np.asarray(expected_ranges, dtype=np.float64)
    if expected.size and np.fmin.reduce(expected, axis=None) < 0.0:
        where = np.argwhere(expected < 0.0)[0]
        raise InvalidInputError(
            f"expected_ranges: expected metres >= 0, got {expected[tuple(where)]} at index {tuple(where.tolist())}"
        )
    return expected


def broadcast_beams(ranges: ArrayLike, expected_ranges: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return measured and expected ranges of one shape, or say why that cannot be."""
    measured, expected = np.asarray(ranges, dtype=np.float64), as_expected_ranges(expected_ranges)
    try:
        shape = np.broadcast_shapes(measured.shape, expected.shape)
    except ValueError:
        raise InvalidInputError(
            f"ranges and expected_ranges: expected shapes that broadcast, got {measured.shape} and {expected.shape}"
        ) from None
    return np.broadcast_to(measured, shape), np.broadcast_to(expected, shape)


def read_only(values: FloatArray) -> FloatArray:
    """Return a read-only view: kernels are compiled for these alone, not again for arrays that may be written."""
    view = values.view()
    view.flags.writeable = False
    return view


def _fill(
    fill: Fill, ranges: ArrayLike, expected_ranges: ArrayLike, max_range: float, parameters: BeamParameters,
    min_range: float, per_beam: tuple[int, ...],
) -> FloatArray:  # fmt: skip
    """Run a kernel over all beams; `per_beam` is the shape of its result for one."""
    view = as_view(parameters, max_range, min_range)
    measured, expected = broadcast_beams(ranges, expected_ranges)
    flat_measured = read_only(counted_from(min_range, np.ascontiguousarray(measured).reshape(-1), max_range))
    flat_expected = read_only(expected_from(min_range, np.ascontiguousarray(expected).reshape(-1)))
    out: FloatArray = np.empty((flat_measured.size, *per_beam))
    run_in_blocks(lambda a, b: fill(flat_measured[a:b], flat_expected[a:b], view, out[a:b]), flat_measured.size)
    return out.reshape((*measured.shape, *per_beam))
