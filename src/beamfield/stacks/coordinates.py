"""What a fit moves of a model's parameters: numbers in coordinates of their own, and settings tried in turn."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder

# Below 2.5 sigma a maximum distance would cut into the hits; the rest is for rounding when values are written.
SHORTEST_REACH = 2.501
# Where the search looks first: metres, multiples of sigma, log odds.
SIGMAS = (0.03, 0.05, 0.08, 0.13, 0.2, 0.32)
REACHES = (SHORTEST_REACH, 5.0, 10.0)
LOG_ODDS = (-3.0, -1.0, 1.0, 3.0, 5.0, 7.0)
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
    from_likelihood: bool = False

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


class FitInputs(NamedTuple):
    """What a fit space is made for."""

    start: Any
    """The stack's parameters."""
    finder: RangeFinder
    grid: OccupancyGrid
    counts: Sequence[int]
    """Numbers of beams to try, few first."""
    learned: BeamParameters | None
    """The chapter's beam model by maximum likelihood; None if it is not known."""

    @property
    def narrowest(self) -> float:
        """The least sigma that the map shows, metres: walls are drawn up to half a cell from where they are."""
        return max(0.01, self.grid.resolution / 2.0)

    def steps(self, counts: Sequence[int]) -> list[int]:
        """Return the steps over beams that come nearest to these counts, the widest first."""
        return sorted({max(1, round(self.finder.n_beams / n)) for n in counts} or {1}, reverse=True)


def log_of(name: str, step: float, low: float, high: float, grid: tuple[float, ...], per: str = "") -> Coordinate:
    """Return a positive parameter by its logarithm, or that of its ratio to another, which is put first."""

    def unit(parameters: Any) -> float:
        return getattr(parameters, per) if per else 1.0

    return Coordinate(
        name,
        lambda parameters: math.log(getattr(parameters, name) / unit(parameters)),
        lambda parameters, value: replace(parameters, **{name: math.exp(value) * unit(parameters)}),
        step,
        math.log(low),
        math.log(high),
        tuple(map(math.log, grid)),
    )


def share(names: tuple[str, ...], name: str) -> Coordinate:
    """Return one of several weights by the log odds of its share; the others keep their ratios, all sum to 1."""

    def get(parameters: Any) -> float:
        total = sum(getattr(parameters, other) for other in names)
        part = min(max(getattr(parameters, name) / total, 1e-6), 1.0 - 1e-6) if total > 0.0 else 0.5
        return math.log(part / (1.0 - part))

    def put(parameters: Any, value: float) -> Any:
        part = 1.0 / (1.0 + math.exp(-value))
        others = [other for other in names if other != name]
        rest = sum(getattr(parameters, other) for other in others)
        values = {
            other: (1.0 - part) * (getattr(parameters, other) / rest if rest > 0.0 else 1.0 / len(others))
            for other in others
        }
        return replace(parameters, **values, **{name: part})

    return Coordinate(f"share of {name}", get, put, 1.0, math.log(LEAST_SHARE / (1.0 - LEAST_SHARE)), 9.0, LOG_ODDS)
