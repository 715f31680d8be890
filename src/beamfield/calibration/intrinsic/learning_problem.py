"""What is learned and what is held: the free parameters, their bounds, the priors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import require
from beamfield.calibration.intrinsic.likelihood import N_PARAMETERS, OFFSET, RATE, SLOPE, VARIANCE
from beamfield.calibration.intrinsic.priors import IntrinsicPriors
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import WEIGHTS, BeamParameters
from beamfield.models.blind_zone import check_limits

# The likelihood grows without bound where all hits are exact; sigma_hit stops at this share of the maximum range, far
# below what a range finder resolves (0.8 mm at 80 m).
SIGMA_FLOOR_SHARE = 1e-5
# Shorts nearer to the sensor than this share of the maximum range cannot be told from 0.
SHORTEST_MEAN_SHARE = 1e-4
# A map's surface is not further from its cells than this many metres, nor than this share of the maximum range; keeps
# hits and shorts from trading names.
LARGEST_OFFSET = 1.0
LARGEST_OFFSET_SHARE = 0.1
LARGEST_SIGMA_SLOPE = 1.0

_POSITIONS = {
    "z_hit": 0,
    "z_short": 1,
    "z_max": 2,
    "z_rand": 3,
    "sigma_hit": VARIANCE,
    "sigma_slope": SLOPE,
    "range_offset": OFFSET,
    "lambda_short": RATE,
}


@dataclass(frozen=True)
class LearningProblem:
    """Free parameters, bounds and priors, in the order of the working vector, (8,) each.

    `held` has the values of the entries that are not learned, NaN elsewhere. The sensor's limits are in metres.
    """

    max_range: float
    min_range: float
    free: NDArray[np.bool_]
    held: FloatArray
    lower: FloatArray
    upper: FloatArray
    priors: IntrinsicPriors

    @property
    def span(self) -> float:
        """From the nearest range that is measured to the farthest, metres."""
        return self.max_range - self.min_range

    @staticmethod
    def position(name: str) -> int:
        """Return where a parameter of `BeamParameters` stands in the working vector; its name must be one of them."""
        return _POSITIONS[name]

    def apply(self, theta: FloatArray) -> FloatArray:
        """Make a working vector (8,) of any numbers valid.

        Held values are in place, the rest inside the bounds, the free weights share what held ones leave of 1.
        """
        new = np.clip(np.where(self.free, theta, self.held), self.lower, self.upper)
        free = self.free[:4]
        rest = max(1.0 - new[:4][~free].sum(), 0.0)
        if free.any():
            total = new[:4][free].sum()
            share = new[:4] / total if total > 0.0 else 1.0 / free.sum()
            new[:4] = np.where(free, rest * share, new[:4])
        return new


def learning_problem(
    max_range: float,
    *,
    min_range: float = 0.0,
    hold: Mapping[str, float] | None = None,
    priors: IntrinsicPriors | None = None,
    fit_offset: bool = False,
    fit_sigma_slope: bool = False,
) -> LearningProblem:
    """Check what is to be held, by the names of `BeamParameters`, and lay out the problem.

    range_offset and sigma_slope are held, at 0 if `hold` has no other value, where they are not to be fitted.
    InvalidInputError if the limits are not 0 <= min_range < max_range, a held name is unknown, a held value is
    impossible or held weights leave nothing to share.
    """
    check_limits(max_range, min_range)
    max_range, min_range = float(max_range), float(min_range)  # others would be other types to the compiler
    hold = dict(hold or {})
    for name, value in hold.items():
        if name not in _POSITIONS:
            raise InvalidInputError(f"hold: expected names among {', '.join(_POSITIONS)}, got {name!r}")
        require(np.isfinite(value), f"hold {name}", "a finite number", value)
    if not fit_offset:
        hold.setdefault("range_offset", 0.0)
    if not fit_sigma_slope:
        hold.setdefault("sigma_slope", 0.0)
    _check_held_values(hold)
    free_theta, held_theta = np.ones(N_PARAMETERS, dtype=bool), np.full(N_PARAMETERS, np.nan)
    for name, value in hold.items():
        free_theta[_POSITIONS[name]], held_theta[_POSITIONS[name]] = False, value
    held_theta[[VARIANCE, SLOPE]] **= 2
    lower = np.zeros(N_PARAMETERS)
    lower[VARIANCE] = (SIGMA_FLOOR_SHARE * max_range) ** 2
    largest_offset = min(LARGEST_OFFSET, LARGEST_OFFSET_SHARE * max_range)
    lower[OFFSET] = -largest_offset
    upper = np.ones(N_PARAMETERS)
    # A hit wider than the sensor's range cannot be told from a uniform density.
    upper[VARIANCE] = max_range**2
    upper[SLOPE] = LARGEST_SIGMA_SLOPE**2
    upper[OFFSET] = largest_offset
    upper[RATE] = 1.0 / (SHORTEST_MEAN_SHARE * max_range)
    # Held values are the caller's business, also outside these bounds.
    lower = np.where(free_theta, lower, held_theta)
    upper = np.where(free_theta, upper, held_theta)
    return LearningProblem(max_range, min_range, free_theta, held_theta, lower, upper, priors or IntrinsicPriors())


def _check_held_values(hold: Mapping[str, float]) -> None:
    weights = [name for name in WEIGHTS if name in hold]
    total = sum(hold[name] for name in weights)
    if total > 1.0 + 1e-9 or (len(weights) == 4 and abs(total - 1.0) > 1e-6):
        names = ", ".join(weights)
        raise InvalidInputError(f"hold: {names} sum to {total:.9g}, expected at most 1, and 1 if all four are held")
    neutral = {field.name: 0.0 for field in fields(BeamParameters)} | {"z_rand": 1.0, "sigma_hit": 1.0}
    for name, value in hold.items():
        trial = {**neutral, name: value}
        if name in weights:
            other = "z_hit" if name != "z_hit" else "z_rand"
            trial = {**neutral, "z_rand": 0.0, name: value, other: 1.0 - value}
        try:
            BeamParameters(**trial)
        except InvalidInputError as error:
            raise InvalidInputError(f"hold {name}: {error}") from error
