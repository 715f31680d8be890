"""What a calibration may be told: which scans, which parameters, how much time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from beamfield.arguments import check_fields, require
from beamfield.calibration.beam_table import UnknownRule
from beamfield.calibration.selection import SelectionOptions

Choice = Literal["auto", "on", "off"]


@dataclass(frozen=True)
class CalibrationOptions:
    """Everything that changes the result besides the data.

    Parameters
    ----------
    selection
        Which scans are used.
    unknown
        What rays do in unknown cells, see `build_beam_table`.
    block_s
        Length of the time blocks that are held out or fitted whole, seconds; None chooses 20 s or less.
    range_offset
        Whether hits may be centred beside the expected range: "auto" keeps it if held-out likelihood asks for it.
    sigma_slope
        Whether sigma may grow with the expected range: likewise.
    hold
        Parameters held at given values.
    refine
        Whether to refine reference poses to see their share in sigma_hit.
    seed
        For the randomised PIT.
    """

    selection: SelectionOptions = field(default_factory=SelectionOptions)
    unknown: UnknownRule = "skip"
    block_s: float | None = None
    range_offset: Choice = "auto"
    sigma_slope: Choice = "auto"
    hold: Mapping[str, float] = field(default_factory=dict)
    refine: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        check_fields(self)
        for name, allowed in (
            ("unknown", ("skip", "free", "occupied")),
            ("range_offset", ("auto", "on", "off")),
            ("sigma_slope", ("auto", "on", "off")),
        ):
            require(getattr(self, name) in allowed, name, f"one of {allowed}", getattr(self, name))
        require(self.seed >= 0, "seed", "at least 0", self.seed)
