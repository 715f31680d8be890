"""Which robots differ from the others, with a bound on false discoveries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from beamfield.fleet.learning import FleetFit


@dataclass(frozen=True)
class Difference:
    """A parameter of a robot against those of the others.

    Parameters
    ----------
    robot, site
        Whose.
    parameter
        Name of `BeamParameters`.
    value, usual
        The robot's, and the median of the others.
    low, high
        95 % interval of the robot's own value.
    p_value, q_value
        Chance of such a difference in a robot like the others; the same, adjusted for all comparisons.
    differs
        Whether the q-value is at most the rate of false discoveries that was asked for.
    """

    robot: str
    site: str
    parameter: str
    value: float
    usual: float
    low: float
    high: float
    p_value: float
    q_value: float
    differs: bool


def compare_robots(
    fit: FleetFit, *, within: Literal["fleet", "site"] = "fleet", false_discoveries: float = 0.05
) -> tuple[Difference, ...]:
    """Compare each robot's parameters with those of the others; the least likely first."""
    raise NotImplementedError
