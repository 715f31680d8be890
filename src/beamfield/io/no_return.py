"""What a sensor in a text log writes when there was no return: found in the data, or given."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.sensors import NoReturnPolicy

NoReturnRule = Literal["detect", "none"] | tuple[float, ...]

# The evidence behind these: in the public CARMEN logs the values for "no return" (81.83, 81.91, 51.05 ... 51.16, 50.0,
# 32.759 ... 32.767 m) are 40 to 10,000 times as frequent as the values in the tenth below them, and lie within 0.3%.
CODE_SPREAD = 0.002  # relative distance below the most frequent code in which further codes lie
CONTRAST = 30.0  # how much more frequent than the values below it a code must be
VALUES_BELOW = 10
SHARE_OF_OUTLIERS = 1e-4  # of the readings may lie beyond the codes
FREQUENT_ZEROS = 0.01
# A limit that a parameter file declares is not believed when more than this share of the readings contradict it.
CONTRADICTING_SHARE = 0.005
TOLERANCE = 5e-4  # metres within which a reading is a given value: half a step of the finest text logs


@dataclass(frozen=True, eq=False)
class ResolvedRanges:
    """Ranges (t, k) in the conventions of `Scan`, the limit in metres that they need, and what was done.

    The policy is what meant "no return"; the notes are what a user should know besides.
    """

    ranges: FloatArray
    max_range: float
    policy: NoReturnPolicy
    notes: tuple[str, ...] = ()


def resolve_no_return(
    ranges: FloatArray,
    *,
    rule: NoReturnRule = "detect",
    declared_max: float | None = None,
    max_range: float | None = None,
) -> ResolvedRanges:
    """Turn a sensor's own values for "no return" into +inf and find its limit.

    In this order:

    1. Readings that reach the limit (`max_range`, which the user gives, else `declared_max`, unless more than
    `CONTRADICTING_SHARE` of the readings are ordinary ones beyond it) are no return.

    2. "detect" looks for *codes*: the most frequent value in the top tenth of the readings, and its neighbours within
    0.2%, if it is `CONTRAST` times as frequent as the values next below it. Without a limit from (1) the smallest code
    is the limit.

    3. "detect" takes zeros as no return if at least 1% of the readings are 0, there are no codes, and none is +inf:
    readings beyond a declared limit are glitches then, and no way to say that there was no return.

    4. Without any limit so far, it is set just beyond the largest reading, and a note says so.

    Zeros that are not explained so and negative readings are not measurements (NaN). Other rules are "none", with (1)
    and (4) alone, or the values in metres, NaN among them, that mean "no return". Ranges are (t, k) as in the file;
    other NaN and +inf keep their meaning. The policy says which share of *all* readings is no return. InvalidInputError
    if the rule or a limit makes no sense.
    """
    _check(rule, declared_max, max_range)
    z = np.array(ranges, dtype=np.float64)
    notes: list[str] = []
    codes = _find_codes(z) if rule == "detect" else ()
    limit, limit_origin = max_range, "given"
    if limit is None and declared_max is not None:
        limit, limit_origin = _believed(z, declared_max, codes, notes), "declared"
        if limit is not None and codes and codes[0] < limit:
            limit = codes[0]  # the sensor saturates there, whatever it declares
    values: tuple[float, ...] = codes
    origin = "detected" if codes else "none"
    if codes and limit is not None and codes[0] > limit:
        origin = limit_origin
    if not isinstance(rule, str):
        values, origin = tuple(sorted(float(v) for v in rule)), "given"
    mask = _mask(z, values, limit)
    if rule == "detect" and not codes and not (z == np.inf).any() and np.mean(z == 0.0) >= FREQUENT_ZEROS:
        values, origin, mask = (0.0,), "detected", mask | (z == 0.0)
    _drop_impossible(z, mask, notes)
    z[mask] = np.inf
    if limit is None:
        limit = _limit_from(z, values, notes)
        z[z >= limit] = np.inf
    elif origin == "none" and mask.any():
        origin = limit_origin
    share = float(np.mean(z == np.inf))
    return ResolvedRanges(z, limit, NoReturnPolicy(values, share, origin, _explain(values, share, origin, limit)),
                          tuple(notes))  # fmt: skip


def _check(rule: NoReturnRule, declared_max: float | None, max_range: float | None) -> None:
    if isinstance(rule, str):
        require(rule in ("detect", "none"), "no_return", "'detect', 'none' or a tuple of metres", rule)
    elif not all(np.isnan(v) or 0.0 <= v < np.inf for v in rule):
        raise InvalidInputError(f"no_return: expected values >= 0 in metres or NaN, got {rule!r}")
    for name, limit in (("declared_max", declared_max), ("max_range", max_range)):
        if limit is not None and not 0.0 < limit < np.inf:
            raise InvalidInputError(f"{name}: expected a finite number of metres > 0, got {limit!r}")


def _find_codes(z: FloatArray) -> tuple[float, ...]:
    """Return the values at the top end that are far too frequent to be measurements, ascending."""
    readings = z[np.isfinite(z) & (z > 0.0)]
    if readings.size == 0:
        return ()
    values, counts = np.unique(readings, return_counts=True)
    # A few readings beyond the codes (glitches) must not hide them.
    beyond = np.cumsum(counts[::-1])[::-1]
    top = values[max(0, int(np.searchsorted(-beyond, -max(1.0, SHARE_OF_OUTLIERS * z.size), side="right")) - 1)]
    in_reach = values >= 0.9 * top
    peak = int(np.argmax(np.where(in_reach, counts, 0)))
    lowest = values[peak] * (1.0 - CODE_SPREAD)
    # The values of the tenth below, or the next ones where that is (almost) empty.
    first, end = (int(i) for i in np.searchsorted(values, (0.9 * values[peak], lowest)))
    below = counts[max(0, min(first, end - VALUES_BELOW)) : end]
    # Their 90% quantile, because a second code (or a beam that is stuck) below must not hide the first.
    ordinary = max(1.0, float(np.quantile(below, 0.9))) if below.size else 1.0
    enough = max(10.0, SHARE_OF_OUTLIERS * z.size)
    # Data of one value only: it may be a wall, there is nothing to compare it with.
    if counts[peak] < max(enough, CONTRAST * ordinary) or counts[peak] == readings.size:
        return ()
    cluster = (values >= lowest) & (counts >= max(enough, 3.0 * ordinary))
    return tuple(float(v) for v in values[cluster])


def _believed(z: FloatArray, declared: float, codes: tuple[float, ...], notes: list[str]) -> float | None:
    ordinary = np.isfinite(z) & (z > declared * (1.0 + 1e-9))
    # Beyond the limit, codes are (almost) one value; measurements spread.
    largest = codes[0] if codes else float(np.max(z, where=np.isfinite(z), initial=0.0))
    ordinary &= z < largest * (1.0 - CODE_SPREAD)
    share = float(np.mean(ordinary))
    if share <= CONTRADICTING_SHARE:
        return declared
    notes.append(
        f"the file declares a limit of {declared:.6g} m, but {share:.1%} of the readings are ordinary ones beyond it: "
        "not used"
    )
    return None


def _mask(z: FloatArray, values: tuple[float, ...], limit: float | None) -> NDArray[np.bool_]:
    mask: NDArray[np.bool_] = z == np.inf
    for value in values:
        mask |= np.isnan(z) if np.isnan(value) else np.abs(z - value) < TOLERANCE
    if limit is not None:
        mask |= z >= limit
    return mask


def _drop_impossible(z: FloatArray, mask: NDArray[np.bool_], notes: list[str]) -> None:
    """Make readings <= 0 that do not mean "no return" no measurements."""
    impossible = (z <= 0.0) & (z > -np.inf) & ~mask
    if impossible.any():
        count = np.count_nonzero(impossible)
        notes.append(f"{count:,} of {z.size:,} readings are 0 or negative: taken as no measurement")
        z[impossible] = np.nan


def _limit_from(z: FloatArray, values: tuple[float, ...], notes: list[str]) -> float:
    """Return the limit of a sensor whose file declares none."""
    seen = z[np.isfinite(z)]
    largest = float(seen.max()) if seen.size else 0.0
    positive = [v for v in values if v > 0.0]
    if positive and (seen.size == 0 or float(np.mean(seen > min(positive))) <= CONTRADICTING_SHARE):
        return min(positive)
    limit = np.floor(largest * 100.0 + 1.0) / 100.0
    notes.append(
        f"the file declares no limit: max_range is set to {limit:.6g} m, just beyond the largest reading "
        f"({largest:.6g} m); give max_range if you know it"
    )
    return float(limit)


def _explain(values: tuple[float, ...], share: float, origin: str, limit: float) -> str:
    listed = ", ".join(f"{v:.6g}" for v in values[:8]) + (", ..." if len(values) > 8 else "")
    if origin == "none":
        return "no special value seen" if share == 0.0 else f"{share:.2%} of the readings are +inf"
    if values == (0.0,):
        reason = "are 0, and nothing else says that there was no return" if origin == "detected" else "are 0"
        return f"{share:.2%} of the readings {reason}"
    if origin == "detected":
        return f"{share:.2%} of the readings are {listed} m or more, far more often than the values below"
    if origin == "given":
        return f"{share:.2%} of the readings are one of the given values ({listed}) or reach {limit:.6g} m"
    return f"{share:.2%} of the readings reach the declared limit of {limit:.6g} m" + (f" ({listed})" if values else "")
