"""Partial pooling: parameters per fleet, site and robot that borrow from one another what the data lack."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from beamfield.fleet.learning import FleetFit, SensorLimits
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class Pooled:
    """Pooled parameters of the fleet, a site or a robot.

    Parameters
    ----------
    site, robot
        Whose; None for those of all.
    parameters
        Posterior means in the transformed parameters, as a beam model.
    intervals
        (low, high) that hold the truth with 95 %, by the names of `BeamParameters` that were learned.
    shrinkage
        By the same names, for robots: 0 where the robot's own estimate stands, 1 where it is that of its site. Empty
        for sites and the fleet.
    """

    site: str | None
    robot: str | None
    parameters: BeamParameters
    intervals: Mapping[str, tuple[float, float]]
    shrinkage: Mapping[str, float]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Hierarchy:
    """Partial pooling of robots with sensors of equal limits.

    Parameters
    ----------
    limits
        Limits of the sensors.
    fleet, sites, robots
        Pooled parameters.
    spread_of_robots, spread_of_sites
        Standard deviation between the robots of a site, and between sites, of the transformed parameters: log odds of
        a weight against z_hit, log of sigma_hit and of lambda_short. By the names of `BeamParameters`.
    """

    limits: SensorLimits
    fleet: Pooled
    sites: tuple[Pooled, ...]
    robots: tuple[Pooled, ...]
    spread_of_robots: Mapping[str, float]
    spread_of_sites: Mapping[str, float]

    __repr__ = short_repr


def pool(fit: FleetFit) -> tuple[Hierarchy, ...]:
    """Pool what `learn(by="robot")` found; one hierarchy per sensor limits."""
    raise NotImplementedError
