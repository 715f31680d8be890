"""What comes of translating parameters: values, what differs, and by how much."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from beamfield.arguments import require
from beamfield.stacks.stack import FIELD_PRODUCT, RAY_PRODUCT, Stack, Weight
from beamfield.stacks.syntax.parameter_text import Value
from beamfield.stacks.translation.weight_comparison import N_BEAMS, N_POSES, Comparison

# beamfield's own models, whose parameters mean what the chapter says.
CHAPTER = "chapter"
CHAPTER_WEIGHTS: Mapping[str, Weight] = {"beam": RAY_PRODUCT, "likelihood_field": FIELD_PRODUCT}


@dataclass(frozen=True)
class Translation:
    """Parameters for another stack.

    Parameters
    ----------
    stack, model
        Whose they are.
    values
        By the stack's own names; parameters that have no counterpart are left out.
    comparison
        Of the weights before and after, by the formulas of both models with the digits that files hold, on a sample;
        of the same distances, or of the same readings and expected ranges.
    assumptions
        What has to hold for the comparison to mean something; one sentence each.
    notes
        What differs all the same; one sentence each.
    """

    stack: str
    model: str
    values: Mapping[str, Value]
    comparison: Comparison
    assumptions: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def exact(self) -> bool:
        """Whether relative weights came out the same, with nothing assumed."""
        return self.comparison.is_same and not self.assumptions

    @property
    def summary(self) -> str:
        """What the comparison says, in one sentence."""
        made = self.comparison
        sample = f"one scan of {N_BEAMS} beams at {N_POSES} poses"
        if made.is_same:
            provided = "" if not self.assumptions else ", if what is assumed below is true"
            return (
                f"the same relative weights at equal distances{provided}: computed for {sample}, log weights differ by "
                f"{made.difference:.1g} of {made.spread:.2g} nats"
            )
        return (
            f"not the same weights: computed for {sample}, log weights range over {made.spread:.3g} nats before and "
            f"{made.other_spread:.3g} after, and differ by up to {made.difference:.3g}"
        )


def check_metres(**lengths: float | None) -> None:
    """Refuse lengths that are none; None is not given."""
    for name, value in lengths.items():
        require(value is None or 0.0 < value < math.inf, name, "a positive number of metres", value)


def as_written(values: Mapping[str, Value]) -> dict[str, Any]:
    """Return values with the digits that a file holds."""
    return {name: float(f"{value:.6g}") if isinstance(value, float) else value for name, value in values.items()}


def map_notes(source: Stack, target: Stack | None) -> list[str]:
    """Return what two stacks make of the same map and scan, as far as no parameter changes it; None is the chapter."""
    notes = []
    other = "beamfield" if target is None else target.title
    is_low = source.half_cell_low, target is not None and target.half_cell_low
    if any(is_low) and not all(is_low):
        low, right = (source.title, other) if is_low[0] else (other, source.title)
        notes.append(f"{low} sees walls half a cell off, {right} where the map has them")
    if target is not None and source.beams_taken and target.beams_taken and source.beams_taken != target.beams_taken:
        notes.append(
            f"{source.title} takes {source.beams_taken}, {target.title} {target.beams_taken}: not the same beams"
        )
    notes += [
        f"off the map {stack.title} gives {stack.off_map}, {one} what the maximum distance is worth"
        for stack, one in ((source, other), (target, source.title))
        if stack is not None and stack.off_map
    ]
    return notes


def random_poses(stack: Stack, model: str) -> list[str]:
    """Report that a program draws poses at random by default, with weights that do not tell a lost robot."""
    fast = 0.0 if stack.filter is None else getattr(stack.filter.parameters(), "recovery_alpha_fast", 0.0)
    if not (fast and stack.averages_scans and stack.model(model).weight.is_product):
        return []
    do = "set recovery_alpha_slow and recovery_alpha_fast to 0"
    return [f"{stack.title} draws poses at random by default, which can lead this product astray: {do}"]


def above_one(stack: Stack, hit: float) -> list[str]:
    """Report a peak against which a program would assert, or that it refuses."""
    if hit > stack.limits.get("z_hit", (0.0, math.inf))[1]:
        return [f"z_hit is above 1: {stack.title}'s node for ROS 2 refuses it and does not start"]
    if not stack.asserts_p or hit <= 1.0:
        return []
    return [f"z_hit is above 1: builds of {stack.name} with assertions (debug builds) stop"]
