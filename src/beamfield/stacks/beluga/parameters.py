"""Parameters of Beluga's AMCL that its measurement models use, with the names and defaults of its ROS node."""

from __future__ import annotations

from dataclasses import dataclass, field

from beamfield.stacks.amcl.parameters import MODEL_TYPES, LaserParameters
from beamfield.stacks.emulation.parameter_checks import check_choice, check_counts, check_numbers, check_switches


@dataclass(frozen=True)
class BelugaParameters(LaserParameters):
    """What stands under ``amcl: ros__parameters:`` about the laser.

    The names are nav2's, the meaning is not: densities have their constants here. Weights need not sum to 1, and by
    default do not.

    Parameters
    ----------
    laser_model_type
        "likelihood_field", "likelihood_field_prob" or "beam".
    z_hit, z_short, z_max, z_rand
        Weights of the four densities; z_short and z_max only in the beam model.
    sigma_hit
        Standard deviation of a hit, metres.
    lambda_short
        Rate of unexpected objects, 1/metre.
    laser_likelihood_max_dist
        Distances to obstacles are cut off here, metres (fields only).
    laser_max_range
        Longest range in metres, by which z_rand is divided whatever the sensor's own limit. Readings beyond this or
        that limit are dropped.
    laser_min_range
        Readings below this, metres, or below the sensor's own limit, are dropped.
    max_beams
        How many beams of a scan are looked at, before any is dropped.
    model_unknown_space
        Whether an end point in an unknown cell is worth 1 / laser_max_range; otherwise unknown cells are as free ones.
        likelihood_field only.
    only_obstacle_boundaries
        Whether only occupied cells beside a free cell count as obstacles; other occupied cells are then as unknown
        ones. likelihood_field only.

    Raises
    ------
    InvalidInputError
        If a number is not finite, a weight or rate is negative, sigma_hit, the maximum distance or the longest range is
        not positive, max_beams < 1, or the model is unknown.
    """

    laser_min_range: float = field(default=0.0, metadata={"unit": "m"})
    model_unknown_space: bool = False
    only_obstacle_boundaries: bool = True

    def __post_init__(self) -> None:
        check_choice(self, "laser_model_type", MODEL_TYPES)
        check_numbers(
            self,
            at_least_zero=("z_hit", "z_short", "z_max", "z_rand", "lambda_short"),
            positive=("sigma_hit", "laser_likelihood_max_dist", "laser_max_range"),
            finite=("laser_min_range",),
        )
        check_counts(self, max_beams=1)
        check_switches(self, "model_unknown_space", "only_obstacle_boundaries")
