"""Numbers per scan that say how badly it fits: the statistics behind the p-value and the lost probability."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.indices import subset_of
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.range_mixture import RangeMixtureModel
from beamfield.scan_fit.surprise import MOST_SURPRISE, BeamSurprise, beam_surprise
from beamfield.sensors import RangeFinder, Scan, usable_ranges
from beamfield.short_repr import short_repr

Progress = Callable[[int, int], None]
FitModel = RangeMixtureModel | LikelihoodFieldModel

# Neighbouring beams within this angle are looked at together, radians: a moved cupboard or a wrong pose misleads
# whole groups of beams, noise does not. From 5 to 30 degrees the choice hardly mattered on simulated changes of maps.
WINDOW = math.radians(20.0)
# Weight of the share of beams on one side against excess surprise, nats.
SIDE_WEIGHT = 2.0
# Beams per call of the ray caster: keeps memory small and progress alive.
BEAMS_PER_CHUNK = 1 << 17


@dataclass(frozen=True, eq=False)
class FitStatistics:
    """How badly scans fit, one entry per scan; NaN where a scan says nothing (`n_beams` is 0).

    Parameters
    ----------
    surprise
        (t,) mean over beams of the excess surprise, nats: about 0 for the model's own scans.
    misfit
        (t,) how coherently beams disagree: root mean square over groups of neighbouring beams of their excess surprise
        and of their one-sidedness (through or short). Large where whole groups of beams disagree.
    through, short
        (t,) share of beams beyond the mapped obstacle, and before it, minus what the model expects; NaN for a
        likelihood field, which has no expected ranges.
    n_beams
        (t,) beams that count.
    """

    surprise: FloatArray
    misfit: FloatArray
    through: FloatArray
    short: FloatArray
    n_beams: NDArray[np.int64]

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.surprise)

    def select(self, scans: ArrayLike) -> FitStatistics:
        """Return the statistics of the given scans, indices or a mask (t,), in the given order."""
        return subset_of(self, scans, len(self), "scans", [item.name for item in fields(self)])


def fit_statistics(
    model: FitModel, ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike, *, progress: Progress | None = None
) -> FitStatistics:
    """Return how badly each scan fits the map at its pose; columns (t,), NaN where a scan says nothing.

    The model is a `BeamModel`, `SonarModel` or `LikelihoodFieldModel`, else InvalidInputError; its exponent and n_beams
    do not matter: all beams count. Beams whose ray enters unknown space before an obstacle say nothing: what they
    should measure is not known. A scan whose pose (3,) is NaN says nothing. `progress` is called with (done, total)
    scans.
    """
    z = np.asarray(ranges, dtype=np.float64)
    robots = np.asarray(poses, dtype=np.float64)
    if z.ndim != 2 or z.shape[1] != finder.n_beams or robots.shape != (len(z), 3):
        raise InvalidInputError(
            f"ranges and poses: expected shapes (t, {finder.n_beams}) and (t, 3), got {z.shape} and {robots.shape}"
        )
    judge = _Judge(model, finder)
    parts: list[tuple[Any, ...]] = [(*(np.zeros(0) for _ in range(4)), np.zeros(0, np.int64))]
    step = max(1, BEAMS_PER_CHUNK // max(finder.n_beams, 1))
    for start in range(0, len(z), step):
        rows = slice(start, min(start + step, len(z)))
        parts.append(judge(z[rows], robots[rows]))
        if progress is not None:
            progress(rows.stop, len(z))
    return FitStatistics(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


@dataclass
class _Judge:
    """What the chunks of one call share."""

    model: FitModel
    finder: RangeFinder
    stopping: RayCaster | None = field(init=False, default=None)
    window: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]] = field(init=False)

    def __post_init__(self) -> None:
        check_fields(self)
        if isinstance(self.model, RangeMixtureModel):
            self.stopping = stopping_rays(self.model)
        self.window = _windows(self.finder.bearings)

    def __call__(self, ranges: FloatArray, poses: FloatArray) -> tuple[Any, ...]:
        posed = np.asarray(np.isfinite(poses).all(axis=1))
        z = usable_ranges(ranges, self.finder)
        z[~posed] = np.nan
        robots = np.where(posed[:, None], poses, 0.0)
        if isinstance(self.model, LikelihoodFieldModel):
            return self._summarise(_field_surprise(self.model, z, robots, self.finder), sided=False)
        expected = known_expected_ranges(self.model, self.stopping, robots, self.finder)
        max_range, min_range = self.finder.max_range, self.finder.min_range
        surprise = beam_surprise(z, expected, max_range, self.model.parameters, min_range=min_range)
        return self._summarise(surprise, sided=True)

    def _summarise(self, beams: BeamSurprise, *, sided: bool) -> tuple[Any, ...]:
        n = beams.used.sum(axis=1)
        silent = n == 0
        share = 1.0 / np.maximum(n, 1)

        def mean(values: FloatArray) -> FloatArray:
            return np.where(silent, np.nan, values.sum(axis=1) * share)

        smooth, side = self._smooth(beams.excess, beams.used), self._smooth(beams.through - beams.short, beams.used)
        squares = np.square(np.maximum(smooth, 0.0)) + np.square(SIDE_WEIGHT * side)
        misfit = np.sqrt(mean(np.where(beams.used, squares, 0.0)))
        none = np.full(len(n), np.nan)
        through, short = (mean(beams.through), mean(beams.short)) if sided else (none, none)
        return mean(beams.excess), misfit, through, short, n.astype(np.int64)

    def _smooth(self, values: FloatArray, used: NDArray[np.bool_]) -> FloatArray:
        """Return each beam's mean over the used beams within half a window to either side."""
        order, first, behind = self.window
        sums, counts = (np.zeros((len(values), values.shape[1] + 1)) for _ in range(2))
        np.cumsum(values[:, order], axis=1, out=sums[:, 1:])
        np.cumsum(used[:, order], axis=1, out=counts[:, 1:])
        total, count = sums[:, behind] - sums[:, first], counts[:, behind] - counts[:, first]
        result = np.empty_like(values)
        result[:, order] = total / np.maximum(count, 1.0)
        return result


def _field_surprise(model: LikelihoodFieldModel, z: FloatArray, poses: FloatArray, finder: RangeFinder) -> BeamSurprise:
    """How much less likely each end point is than one on an obstacle; readings of max_range are left out.

    A likelihood field is not a density over z, so there is no expectation to subtract; half a nat is what a hit with
    Gaussian noise loses on average.
    """
    used = np.isfinite(z) & (z < finder.max_range)
    parameters = model.parameters
    best = parameters.z_hit / (math.sqrt(2.0 * math.pi) * parameters.sigma_hit) + parameters.z_rand / finder.max_range
    loss = np.zeros(z.shape)
    every_beam = model if model.n_beams is None else replace(model, n_beams=None)
    for i in np.flatnonzero(used.any(axis=1)):
        loss[i] = math.log(best) - every_beam.beam_log_likelihood(Scan(z[i], finder), poses[i]) / every_beam.exponent
    excess = np.where(used, np.clip(loss - 0.5, -MOST_SURPRISE, 2.0 * MOST_SURPRISE), 0.0)
    return BeamSurprise(np.asarray(used), excess, np.zeros(z.shape), np.zeros(z.shape))


def stopping_rays(model: RangeMixtureModel) -> RayCaster | None:
    """Return a caster in the model's grid whose rays stop at unknown cells; None where that says nothing new.

    That is without a grid or unknown cells, or where the model's own rays stop there.
    """
    grid = grid_of(model)
    if grid is None or getattr(model, "unknown", "free") != "free" or not grid.unknown.any():
        return None
    return RayCaster(grid, unknown="occupied")


def known_expected_ranges(
    model: RangeMixtureModel, stopping: RayCaster | None, poses: FloatArray, finder: RangeFinder
) -> FloatArray:
    """Return expected ranges (t, k), metres; NaN where the ray enters unknown space first.

    `stopping` casts rays that stop at unknown cells; None: there are none.
    """
    expected = model.expected(poses, finder)
    if stopping is not None:
        stopped = stopping.expected_ranges(poses, finder)
        expected = np.where(stopped < expected - 1e-9, np.nan, expected)
    return expected


def grid_of(model: FitModel) -> OccupancyGrid | None:
    """Return the grid that a model is built on; None for a map of landmarks."""
    if isinstance(model, LikelihoodFieldModel):
        return model.distances.grid
    for name in ("grid", "map"):
        if isinstance(grid := getattr(model, name, None), OccupancyGrid):
            return grid
    return None


def _windows(bearings: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return beams by bearing, and the first and one past the last neighbour of each (no window spans +-pi)."""
    order = np.argsort(bearings, kind="stable")
    angle = bearings[order]
    reach = 0.5 * WINDOW + 1e-9
    return order, np.searchsorted(angle, angle - reach, "left"), np.searchsorted(angle, angle + reach, "right")
