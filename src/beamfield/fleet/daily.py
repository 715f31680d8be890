"""Numbers per robot and day in which faults of lidars, mounts and wheels show."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import checked
from beamfield.errors import InvalidInputError
from beamfield.fleet.catalogue import Catalogue
from beamfield.fleet.engine import Engine
from beamfield.fleet.learning import FleetFit
from beamfield.fleet.run_record import RunRecord
from beamfield.fleet.shard_passes import BATCH_ROWS, Part, SensorLimits, metres, shard_parts
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr

FaultKind = Literal["dirty-lens", "turned-mount", "range-bias", "wheel-scale"]
UNITS: dict[FaultKind, str] = {"dirty-lens": "share", "turned-mount": "rad", "range-bias": "m", "wheel-scale": "1"}
# Which error of odometry shows a fault.
_ODOMETRY: dict[FaultKind, str] = {"turned-mount": "yaw", "wheel-scale": "distance_scale"}
CAUSES = ("max", "short")

# Of bearings, all around; a series is about two neighbours, 30 degrees, as a smear covers 10 to 40.
N_SECTORS = 24
_EDGES = np.linspace(-np.pi, np.pi, N_SECTORS + 1)
_WIDTH = 2.0 * np.pi / N_SECTORS
# A day's usual share takes so many sectors; those so far apart share no smear.
_FEWEST_SECTORS, _SMEAR_SECTORS = 3, 4
# A reading so many sigma_hit before the wall is short.
_SHORT_SIGMAS = 4.0
# Residuals up to so many sigma_hit, or metres, are those of hits: a biased sensor's too.
_HIT_SIGMAS, _HIT_WINDOW = 6.0, 0.3
# Fewer hits of a block, or beams of 15 degrees and a day, tell nothing.
_FEWEST_HITS = 50
_FEWEST_BEAMS = 100
# A day with less of this share of a robot's usual beams, or with so many times its usual error, is no day's work.
_LEAST_SHARE, _LARGEST_ERROR = 0.25, 3.0


@dataclass(frozen=True, eq=False)
class DailySeries:
    """One number per day of a robot.

    Parameters
    ----------
    robot, site
        Whose.
    fault
        What shows in it: "dirty-lens" (share of readings without return, or before the wall, in a sector of
        bearings), "turned-mount" (yaw of the laser against the direction of motion, rad), "range-bias" (median
        residual of hits, metres), "wheel-scale" (relative error of odometry's distances).
    unit
        "share", "rad", "m" or "1".
    days
        Of the values, ascending.
    values, standard_errors
        In `unit`, shape (d,); the errors tell how a day's beams vary, by blocks of time, not how days do.
    contrasts
        What is compared over days, shape (d,): for a dirty lens the log odds of the share less their median over the
        sectors that are 60 degrees and more away, so that a crowded day does not count; else the values.
    contrast_errors
        Standard errors of the contrasts, shape (d,), by blocks of time; for shares at least binomial ones.
    bearings
        (from, to) of the sector of 30 degrees, radians in the robot frame, from -pi on; None for the other faults.
        Neighbouring sectors overlap by half.
    cause
        "max" (no return) or "short" (before the wall) for a dirty lens, else "".
    """

    robot: str
    site: str
    fault: FaultKind
    unit: str
    days: tuple[datetime.date, ...]
    values: FloatArray
    standard_errors: FloatArray
    contrasts: FloatArray
    contrast_errors: FloatArray
    bearings: tuple[float, float] | None = None
    cause: str = ""

    __repr__ = short_repr


@checked
def daily_series(catalogue: Catalogue, engine: Engine, fleet: FleetFit) -> tuple[DailySeries, ...]:
    """Return the daily numbers of all robots; beams are read once.

    Parameters
    ----------
    catalogue, engine
        The beams, and where they are read.
    fleet
        Of ``learn(by="fleet")``: says which readings are hits, and which lie before the wall.

    Returns
    -------
    By site, robot, fault, cause and sector; only those with a value. Days on which a robot did less than a quarter of
    its usual work are left out.

    Raises
    ------
    InvalidInputError
        If the fit is not one of the fleet, or lacks a sensor of the catalogue.
    FormatError
        If a shard is damaged.
    """
    parameters = {fit.limits: fit.parameters for fit in fleet.fits}
    parts = shard_parts(catalogue)
    if fleet.left_out:  # sensors with too few beams to learn from
        parts = [part for part in parts if part.limits in parameters]
    if fleet.by != "fleet" or not all(part.limits in parameters for part in parts):
        raise InvalidInputError("fleet: expected a fit by fleet of all sensors of the catalogue")
    days: dict[tuple[str, str], dict[datetime.date, _Sums]] = {}
    for part, sums in zip(parts, engine.map(partial(_sums, parameters=parameters), parts), strict=True):
        of_robot = days.setdefault((part.shard.site, part.shard.robot), {})
        day = part.shard.day
        of_robot[day] = _Sums(*(a + b for a, b in zip(of_robot[day], sums, strict=True))) if day in of_robot else sums
    return tuple(
        series
        for site, robot in sorted(days)
        for series in (
            *_lens_series(robot, site, days[site, robot]),
            *_bias_series(robot, site, days[site, robot]),
            *_odometry_series(robot, site, [r for r in catalogue.used if (r.site, r.robot) == (site, robot)]),
        )
    )


class _Sums(NamedTuple):
    """Of a robot's day; squares are those of blocks about the day's share.

    By sector and cause, (s, 2), and medians of residuals by block: their number, sum and sum of squares.
    """

    beams: FloatArray
    counts: FloatArray
    squares: FloatArray
    medians: FloatArray


def _sums(part: Part, parameters: Mapping[SensorLimits, BeamParameters]) -> _Sums:
    beams: dict[int, FloatArray] = {}
    counts: dict[int, FloatArray] = {}
    medians = np.zeros(3)
    model = parameters[part.limits]
    sigma, offset = model.sigma_hit, model.range_offset
    columns = ("stamp", "bearing", "range", "expected_range")
    for batch in part.shard.batches(columns, BATCH_ROWS):
        ranges, expected, hits = metres(batch["range"], batch["expected_range"], part.limits)
        sector = np.clip(np.searchsorted(_EDGES, batch["bearing"], side="right") - 1, 0, N_SECTORS - 1)
        block = np.floor((batch["stamp"] - part.first_stamp) / part.block_s).astype(np.int64)
        residual = ranges - expected - offset
        no_return = ranges >= part.limits.max_range
        spread = np.sqrt(sigma**2 + (model.sigma_slope * expected) ** 2)
        short = ~no_return & (residual < -_SHORT_SIGMAS * spread)
        is_hit = hits & (np.abs(residual) < max(_HIT_SIGMAS * sigma, _HIT_WINDOW))
        for number in np.unique(block):
            rows = hits & (block == number)
            n = np.bincount(sector[rows], minlength=N_SECTORS).astype(np.float64)
            each = [np.bincount(sector[rows & of], minlength=N_SECTORS) for of in (no_return, short)]
            beams[number] = beams.get(number, np.zeros(1)) + n[:, None]
            counts[number] = counts.get(number, np.zeros(1)) + np.stack(each, axis=1)
            if np.count_nonzero(rows & is_hit) >= _FEWEST_HITS:
                median = float(np.median(residual[rows & is_hit])) + offset
                medians += (1.0, median, median**2)
    n, k = (np.array([sums[number] for number in sorted(sums)]) for sums in (beams, counts))  # (b, s, 1) and (b, s, 2)
    if not len(n):
        return _Sums(np.zeros((N_SECTORS, 1)), np.zeros((N_SECTORS, 2)), np.zeros((N_SECTORS, 2)), medians)
    share = k.sum(axis=0) / np.maximum(n.sum(axis=0), 1.0)
    return _Sums(n.sum(axis=0), k.sum(axis=0), ((k - share * n) ** 2).sum(axis=0), medians)


def _lens_series(robot: str, site: str, days: dict[datetime.date, _Sums]) -> list[DailySeries]:
    dates = sorted(days)
    n = np.array([days[day].beams for day in dates])  # (d, s, 1)
    k, squares = (np.array([getattr(days[day], name) for day in dates]) for name in ("counts", "squares"))
    worked = _worked(n.sum(axis=(1, 2)))
    dates = [day for day, is_work in zip(dates, worked, strict=True) if is_work]
    n, k, squares = n[worked], k[worked], squares[worked]
    seen = (n[:, :, 0] >= _FEWEST_BEAMS).all(axis=0)  # (s,) every day
    seen &= np.roll(seen, -1)
    n, k, squares = (column + np.roll(column, -1, axis=1) for column in (n, k, squares))
    if np.count_nonzero(seen) < _FEWEST_SECTORS:
        return []
    odds = np.log((k + 0.5) / (n - k + 0.5))
    contrasts = odds - np.stack([np.median(odds[:, _elsewhere(j, seen)], axis=1) for j in range(N_SECTORS)], axis=1)
    inside = (k + 0.5) * (n - k + 0.5) / (n + 1.0)  # n p (1 - p)
    errors = np.sqrt(np.maximum(1.0 / inside, squares / inside**2))
    return [
        DailySeries(
            robot, site, "dirty-lens", "share", tuple(dates),
            values=k[:, j, c] / n[:, j, 0],
            standard_errors=np.sqrt(squares[:, j, c]) / n[:, j, 0],
            contrasts=contrasts[:, j, c],
            contrast_errors=errors[:, j, c],
            bearings=(float(_EDGES[j]), float(_EDGES[j]) + 2.0 * _WIDTH),
            cause=cause,
        )
        for c, cause in enumerate(CAUSES)
        for j in np.flatnonzero(seen)
    ]  # fmt: skip


def _elsewhere(sector: int, seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the sectors that no smear shares with this one; all, where these are too few.

    The median of all would rise with the sectors that are dirty beside it, and make the dirt seem less.
    """
    steps = np.abs(np.arange(N_SECTORS) - sector)
    far = seen & (np.minimum(steps, N_SECTORS - steps) >= _SMEAR_SECTORS)
    return far if np.count_nonzero(far) >= _FEWEST_SECTORS else seen


def _bias_series(robot: str, site: str, days: dict[datetime.date, _Sums]) -> list[DailySeries]:
    dates = [day for day in sorted(days) if days[day].medians[0] >= 2.0]
    if not dates:
        return []
    n, total, square = np.array([days[day].medians for day in dates]).T
    errors = np.sqrt(np.maximum(square / n - (total / n) ** 2, 0.0) / (n - 1.0))
    worked = _worked(n)
    return [_plain(robot, site, "range-bias", np.array(dates)[worked].tolist(), (total / n)[worked], errors[worked])]


def _odometry_series(robot: str, site: str, records: Sequence[RunRecord]) -> list[DailySeries]:
    found = []
    for fault, name in _ODOMETRY.items():
        estimates = sorted(
            (_day(record), *known)
            for record in records
            if record.odometry is not None and (known := record.odometry.estimate(name)) is not None
        )
        dates, values, errors = [], [], []
        for day, of_day in groupby(estimates, key=lambda item: item[0]):
            _, value, error = np.array(list(of_day), dtype=object).T
            weight = 1.0 / np.maximum(error.astype(np.float64), 1e-9) ** 2
            dates.append(day)
            values.append(float(weight @ value.astype(np.float64) / weight.sum()))
            errors.append(1.0 / math.sqrt(weight.sum()))
        if dates:
            good = np.array(errors) <= _LARGEST_ERROR * float(np.median(errors))
            kept = [day for day, is_good in zip(dates, good, strict=True) if is_good]
            found.append(_plain(robot, site, fault, kept, np.array(values)[good], np.array(errors)[good]))
    return found


def _plain(
    robot: str, site: str, fault: FaultKind, days: list[datetime.date], values: FloatArray, errors: FloatArray
) -> DailySeries:
    return DailySeries(robot, site, fault, UNITS[fault], tuple(days), values, errors, values, errors)


def _day(record: RunRecord) -> datetime.date:
    return datetime.datetime.fromtimestamp(record.first_stamp, datetime.UTC).date()


def _worked(amounts: FloatArray) -> FloatArray:
    return np.asarray(amounts >= _LEAST_SHARE * np.median(amounts))
