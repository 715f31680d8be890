"""Parameters of MRPT's occupancy grid that its likelihood models use, with MRPT's names and defaults."""

# ruff: noqa: N815  (the names are MRPT's)
from __future__ import annotations

from dataclasses import dataclass, field

from beamfield.errors import InvalidInputError
from beamfield.stacks.emulation.parameter_checks import check_counts, check_numbers, check_switches

# MRPT's numbers for its models.
LF_THRUN, RAY_TRACING = 4, 1


@dataclass(frozen=True)
class MrptFieldParameters:
    """What stands in a section ``[..._likelihoodOpts]`` about the model LF_Thrun.

    The factors need not sum to 1. The Gaussian has no constant, so that LF_zHit is the height of its peak.

    Parameters
    ----------
    likelihoodMethod
        MRPT's number of the model, 4.
    LF_stdHit
        Width of a hit, metres.
    LF_zHit, LF_zRandom
        Factors of hits and of random readings.
    LF_maxRange
        LF_zRandom is divided by this, metres. It drops no reading.
    LF_decimation
        Every so many-th point of the scan is looked at, or all of fewer than 10.
    LF_maxCorrsDistance
        Distances to obstacles are cut off here, metres.
    LF_useSquareDist
        The exponent takes the fourth power of the distance instead of its square.
    LF_alternateAverageMethod
        The weight is the mean over beams instead of their product.
    enableLikelihoodCache
        MRPT keeps values by cell; changes nothing in them.

    Raises
    ------
    InvalidInputError
        If a number is not finite, a factor or the distance is negative, LF_stdHit or LF_maxRange is not positive,
        LF_decimation < 1, or likelihoodMethod is another model's.
    """

    likelihoodMethod: int = LF_THRUN
    LF_stdHit: float = field(default=0.35, metadata={"unit": "m"})
    LF_zHit: float = 0.95
    LF_zRandom: float = 0.05
    LF_maxRange: float = field(default=81.0, metadata={"unit": "m"})
    LF_decimation: int = 5
    LF_maxCorrsDistance: float = field(default=0.3, metadata={"unit": "m"})
    LF_useSquareDist: bool = False
    LF_alternateAverageMethod: bool = False
    enableLikelihoodCache: bool = True

    def __post_init__(self) -> None:
        _check_method(self.likelihoodMethod, LF_THRUN)
        check_numbers(
            self, at_least_zero=("LF_zHit", "LF_zRandom", "LF_maxCorrsDistance"), positive=("LF_stdHit", "LF_maxRange")
        )
        check_counts(self, LF_decimation=1)
        check_switches(self, "LF_useSquareDist", "LF_alternateAverageMethod", "enableLikelihoodCache")


@dataclass(frozen=True)
class MrptRayParameters:
    """What stands in a section ``[..._likelihoodOpts]`` about the model rayTracing.

    Parameters
    ----------
    likelihoodMethod
        MRPT's number of the model, 1.
    rayTracing_stdHit
        Width of a hit, metres.
    rayTracing_decimation
        Every so many-th beam is looked at.
    rayTracing_useDistanceFilter
        Whether differences of ranges are cut off at 2 m.

    Raises
    ------
    InvalidInputError
        If rayTracing_stdHit is not a positive number, rayTracing_decimation < 1, or likelihoodMethod is another
        model's.
    """

    likelihoodMethod: int = RAY_TRACING
    rayTracing_stdHit: float = field(default=1.0, metadata={"unit": "m"})
    rayTracing_decimation: int = 10
    rayTracing_useDistanceFilter: bool = True

    def __post_init__(self) -> None:
        _check_method(self.likelihoodMethod, RAY_TRACING)
        check_numbers(self, positive=("rayTracing_stdHit",))
        check_counts(self, rayTracing_decimation=1)
        check_switches(self, "rayTracing_useDistanceFilter")


def _check_method(given: int, own: int) -> None:
    if isinstance(given, bool) or given != own:
        raise InvalidInputError(f"likelihoodMethod: expected {own}, the number of this model, got {given!r}")
