"""Beluga's likelihood_field_prob, emulated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from beamfield.stacks.amcl.grid_models import SCAN_SETTINGS
from beamfield.stacks.beluga.field import BelugaField


@dataclass(frozen=True, eq=False)
class BelugaFieldProb(BelugaField):
    """``w = exp(sum log p)`` with the p of `BelugaField`.

    The node hands neither model_unknown_space nor only_obstacle_boundaries to this model: unknown cells are as free
    ones, and all occupied cells count.

    Parameters
    ----------
    grid, parameters, distance, no_return, map_mode
        As for `BelugaField`.

    Notes
    -----
    The program's weights underflow to 0 where the logarithms here do not.
    """

    model: ClassVar[str] = "likelihood_field_prob"
    evidence_settings: ClassVar[tuple[str, ...]] = SCAN_SETTINGS
    has_map_options: ClassVar[bool] = False
    is_product: ClassVar[bool] = True
