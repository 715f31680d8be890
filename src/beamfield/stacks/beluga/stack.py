"""Beluga's AMCL."""

from __future__ import annotations

import math
from typing import Any

from beamfield.models.beam_parameters import BeamParameters
from beamfield.stacks.amcl.chapter import amcl_fit_space, beam_notes, plain_from_chapter
from beamfield.stacks.amcl.learned_motion import differential_alphas, omni_alphas
from beamfield.stacks.amcl.parameters import DECLARED, ROS_1_DEFAULTS, ROS_1_NAMES
from beamfield.stacks.beluga.filter import BelugaFilterParameters, beluga_filter
from beamfield.stacks.beluga.models import BelugaBeam, BelugaField, BelugaFieldProb
from beamfield.stacks.beluga.motion import DIFFERENTIAL, NAV2_NAMES, OMNI, STATIONARY, BelugaMotion
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.stack import (
    FIELD_CUBES,
    FIELD_PRODUCT,
    RAY_CUBES,
    SURE,
    Model,
    OtherNode,
    Stack,
    StackFilter,
    models,
)
from beamfield.stacks.syntax.parameter_text import ParameterSection

PACKAGE = "beluga_amcl"
SIGNS = frozenset(
    ("model_unknown_space", "only_obstacle_boundaries", "execution_policy", "spatial_resolution_x",
     "spatial_resolution_y", "spatial_resolution_theta", "selective_resampling", "point_cloud_topic")
)  # fmt: skip
# Its node for ROS 1: the laser's names and defaults are amcl's, those of motion and particles its own mixture.
OTHER_NODE = OtherNode(
    names={
        **ROS_1_NAMES, "pf_err": "kld_err", "pf_z": "kld_z", "robot_model_type": "odom_model_type",
        **{f"alpha{i}": f"odom_alpha{i}" for i in range(1, 6)},
    },
    defaults={
        **ROS_1_DEFAULTS, "min_particles": 100, "max_particles": 5000, "pf_err": 0.01, "resample_interval": 2,
        "update_min_d": 0.2, "update_min_a": math.pi / 6.0,
    },
)  # fmt: skip
# Of its node for ROS 2; nav2's files have -1.0 for laser_min_range.
LIMITS = {
    **dict.fromkeys(("z_hit", "z_short", "z_max", "z_rand", "recovery_alpha_slow", "recovery_alpha_fast", "pf_err"),
                    (0.0, 1.0)),
    "laser_min_range": (0.0, math.inf), "update_min_a": (0.0, math.tau), "max_beams": (2.0, math.inf),
}  # fmt: skip
_FIELD = "p = z_hit N(d; 0, sigma_hit²) + z_rand / laser_max_range, d from a beam's end to the nearest obstacle"


def _likeness(section: ParameterSection) -> float:
    if section.package == PACKAGE:
        return SURE
    motion = section.entries.get("robot_model_type") or section.entries.get("odom_model_type")
    own = section.count(SIGNS) + (motion is not None and motion.value in (DIFFERENTIAL, OMNI, STATIONARY))
    if section.is_ros_2:
        return own or 0.5
    if own:  # its node for ROS 1 has amcl's names, and some of its own
        return own + section.count(ROS_1_NAMES.values())
    return 0.5 if section.syntax == "yaml" and section.count(ROS_1_NAMES) else 0.0


def _from_chapter(learned: BeamParameters, typical_range: float, cell: float) -> dict[str, float]:  # noqa: ARG001
    return plain_from_chapter(learned)  # its densities are the chapter's


def _described(emulator: type[StackModel[Any, Any]], **facts: Any) -> Model:
    return Model(
        emulator=emulator, parameters=BelugaParameters, in_file=(emulator.model,), hit_is_density=True,
        fit_space=amcl_fit_space, **facts,
    )  # fmt: skip


_MOTIONS = {DIFFERENTIAL: differential_alphas, OMNI: omni_alphas}

BELUGA = Stack(
    name="beluga",
    title="Beluga",
    models=models(
        _described(
            BelugaField, weight=FIELD_CUBES, adds_one=True, unknown_attracts="model_unknown_space",
            only_surfaces="only_obstacle_boundaries",
            formula=f"1 + Σ p³ over beams; {_FIELD}",
            off_values={"model_unknown_space": False, "only_obstacle_boundaries": False},
            left_out={
                "model_unknown_space": "model_unknown_space is left out: only Beluga has it",
                "only_obstacle_boundaries": "only_obstacle_boundaries is left out: elsewhere the inner cells of thick "
                "walls are obstacles too",
            },
        ),
        _described(BelugaFieldProb, weight=FIELD_PRODUCT, adds_one=True, formula=f"Π p over beams; {_FIELD}"),
        _described(
            BelugaBeam, weight=RAY_CUBES, unknown_cells="stop", from_chapter=_from_chapter, chapter_notes=beam_notes,
            formula="Σ p³ over beams; p is the chapter's mixture with z_max for a density",
            notes=(
                "nav2 and ROS 1 add 1 to the sum of cubes, Beluga does not: its weights differ more between poses",
                ("Beluga normalises z_short by 1 - exp(-lambda_short z*), nav2 and ROS 1 do not: the same only far "
                 "from walls"),
                "Beluga casts rays from the robot's centre, the others from the sensor",
            ),
            z_max_needs=(
                "z_max counts only readings of laser_max_range that the sensor's own limit lets pass; +inf is dropped",
                "have the driver report range_max where nothing comes back, and set laser_max_range to it",
            ),
        ),
    ),
    likeness=_likeness,
    signs=SIGNS,
    nodes=("amcl",),
    packages=(PACKAGE,),
    layout=("amcl:", "  ros__parameters:"),
    model_key="laser_model_type",
    unknown_model="Beluga stops with an error: the robot does not localise",
    declares=DECLARED,
    limits=LIMITS,
    is_typed=True,
    too_few_beams="without beams no pose can be weighed",
    other_node=OTHER_NODE,
    wants_extremes=True,
    beams_taken="max_beams evenly",
    off_map="1 / laser_max_range",
    filter=StackFilter(motion=BelugaMotion, parameters=BelugaFilterParameters, build=beluga_filter),
    motion_key="robot_model_type",
    motions={**_MOTIONS, **{name: _MOTIONS[own] for name, own in NAV2_NAMES.items()}},
    omni_motion=dict.fromkeys(_MOTIONS, OMNI) | dict.fromkeys(NAV2_NAMES, [*NAV2_NAMES][-1]),
)  # fmt: skip
