"""Learn the beam model's parameters of a fleet, of its sites or of its robots, from a catalogue of beams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from beamfield.calibration.intrinsic.block_intervals import IntervalResult
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr

By = Literal["fleet", "site", "robot"]


@dataclass(frozen=True, order=True)
class SensorLimits:
    """What sensors must share to be learned together.

    Parameters
    ----------
    max_range, min_range
        Limits of the sensor, metres.
    """

    max_range: float
    min_range: float


@dataclass(frozen=True, eq=False)
class GroupFit:
    """What was learned from the beams of one group: the fleet, a site or a robot, with sensors of equal limits.

    Parameters
    ----------
    site, robot
        Whose beams; None for those of all.
    limits
        Limits of the sensors.
    parameters
        The maximum-likelihood parameters.
    first
        The first answer, from a thinned sample.
    intervals
        95 % intervals and standard errors by blocks of time.
    covariance
        Of the working vector (z_hit, z_short, z_max, z_rand, sigma_hit^2, sigma_slope^2, range_offset, lambda_short),
        by blocks of time, shape (8, 8).
    log_likelihood
        At the parameters, nats per beam.
    n_beams, n_shards
        What was learned from.
    passes
        How often all beams were read.
    converged
        Whether one more step promises less than the tolerance.
    """

    site: str | None
    robot: str | None
    limits: SensorLimits
    parameters: BeamParameters
    first: BeamParameters
    intervals: IntervalResult
    covariance: FloatArray
    log_likelihood: float
    n_beams: int
    n_shards: int
    passes: int
    converged: bool

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class FleetFit:
    """What `learn` found.

    Parameters
    ----------
    by
        "fleet", "site" or "robot": one fit for each, and for each pair of sensor limits within.
    fits
        Sorted by site, robot and limits.
    left_out
        (site, robot, reason) of groups with too few beams.
    """

    by: By
    fits: tuple[GroupFit, ...]
    left_out: tuple[tuple[str | None, str | None, str], ...] = ()

    __repr__ = short_repr


def learn(catalogue: Any, engine: Any, *, by: By = "fleet", thin: int = 1) -> FleetFit:
    """Learn parameters from the beams that are not held out."""
    raise NotImplementedError
