"""What a fitted trajectory must hold to be trusted."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from beamfield.arguments import check_fields, require


@dataclass(frozen=True)
class TrajectoryOptions:
    """When a pose of a fitted trajectory is trusted.

    Parameters
    ----------
    max_deviation
        Largest standard deviation of the position in any direction, metres.
    max_heading_deviation
        Largest standard deviation of the heading, radians.
    least_agreement
        Smallest share of the readings about a pose (over two metres of the way) that agree with the map, relative to
        that of the whole log.

    Raises
    ------
    InvalidInputError
        If a number is not positive and finite.
    """

    max_deviation: float = 0.1
    max_heading_deviation: float = float(np.radians(4.0))
    least_agreement: float = 0.5

    def __post_init__(self) -> None:
        check_fields(self)
        for item in fields(self):
            require(0.0 < getattr(self, item.name) < np.inf, item.name, "a number > 0", getattr(self, item.name))
