"""What of a stack's parameters is fitted, in which coordinates, and which settings are tried."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder
from beamfield.stacks.fit.likelihood_values import from_likelihood

# Below 2.5 sigma a maximum distance would cut into the hits; the rest is for rounding when values are written.
SHORTEST_REACH = 2.501
# Numbers of beams that are tried, few first.
BEAM_COUNTS = (4, 6, 9, 13, 20, 30, 60, 120)
# Where the search looks first: metres, pixels, multiples of sigma, log odds.
SIGMAS = (0.03, 0.05, 0.08, 0.13, 0.2, 0.32)
WIDE_SIGMAS = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
PIXELS = (0.5, 1.0, 2.0, 4.0, 8.0)
REACHES = (SHORTEST_REACH, 5.0, 10.0)
LOG_ODDS = (-3.0, -1.0, 1.0, 3.0, 5.0, 7.0)
SQUASHES = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
# No log is long enough to show that random readings are rarer than one in a hundred: what it lacks a robot will meet.
LEAST_SHARE = 0.01


@dataclass(frozen=True)
class Coordinate:
    """One number that the optimiser moves.

    Parameters
    ----------
    name
        What it stands for.
    get, put
        From parameters to the number, and back into parameters.
    step
        Its first step.
    low, high
        Its bounds.
    grid
        Values to look at before the optimiser starts; those out of bounds are left out.
    """

    name: str
    get: Callable[[Any], float]
    put: Callable[[Any, float], Any]
    step: float
    low: float
    high: float
    grid: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class FitSpace:
    """The coordinates and settings of one stack's model.

    Parameters
    ----------
    coordinates
        What is moved continuously; empty if likelihood gives all.
    settings
        Values of the discrete parameters that are tried, by name, fewest beams first.
    first_guess
        Parameters to start each fit from.
    usable_start
        The user's parameters, changed only where the program itself could not run with them.
    from_likelihood
        Whether `first_guess` has values learned by maximum likelihood.
    """

    coordinates: tuple[Coordinate, ...]
    settings: tuple[Mapping[str, Any], ...]
    first_guess: Any
    usable_start: Any
    from_likelihood: bool

    def grid(self, parameters: Any) -> list[FloatArray]:
        """Return the points to look at first: those of parameters, and every combination of the coordinates' grids."""
        axes = [[value for value in item.grid if item.low <= value <= item.high] for item in self.coordinates]
        return [self.point(parameters), *(np.array(values) for values in product(*axes))] if axes else [np.zeros(0)]

    def point(self, parameters: Any) -> FloatArray:
        """Return the coordinates of parameters, within their bounds."""
        return np.array([min(max(item.get(parameters), item.low), item.high) for item in self.coordinates])

    def parameters(self, base: Any, point: FloatArray) -> Any:
        """Return parameters with these coordinates and everything else as in `base`."""
        for item, value in zip(self.coordinates, point.tolist(), strict=True):
            base = item.put(base, min(max(value, item.low), item.high))
        return base

    def simplex(self, first: FloatArray) -> FloatArray:
        """Return a starting simplex (n + 1, n) for Nelder and Mead."""
        corners = [first]
        for i, item in enumerate(self.coordinates):
            corner = first.copy()
            corner[i] += item.step if corner[i] + item.step <= item.high else -item.step
            corners.append(corner)
        return np.array(corners)


def fit_space(
    stack: str, model: str, start: Any, finder: RangeFinder, grid: OccupancyGrid, likelihood: BeamParameters | None
) -> FitSpace:
    """Return what to fit of a stack's model.

    Parameters
    ----------
    stack, model
        Which.
    start
        The stack's parameters.
    finder
        The sensor.
    grid
        The map.
    likelihood
        The chapter's beam model by maximum likelihood; None if it is not known.
    """
    counts = [n for n in BEAM_COUNTS if n <= finder.n_beams] or [finder.n_beams]
    if stack == "mrpt":
        return _mrpt(model, start, finder, grid, counts)
    if stack == "f1tenth":
        return _f1tenth(start, finder, grid, likelihood, counts)
    return _amcl(stack, model, start, finder, grid, likelihood, counts)


def _amcl(
    stack: str, model: str, start: Any, finder: RangeFinder, grid: OccupancyGrid, likelihood: BeamParameters | None,
    counts: Sequence[int],
) -> FitSpace:  # fmt: skip
    prefix = "laser_" if stack == "ros1" else ""
    beams = f"{prefix}max_beams"
    usable = start
    # A scan of one beam is refused by the emulators of what never returns from it.
    if getattr(start, beams) > max(2, finder.n_beams):
        usable = replace(start, **{beams: max(2, finder.n_beams)})
    settings = tuple({beams: max(2, n)} for n in counts)
    if model == "beam":
        first, learned = from_likelihood(stack, usable, likelihood, finder, grid)
        if learned:
            return FitSpace((), settings, first, usable, True)
        weights = (f"{prefix}z_hit", f"{prefix}z_short", f"{prefix}z_max", f"{prefix}z_rand")
        shares = (_share(weights, weights[3]), _log(f"{prefix}sigma_hit", 0.4, narrowest(grid), 1.0, SIGMAS))
        return FitSpace(shares, settings, first, usable, False)
    coordinates = (
        _share((f"{prefix}z_hit", f"{prefix}z_rand"), f"{prefix}z_rand"),
        _log(f"{prefix}sigma_hit", 0.4, narrowest(grid), 1.0, SIGMAS),
        _reach("laser_likelihood_max_dist", f"{prefix}sigma_hit"),
    )
    return FitSpace(coordinates, settings, usable, usable, False)


def narrowest(grid: OccupancyGrid) -> float:
    """Return the least sigma that a map shows, metres: walls are drawn up to half a cell from where they are."""
    return max(0.01, grid.resolution / 2.0)


def _mrpt(model: str, start: Any, finder: RangeFinder, grid: OccupancyGrid, counts: Sequence[int]) -> FitSpace:
    if model == "LF_Thrun":
        coordinates: tuple[Coordinate, ...] = (
            _share(("LF_zHit", "LF_zRandom"), "LF_zRandom"),
            _log("LF_stdHit", 0.4, narrowest(grid), 1.0, SIGMAS),
        )
        decimation = "LF_decimation"
    else:
        coordinates, decimation = (
            (_log("rayTracing_stdHit", 0.4, narrowest(grid), 3.0, WIDE_SIGMAS),),
            "rayTracing_decimation",
        )
    steps = sorted({max(1, round(finder.n_beams / n)) for n in counts}, reverse=True)
    return FitSpace(coordinates, tuple({decimation: step} for step in steps), start, start, False)


def _f1tenth(
    start: Any, finder: RangeFinder, grid: OccupancyGrid, likelihood: BeamParameters | None, counts: Sequence[int]
) -> FitSpace:
    first, learned = from_likelihood("f1tenth", start, likelihood, finder, grid)
    coordinates = [_log("squash_factor", 0.7, 0.5, 100.0, SQUASHES)]
    if not learned:
        weights = ("z_hit", "z_short", "z_max", "z_rand")
        coordinates += [_share(weights, "z_rand"), _log("sigma_hit", 0.4, 0.3, 40.0, PIXELS)]
    # One count will do: the exponent 1 / squash_factor makes up for more beams.
    steps = sorted({max(1, round(finder.n_beams / n)) for n in counts if 20 <= n <= 60} or {1}, reverse=True)
    return FitSpace(tuple(coordinates), tuple({"angle_step": step} for step in steps), first, start, learned)


def _log(name: str, step: float, low: float, high: float, grid: tuple[float, ...]) -> Coordinate:
    """Return a positive parameter by its logarithm."""
    return Coordinate(
        name,
        lambda parameters: math.log(getattr(parameters, name)),
        lambda parameters, value: replace(parameters, **{name: math.exp(value)}),
        step,
        math.log(low),
        math.log(high),
        tuple(math.log(value) for value in grid),
    )


def _reach(name: str, sigma: str) -> Coordinate:
    """Return a maximum distance by the logarithm of its ratio to sigma, which is put first."""
    return Coordinate(
        name,
        lambda parameters: math.log(getattr(parameters, name) / getattr(parameters, sigma)),
        lambda parameters, value: replace(parameters, **{name: math.exp(value) * getattr(parameters, sigma)}),
        -0.7,
        math.log(SHORTEST_REACH),
        math.log(20.0),
        tuple(math.log(value) for value in REACHES),
    )


def _share(names: tuple[str, ...], name: str) -> Coordinate:
    """Return one of several weights by the log odds of its share; the others keep their ratios, all sum to 1."""

    def get(parameters: Any) -> float:
        total = sum(getattr(parameters, other) for other in names)
        share = min(max(getattr(parameters, name) / total, 1e-6), 1.0 - 1e-6) if total > 0.0 else 0.5
        return math.log(share / (1.0 - share))

    def put(parameters: Any, value: float) -> Any:
        share = 1.0 / (1.0 + math.exp(-value))
        others = [other for other in names if other != name]
        rest = sum(getattr(parameters, other) for other in others)
        values = {
            other: (1.0 - share) * (getattr(parameters, other) / rest if rest > 0.0 else 1.0 / len(others))
            for other in others
        }
        return replace(parameters, **values, **{name: share})

    return Coordinate(f"share of {name}", get, put, 1.0, math.log(LEAST_SHARE / (1.0 - LEAST_SHARE)), 9.0, LOG_ODDS)
