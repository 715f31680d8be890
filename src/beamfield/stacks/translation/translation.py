"""What comes of translating parameters: values, what differs, and by how much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from beamfield.stacks.files.parameter_text import Value
from beamfield.stacks.translation.weight_comparison import N_BEAMS, N_POSES, Comparison

# beamfield's own models, whose parameters mean what the chapter says.
CHAPTER = "chapter"
# amcl sees walls half a cell off, and so does its port to ROS 2.
AMCL = frozenset(("nav2", "ros1"))

# How a scan's weight comes from the values p of its beams. Stacks' parameters translate within a row, not across.
FAMILIES: Mapping[str, frozenset[tuple[str, str]]] = {
    "1 + the sum of p^3 over fields": frozenset(
        (("nav2", "likelihood_field"), ("ros1", "likelihood_field"), ("beluga", "likelihood_field"))
    ),
    "the product of p over fields": frozenset(
        (("nav2", "likelihood_field_prob"), ("ros1", "likelihood_field_prob"), ("beluga", "likelihood_field_prob"),
         ("mrpt", "LF_Thrun"), (CHAPTER, "likelihood_field"))
    ),
    "a sum of p^3 over ray casts": frozenset((("nav2", "beam"), ("ros1", "beam"), ("beluga", "beam"))),
    "1 + the sum of log p over ray casts": frozenset((("mrpt", "rayTracing"),)),
    "the product of p^(1 / squash_factor) over ray casts": frozenset((("f1tenth", "table"),)),
    "the product of p over ray casts": frozenset(((CHAPTER, "beam"),)),
}  # fmt: skip


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


def family(stack: str, model: str) -> str:
    """Return how a model makes the weight of a scan from those of its beams."""
    return next(name for name, members in FAMILIES.items() if (stack, model) in members)


def as_written(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return values with the digits that a file holds."""
    return {name: float(f"{value:.6g}") if isinstance(value, float) else value for name, value in values.items()}


def map_notes(source: str, target: str) -> list[str]:
    """Return what two stacks make of the same map and scan, as far as no parameter changes it."""
    notes = []
    if (source in AMCL) != (target in AMCL):
        notes.append("nav2 and ROS 1 see walls half a cell off, the others where the map has them")
    if "beluga" in (source, target) and AMCL & {source, target}:
        notes.append("nav2 and ROS 1 take every n-th beam, Beluga max_beams evenly: not the same beams")
    if "beluga" in (source, target):
        notes.append("off the map Beluga gives 1 / laser_max_range, the others what the maximum distance is worth")
    return notes


def above_one(stack: str, hit: float) -> list[str]:
    """Say if amcl would assert against a peak."""
    if stack not in AMCL or hit <= 1.0:
        return []
    return [f"z_hit is above 1: builds of {stack} with assertions (debug builds) stop"]
