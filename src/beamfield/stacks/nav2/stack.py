"""nav2's AMCL."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from beamfield.finding import Finding
from beamfield.stacks.amcl.filter import amcl_filter
from beamfield.stacks.amcl.learned_motion import differential_alphas, omni_alphas
from beamfield.stacks.amcl.parameters import DECLARED, ROS_1_NAMES
from beamfield.stacks.amcl.stack import amcl_stack
from beamfield.stacks.filters.amcl_filter import AmclFilterParameters
from beamfield.stacks.nav2.models import Nav2Beam, Nav2Field, Nav2FieldProb
from beamfield.stacks.nav2.motion import DIFFERENTIAL, OLD_NAMES, OMNI, Nav2Motion
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.stack import SURE, StackFilter
from beamfield.stacks.syntax.parameter_text import ParameterSection

PACKAGE = "nav2_amcl"


_MOTIONS = {DIFFERENTIAL: differential_alphas, OMNI: omni_alphas}


def _likeness(section: ParameterSection) -> float:
    if section.package == PACKAGE:
        return SURE
    # Beluga has the same names, and may be as sure.
    return 0.5 if section.syntax == "yaml" and (section.is_ros_2 or section.count(ROS_1_NAMES)) else 0.0


def uninitialised_queue(subject: Any) -> Iterator[Finding]:
    """Report that nav2's distances depend on its build."""
    if subject.model.weight.of_field:
        yield subject.finding(
            "distance-queue-uninitialised", "info",
            "nav2 since April 2025 (commit def640f3d) never sets the distance by which it sorts obstacles in its queue",
            "the queue's order depends on what is in memory: distances may be right or metres too long, and vary "
            "between builds and starts; here they are computed as intended",
            "nothing in this file: use a release that sets occ_dist of obstacle cells to 0 in map_cspace.cpp, or "
            "build one",
        )  # fmt: skip


def old_motion_name(subject: Any) -> Iterator[Finding]:
    """Find a motion model by a name that nav2 no longer knows."""
    entry = subject.file.section.entries.get("robot_model_type")
    if entry is not None and entry.value in OLD_NAMES:
        yield subject.finding(
            "old-motion-name", "warning", f"robot_model_type is {entry.value!r}, as before Humble",
            "since Humble it is the name of a plugin, and there is none of this name: the node does not start",
            f'write "{OLD_NAMES[entry.value]}", unless the robot runs Galactic or older', own="robot_model_type",
        )  # fmt: skip


NAV2 = amcl_stack(
    "nav2",
    "nav2",
    (Nav2Field, Nav2FieldProb, Nav2Beam),
    Nav2Parameters,
    {},
    likeness=_likeness,
    signs=frozenset(
        ("laser_model_type", *ROS_1_NAMES, "laser_likelihood_max_dist", "laser_max_range", "laser_min_range",
         "do_beamskip", "beam_skip_distance")
    ),
    packages=(PACKAGE,),
    layout=("amcl:", "  ros__parameters:"),
    unknown_model="nav2 runs likelihood_field instead, without a message",
    declares={
        **DECLARED, "save_pose_rate": 0.5, "always_reset_initial_pose": False, "first_map_only": False,
        "initial_pose.z": 0.0, "map_topic": "map",
    },
    is_typed=True,
    filter=StackFilter(motion=Nav2Motion, parameters=AmclFilterParameters, build=amcl_filter),
    motion_key="robot_model_type",
    motions=_MOTIONS | {old: _MOTIONS[new] for old, new in OLD_NAMES.items()},
    omni_motion=dict.fromkeys(_MOTIONS, OMNI) | dict.fromkeys(OLD_NAMES, [*OLD_NAMES][-1]),
    checks=(uninitialised_queue, old_motion_name),
)  # fmt: skip
