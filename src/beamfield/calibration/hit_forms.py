"""The forms that the hit component may have: fitted one by one, chosen by held-out likelihood."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.evaluation import block_standard_error, gains_over, is_worth_it, log_density
from beamfield.calibration.intrinsic.block_intervals import IntervalResult, block_intervals
from beamfield.calibration.intrinsic.em import LearningResult, learn_intrinsic_parameters
from beamfield.calibration.options import CalibrationOptions, Choice
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Candidate:
    """One form of the hit component, fitted on the fit blocks and scored on the held-out ones.

    Parameters
    ----------
    name
        "chapter", "range offset", "sigma slope" or "range offset + sigma slope".
    result
        The fit.
    held_out
        Mean log-likelihood per held-out beam, nats.
    gain, gain_se
        Gain over the simplest candidate per held-out beam, nats, and its standard error from blocks of time.
    chosen
        Whether it is the result.
    has_offset, has_slope
        Whether range_offset and sigma_slope were fitted; neither in the chapter's form.
    """

    name: str
    result: LearningResult
    held_out: float
    gain: float
    gain_se: float
    chosen: bool = False
    has_offset: bool = False
    has_slope: bool = False

    @property
    def is_chapter(self) -> bool:
        """Whether it is the chapter's form."""
        return not (self.has_offset or self.has_slope)

    __repr__ = short_repr


def fit_candidates(
    table: BeamTable,
    blocks: NDArray[np.int64],
    held_out: NDArray[np.bool_],
    options: CalibrationOptions,
    progress: Progress,
) -> tuple[Candidate, ...]:
    """Fit every form of the hit component that the options allow, from simple to rich, and mark the one to keep.

    Blocks (n,) are those of time of each beam; the beams held out (n,) judge the forms, which are fitted to the others.
    Beams whose ray hits nothing are left out.
    """
    usable = ~table.hits_nothing
    fitted, judged = table.select(~held_out & usable), table.select(held_out & usable)
    judged_blocks = blocks[held_out & usable]
    forms = [
        (offset, slope)
        for offset in (False, True)
        for slope in (False, True)
        if _allowed(offset, options.range_offset) and _allowed(slope, options.sigma_slope)
    ]
    results: list[LearningResult] = []
    for number, (offset, slope) in enumerate(forms):
        progress("learning", number, len(forms))
        results.append(learn_form(fitted, options.hold, offset=offset, slope=slope))
    progress("learning", len(forms), len(forms))
    densities = [log_density(judged, result.parameters) for result in results]
    gains = [gains_over(densities[0], density) for density in densities]
    best = _choose(densities, judged_blocks)
    return tuple(
        Candidate(
            _form_name(*forms[i]),
            results[i],
            float(densities[i].mean()),
            float(gains[i].mean()),
            block_standard_error(gains[i], judged_blocks),
            chosen=i == best,
            has_offset=forms[i][0],
            has_slope=forms[i][1],
        )
        for i in range(len(forms))
    )


def learn_form(table: BeamTable, hold: Mapping[str, float], *, offset: bool, slope: bool = False) -> LearningResult:
    """Learn the parameters of one form of the hit component from a table's beams; see `learn_intrinsic_parameters`."""
    return learn_intrinsic_parameters(
        table.ranges,
        table.expected_ranges,
        table.max_range,
        min_range=table.min_range,
        fit_offset=offset,
        fit_sigma_slope=slope,
        hold=hold,
    )


def form_intervals(
    table: BeamTable,
    parameters: BeamParameters,
    hold: Mapping[str, float],
    block_s: float | None,
    *,
    offset: bool,
    slope: bool = False,
) -> IntervalResult:
    """Return the intervals of parameters that were learned from these beams; see `block_intervals`."""
    return block_intervals(
        table.ranges,
        table.expected_ranges,
        table.stamps,
        table.max_range,
        parameters,
        min_range=table.min_range,
        fit_offset=offset,
        fit_sigma_slope=slope,
        hold=hold,
        block_s=block_s,
    )


def _allowed(present: bool, choice: Choice) -> bool:
    return choice == "auto" or present == (choice == "on")


def _form_name(offset: bool, slope: bool) -> str:
    parts = [name for name, present in (("range offset", offset), ("sigma slope", slope)) if present]
    return " + ".join(parts) or "chapter"


def _choose(densities: list[FloatArray], blocks: NDArray[np.int64]) -> int:
    """Start with the simplest form; move to another only for a gain that is more than noise."""
    best = 0
    for i, density in enumerate(densities):
        if is_worth_it(gains_over(densities[best], density), blocks):
            best = i
    return best
