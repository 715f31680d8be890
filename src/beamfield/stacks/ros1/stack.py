"""ROS 1's amcl."""

from __future__ import annotations

from functools import partial

from beamfield.stacks.amcl.learned_motion import differential_alphas, omni_alphas
from beamfield.stacks.amcl.parameters import ROS_1_NAMES
from beamfield.stacks.amcl.stack import amcl_stack
from beamfield.stacks.ros1.filter import Ros1FilterParameters, ros1_filter
from beamfield.stacks.ros1.learned_motion import DIFF, OMNI, corrected, literal
from beamfield.stacks.ros1.models import Ros1Beam, Ros1Field, Ros1FieldProb
from beamfield.stacks.ros1.motion import MODEL_TYPES, Ros1Motion
from beamfield.stacks.ros1.parameters import Ros1Parameters
from beamfield.stacks.stack import SURE, StackFilter
from beamfield.stacks.syntax.parameter_text import ParameterSection

PACKAGE = "amcl"
SIGNS = frozenset(ROS_1_NAMES.values())


def _likeness(section: ParameterSection) -> float:
    if section.package == PACKAGE:
        return SURE
    if section.is_ros_2:
        return 0.0
    # Names that both ROS versions have are ROS 1's, unless nav2's own weights are among them.
    return section.count(SIGNS) or (0.6 if section.syntax == "launch" else 0.25)


ROS1 = amcl_stack(
    "ros1",
    "ROS 1 amcl",
    (Ros1Field, Ros1FieldProb, Ros1Beam),
    Ros1Parameters,
    ROS_1_NAMES,
    likeness=_likeness,
    signs=SIGNS,
    packages=(PACKAGE,),
    layout=("amcl:",),
    in_launch_files=True,
    unknown_model="amcl runs likelihood_field instead; it only logs a warning",
    is_roscpp=True,
    wrong_type="amcl uses its default without a message",
    filter=StackFilter(motion=Ros1Motion, parameters=Ros1FilterParameters, build=ros1_filter),
    flatter="fewer beams or a wider laser_sigma_hit",
    motion_key="odom_model_type",
    motions={
        "diff": partial(literal, DIFF, 4),
        "omni": partial(literal, OMNI, 5),
        "diff-corrected": partial(corrected, differential_alphas),
        "omni-corrected": partial(corrected, omni_alphas),
    },
    # Who runs "omni" keeps it: noise of its kind is tried instead.
    omni_motion={kind: "omni-corrected" for kind in MODEL_TYPES if kind != "omni"},
)
