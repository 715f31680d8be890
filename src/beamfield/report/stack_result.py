"""What calibrating for another program's model found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from beamfield.stacks.fit.fit import LEAST_COVERAGE, StackFit, Trial
from beamfield.stacks.fit.motion_candidates import BEFORE
from beamfield.stacks.fit.replay_choice import ReplayChoice

# Fewer stretches of a log than these are too few places to be judged by.
FEW_STRETCHES = 4


@dataclass(frozen=True, eq=False)
class StackResult:
    """What calibrating for another program's model found.

    Parameters
    ----------
    fits
        One per model of the stack that was fitted.
    chosen
        The one that the file holds.
    replay
        What its filter decided; None if it was not replayed.
    why_not
        Why not.
    doubt
        Why no value may be used yet, whatever replay says: map or poses cannot be trusted; empty if they can.
    disagrees
        Whether many scans, or most readings of most scans, disagree with the map.
    leaves_out_jumps
        Whether the odometry jumps and the log that was replayed does not: its poses were fitted without these steps.
    """

    fits: Sequence[StackFit]
    chosen: StackFit
    replay: ReplayChoice | None = None
    why_not: str = ""
    doubt: str = ""
    disagrees: bool = False
    leaves_out_jumps: bool = False

    @property
    def start(self) -> Any:
        """The sensor's values before."""
        if self.replay is None:
            return self.chosen.start
        model = self.replay.before.filter.model
        return next(fit.start for fit in self.fits if fit.model.model == model)

    @property
    def unproven(self) -> str:
        """Why the user's file must stay as it is: scores on windows alone have chosen values that did harm."""
        stack = self.chosen.model.stack
        why = f"no value for {stack} is proven, for its filter could not be replayed: {self.why_not}."
        return why if self.replay is None else ""

    @property
    def trial(self) -> Trial:
        """The sensor's values to use: those before or those fitted."""
        keeps = self.replay is not None and self.replay.chosen.key.sensor == BEFORE
        return self.chosen.before if keeps else self.chosen.chosen

    @property
    def parameters(self) -> Any:
        """The sensor's values to use."""
        return self.trial.parameters

    @property
    def covers(self) -> bool:
        """Whether enough held-out windows have the reference in their 95% region with these values."""
        return self.trial.held_out.coverage >= LEAST_COVERAGE

    @property
    def is_from_few_places(self) -> bool:
        """Whether replay changed values by what it saw in a few places."""
        return self.replay is not None and self.replay.is_better and len(self.replay.trials_before) < FEW_STRETCHES

    @property
    def motion(self) -> dict[str, Any]:
        """The motion model's values that replay changed."""
        return self._changed("motion")

    @property
    def recovery(self) -> dict[str, Any]:
        """The filter's values that replay changed: those that draw poses at random."""
        return self._changed("particles")

    def _changed(self, part: str) -> dict[str, Any]:
        if self.replay is None:
            return {}
        before, after = (asdict(getattr(one.filter, part)) for one in (self.replay.before, self.replay.chosen))
        return {name: value for name, value in after.items() if value != before[name]}
