"""Passes over the beams of many shards: each gives sums, which are added in a fixed order."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.intrinsic.likelihood import (
    N_PARAMETERS,
    SLOPE,
    ExpectedStatistics,
    IntrinsicLikelihood,
    cut,
    mixture_of,
)
from beamfield.calibration.time_split import FEWEST_BLOCKS, LONGEST_BLOCK_S
from beamfield.fleet.catalogue import Catalogue
from beamfield.fleet.engine import Engine
from beamfield.fleet.run_record import RunRecord
from beamfield.fleet.shard import Shard
from beamfield.geometry import FloatArray
from beamfield.kernels import narrow_bins

# Beams in memory at a time; with their copies some 60 MB.
BATCH_ROWS = 500_000
# A day of beams has no more blocks than this, so that what it sends back stays small.
MOST_BLOCKS_OF_A_RUN = 64
Sums = TypeVar("Sums")
Combine = Callable[[Sums, Sums], Sums]


@dataclass(frozen=True, order=True)
class SensorLimits:
    """What sensors must share to be learned together: their parameters mean the same then.

    Parameters
    ----------
    max_range, min_range
        Limits of the sensor, metres.
    opening_angle
        Full width of its cones, radians; 0 for beams.
    """

    max_range: float
    min_range: float
    opening_angle: float = 0.0

    @property
    def span(self) -> float:
        """From the nearest range that is measured to the farthest, metres."""
        return self.max_range - self.min_range

    @property
    def text(self) -> str:
        """Which sensors these are, for people."""
        kind = f"Sonars of {math.degrees(self.opening_angle):.3g} degrees" if self.opening_angle else "Range finders"
        least = f" from {self.min_range:g}" if self.min_range else ""
        return f"{kind}{least} up to {self.max_range:g} m"


@dataclass(frozen=True)
class Part:
    """A shard, and how its beams are read.

    Parameters
    ----------
    shard
        The file.
    limits
        Limits of the sensor.
    first_stamp, block_s
        Where its blocks of time begin, and their length, seconds.
    thin
        One beam in this many.
    """

    shard: Shard
    limits: SensorLimits
    first_stamp: float
    block_s: float
    thin: int = 1

    def likelihoods(self) -> Iterator[IntrinsicLikelihood]:
        """Yield the beams to learn from, a batch at a time."""
        for ranges, expected, _ in self.beams():
            yield IntrinsicLikelihood(ranges, expected, self.limits.max_range, min_range=self.limits.min_range)

    def beams(self) -> Iterator[tuple[FloatArray, FloatArray, NDArray[np.int64]]]:
        """Yield ranges, expected ranges and blocks of time of beams whose rays hit something, a batch at a time."""
        columns = ("stamp", "range", "expected_range")
        for batch in self.shard.batches(columns, BATCH_ROWS, fit_only=True, thin=self.thin):
            ranges, expected, hits = metres(batch["range"], batch["expected_range"], self.limits)
            blocks = np.floor((batch["stamp"] - self.first_stamp) / self.block_s).astype(np.int64)
            yield ranges[hits], expected[hits], blocks[hits]


def shard_parts(catalogue: Catalogue, thin: int = 1) -> list[Part]:
    """Return the shards of a catalogue by path, to be read one beam in `thin`."""
    records = {record.run: record for record in catalogue.used}
    parts = []
    for shard in catalogue.shards():
        record = records[shard.run]
        duration = max(record.last_stamp - record.first_stamp, 1e-3)
        block = max(min(LONGEST_BLOCK_S, duration / FEWEST_BLOCKS), duration / MOST_BLOCKS_OF_A_RUN)
        parts.append(Part(shard, sensor_limits(record), record.first_stamp, block, thin))
    return parts


def sensor_limits(record: RunRecord) -> SensorLimits:
    """Return the limits of a run's sensor."""
    finder = record.finder
    return SensorLimits(finder.max_range, finder.min_range, finder.opening_angle)


def metres(
    ranges: NDArray[np.float32], expected_ranges: NDArray[np.float32], limits: SensorLimits
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return ranges and expected ranges as doubles inside the sensor's limits, and which rays hit something.

    Single precision rounds the limits: a file's 5.6 is less than 5.6, and yet no return.
    """
    farthest = np.float32(limits.max_range)
    z, expected = ranges.astype(np.float64), expected_ranges.astype(np.float64)
    z[ranges >= farthest] = limits.max_range
    expected[expected_ranges >= farthest] = limits.max_range
    np.maximum(z, limits.min_range, out=z)
    return z, expected, expected_ranges < farthest


class ShardedLikelihood:
    """The log-likelihood of the beams of many shards; each call reads them once.

    Parameters
    ----------
    parts
        The shards, in the order that their sums are added in; sensors of equal limits.
    engine
        Where they are read.
    theta
        (8,) working vector of a first pass, which counts the beams.

    Notes
    -----
    What comes back from a shard has a bounded size, however many beams it has, and the pairwise sums are the same to
    the bit for any number of workers.
    """

    def __init__(self, parts: Sequence[Part], engine: Engine, theta: FloatArray) -> None:
        self.parts = parts
        self.engine = engine
        self.passes = 0
        self.n_beams, self.n_max = 0.0, 0.0
        self.at_start = self.derivatives(theta)

    def derivatives(self, theta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the log-likelihood, its gradient (8,) and its Hessian (8, 8), as `IntrinsicLikelihood`."""
        sums = self._sum(partial(_derivatives, theta=theta), np.add)
        self.n_beams, self.n_max = float(sums[0]), float(sums[1])
        return float(sums[2]), sums[3 : 3 + N_PARAMETERS], sums[3 + N_PARAMETERS :].reshape(N_PARAMETERS, N_PARAMETERS)

    def expected_statistics(self, theta: FloatArray, *, slope_is_free: bool = False) -> ExpectedStatistics:
        """Do the E-step, as `IntrinsicLikelihood`; its nodes are those of all shards, merged."""
        add: Combine[ExpectedStatistics] = partial(add_statistics, theta=theta, limits=self.parts[0].limits)
        return self._sum(partial(_statistics, theta=theta, slope_is_free=slope_is_free), add)

    def blocks(self, theta: FloatArray) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
        """Return beams (b,) and gradient (b, 8) of each block of time, and the Hessian of all beams (8, 8)."""
        sizes, gradients, hessian = self._sum(partial(_blocks, theta=theta), _add_blocks)
        return sizes.astype(np.int64), gradients, hessian

    def _sum(self, function: Callable[[Part], Sums], combine: Combine[Sums]) -> Sums:
        self.passes += 1
        return self.engine.reduce(function, self.parts, combine)


def add_statistics(
    first: ExpectedStatistics, second: ExpectedStatistics, *, theta: FloatArray, limits: SensorLimits
) -> ExpectedStatistics:
    """Return the statistics of two sets of beams together, of E-steps with the same working vector theta (8,).

    Nodes are cut into bins as beams are, and 8 nodes stand for those of a bin: what the M-step integrates is a
    polynomial there to rounding.
    """
    both = replace(
        first,
        log_likelihood=first.log_likelihood + second.log_likelihood,
        counts=first.counts + second.counts,
        node_ranges=np.concatenate([first.node_ranges, second.node_ranges]),
        node_hit=np.concatenate([first.node_hit, second.node_hit], axis=1),
        node_short=np.concatenate([first.node_short, second.node_short]),
        sum_short_range=first.sum_short_range + second.sum_short_range,
        cut_matters=first.cut_matters or second.cut_matters,
    )
    return _merged(both, theta, limits)


def _merged(statistics: ExpectedStatistics, theta: FloatArray, limits: SensorLimits) -> ExpectedStatistics:
    if statistics.node_ranges.size == 0:
        return statistics
    order = np.argsort(statistics.node_ranges, kind="stable")
    nodes = statistics.node_ranges[order]
    bins = cut(nodes, mixture_of(theta, limits.span, limits.min_range))
    sizes = bins.stops - bins.starts
    t = (nodes - np.repeat(bins.centres, sizes)) / np.repeat(bins.half_widths, sizes)
    weights = np.concatenate([statistics.node_hit, statistics.node_short[None]])[:, order]
    chebyshev = np.cos(np.arange(narrow_bins.TERMS)[:, None] * np.arccos(np.clip(t, -1.0, 1.0)))
    moments = np.add.reduceat(weights[:, None] * chebyshev, bins.starts, axis=2)  # (4, terms, bins)
    merged = (moments.transpose(0, 2, 1) @ narrow_bins.NODE_WEIGHTS).reshape(4, -1)
    ranges = (bins.centres[:, None] + bins.half_widths[:, None] * narrow_bins.NODES).reshape(-1)
    return replace(statistics, node_ranges=ranges, node_hit=merged[:3], node_short=merged[3])


def _derivatives(part: Part, theta: FloatArray) -> FloatArray:
    sums = np.zeros(3 + N_PARAMETERS + N_PARAMETERS**2)
    for likelihood in part.likelihoods():
        value, gradient, hessian = likelihood.derivatives(theta)
        sums += np.concatenate([[likelihood.n_beams, likelihood.n_max, value], gradient, hessian.reshape(-1)])
    return sums


def _statistics(part: Part, theta: FloatArray, slope_is_free: bool) -> ExpectedStatistics:
    none = np.empty(0)
    total = ExpectedStatistics(0.0, np.zeros(4), none, np.empty((3, 0)), none, 0.0, cut_matters=False)
    all_moments = bool(slope_is_free or theta[SLOPE] > 0.0)
    for likelihood in part.likelihoods():
        of_batch = likelihood.expected_statistics(theta, slope_is_free=all_moments)
        total = add_statistics(total, of_batch, theta=theta, limits=part.limits)
    return total


def _blocks(part: Part, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    sums: dict[int, FloatArray] = {}
    hessian = np.zeros((N_PARAMETERS, N_PARAMETERS))
    for ranges, expected, blocks in part.beams():
        for block in np.unique(blocks):
            rows = blocks == block
            likelihood = IntrinsicLikelihood(
                ranges[rows], expected[rows], part.limits.max_range, min_range=part.limits.min_range
            )
            _, gradient, of_block = likelihood.derivatives(theta)
            hessian += of_block
            added = np.concatenate([[likelihood.n_beams], gradient])
            sums[int(block)] = sums.get(int(block), np.zeros(1)) + added
    table = np.array([sums[block] for block in sorted(sums)]).reshape(-1, 1 + N_PARAMETERS)
    return table[:, 0], table[:, 1:], hessian


def _add_blocks(
    first: tuple[FloatArray, FloatArray, FloatArray], second: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    return np.concatenate([first[0], second[0]]), np.concatenate([first[1], second[1]]), first[2] + second[2]
