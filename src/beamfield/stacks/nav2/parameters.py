"""Parameters of nav2's AMCL that its measurement models use, with its names and defaults."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

from beamfield.stacks.emulation.parameter_checks import check_choice, check_counts, check_numbers, check_switches

MODEL_TYPES = ("likelihood_field", "likelihood_field_prob", "beam")


class AmclParameters(Protocol):
    """Parameters of nav2's AMCL or of the program that it was ported from, under that program's names."""

    def as_nav2(self) -> Nav2Parameters:
        """Return the same values under nav2's names."""
        ...


@dataclass(frozen=True)
class Nav2Parameters:
    """What stands under ``amcl: ros__parameters:`` about the laser.

    The weights need not sum to 1, and by default do not: nav2 does not ask for it, and only ratios matter.

    Parameters
    ----------
    laser_model_type
        "likelihood_field", "likelihood_field_prob" or "beam".
    z_hit, z_short, z_max, z_rand
        Factors of the four terms; z_short and z_max only in the beam model. They are not weights of densities: the
        Gaussian has no constant, so that z_hit is the height of its peak.
    sigma_hit
        Width of a hit, metres.
    lambda_short
        Rate of unexpected objects, 1/metre.
    laser_likelihood_max_dist
        Distances to obstacles are cut off here, metres (fields only).
    laser_max_range
        Longest range in metres that counts; the sensor's own limit holds if that is less, or this is not positive.
    laser_min_range
        Ranges up to here, metres, are taken as the longest range; the sensor's own limit holds if that is more, or
        this is not positive.
    max_beams
        How many beams of a scan are looked at, about.
    do_beamskip
        Whether likelihood_field_prob leaves out beams that most particles disagree with.
    beam_skip_distance
        A beam agrees with the map at a particle if it ends closer than this to an obstacle, metres.
    beam_skip_threshold
        A beam counts if more than this share of the particles agree.
    beam_skip_error_threshold
        If this share of the beams or more would be left out, all count.

    Raises
    ------
    InvalidInputError
        If a number is not finite, a factor, rate or distance is negative, sigma_hit or the maximum distance is 0,
        max_beams < 2, or the model is unknown.
    """

    laser_model_type: str = "likelihood_field"
    z_hit: float = 0.5
    z_short: float = 0.05
    z_max: float = 0.05
    z_rand: float = 0.5
    sigma_hit: float = field(default=0.2, metadata={"unit": "m"})
    lambda_short: float = field(default=0.1, metadata={"unit": "1/m"})
    laser_likelihood_max_dist: float = field(default=2.0, metadata={"unit": "m"})
    laser_max_range: float = field(default=100.0, metadata={"unit": "m"})
    laser_min_range: float = field(default=-1.0, metadata={"unit": "m"})
    max_beams: int = 60
    do_beamskip: bool = False
    beam_skip_distance: float = field(default=0.5, metadata={"unit": "m"})
    beam_skip_threshold: float = 0.3
    beam_skip_error_threshold: float = 0.9

    def __post_init__(self) -> None:
        check_choice(self, "laser_model_type", MODEL_TYPES)
        check_numbers(
            self,
            at_least_zero=(
                "z_hit",
                "z_short",
                "z_max",
                "z_rand",
                "lambda_short",
                "beam_skip_distance",
                "beam_skip_threshold",
                "beam_skip_error_threshold",
            ),
            positive=("sigma_hit", "laser_likelihood_max_dist"),
            finite=("laser_max_range", "laser_min_range"),
        )
        check_counts(self, max_beams=2)
        check_switches(self, "do_beamskip")

    def as_nav2(self) -> Nav2Parameters:
        """Return the parameters: they have nav2's names."""
        return self
