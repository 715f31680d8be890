"""What a reading says about cells: the inverse sensor model of occupancy mapping."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_fields, require
from beamfield.errors import InvalidInputError


@dataclass(frozen=True)
class InverseSensorModel:
    """What one reading says about the cells on its way: p(occupied | z, x) of a cell, by three cases.

    - The cell in which a reading ends has probability `hit`.
    - The cells that its beam crosses before have probability `passed`.
    - Cells beyond the reading, and cells off the beam, learn nothing: a map made so never sees through walls.

    A reading without return says that nothing was within max_range, or that a surface did not reflect; it marks cells
    as passed up to `clear_without_return` and no cell as hit.

    Parameters
    ----------
    hit
        In (0.5, 1).
    passed
        In (0, 0.5).
    lowest, highest
        Bounds on the probability of a cell, 0 < lowest <= passed and hit <= highest < 1, so that a map can still
        change after many scans.
    clear_without_return
        Metres that a reading without return marks as passed; 0: none at all.
    longest_hit
        Readings longer than this, metres, mark cells as passed up to there and no cell as hit; None: no limit. Far
        readings are sparse and their end points suffer from small errors of the heading.

    Raises
    ------
    InvalidInputError
        If a value is outside its range.

    References
    ----------
    Probabilistic Robotics, section 6.5, which takes maps from scans for given.

    Examples
    --------
    >>> np.round(log_odds_steps(InverseSensorModel(hit=0.8, passed=0.4)).astype(float), 2).tolist()
    [1.39, -0.41, -3.48, 3.48]
    """

    hit: float = 0.7
    passed: float = 0.4
    lowest: float = 0.03
    highest: float = 0.97
    clear_without_return: float = field(default=0.0, kw_only=True)
    longest_hit: float | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_fields(self)
        require(0.5 < self.hit < 1.0, "hit", "a probability in (0.5, 1)", self.hit)
        require(0.0 < self.passed < 0.5, "passed", "a probability in (0, 0.5)", self.passed)
        if not (0.0 < self.lowest <= self.passed and self.hit <= self.highest < 1.0):
            raise InvalidInputError(
                "bounds: expected 0 < lowest <= passed and hit <= highest < 1, "
                f"got lowest {self.lowest} and highest {self.highest}"
            )
        clear = self.clear_without_return
        require(0.0 <= clear < np.inf, "clear_without_return", "0 or a finite number of metres", clear)
        if self.longest_hit is not None and not 0.0 < self.longest_hit < np.inf:
            raise InvalidInputError(f"longest_hit: expected metres > 0 or None, got {self.longest_hit}")


# For maps of a few scans, whose cells are seen once or twice: full confidence at the first reading.
CONFIDENT = InverseSensorModel(hit=0.97, passed=0.03)


def log_odds_steps(model: InverseSensorModel) -> NDArray[np.float32]:
    """Return what a hit and a pass add to the log-odds, and the lowest and highest log-odds: (4,)."""
    p = np.array([model.hit, model.passed, model.lowest, model.highest])
    return np.log(p / (1.0 - p)).astype(np.float32)
