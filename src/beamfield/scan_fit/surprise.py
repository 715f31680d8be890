"""How surprising each beam is, compared with what the model expects of it: the raw material of `scan_fit`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.kernels.beam import SHORTEST_SUPPORT
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters

# A beam counts for at most this much, nats: one impossible reading says as much as a merely wrong one.
MOST_SURPRISE = 2.0
# A reading is through the wall, or short of it, from so many sigma on.
HIT_SIGMAS = 3.0
# Expected ranges for which expectations are tabulated; between them they are interpolated.
N_NODES = 400
GAUSS = np.polynomial.legendre.leggauss(8)


@dataclass(frozen=True, eq=False)
class BeamSurprise:
    """Per beam, how far its reading is from what the model expects; all 0 where `used` is not set.

    Parameters
    ----------
    used
        (..., k) beams that carry a measurement and whose expected range is known.
    excess
        (..., k) surprise -log p(z | z*), minus its expectation under the model for that z*, cut to +-2 nats (and the
        expectation of the cut value subtracted, so that its mean is 0 if the model is right).
    through
        (..., k) 1 where the reading is beyond the mapped obstacle (or missing), else 0, minus the model's probability
        of that.
    short
        (..., k) the same for readings before the obstacle.
    """

    used: NDArray[np.bool_]
    excess: FloatArray
    through: FloatArray
    short: FloatArray


def beam_surprise(
    ranges: FloatArray, expected_ranges: FloatArray, max_range: float, parameters: BeamParameters,
    *, min_range: float = 0.0,
) -> BeamSurprise:  # fmt: skip
    """Compare readings (..., k) with what the beam model expects of them; 0 where a beam is left out.

    The surprise of a beam, -log p(z | z*), depends on the scene even if all is well: far walls are noisier, and a ray
    into the open has its "no return". Its expectation (the entropy of the model for that z*) is therefore subtracted.

    "No return" is max_range; NaN in a reading or an expected range leaves the beam out. Readings nearer than min_range
    are dropped: expectations are those of the others.

    Where a ray hits nothing (z* = max_range) nothing can be hit: there z_hit is added to z_max, and a reading is short
    if it returned at all. The model as written (Probabilistic Robotics, section 6.3.1, (6.12)) expects such readings
    just below max_range, which no sensor does.
    """
    used = np.isfinite(ranges) & np.isfinite(expected_ranges)
    z, z_star = np.where(used, ranges, 0.0), np.clip(np.where(used, expected_ranges, 0.0), min_range, max_range)
    table = _expectations(parameters, float(max_range), float(min_range))
    # With -inf (an impossible reading) the cut takes over.
    surprise = -_log_density(z, z_star, max_range, parameters, min_range)
    excess = np.clip(surprise - table.at("surprise", z_star), -MOST_SURPRISE, MOST_SURPRISE)
    through, short = _sides(z, z_star, max_range, parameters)
    return BeamSurprise(
        np.asarray(used),
        np.where(used, excess - table.at("excess", z_star), 0.0),
        np.where(used, through - table.at("through", z_star), 0.0),
        np.where(used, short - table.at("short", z_star), 0.0),
    )


def beam_side(
    ranges: FloatArray, expected_ranges: FloatArray, max_range: float, parameters: BeamParameters
) -> NDArray[np.int8]:
    """Return how each reading (..., k) disagrees: 0 hit, 1 short, 2 through the wall, 3 no return; -1 if it is none.

    A missing return where the ray hits nothing counts as a hit: it agrees.
    """
    used = np.isfinite(ranges) & np.isfinite(expected_ranges)
    z, z_star = np.where(used, ranges, 0.0), np.minimum(np.where(used, expected_ranges, 0.0), max_range)
    through, short = _sides(z, z_star, max_range, parameters)
    side = np.where(through, np.where(z >= max_range, 3, 2), np.where(short, 1, 0))
    return np.asarray(np.where(used, side, -1), dtype=np.int8)


def _log_density(
    z: FloatArray, z_star: FloatArray, max_range: float, parameters: BeamParameters, min_range: float
) -> FloatArray:
    """Return log p(z | z*), with the mass of hits at "no return" where there is nothing to hit."""
    result = beam_log_density(z, z_star, max_range, parameters, min_range=min_range)
    nothing = z_star >= max_range
    if nothing.any():
        without_hits = replace(parameters, z_hit=0.0, z_max=parameters.z_max + parameters.z_hit)
        result[nothing] = beam_log_density(z[nothing], z_star[nothing], max_range, without_hits, min_range=min_range)
    return result


def _sides(
    z: FloatArray, z_star: FloatArray, max_range: float, parameters: BeamParameters
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which readings lie beyond, and which before the hit's band."""
    sigma = np.hypot(parameters.sigma_hit, parameters.sigma_slope * z_star)
    mean = z_star + parameters.range_offset
    nothing = z_star >= max_range
    through = ~nothing & ((z > mean + HIT_SIGMAS * sigma) | (z >= max_range))
    short = np.where(nothing, z < max_range, z < np.minimum(mean - HIT_SIGMAS * sigma, max_range))
    return through, short


@dataclass(frozen=True, eq=False)
class _Expectations:
    """Expectations under the model on a grid of z*; the last node is "hits nothing" and stands alone."""

    nodes: FloatArray
    values: dict[str, FloatArray]

    def at(self, name: str, z_star: FloatArray) -> FloatArray:
        values = self.values[name]
        inside = np.interp(z_star, self.nodes[:-1], values[:-1])
        return np.asarray(np.where(z_star >= self.nodes[-1], values[-1], inside))


@lru_cache(maxsize=16)
def _expectations(parameters: BeamParameters, max_range: float, min_range: float) -> _Expectations:
    """Tabulate E[surprise], E[cut excess], P(through) and P(short) by quadrature, once per model."""
    nodes = _nodes(parameters, max_range, min_range)
    z, weight = _quadrature(nodes, parameters, max_range, min_range)
    z_star = np.broadcast_to(nodes[:, None], z.shape)
    log_p = _log_density(z, np.ascontiguousarray(z_star), max_range, parameters, min_range)
    # The last column is the point mass at max_range, whose weight is 1.
    share = weight * np.exp(log_p)
    share /= share.sum(axis=1, keepdims=True)
    surprise = np.where(share > 0.0, -log_p, 0.0)
    mean = (share * surprise).sum(axis=1)
    excess = np.clip(surprise - mean[:, None], -MOST_SURPRISE, MOST_SURPRISE)
    through, short = _sides(z, z_star, max_range, parameters)
    each: dict[str, NDArray[Any]] = {"excess": excess, "through": through, "short": short}
    return _Expectations(nodes, {"surprise": mean} | {name: (share * v).sum(axis=1) for name, v in each.items()})


def _nodes(parameters: BeamParameters, max_range: float, min_range: float) -> FloatArray:
    """Return expected ranges, denser within some sigma of both limits, where the densities are cut off."""
    near = np.hypot(parameters.sigma_hit, parameters.sigma_slope * max_range) * np.linspace(0.0, 8.0, 65)
    offset = abs(parameters.range_offset)
    last = np.nextafter(max_range, 0.0)
    low = min_range + near
    inner = np.concatenate([low, low + offset, last - near, last - near - offset, np.linspace(0.0, last, N_NODES)])
    return np.concatenate([np.unique(np.clip(inner, min_range, last)), [max_range]])


def _quadrature(
    nodes: FloatArray, parameters: BeamParameters, max_range: float, min_range: float
) -> tuple[FloatArray, FloatArray]:
    """Return readings and weights (n, q) of a composite Gauss rule whose pieces follow the hit's peak and the decay."""
    sigma = np.hypot(parameters.sigma_hit, parameters.sigma_slope * nodes)[:, None]
    mean = nodes[:, None] + parameters.range_offset
    around = mean + sigma * np.array([-8.0, -6.0, -5.0, -4.0, -3.0, -2.5, -2, -1.5, -1, -0.5, 0, 0.5, 1, 1.5, 2, 2.5,
                                      3.0, 4.0, 5.0, 6.0, 8.0])  # fmt: skip
    even = np.broadcast_to(np.linspace(min_range, max_range, 17), (len(nodes), 17))
    wall = np.maximum(nodes[:, None], min_range + SHORTEST_SUPPORT)
    decay = min_range + np.array([1.0, 3.0, 6.0, 12.0, 24.0]) / max(parameters.lambda_short, 1.0 / max_range)
    decay = np.broadcast_to(decay, (len(nodes), len(decay)))
    edges = np.sort(np.clip(np.hstack([even, around, wall, decay]), min_range, max_range), axis=1)
    half = 0.5 * np.diff(edges, axis=1)[..., None]
    z = (0.5 * (edges[:, 1:] + edges[:, :-1])[..., None] + half * GAUSS[0]).reshape(len(nodes), -1)
    weight = (half * GAUSS[1]).reshape(len(nodes), -1)
    last = np.full((len(nodes), 1), max_range)
    return np.hstack([np.minimum(z, np.nextafter(max_range, 0.0)), last]), np.hstack([weight, np.ones_like(last)])
