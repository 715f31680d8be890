"""Motion models of Beluga's AMCL, with its names and defaults."""

from __future__ import annotations

from dataclasses import dataclass

from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.gaussian_motion import StationaryMotion
from beamfield.models.omni_motion import OmniMotion
from beamfield.stacks.emulation.parameter_checks import check_choice, check_numbers
from beamfield.stacks.emulation.stack_motion import StackMotion

DIFFERENTIAL, OMNI, STATIONARY = "differential_drive", "omnidirectional_drive", "stationary"
# Beluga takes nav2's names for its own.
NAV2_NAMES = {"nav2_amcl::DifferentialMotionModel": DIFFERENTIAL, "nav2_amcl::OmniMotionModel": OMNI}
# Beluga's threshold for turning in place, metres, and the noise of its stationary model, metres and radians.
SHORTEST_TRANSLATION, STATIONARY_NOISE = 0.01, 0.02


@dataclass(frozen=True)
class BelugaMotion(StackMotion):
    """What stands under ``amcl: ros__parameters:`` about the odometry.

    Parameters
    ----------
    robot_model_type
        "differential_drive", "omnidirectional_drive", "stationary", or one of nav2's names.
    alpha1, alpha2, alpha3, alpha4
        As for `DifferentialMotion` and `OmniMotion`.
    alpha5
        Of the omnidirectional model alone.

    Raises
    ------
    InvalidInputError
        If the model is another, or an alpha is negative or not finite.

    Examples
    --------
    >>> BelugaMotion("stationary").formula
    StationaryMotion(position=0.02, heading=0.02)
    """

    robot_model_type: str = DIFFERENTIAL
    alpha1: float = 0.2
    alpha2: float = 0.2
    alpha3: float = 0.2
    alpha4: float = 0.2
    alpha5: float = 0.2

    def __post_init__(self) -> None:
        check_choice(self, "robot_model_type", (DIFFERENTIAL, OMNI, STATIONARY, *NAV2_NAMES))
        check_numbers(self, at_least_zero=("alpha1", "alpha2", "alpha3", "alpha4", "alpha5"))

    @property
    def formula(self) -> DifferentialMotion | OmniMotion | StationaryMotion:
        """The motion model that Beluga runs with these parameters."""
        kind = NAV2_NAMES.get(self.robot_model_type, self.robot_model_type)
        if kind == STATIONARY:
            return StationaryMotion(STATIONARY_NOISE, STATIONARY_NOISE)
        if kind == DIFFERENTIAL:
            return DifferentialMotion(self.alpha1, self.alpha2, self.alpha3, self.alpha4)
        return OmniMotion(
            self.alpha1, self.alpha2, self.alpha3, self.alpha4, self.alpha5,
            shortest_translation=SHORTEST_TRANSLATION, turns_from_line=True,
        )  # fmt: skip
