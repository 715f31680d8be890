"""ROS 1's amcl: its three measurement models, emulated.

nav2's are ported from it. The formulas are the same; names and defaults of the parameters are not.
"""

from __future__ import annotations

from typing import ClassVar

from beamfield.stacks.amcl.beam import AmclBeam
from beamfield.stacks.amcl.field import AmclField
from beamfield.stacks.amcl.field_prob import AmclFieldProb
from beamfield.stacks.ros1.parameters import Ros1Parameters

__all__ = ["Ros1Beam", "Ros1Field", "Ros1FieldProb"]

SETTINGS = ("laser_max_beams", "laser_max_range", "laser_min_range")
FIELD = ("laser_z_hit", "laser_z_rand", "laser_sigma_hit")
BEAM = ("laser_z_hit", "laser_z_short", "laser_z_max", "laser_z_rand", "laser_sigma_hit", "laser_lambda_short")


class Ros1Field(AmclField[Ros1Parameters]):
    """ROS 1 amcl's likelihood_field; see `AmclField`."""

    stack: ClassVar[str] = "ros1"
    evidence_settings: ClassVar[tuple[str, ...]] = SETTINGS
    fitted_parameters: ClassVar[tuple[str, ...]] = FIELD


class Ros1FieldProb(AmclFieldProb[Ros1Parameters]):
    """ROS 1 amcl's likelihood_field_prob; see `AmclFieldProb`."""

    stack: ClassVar[str] = "ros1"
    evidence_settings: ClassVar[tuple[str, ...]] = SETTINGS
    fitted_parameters: ClassVar[tuple[str, ...]] = FIELD


class Ros1Beam(AmclBeam[Ros1Parameters]):
    """ROS 1 amcl's beam model; see `AmclBeam`. One NaN among the beams makes every pose's weight NaN, here -inf."""

    stack: ClassVar[str] = "ros1"
    evidence_settings: ClassVar[tuple[str, ...]] = SETTINGS
    fitted_parameters: ClassVar[tuple[str, ...]] = BEAM
    tests_nan: ClassVar[bool] = False
