"""Odometry as one unbroken track: resets, jumps and gaps found and bridged, never followed."""

from __future__ import annotations

import math

from beamfield.geometry import FloatArray, Pose, after_step, step_between
from beamfield.models.motion import JUMP, JUMP_RATE, JUMP_SPEED, JUMP_TURN


class ContinuousOdometry:
    """The odometry's poses chained step by step, without the steps that no robot can have made.

    Such a step is a reset or a jump: the track stands still over it, and `jumps` counts it. Poses that are not finite
    are gaps, which the next finite pose bridges. Time that runs backwards counts as time that runs.
    """

    def __init__(self) -> None:
        self._last: Pose | None = None
        self._last_stamp: float | None = None
        self.pose: Pose = (0.0, 0.0, 0.0)
        """Where the track is now: x, y and theta in the frame of the first pose."""
        self.jumps = 0
        """Steps that were not followed."""

    def add(self, pose: FloatArray, stamp: float | None) -> bool:
        """Go on to another pose (3,), as the odometry reports it; return whether it is finite: if not, nothing changes.

        Without a stamp the step is followed, however long.
        """
        x, y, theta = pose.tolist()
        if not math.isfinite(x + y + theta):
            return False
        if self._last is None:
            self.pose = (x, y, theta)
        else:
            step = step_between(self._last, (x, y, theta))
            if self._is_possible(step, stamp):
                self.pose = after_step(self.pose, step)
            else:
                self.jumps += 1
        self._last, self._last_stamp = (x, y, theta), stamp
        return True

    def _is_possible(self, step: Pose, stamp: float | None) -> bool:
        if stamp is None:
            return True
        seconds = 0.0 if self._last_stamp is None else abs(stamp - self._last_stamp)
        seconds = seconds if math.isfinite(seconds) else 0.0
        return (
            math.hypot(step[0], step[1]) <= JUMP + JUMP_SPEED * seconds
            and abs(step[2]) <= JUMP_TURN + JUMP_RATE * seconds
        )
