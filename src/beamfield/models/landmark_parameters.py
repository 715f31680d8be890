"""The noise of a landmark sensor (6.40)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import LARGEST, check_fields, check_magnitude, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.short_repr import short_repr

# Rows of a confusion matrix may miss the sum 1 by this much: they are read from files with a few digits.
ROW_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class LandmarkParameters:
    """sigma_r, sigma_phi and sigma_s of (6.40), biases, and how often a feature belongs to no landmark.

    What is measured is ``range_scale * range + range_bias`` and ``bearing + bearing_bias``, plus noise.

    Parameters
    ----------
    sigma_range, sigma_bearing
        Standard deviations, metres and radians; None for what the sensor never measures, and such a value is refused.
    sigma_signature
        Standard deviation of a signature that is a number.
    signature_covariance
        (d, d) covariance of a signature that is a vector.
    confusion
        (t, t) P(type seen = column | type of the landmark = row); rows sum to 1.
    spurious_rate
        Probability that a feature of unknown id belongs to no landmark of the map (c = N + 1), in [0, 1).
    max_range
        Features of no landmark have ranges uniform on [0, max_range], metres; needed where there are any
        and the sensor measures ranges.
    range_bias, bearing_bias
        Mean of what is measured minus what is true. Beyond the chapter, where they are 0.
    range_scale
        How much a measured range grows when the true one grows by a metre. Beyond the chapter, where it is 1.

    Raises
    ------
    InvalidInputError
        If a standard deviation, the scale or max_range is not from 1e-12 to 1e9, spurious_rate is not in [0, 1), it
        is positive without a max_range for a sensor that measures ranges, the covariance is not symmetric and positive
        definite, a row of the confusion matrix does not sum to 1 or has an entry outside [0, 1], or a bias is not
        finite.

    References
    ----------
    Probabilistic Robotics, section 6.6.2, (6.40); 6.6.3 for c = N + 1.

    Examples
    --------
    >>> noise = LandmarkParameters(sigma_range=0.1, sigma_bearing=0.02, spurious_rate=0.05, max_range=10.0)
    >>> noise.range_bias
    0.0
    """

    sigma_range: float | None
    sigma_bearing: float | None
    sigma_signature: float | None = None
    signature_covariance: FloatArray | None = None
    confusion: FloatArray | None = None
    spurious_rate: float = 0.0
    max_range: float | None = None
    range_bias: float = 0.0
    bearing_bias: float = 0.0
    range_scale: float = 1.0

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            sigma_range: float | None,
            sigma_bearing: float | None,
            sigma_signature: float | None = None,
            signature_covariance: ArrayLike | None = None,
            confusion: ArrayLike | None = None,
            spurious_rate: float = 0.0,
            max_range: float | None = None,
            range_bias: float = 0.0,
            bearing_bias: float = 0.0,
            range_scale: float = 1.0,
        ) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("sigma_range", "sigma_bearing", "sigma_signature", "max_range"):
            if getattr(self, name) is not None:
                check_magnitude(name, getattr(self, name))
        check_magnitude("range_scale", self.range_scale)
        for name in ("range_bias", "bearing_bias"):
            require(abs(getattr(self, name)) <= LARGEST, name, f"at most {LARGEST:g}", getattr(self, name))
        require(0.0 <= self.spurious_rate < 1.0, "spurious_rate", "a probability in [0, 1)", self.spurious_rate)
        if self.spurious_rate > 0.0 and self.max_range is None and self.sigma_range is not None:
            raise InvalidInputError("max_range: expected a limit where spurious_rate > 0, got None")
        if self.signature_covariance is not None:
            keep(self, signature_covariance=_checked_covariance(self.signature_covariance))
        if self.confusion is not None:
            keep(self, confusion=_checked_confusion(self.confusion))


def _checked_covariance(values: Any) -> FloatArray:
    covariance = _square(values, "signature_covariance")
    if not np.allclose(covariance, covariance.T, rtol=1e-9, atol=0.0):
        raise InvalidInputError(f"signature_covariance: expected a symmetric matrix, got {covariance.tolist()}")
    # Judged on correlations: components may have any units.
    scale = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if not (scale > 0.0).all():
        raise InvalidInputError(
            f"signature_covariance: expected positive variances, got {np.diag(covariance).tolist()}"
        )
    least = float(np.linalg.eigvalsh(covariance / np.outer(scale, scale))[0])
    if least < 1e-12:
        raise InvalidInputError(
            "signature_covariance: expected a positive definite matrix, "
            f"got {covariance.tolist()}, whose correlations have the eigenvalue {least:.3g}"
        )
    return covariance


def _checked_confusion(values: Any) -> FloatArray:
    confusion = _square(values, "confusion")
    if (confusion < 0.0).any() or (confusion > 1.0).any():
        wrong = confusion[(confusion < 0.0) | (confusion > 1.0)][0]
        raise InvalidInputError(f"confusion: expected probabilities in [0, 1], got {wrong}")
    sums = confusion.sum(axis=1)
    if (np.abs(sums - 1.0) > ROW_SUM_TOLERANCE).any():
        row = int(np.abs(sums - 1.0).argmax())
        raise InvalidInputError(f"confusion: expected rows that sum to 1, got {sums[row]:.9g} in row {row}")
    return confusion


def _square(values: Any, name: str) -> FloatArray:
    matrix = np.array(values, dtype=np.float64)
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1] or not matrix.size:
        raise InvalidInputError(f"{name}: expected a square matrix, got shape {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise InvalidInputError(f"{name}: expected finite numbers, got {matrix[~np.isfinite(matrix)][0]}")
    return matrix
