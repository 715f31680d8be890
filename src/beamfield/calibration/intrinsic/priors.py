"""Optional priors for learning: knowledge from other sensors of the same make, or a guard for small data sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from beamfield.arguments import check_fields, require
from beamfield.calibration.intrinsic.likelihood import N_PARAMETERS, RATE, VARIANCE
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import WEIGHTS


@dataclass(frozen=True)
class IntrinsicPriors:
    """Priors that turn maximum likelihood into maximum a posteriori; each default says nothing.

    Parameters
    ----------
    weight_counts
        Imagined beams per cause, by name (``"z_short": 2.0``): a Dirichlet prior with concentration 1 + count.
    sigma_hit, sigma_beams
        An imagined sample of `sigma_beams` hits whose root mean square error is `sigma_hit` metres: an inverse gamma
        prior on sigma_hit^2 with its mode there.
    mean_short, short_beams
        An imagined sample of `short_beams` shorts with mean range `mean_short` metres in free space: a gamma prior on
        lambda_short with its mode at 1 / mean_short.

    Raises
    ------
    InvalidInputError
        If a name is unknown, a count negative, or a length not positive.

    Examples
    --------
    As if 20 readings had been seen before whose unexpected objects were 2 m away on average:

    >>> IntrinsicPriors({"z_short": 20.0}, mean_short=2.0, short_beams=20.0).counts.tolist()
    [0.0, 20.0, 0.0, 0.0]
    """

    weight_counts: Mapping[str, float] = field(default_factory=dict)
    sigma_hit: float = 0.1
    sigma_beams: float = 0.0
    mean_short: float = 1.0
    short_beams: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        unknown = sorted(set(self.weight_counts) - set(WEIGHTS))
        if unknown:
            raise InvalidInputError(f"weight_counts: expected names among {', '.join(WEIGHTS)}, got {unknown[0]!r}")
        counts = {**self.weight_counts, "sigma_beams": self.sigma_beams, "short_beams": self.short_beams}
        for name, count in counts.items():
            require(0.0 <= count < np.inf, name, "a number of beams >= 0", count)
        for name in ("sigma_hit", "mean_short"):
            length = getattr(self, name)
            require(0.0 < length < np.inf, name, "a positive number of metres", length)

    @property
    def counts(self) -> FloatArray:
        """Imagined beams per cause: hit, short, max, rand."""
        return np.array([float(self.weight_counts.get(name, 0.0)) for name in WEIGHTS])

    def log_density(self, theta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the log prior up to a constant, nats, with its gradient (8,) and Hessian (8, 8) at theta (8,)."""
        value = 0.0
        gradient, hessian = np.zeros(N_PARAMETERS), np.zeros((N_PARAMETERS, N_PARAMETERS))
        for i, count in enumerate(self.counts):
            if count > 0.0:
                w = max(theta[i], 1e-300)
                value += count * np.log(w)
                gradient[i] = count / w
                hessian[i, i] = -count / max(w, 1e-150) ** 2
        if self.sigma_beams > 0.0:
            half, v, v0 = 0.5 * self.sigma_beams, theta[VARIANCE], self.sigma_hit**2
            value += half * (-np.log(v) - v0 / v)
            gradient[VARIANCE] = half * (-1.0 / v + v0 / v**2)
            hessian[VARIANCE, VARIANCE] = half * (1.0 / v**2 - 2.0 * v0 / v**3)
        if self.short_beams > 0.0:
            rate = max(theta[RATE], 1e-300)
            value += self.short_beams * (np.log(rate) - rate * self.mean_short)
            gradient[RATE] = self.short_beams * (1.0 / rate - self.mean_short)
            hessian[RATE, RATE] = -self.short_beams / max(rate, 1e-150) ** 2
        return float(value), gradient, hessian
