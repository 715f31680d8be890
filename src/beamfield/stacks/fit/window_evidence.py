"""What many scans say before the fitted parameters come in, kept so that thousands of parameters are soon weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.context.posterior_judge import PosteriorScores, judge_weights
from beamfield.calibration.pose_windows import Rivals, Window
from beamfield.geometry import FloatArray
from beamfield.kernels import posterior as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.sensors import SensorLog
from beamfield.stacks.emulation.emulator import Evidence, FieldEvidence, FieldModel, StackModel

LANES = kernels.LANES


@dataclass(frozen=True, eq=False)
class FieldCodes:
    """Evidence of a likelihood field for many scans: the few values there are, and which of them each end point has.

    A map has thousands of distances, the evidence millions: the stack's formula is evaluated for the former.

    Parameters
    ----------
    values
        Evidence of one pose with a beam for each distance and place that occurs.
    codes
        Index into them of each end point, the beams of one pose after those of the other, scan after scan.
    starts
        (r + 1,) where each pose's beams start.
    n_beams
        (r,) beams of each pose.
    """

    values: FieldEvidence
    codes: NDArray[np.int32]
    starts: NDArray[np.int64]
    n_beams: NDArray[np.int64]

    def log_weights(self, model: FieldModel[Any], candidates: Sequence[Any]) -> FloatArray:
        """Return log-weights (r, c) of all poses, one after the other, for c parameters."""
        weights = np.empty((len(self.n_beams), len(candidates)))
        beams = max(1, len(self.codes) // max(1, len(self.n_beams)))
        width = 1 if len(candidates) == 1 else LANES
        sums = np.empty((len(self.n_beams), width))
        for first in range(0, len(candidates), LANES):
            chunk = candidates[first : first + LANES]
            table = np.zeros((len(self.values.beams), width))
            for lane, parameters in enumerate(chunk):
                table[:, lane] = model.beam_terms(self.values, parameters)[0]

            def work(a: int, b: int, table: FloatArray = table) -> None:
                kernels.sum_values(self.codes, self.starts[a : b + 1], table, sums[a:b])

            run_in_blocks(work, len(self.n_beams), work_per_row=beams)
            for lane, parameters in enumerate(chunk):
                weights[:, first + lane] = model.log_of_sums(sums[:, lane], self.n_beams, parameters)
        return weights


@dataclass(frozen=True, eq=False)
class WindowEvidence:
    """Evidence of windows with equally many scans and poses.

    Parameters
    ----------
    n_windows
        How many windows.
    n_near
        How many poses of each scan are near ones; they come before the far ones.
    scans
        (w) x (s) evidence of each window's scans; empty if `codes` has it.
    codes
        The same for likelihood fields; else None.
    n_scans
        Scans in a window.
    """

    n_windows: int
    n_near: int
    scans: tuple[tuple[Evidence, ...], ...]
    codes: FieldCodes | None
    n_scans: int

    def log_weights(self, model: StackModel[Any, Any], candidates: Sequence[Any]) -> FloatArray:
        """Return log-weights (w, c, n) of trajectories: sums over a window's scans, for c parameters."""
        if self.codes is not None and isinstance(model, FieldModel):
            each = self.codes.log_weights(model, candidates)
            total = each.reshape(self.n_windows, self.n_scans, -1, len(candidates)).sum(axis=1)
            return np.ascontiguousarray(total.swapaxes(1, 2))
        return np.array(
            [
                [np.sum([model.log_weights(scan, parameters) for scan in scans], axis=0) for parameters in candidates]
                for scans in self.scans
            ]
        )


def gather_evidence(model: StackModel[Any, Any], log: SensorLog, windows: Sequence[Window]) -> WindowEvidence:
    """Return the evidence of all windows, for many evaluations with other parameters."""
    n_near, n_scans = windows[0].near.shape[1], len(windows[0].scans)
    coder = _Coder() if isinstance(model, FieldModel) and model.takes_poses_alone() else None
    gathered = []
    for window in windows:
        scans = []
        for i, near, far in zip(window.scans, window.near, window.far, strict=True):
            evidence = model.evidence(log.scan(int(i)), np.concatenate([near, far]))
            if coder is None:
                scans.append(evidence)
            else:
                coder.add(evidence)
        gathered.append(tuple(scans))
    if coder is None:
        return WindowEvidence(len(windows), n_near, tuple(gathered), None, n_scans)
    return WindowEvidence(len(windows), n_near, (), coder.result(evidence), n_scans)


def score_windows(
    model: StackModel[Any, Any], evidence: WindowEvidence, candidates: Sequence[Any], rivals: Rivals
) -> list[PosteriorScores]:
    """Return how well parameters, one set after the other, do on windows.

    A filter knows where the robot is up to a prior, which is off the truth as far as its spread says, or that it may be
    anywhere. The posterior is that prior times the stack's weights. It is judged where the truth may be: around the
    reference.

    The evidence is from `gather_evidence`; the rivals are those that the windows were cut with.
    """
    scores: list[PosteriorScores] = []
    for first in range(0, len(candidates), LANES):
        chunk = candidates[first : first + LANES]
        log_weights = evidence.log_weights(model, chunk)
        scores += judge_weights(log_weights, evidence.n_near, rivals)
    return scores


class _Coder:
    """Numbers distances as they come."""

    def __init__(self) -> None:
        self._codes: list[NDArray[np.int32]] = []
        self._n_beams: list[NDArray[np.int64]] = []
        self._n_known = 0
        self._known, self._places = np.empty(0, np.uint64), np.empty(0, np.int8)
        self._slots = np.empty(0, np.int32)
        self._enlarge(1 << 12)

    def add(self, evidence: FieldEvidence) -> None:
        """Number the end points of one scan."""
        bits = evidence.distances.astype(np.float64).view(np.uint64).ravel()
        places = np.ascontiguousarray(evidence.places).ravel()
        codes = np.empty(len(bits), np.int32)
        while True:
            count = kernels.number_distances(bits, places, self._slots, self._known, self._places, self._n_known, codes)
            if count >= 0:
                break
            self._enlarge(4 * len(self._known))
        self._n_known = count
        self._codes.append(codes)
        n, k = evidence.distances.shape
        self._n_beams.append(np.full(n, k, np.int64))

    def result(self, last: FieldEvidence) -> FieldCodes:
        """Return what was gathered, with the settings and the kind of distances of the last evidence."""
        known = self._known[: self._n_known].view(np.float64).astype(last.distances.dtype)
        values = replace(
            last, beams=np.arange(len(known)), distances=known[None], places=self._places[None, : self._n_known].copy()
        )
        n_beams = np.concatenate(self._n_beams)
        starts = np.concatenate([[0], np.cumsum(n_beams)])
        return FieldCodes(values, np.concatenate(self._codes), starts, n_beams)

    def _enlarge(self, size: int) -> None:
        """Make room for `size` distances, with those known before."""
        known, places, n = self._known, self._places, self._n_known
        self._known, self._places = np.empty(size, np.uint64), np.empty(size, np.int8)
        self._slots = np.full(2 * size, -1, np.int32)
        # Those of a scan that did not fit are found anew.
        codes = np.empty(n, np.int32)
        self._n_known = kernels.number_distances(
            known[:n], places[:n], self._slots, self._known, self._places, 0, codes
        )
