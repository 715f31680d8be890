"""How the models of scans allow for beams that err together (6.3.4): an exponent, and fewer beams."""

from __future__ import annotations

from typing import Any

import numpy as np

from beamfield.arguments import keep, require
from beamfield.models.beam_parameters import SavedBeamModel
from beamfield.models.field_parameters import SavedLikelihoodField


def settle_dependence(model: Any) -> None:
    """Take exponent and n_beams of what a file says, where a model is not given them, and check them.

    The model is a frozen dataclass with `parameters`, `exponent` and `n_beams`, in its `__post_init__`.
    InvalidInputError if the exponent is not positive and finite, or n_beams is less than 1.
    """
    learned: dict[str, Any] = {"exponent": 1.0}
    saved = model.parameters
    if isinstance(saved, SavedBeamModel | SavedLikelihoodField):
        learned = {"exponent": saved.exponent, "n_beams": saved.n_beams}
        keep(model, parameters=saved.parameters)
    keep(model, **{name: value for name, value in learned.items() if getattr(model, name) is None})
    require(0.0 < model.exponent < np.inf, "exponent", "a positive, finite number", model.exponent)
    require(model.n_beams is None or model.n_beams >= 1, "n_beams", "at least 1 or None", model.n_beams)
