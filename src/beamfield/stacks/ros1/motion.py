"""Motion models of ROS 1's amcl, with its names and defaults."""

from __future__ import annotations

from dataclasses import dataclass

from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.omni_motion import OmniMotion
from beamfield.stacks.emulation.parameter_checks import check_choice, check_numbers
from beamfield.stacks.emulation.stack_motion import StackMotion

MODEL_TYPES = ("diff", "omni", "diff-corrected", "omni-corrected")


@dataclass(frozen=True)
class Ros1Motion(StackMotion):
    """The node's private parameters about the odometry.

    Parameters
    ----------
    odom_model_type
        "diff" and "omni" take variances for standard deviations; "diff-corrected" and "omni-corrected" do not.
    odom_alpha1, odom_alpha2, odom_alpha3, odom_alpha4
        As for `DifferentialMotion` and `OmniMotion`. In "omni" odom_alpha1 is what `OmniMotion` calls alpha4, and the
        other way round; before amcl 1.16.0 (Melodic) in "omni-corrected", too, which is not emulated.
    odom_alpha5
        Of the omni models alone.

    Raises
    ------
    InvalidInputError
        If the model is another, or an alpha is negative or not finite.

    Examples
    --------
    >>> Ros1Motion().formula
    DifferentialMotion(alpha1=0.2, alpha2=0.2, alpha3=0.2, alpha4=0.2, variance_as_deviation=True)
    """

    odom_model_type: str = "diff"
    odom_alpha1: float = 0.2
    odom_alpha2: float = 0.2
    odom_alpha3: float = 0.2
    odom_alpha4: float = 0.2
    odom_alpha5: float = 0.2

    def __post_init__(self) -> None:
        check_choice(self, "odom_model_type", MODEL_TYPES)
        check_numbers(self, at_least_zero=tuple(f"odom_alpha{i}" for i in range(1, 6)))

    @property
    def formula(self) -> DifferentialMotion | OmniMotion:
        """The motion model that amcl runs with these parameters."""
        a1, a2, a3, a4 = self.odom_alpha1, self.odom_alpha2, self.odom_alpha3, self.odom_alpha4
        literal = not self.odom_model_type.endswith("-corrected")
        if self.odom_model_type.startswith("diff"):
            return DifferentialMotion(a1, a2, a3, a4, variance_as_deviation=literal)
        if literal:
            a1, a4 = a4, a1
        return OmniMotion(a1, a2, a3, a4, self.odom_alpha5, variance_as_deviation=literal)
