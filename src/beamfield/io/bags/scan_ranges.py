"""Ranges of a bag's scans: their limits, and what the sensor means by "no return"."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import require
from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.bags.laser_scan import LaserScans, is_one_of
from beamfield.io.no_return import NoReturnRule, ResolvedRanges
from beamfield.sensors import NoReturnPolicy

FREQUENT = 0.01  # share of all readings from which a special value counts as the sensor's way to say "no return"
RARE = 0.001  # share up to which the ways of REP 117 do not count as the sensor's own
CONTRAST = 10.0  # how much more frequent than its neighbours a value must be that is not a measurement
NEIGHBOURS = 10  # different values to compare with
ENOUGH = 20  # readings
# From this share of different numbers beyond it the declared limit is doubted: at most 0.015 on 9 real bags.
DOUBTED = 0.05
# Metres: a declared limit beyond it is none, as the largest float32. In a simulated office parameters come out right
# with one of 3 km, not with one of 10 km.
FARTHEST = 3000.0


def resolve_limits(
    scans: LaserScans, path: Path, min_range: float | None, max_range: float | None
) -> tuple[float, float]:
    """Return the range limits: the given ones, else those that the messages declare.

    Given limits are rounded to float32, as the ranges are: a sensor that answers 5.6 for "no return" writes
    5.599999904632568, which a max_range of 5.6 must include. InvalidInputError if one is not a number, or not within
    the other; FormatError if none is given and the declared ones are not 0 <= range_min < range_max <= `FARTHEST`.
    """
    require(min_range is None or 0.0 <= min_range < np.inf, "min_range", "a finite number of metres >= 0", min_range)
    require(max_range is None or 0.0 < max_range < np.inf, "max_range", "a finite number of metres > 0", max_range)
    low = scans.range_min if min_range is None else float(np.float32(min_range))
    high = scans.range_max if max_range is None else float(np.float32(max_range))
    farthest = FARTHEST if max_range is None else np.inf
    if 0.0 <= low < high <= farthest and high < np.inf:
        return low, high
    if min_range is not None and max_range is not None:
        raise InvalidInputError(f"expected 0 <= min_range < max_range < inf, got {min_range!r} and {max_range!r}")
    wrong = "min_range" if max_range is not None or not 0.0 <= low < np.inf else "max_range"
    furthest = scans.ranges.max(where=np.isfinite(scans.ranges), initial=0.0)
    hint = f" (the furthest reading is {furthest:.6g} m)" if wrong == "max_range" else ""
    raise FormatError(
        path,
        f"expected limits 0 <= range_min < range_max <= {farthest:g}, got {low:.6g} and {high:.6g}; give {wrong}{hint}",
        field=scans.topic,
    )


def resolve_scan_ranges(
    ranges: FloatArray, min_range: float, max_range: float, rule: NoReturnRule, *, limit_given: bool
) -> ResolvedRanges:
    """Return ranges in which the sensor's own values for "no return" are +inf, the limit, and what was done.

    REP 117, "Informational Distance Measurements", needs no conversion: +inf, and what reaches max_range, is no return;
    NaN is no measurement; -inf, and what falls short of min_range, is too close. Where a driver says it otherwise,
    "detect" looks for it:

    1. zeros, if they are at least `FREQUENT`, and less than `RARE` of the readings are +inf or any one value that
       reaches max_range: different ones are measurements, of a sensor that sees further than it declares;
    2. if less than `RARE` of the readings are +inf or reach max_range, one value below max_range that is the greatest
       of all and `CONTRAST` times as frequent as any other in the tenth below it. It is the sensor's true limit then,
       unless the user gives one. Drivers write one value; a far wall in front of a robot that stands is frequent too,
       but its noise spreads it over neighbouring values.

    A zero that is not explained so is not a range: it becomes NaN if min_range is 0 (else it is too close anyway).

    The rule is "detect"; "none" to convert nothing; or the values in metres that mean "no return" (NaN may be among
    them); InvalidInputError if it is another. The ranges (t, k) are those published, of float32 precision.
    """
    if rule == "none":
        return ResolvedRanges(ranges, max_range, NoReturnPolicy(explanation="not looked for, as asked"))
    if not isinstance(rule, str):
        return _given(ranges, max_range, rule)
    require(rule == "detect", "no_return", "'detect', 'none' or a tuple of metres", rule)
    with np.errstate(invalid="ignore"):
        declared = float(np.mean(ranges >= max_range))
    zero = ranges == 0.0
    if float(zero.mean()) >= FREQUENT and _share_of_one_value(ranges, max_range) < RARE:
        why = "are 0, and nothing else says that there was no return" + _beyond(ranges, max_range)
        return _converted(ranges, max_range, zero, (0.0,), "detected", why)
    if declared < RARE:
        code = _find_repeated_maximum(ranges, min_range)
        if code is not None:
            why = f"are exactly {code:.6g} m, the greatest value and far more frequent than those below it"
            return _converted(ranges, max_range if limit_given else code, ranges == code, (code,), "detected", why)
    return _declared(ranges, min_range, max_range, declared, zero)


def limit_doubts(ranges: FloatArray, max_range: float) -> list[str]:
    """Return a note if much of what counts as no return is measurements beyond the declared limit."""
    beyond = ranges[np.isfinite(ranges) & (ranges > max_range)]
    # One value, however frequent, is the sensor's word for "no return".
    different = len(beyond) - np.unique(beyond, return_counts=True)[1].max(initial=0)
    if different <= DOUBTED * ranges.size:
        return []
    note = (
        f"{len(beyond) / ranges.size:.0%} of the readings are beyond the declared range_max of {max_range:.6g} m, "
        f"up to {beyond.max():.6g} m: as in amcl they count as no return; correct the driver, or give max_range"
    )
    return [note]


def _share_of_one_value(ranges: FloatArray, max_range: float) -> float:
    """Return the share of the most frequent value that reaches the limit, +inf among them."""
    with np.errstate(invalid="ignore"):
        _, counts = np.unique(ranges[ranges >= max_range], return_counts=True)
    return float(counts.max(initial=0) / ranges.size)


def _beyond(ranges: FloatArray, max_range: float) -> str:
    """Return what to say of readings beyond the limit; nothing if they are rare."""
    share = float(np.mean(np.isfinite(ranges) & (ranges > max_range)))
    if share < RARE:
        return ""
    return f" ({share:.2%} are numbers beyond {max_range:.6g} m: give max_range if the sensor measures that far)"


def _find_repeated_maximum(ranges: FloatArray, min_range: float) -> float | None:
    """Return the greatest value if it is repeated as no measurement is."""
    readings = ranges[np.isfinite(ranges) & (ranges > min_range)]
    top = float(readings.max(initial=0.0))
    # The tenth below, or more where that is almost empty: a simulated robot that stands repeats every range it sees.
    counts = np.empty(0, dtype=np.int64)
    for nearest in (0.9 * top, 0.5 * top, 0.0):
        counts = np.unique(readings[readings >= nearest], return_counts=True)[1]
        if len(counts) > NEIGHBOURS:
            break
    if len(counts) < 2:
        return None  # one value only: it may be a wall, there is nothing to compare it with
    enough = max(ENOUGH, 2 * RARE * ranges.size, CONTRAST * counts[:-1].max())
    return top if counts[-1] >= enough else None


def _given(ranges: FloatArray, max_range: float, values: tuple[float, ...]) -> ResolvedRanges:
    listed = ", ".join(f"{v:.6g}" for v in values)
    why = f"are one of the given values ({listed})"
    return _converted(ranges, max_range, is_one_of(ranges, values), tuple(float(v) for v in values), "given", why)


def _converted(ranges: FloatArray, max_range: float, mask: NDArray[np.bool_], values: tuple[float, ...], origin: str,
               why: str) -> ResolvedRanges:  # fmt: skip
    share = float(mask.mean())
    policy = NoReturnPolicy(values, share, origin, f"{share:.2%} of the readings {why}")
    return ResolvedRanges(np.where(mask, np.inf, ranges), max_range, policy)


def _declared(ranges: FloatArray, min_range: float, max_range: float, share: float,
              zero: NDArray[np.bool_]) -> ResolvedRanges:  # fmt: skip
    """Return the ranges as REP 117 has them, with what a user should know about them in the explanation."""
    limit = f"{max_range:.6g} m"
    text = f"{share:.2%} of the readings are +inf or reach {limit}" if share else f"no reading reaches {limit}"
    text += _beyond(ranges, max_range)
    if min_range <= 0.0 and zero.any():
        text += f"; {float(zero.mean()):.2%} are 0, taken as no measurement"
        ranges = np.where(zero, np.nan, ranges)
    elif float(zero.mean()) >= FREQUENT:
        text += f"; {float(zero.mean()):.2%} are 0, taken as too close, unless no_return names 0 as well"
    missing = float(np.isnan(ranges).mean())
    if share < RARE and missing >= FREQUENT:
        text += f"; {missing:.2%} are NaN: no measurement, unless no_return names NaN as this sensor's word for it"
    return ResolvedRanges(ranges, max_range, NoReturnPolicy((), share, "declared" if share else "none", text))
