"""Parameters of ROS 1's amcl that its measurement models use, with its names and defaults."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

from beamfield.stacks.emulation.parameter_checks import check_choice, check_counts, check_numbers, check_switches
from beamfield.stacks.nav2.parameters import MODEL_TYPES, Nav2Parameters

# Names of nav2's that have the prefix laser_ in ROS 1.
PREFIXED = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short", "max_beams")


@dataclass(frozen=True)
class Ros1Parameters:
    """The node's private parameters about the laser; what they mean is as for `Nav2Parameters`.

    Parameters
    ----------
    laser_model_type, laser_likelihood_max_dist, laser_max_range, laser_min_range
        As in nav2.
    laser_z_hit, laser_z_short, laser_z_max, laser_z_rand, laser_sigma_hit, laser_lambda_short, laser_max_beams
        As nav2's names without the prefix.
    do_beamskip, beam_skip_distance, beam_skip_threshold, beam_skip_error_threshold
        As in nav2.

    Raises
    ------
    InvalidInputError
        As for `Nav2Parameters`.
    """

    laser_model_type: str = "likelihood_field"
    laser_z_hit: float = 0.95
    laser_z_short: float = 0.1
    laser_z_max: float = 0.05
    laser_z_rand: float = 0.05
    laser_sigma_hit: float = field(default=0.2, metadata={"unit": "m"})
    laser_lambda_short: float = field(default=0.1, metadata={"unit": "1/m"})
    laser_likelihood_max_dist: float = field(default=2.0, metadata={"unit": "m"})
    laser_max_range: float = field(default=-1.0, metadata={"unit": "m"})
    laser_min_range: float = field(default=-1.0, metadata={"unit": "m"})
    laser_max_beams: int = 30
    do_beamskip: bool = False
    beam_skip_distance: float = field(default=0.5, metadata={"unit": "m"})
    beam_skip_threshold: float = 0.3
    beam_skip_error_threshold: float = 0.9

    def __post_init__(self) -> None:
        check_choice(self, "laser_model_type", MODEL_TYPES)
        check_numbers(
            self,
            at_least_zero=(
                "laser_z_hit",
                "laser_z_short",
                "laser_z_max",
                "laser_z_rand",
                "laser_lambda_short",
                "beam_skip_distance",
                "beam_skip_threshold",
                "beam_skip_error_threshold",
            ),
            positive=("laser_sigma_hit", "laser_likelihood_max_dist"),
            finite=("laser_max_range", "laser_min_range"),
        )
        check_counts(self, laser_max_beams=2)
        check_switches(self, "do_beamskip")

    def as_nav2(self) -> Nav2Parameters:
        """Return the same values under nav2's names."""
        return Nav2Parameters(**{nav2_name(item.name): getattr(self, item.name) for item in fields(self)})

    @classmethod
    def from_nav2(cls, parameters: Nav2Parameters) -> Ros1Parameters:
        """Return the same values under ROS 1's names."""
        return cls(**{item.name: getattr(parameters, nav2_name(item.name)) for item in fields(cls)})


def nav2_name(name: str) -> str:
    """Return what nav2 calls a parameter of ROS 1's amcl."""
    short = name.removeprefix("laser_")
    return short if short in PREFIXED else name


def ros1_name(name: str) -> str:
    """Return what ROS 1's amcl calls a parameter of nav2's."""
    return f"laser_{name}" if name in PREFIXED else name
