"""The intrinsic parameters of the likelihood field model (section 6.4)."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field, fields

import numpy as np

from beamfield.arguments import check_fields, check_magnitude, require
from beamfield.errors import InvalidInputError
from beamfield.models.beam_parameters import EXTENSIONS, WEIGHT_SUM_TOLERANCE, BeamParameters


@dataclass(frozen=True)
class LikelihoodFieldParameters:
    """z_hit, z_rand and sigma_hit of Table 6.3.

    Parameters
    ----------
    z_hit, z_rand
        Weights of a hit and of an unexplained reading (6.34). What is missing to 1 belongs to "no return" and, if the
        parameters come from a beam model, to unexpected objects; this model scores neither.
    sigma_hit
        Standard deviation of the distance between an end point and its obstacle, metres (6.33).

    Raises
    ------
    InvalidInputError
        If a weight is outside [0, 1], both are 0, their sum exceeds 1, or sigma_hit is not from 1e-12 to 1e9.

    References
    ----------
    Probabilistic Robotics, section 6.4.1, Table 6.3.

    Examples
    --------
    >>> beam = BeamParameters(z_hit=0.8, z_short=0.1, z_max=0.05, z_rand=0.05, sigma_hit=0.1, lambda_short=0.5)
    >>> LikelihoodFieldParameters.from_beam_parameters(beam)
    LikelihoodFieldParameters(z_hit=0.8, z_rand=0.05, sigma_hit=0.1)
    """

    z_hit: float
    z_rand: float
    sigma_hit: float

    def __post_init__(self) -> None:
        check_fields(self)
        for item in fields(LikelihoodFieldParameters):
            value = float(getattr(self, item.name))
            require(np.isfinite(value), item.name, "a finite number", value)
            object.__setattr__(self, item.name, value)
        for name in ("z_hit", "z_rand"):
            require(0.0 <= getattr(self, name) <= 1.0, name, "a weight in [0, 1]", getattr(self, name))
        if not 0.0 < self.z_hit + self.z_rand <= 1.0 + WEIGHT_SUM_TOLERANCE:
            raise InvalidInputError(
                f"z_hit + z_rand: expected more than 0 and at most 1, got {self.z_hit + self.z_rand:.9g}"
            )
        check_magnitude("sigma_hit", self.sigma_hit)

    @classmethod
    def from_beam_parameters(
        cls, parameters: BeamParameters, *, drop: Collection[str] = ()
    ) -> LikelihoodFieldParameters:
        """Take over z_hit, z_rand and sigma_hit of a beam model.

        A field has no range_offset, nor a sigma_slope. With an offset, its hits lie beside the mapped walls; with a
        slope, sigma_hit is that of the shortest ranges alone. Learn the field's own parameters instead:
        `beamfield.calibration.field.learning.learn_field_parameters`.

        Parameters
        ----------
        parameters
            The weights are taken as they are: the rest to 1 stays with causes that this model does not score.
        drop
            Which of "range_offset" and "sigma_slope" may be lost.

        Returns
        -------
        Parameters of a likelihood field.

        Raises
        ------
        InvalidInputError
            If z_hit and z_rand are both 0, or the beam model has an offset or a slope that `drop` does not name.
        """
        if unknown := set(drop) - set(EXTENSIONS):
            raise InvalidInputError(f"drop: expected names among {', '.join(EXTENSIONS)}, got {min(unknown)!r}")
        for name in EXTENSIONS:
            value = getattr(parameters, name)
            if value != 0.0 and name not in drop:
                raise InvalidInputError(
                    f"{name}: a likelihood field has no such parameter, expected 0, got {value:g}; learn the field "
                    f"itself, or pass drop=[{name!r}]"
                )
        return cls(parameters.z_hit, parameters.z_rand, parameters.sigma_hit)


@dataclass(frozen=True)
class SavedLikelihoodField(LikelihoodFieldParameters):
    """What a likelihood_field.yaml says: parameters, how much each beam counts, and the sensor they were learned of.

    `LikelihoodFieldModel` takes exponent and n_beams from it where they are not given.

    Parameters
    ----------
    z_hit, z_rand, sigma_hit
        As for `LikelihoodFieldParameters`.
    exponent, n_beams
        How much each beam counts in a filter, and how many of a scan are used.
    single_scan_exponent
        The exponent for one scan on its own; that of a filter if the file does not say.
    max_range, min_range
        The limits of the sensor, metres.
    """

    exponent: float = field(kw_only=True)
    n_beams: int = field(kw_only=True)
    single_scan_exponent: float = field(kw_only=True)
    max_range: float = field(kw_only=True)
    min_range: float = field(kw_only=True)

    @property
    def parameters(self) -> LikelihoodFieldParameters:
        """The parameters alone."""
        return LikelihoodFieldParameters(self.z_hit, self.z_rand, self.sigma_hit)
