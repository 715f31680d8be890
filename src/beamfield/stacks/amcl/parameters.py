"""Parameters of AMCL that its measurement models use: what nav2 and ROS 1 share, under nav2's names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from beamfield.stacks.emulation.parameter_checks import check_choice, check_counts, check_numbers, check_switches
from beamfield.stacks.syntax.parameter_text import Value

MODEL_TYPES = ("likelihood_field", "likelihood_field_prob", "beam")
# What ROS 1's amcl calls parameters of nav2's, where it differs; so does Beluga's node for ROS 1.
ROS_1_NAMES: Mapping[str, str] = {
    name: f"laser_{name}" for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short", "max_beams")
}
# What both have for defaults.
ROS_1_DEFAULTS: Mapping[str, float] = {
    "z_hit": 0.95, "z_short": 0.1, "z_max": 0.05, "z_rand": 0.05, "sigma_hit": 0.2, "lambda_short": 0.1,
    "max_beams": 30,
}  # fmt: skip

# What nav2's amcl and Beluga's declare as well, by the same names and of the same types.
DECLARED: Mapping[str, Value] = {
    "transform_tolerance": 1.0, "tf_broadcast": True, "set_initial_pose": False, "initial_pose.x": 0.0,
    "initial_pose.y": 0.0, "initial_pose.yaw": 0.0, "global_frame_id": "map", "odom_frame_id": "odom",
    "base_frame_id": "base_footprint", "scan_topic": "scan",
}  # fmt: skip


class AsAmcl(Protocol):
    """Parameters of a program that runs AMCL's models, under that program's names."""

    def as_amcl(self) -> AmclParameters:
        """Return the same values under nav2's names."""
        ...


@dataclass(frozen=True)
class LaserParameters:
    """What nav2's amcl and Beluga's have by the same names, with the same defaults but for the shortest range."""

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


@dataclass(frozen=True)
class AmclParameters(LaserParameters):
    """What amcl's files say about the laser, with nav2's names and defaults.

    The weights need not sum to 1, and by default do not: amcl does not ask for it, and only ratios matter.

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

    do_beamskip: bool = False
    beam_skip_distance: float = field(default=0.5, metadata={"unit": "m"})
    beam_skip_threshold: float = 0.3
    beam_skip_error_threshold: float = 0.9

    def __post_init__(self) -> None:
        check_amcl(self, {})

    def as_amcl(self) -> AmclParameters:
        """Return the parameters: they have nav2's names."""
        return self


def check_amcl(parameters: Any, names: Mapping[str, str]) -> None:
    """Refuse values that AMCL cannot compute with; `names` says what it calls nav2's parameters, where that differs."""

    def own(*of_nav2: str) -> tuple[str, ...]:
        return tuple(names.get(name, name) for name in of_nav2)

    check_choice(parameters, "laser_model_type", MODEL_TYPES)
    check_numbers(
        parameters,
        at_least_zero=own("z_hit", "z_short", "z_max", "z_rand", "lambda_short", "beam_skip_distance",
                          "beam_skip_threshold", "beam_skip_error_threshold"),
        positive=own("sigma_hit", "laser_likelihood_max_dist"),
        finite=("laser_max_range", "laser_min_range"),
    )  # fmt: skip
    check_counts(parameters, **dict.fromkeys(own("max_beams"), 2))
    check_switches(parameters, "do_beamskip")
