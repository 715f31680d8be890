"""ROS 1's amcl: its three measurement models, emulated.

nav2's are ported from it. The formulas are the same; names and defaults of the parameters are not.
"""

from __future__ import annotations

from typing import ClassVar

from beamfield.stacks.amcl.beam import AmclBeam
from beamfield.stacks.amcl.field import AmclField
from beamfield.stacks.amcl.field_prob import AmclFieldProb
from beamfield.stacks.amcl.parameters import ROS_1_NAMES
from beamfield.stacks.ros1.parameters import Ros1Parameters


def _own(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(ROS_1_NAMES.get(name, name) for name in names)


class Ros1Field(AmclField[Ros1Parameters]):
    """ROS 1 amcl's likelihood_field; see `AmclField`."""

    stack: ClassVar[str] = "ros1"
    evidence_settings: ClassVar[tuple[str, ...]] = _own(AmclField.evidence_settings)
    fitted_parameters: ClassVar[tuple[str, ...]] = _own(AmclField.fitted_parameters)


class Ros1FieldProb(AmclFieldProb[Ros1Parameters]):
    """ROS 1 amcl's likelihood_field_prob; see `AmclFieldProb`."""

    stack: ClassVar[str] = "ros1"
    evidence_settings: ClassVar[tuple[str, ...]] = _own(AmclFieldProb.evidence_settings)
    fitted_parameters: ClassVar[tuple[str, ...]] = _own(AmclFieldProb.fitted_parameters)


class Ros1Beam(AmclBeam[Ros1Parameters]):
    """ROS 1 amcl's beam model; see `AmclBeam`. One NaN among the beams makes every pose's weight NaN, here -inf."""

    stack: ClassVar[str] = "ros1"
    evidence_settings: ClassVar[tuple[str, ...]] = _own(AmclBeam.evidence_settings)
    fitted_parameters: ClassVar[tuple[str, ...]] = _own(AmclBeam.fitted_parameters)
    tests_nan: ClassVar[bool] = False
    beyond_is_missing: ClassVar[bool] = True
