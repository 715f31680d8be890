"""Parameters of the sensor model of MIT's racecar and F1TENTH (particle_filter), with its names and defaults."""

from __future__ import annotations

from dataclasses import dataclass, field

from beamfield.stacks.emulation.parameter_checks import check_choice, check_counts, check_numbers

# How range_libc casts rays: Bresenham's line, ray marching (also on a GPU), compressed directional distance transform
# (also pruned), giant table.
RANGE_METHODS = ("bl", "rm", "rmgpu", "cddt", "pcddt", "glt")


@dataclass(frozen=True)
class F1tenthParameters:
    """What the launch or YAML file of the particle filter says about the laser.

    The factors need not sum to 1: the table's columns are divided by their sums.

    Parameters
    ----------
    z_short, z_max, z_rand, z_hit
        Factors of the four terms.
    sigma_hit
        Standard deviation of a hit, in cells of the map (pixels).
    squash_factor
        The weight of a scan is taken to the power of 1 / squash_factor.
    max_range
        Longest range, metres, whatever the sensor's: longer ones are taken for it.
    angle_step
        Every n-th beam is looked at.
    theta_discretization
        Number of directions of the compressed distance transform and of the giant table.
    range_method
        How rays are cast: "bl", "rm", "rmgpu", "cddt", "pcddt" or "glt".

    Raises
    ------
    InvalidInputError
        If a number is not finite, a factor is negative, sigma_hit, squash_factor or max_range is not positive, a count
        is below 1, or the method is unknown.
    """

    z_short: float = 0.01
    z_max: float = 0.07
    z_rand: float = 0.12
    z_hit: float = 0.75
    sigma_hit: float = field(default=8.0, metadata={"unit": "cells"})
    squash_factor: float = 2.2
    max_range: float = field(default=10.0, metadata={"unit": "m"})
    angle_step: int = 18
    theta_discretization: int = 112
    range_method: str = "cddt"

    def __post_init__(self) -> None:
        check_choice(self, "range_method", RANGE_METHODS)
        check_numbers(
            self,
            at_least_zero=("z_short", "z_max", "z_rand", "z_hit"),
            positive=("sigma_hit", "squash_factor", "max_range"),
        )
        check_counts(self, angle_step=1, theta_discretization=1)
