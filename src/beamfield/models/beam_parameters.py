"""The intrinsic parameters of the beam model (6.3.2)."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from beamfield.arguments import LARGEST, check_fields, check_magnitude, require

# The weights of the four causes, and what is beyond the chapter.
WEIGHTS = ("z_hit", "z_short", "z_max", "z_rand")
EXTENSIONS = ("range_offset", "sigma_slope")
# Weights may miss the sum 1 by this much: they are read from files with a few digits.
WEIGHT_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True)
class BeamParameters:
    """Theta of section 6.3.2: the weights of the four causes and the shapes of two of them.

    Parameters
    ----------
    z_hit, z_short, z_max, z_rand
        Weights of a hit, an unexpected object, a missing return and an unexplained reading; they sum to 1 (6.12).
    sigma_hit
        Standard deviation of a hit, metres (6.5).
    lambda_short
        Rate of unexpected objects, 1/metre (6.7); 0 makes p_short uniform on [0, z*].
    range_offset
        Mean of a hit minus the expected range, metres: a map's wall surface need not be the cell's edge. Beyond the
        chapter, where it is 0.
    sigma_slope
        Growth of the noise with the expected range: a hit's variance is sigma_hit^2 + (sigma_slope z*)^2. Beyond the
        chapter (but seen in its Figure 6.6), where it is 0.

    Raises
    ------
    InvalidInputError
        If a weight is outside [0, 1], the weights do not sum to 1 within 1e-6, lambda_short or sigma_slope is
        negative, a value is not finite, or one is too small or too large for its density to be computed: sigma_hit
        below 1e-12, or any beyond 1e9.

    References
    ----------
    Probabilistic Robotics, section 6.3.2.

    Examples
    --------
    >>> BeamParameters(z_hit=0.8, z_short=0.1, z_max=0.05, z_rand=0.05, sigma_hit=0.1, lambda_short=0.5).weights
    (0.8, 0.1, 0.05, 0.05)
    """

    z_hit: float
    z_short: float
    z_max: float
    z_rand: float
    sigma_hit: float
    lambda_short: float
    range_offset: float = 0.0
    sigma_slope: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        for item in fields(BeamParameters):
            value = float(getattr(self, item.name))
            require(np.isfinite(value), item.name, "a finite number", value)
            object.__setattr__(self, item.name, value)
        for name in WEIGHTS:
            require(0.0 <= getattr(self, name) <= 1.0, name, "a weight in [0, 1]", getattr(self, name))
        total = self.z_hit + self.z_short + self.z_max + self.z_rand
        require(abs(total - 1.0) <= WEIGHT_SUM_TOLERANCE, "z_hit + z_short + z_max + z_rand", "1", round(total, 9))
        check_magnitude("sigma_hit", self.sigma_hit)
        for name in ("lambda_short", "sigma_slope"):
            require(0.0 <= getattr(self, name) <= LARGEST, name, f"a number from 0 to {LARGEST:g}", getattr(self, name))
        require(abs(self.range_offset) <= LARGEST, "range_offset", f"at most {LARGEST:g} m", self.range_offset)

    @property
    def weights(self) -> tuple[float, float, float, float]:
        """(z_hit, z_short, z_max, z_rand)."""
        return self.z_hit, self.z_short, self.z_max, self.z_rand


@dataclass(frozen=True)
class SavedBeamModel(BeamParameters):
    """What a beam_model.yaml says: parameters, how much each beam counts, and the sensor they were learned of.

    `BeamModel` and `SonarModel` take exponent and n_beams from it where they are not given.

    Parameters
    ----------
    z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short, range_offset, sigma_slope
        As for `BeamParameters`.
    exponent, n_beams
        How much each beam counts in a filter, and how many of a scan are used; 1 and None (all) if the file does not
        say.
    single_scan_exponent
        The exponent for one scan on its own; that of a filter if the file does not say.
    max_range, min_range
        The limits of the sensor, metres.
    """

    exponent: float = field(default=1.0, kw_only=True)
    n_beams: int | None = field(default=None, kw_only=True)
    single_scan_exponent: float = field(default=1.0, kw_only=True)
    max_range: float = field(kw_only=True)
    min_range: float = field(default=0.0, kw_only=True)

    @property
    def parameters(self) -> BeamParameters:
        """The parameters alone."""
        return BeamParameters(*(getattr(self, item.name) for item in fields(BeamParameters)))
