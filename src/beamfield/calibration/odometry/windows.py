"""A filter's update steps, and windows of several of them over which odometry and reference are compared."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import TooLittleDataError
from beamfield.geometry import FloatArray, between, wrap_angle
from beamfield.models.motion import OdometryMotion

# Systematic errors, in the order of `OdometryWindows.design`.
SYSTEMATIC = ("distance_scale", "turn_scale", "drift", "yaw")
# With fewer windows nothing can be held out or said of their spread.
FEWEST_WINDOWS = 12


@dataclass(frozen=True, eq=False)
class OdometryWindows:
    """Windows of the same number of update steps, one from each step on; they overlap.

    Parameters
    ----------
    odometry
        (m + 1, 3) odometry poses at the updates.
    scans
        (m + 1,) index of each update's scan in the log.
    first
        (w,) update that each window starts with.
    length
        Steps of a window.
    residuals
        (w, 3) reference minus odometry over the window, seen from its start: ahead, left, turn.
    reference
        (w, 3, 3) covariance of the reference's error in them.
    """

    odometry: FloatArray
    scans: NDArray[np.int64]
    first: NDArray[np.int64]
    length: int
    residuals: FloatArray
    reference: FloatArray

    def __len__(self) -> int:
        return len(self.first)

    @property
    def motion(self) -> FloatArray:
        """(w, 3) what odometry says of each window, seen from its start."""
        return between(self.odometry[self.first], self.odometry[self.first + self.length])

    def covariance(self, model: OdometryMotion) -> FloatArray:
        """Return what a motion model's noise makes of each window: (w, 3, 3), to first order."""
        steps = self._step_covariances(model)
        total = np.zeros((len(self), 3, 3))
        for j, effect in enumerate(self._effects):
            total += effect @ steps[self.first + j] @ np.swapaxes(effect, 1, 2)
        return total

    def shortening(self, model: OdometryMotion) -> FloatArray:
        """Return what a motion model's noise adds to each window on average: (w, 3), of second order.

        Whatever way its heading errs, a robot gets less far: by half the variance of the heading, of each step. What
        shifts it sideways in a step counts as an error of the step's direction.
        """
        covariances, moved = self._step_covariances(model), between(self.odometry[:-1], self.odometry[1:])[:, :2]
        squares = np.square(moved).sum(axis=1)
        sideways = np.stack([-moved[:, 1], moved[:, 0]], axis=1)
        aside = np.einsum("si,sij,sj->s", sideways, covariances[:, :2, :2], sideways)
        # A step of next to no length has no direction.
        direction = np.minimum(aside, np.pi**2 * squares**2) / np.maximum(squares**2, 1e-300)
        start, total, heading = self.odometry[self.first], np.zeros((len(self), 3)), np.zeros(len(self))
        before = between(start, start)
        for j in range(self.length):
            step, after = self.first + j, between(start, self.odometry[self.first + j + 1])
            total[:, :2] -= 0.5 * (heading + direction[step])[:, None] * (after - before)[:, :2]
            heading += covariances[step, 2, 2]
            before = after
        return total

    def _step_covariances(self, model: OdometryMotion) -> FloatArray:
        """Return the covariance of each step that a window has, seen from its start: (m, 3, 3)."""
        steps = np.zeros((len(self.odometry) - 1, 3, 3))
        for j in np.unique(self.first[:, None] + np.arange(self.length)):
            steps[j] = model.step(self.odometry[j : j + 2]).covariance()
        return steps

    def design(self) -> FloatArray:
        """Return how the residuals follow from the systematic errors of `SYSTEMATIC`: (w, 3, 4)."""
        steps = between(self.odometry[:-1], self.odometry[1:])
        zero = np.zeros(len(steps))
        # A robot that drives backwards turns as far per metre, to the other side.
        driven = np.sign(steps[:, 0]) * np.hypot(steps[:, 0], steps[:, 1])
        errors = np.stack(
            [
                np.column_stack([steps[:, 0], steps[:, 1], zero]),
                np.column_stack([zero, zero, steps[:, 2]]),
                np.column_stack([zero, zero, driven]),
                np.column_stack([-steps[:, 1], steps[:, 0], zero]),
            ],
            axis=2,
        )
        effects = [effect @ errors[self.first + j] for j, effect in enumerate(self._effects)]
        return np.asarray(np.sum(effects, axis=0))

    @cached_property
    def _effects(self) -> list[FloatArray]:
        """How an error of each step of a window moves the window's end, seen from its start: (w, 3, 3) each."""
        start, end, effects = self.odometry[self.first], self.motion, []
        before = between(start, start)
        for j in range(self.length):
            after = between(start, self.odometry[self.first + j + 1])
            rest = end[:, :2] - after[:, :2]
            cos, sin = np.cos(before[:, 2]), np.sin(before[:, 2])
            effect = np.zeros((len(self), 3, 3))
            effect[:, 0, 0], effect[:, 0, 1], effect[:, 0, 2] = cos, -sin, -rest[:, 1]
            effect[:, 1, 0], effect[:, 1, 1], effect[:, 1, 2] = sin, cos, rest[:, 0]
            effect[:, 2, 2] = 1.0
            effects.append(effect)
            before = after
        return effects


def update_scans(odometry: FloatArray, min_distance: float, min_turn: float) -> NDArray[np.int64]:
    """Return the scans at which a filter updates: the first, and each that is far enough from the last.

    Far enough, as in AMCL: x or y of the odometry frame (t, 3) differ by more than `min_distance`, or the heading by
    more than `min_turn`; 0 for every scan. Scans whose odometry is NaN are skipped.
    """
    chosen: list[int] = []
    for i in np.flatnonzero(np.isfinite(odometry).all(axis=1)).tolist():
        if not chosen:
            chosen.append(i)
            continue
        moved = np.abs(odometry[i] - odometry[chosen[-1]])
        turned = abs(float(wrap_angle(odometry[i, 2] - odometry[chosen[-1], 2])))
        if max(moved[0], moved[1]) > min_distance or turned > min_turn or (min_distance == 0.0 and min_turn == 0.0):
            chosen.append(i)
    return np.array(chosen, dtype=np.int64)


def cut_odometry_windows(
    odometry: FloatArray, poses: FloatArray, covariances: FloatArray, scans: NDArray[np.int64], length: int
) -> OdometryWindows:
    """Compare odometry and reference (t, 3) over every `length` update steps, from `update_scans`.

    Windows begin and end where the pose is finite. Covariances (t, 3, 3) are those of the poses in their frame; the
    errors at a window's two ends count as independent. TooLittleDataError if there are fewer than 12 windows.
    """
    posed = np.asarray(np.isfinite(poses[scans]).all(axis=1))
    first = np.arange(max(len(scans) - length, 0))
    first = first[posed[first] & posed[first + length]]
    if len(first) < FEWEST_WINDOWS:
        raise TooLittleDataError(
            f"expected at least {FEWEST_WINDOWS} windows of {length} update steps between poses, got {len(first)}: "
            "record a longer drive"
        )
    starts, ends = poses[scans[first]], poses[scans[first + length]]
    shown = between(starts, ends)
    driven = between(odometry[scans[first]], odometry[scans[first + length]])
    residuals = shown - driven
    residuals[:, 2] = wrap_angle(residuals[:, 2])
    reference = _reference_covariance(
        starts, shown, covariances[scans[first]], covariances[scans[first + length]]
    )  # fmt: skip
    return OdometryWindows(odometry[scans], scans, first, length, residuals, reference)


def _reference_covariance(
    starts: FloatArray, shown: FloatArray, of_start: FloatArray, of_end: FloatArray
) -> FloatArray:
    """Return the covariance of the poses between, from those of their ends in the map frame."""
    cos, sin = np.cos(starts[:, 2]), np.sin(starts[:, 2])
    turn = np.zeros((len(starts), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = cos, sin, -sin, cos, 1.0
    at_start = -turn
    at_start[:, 0, 2], at_start[:, 1, 2] = shown[:, 1], -shown[:, 0]
    return np.asarray(turn @ of_end @ turn.swapaxes(1, 2) + at_start @ of_start @ at_start.swapaxes(1, 2))
