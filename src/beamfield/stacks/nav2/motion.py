"""nav2's motion models, with its names and defaults."""

from __future__ import annotations

from dataclasses import dataclass

from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.omni_motion import OmniMotion
from beamfield.stacks.emulation.parameter_checks import check_choice, check_numbers
from beamfield.stacks.emulation.stack_motion import StackMotion

DIFFERENTIAL, OMNI = "nav2_amcl::DifferentialMotionModel", "nav2_amcl::OmniMotionModel"
# Until Galactic; since Humble no plugin has these names.
OLD_NAMES = {"differential": DIFFERENTIAL, "omnidirectional": OMNI}


@dataclass(frozen=True)
class Nav2Motion(StackMotion):
    """What stands under ``amcl: ros__parameters:`` about the odometry.

    Parameters
    ----------
    robot_model_type
        "nav2_amcl::DifferentialMotionModel" or "nav2_amcl::OmniMotionModel"; before Humble "differential" or
        "omnidirectional".
    alpha1, alpha2, alpha3, alpha4
        As for `DifferentialMotion` and `OmniMotion`.
    alpha5
        Of `OmniMotion` alone.

    Raises
    ------
    InvalidInputError
        If the model is another, or an alpha is negative or not finite.

    Examples
    --------
    >>> Nav2Motion(alpha3=0.02).formula
    DifferentialMotion(alpha1=0.2, alpha2=0.2, alpha3=0.02, alpha4=0.2, variance_as_deviation=False)
    """

    robot_model_type: str = DIFFERENTIAL
    alpha1: float = 0.2
    alpha2: float = 0.2
    alpha3: float = 0.2
    alpha4: float = 0.2
    alpha5: float = 0.2

    def __post_init__(self) -> None:
        check_choice(self, "robot_model_type", (DIFFERENTIAL, OMNI, *OLD_NAMES))
        check_numbers(self, at_least_zero=("alpha1", "alpha2", "alpha3", "alpha4", "alpha5"))

    @property
    def formula(self) -> DifferentialMotion | OmniMotion:
        """The motion model that nav2 runs with these parameters."""
        if OLD_NAMES.get(self.robot_model_type, self.robot_model_type) == DIFFERENTIAL:
            return DifferentialMotion(self.alpha1, self.alpha2, self.alpha3, self.alpha4)
        return OmniMotion(self.alpha1, self.alpha2, self.alpha3, self.alpha4, self.alpha5)
