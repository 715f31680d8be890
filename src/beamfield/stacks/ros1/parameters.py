"""Parameters of ROS 1's amcl that its measurement models use, with its names and defaults."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields

from beamfield.stacks.amcl.parameters import ROS_1_NAMES, AmclParameters, check_amcl


@dataclass(frozen=True)
class Ros1Parameters:
    """The node's private parameters about the laser; what they mean is as for `AmclParameters`.

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
        As for `AmclParameters`.
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
        check_amcl(self, ROS_1_NAMES)

    @classmethod
    def from_amcl(cls, parameters: AmclParameters) -> Ros1Parameters:
        """Return the same values under ROS 1's names."""
        return cls(**{ROS_1_NAMES.get(name, name): value for name, value in asdict(parameters).items()})

    def as_amcl(self) -> AmclParameters:
        """Return the same values under nav2's names."""
        names = (item.name for item in fields(AmclParameters))
        return AmclParameters(**{name: getattr(self, ROS_1_NAMES.get(name, name)) for name in names})
