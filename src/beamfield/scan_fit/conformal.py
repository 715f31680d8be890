"""Conformal p-values: how many good scans look at least as strange as this one."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import require
from beamfield.geometry import FloatArray


def conformal_p_values(values: ArrayLike, good: ArrayLike) -> FloatArray:
    """Return (1 + number of good values at least as large) / (n + 1) for each value; larger is stranger.

    If a fresh scan is as good as the n good ones (exchangeable with them), P(p <= a) <= a for every a, whatever the
    distribution of the values and however few good scans there are: few make the p-value conservative, not wrong. NaN
    among the values gives NaN, among the good ones it is left out.

    >>> conformal_p_values([0.0, 2.5, 9.0], [1.0, 2.0, 3.0]).tolist()
    [1.0, 0.5, 0.25]
    """
    scores = np.asarray(values, dtype=np.float64)
    known = np.asarray(good, dtype=np.float64)
    known = np.sort(known[~np.isnan(known)])
    at_least = len(known) - np.searchsorted(known, scores, side="left")
    return np.asarray(np.where(np.isnan(scores), np.nan, (1.0 + at_least) / (len(known) + 1.0)))


def cross_conformal_p_values(
    values: ArrayLike, stamps: ArrayLike, good: ArrayLike, good_stamps: ArrayLike, gap_s: float
) -> FloatArray:
    """Return conformal p-values of scans (m,) that are, or stand beside, the good ones (n,): near ones do not count.

    Each scan is compared with the good scans further away in time than the gap, so that none is judged by itself or by
    neighbours that saw the same walls and people. Stamps and the gap, at least 0, are in seconds. NaN where the value
    is NaN or no good scan is far enough.
    """
    require(gap_s >= 0.0, "gap_s", "seconds >= 0", gap_s)
    scores, when = np.asarray(values, dtype=np.float64), np.asarray(stamps, dtype=np.float64)
    known, known_when = np.asarray(good, dtype=np.float64), np.asarray(good_stamps, dtype=np.float64)
    keep = ~np.isnan(known)
    order = np.argsort(known_when[keep], kind="stable")
    known, known_when = known[keep][order], known_when[keep][order]
    ordered = np.sort(known)
    first = np.searchsorted(known_when, when - gap_s, side="left")
    behind = np.searchsorted(known_when, when + gap_s, side="right")
    result: FloatArray = np.full(len(scores), np.nan)
    for i in np.flatnonzero(~np.isnan(scores)):
        n = len(known) - (behind[i] - first[i])
        if n > 0:
            near = int((known[first[i] : behind[i]] >= scores[i]).sum())
            at_least = len(known) - int(np.searchsorted(ordered, scores[i], side="left")) - near
            result[i] = (1.0 + at_least) / (n + 1.0)
    return result
