"""How the time per pose and beam grows with poses, beams, cells and range: a table and one figure of `make bench`."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from beam_model import PARAMETERS, anywhere, near, office
from beamfield.geometry import FloatArray
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import BeamModel
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.report.drawing import new_figure, style
from beamfield.sensors import RangeFinder, Scan
from likelihood_field import PARAMETERS as FIELD_PARAMETERS
from measure import Call, take_turns

ROUNDS = 5
N_BEAMS, N_POSES, MAX_RANGE = 60, 1000, 20.0
# On maps of all sizes: enough to leave the cache.
N_FAR = 20_000
POSES = (1, 10, 100, 1000, 10_000, 100_000)
BEAMS = (1, 10, 60, 100, 1000)
SIDES = (100, 300, 1000, 3000)
RANGES = (1.0, 5.0, 20.0, 100.0, 1000.0)
PLACE = np.array([25.0, 25.0, 0.3])
NAMES = ("rays", "beam model", "field, nearest", "field, bilinear", "landmarks, known")

# What grows, how much of it, and the median ns per pose and beam (or feature) of each call.
Row = tuple[str, float, dict[str, float]]


def measure_growth() -> list[Row]:
    """Measure one row per size; what does not grow has 1000 poses, 60 beams, 10^6 cells and 20 m."""
    rng = np.random.default_rng(3)
    grid = office(np.random.default_rng(7))
    rows = []
    for what, size, calls, n in [
        *in_poses(grid, rng),
        *in_beams(grid, rng),
        *in_cells(grid, rng),
        *in_range(grid, rng),
    ]:
        seconds = take_turns(calls, ROUNDS)
        rows.append((what, size, {name: float(np.median(times)) / n * 1e9 for name, times in seconds.items()}))
    return rows


def in_poses(grid: OccupancyGrid, rng: np.random.Generator) -> Iterator[tuple[str, float, dict[str, Call], float]]:
    """Yield calls for more and more poses of a tracking filter; as many landmarks are seen as there are beams."""
    calls = calls_on(grid, N_BEAMS, MAX_RANGE)
    landmarks = LandmarkMap(rng.uniform(0.0, 50.0, (N_BEAMS, 2)))
    model = LandmarkModel(landmarks, LandmarkParameters(sigma_range=0.2, sigma_bearing=0.03), correspondence="known")
    z = model.sample(PLACE, rng)[0]
    for n in POSES:
        poses = near(PLACE, rng, n)
        each = {name: partial(call, poses) for name, call in calls.items()}
        yield "poses", n, each | {"landmarks, known": partial(model.log_likelihood, z, poses)}, n * N_BEAMS


def in_beams(grid: OccupancyGrid, rng: np.random.Generator) -> Iterator[tuple[str, float, dict[str, Call], float]]:
    poses = near(PLACE, rng, N_POSES)
    for n in BEAMS:
        yield "beams", n, with_poses(calls_on(grid, n, MAX_RANGE), poses), n * N_POSES


def in_cells(grid: OccupancyGrid, rng: np.random.Generator) -> Iterator[tuple[str, float, dict[str, Call], float]]:
    """Yield calls on parts of the floor and floors side by side; the poses are everywhere."""
    for side in SIDES:
        tiles = -(-side // grid.shape[0])
        occupied = np.tile(grid.occupied, (tiles, tiles))[:side, :side]
        part = OccupancyGrid(occupied.astype(np.float32), grid.resolution)
        calls = with_poses(calls_on(part, N_BEAMS, MAX_RANGE), anywhere(part, rng, N_FAR))
        yield "cells", side**2, calls, N_FAR * N_BEAMS


def in_range(grid: OccupancyGrid, rng: np.random.Generator) -> Iterator[tuple[str, float, dict[str, Call], float]]:
    poses = anywhere(grid, rng, N_POSES)
    for limit in RANGES:
        yield "range [m]", limit, with_poses(calls_on(grid, N_BEAMS, limit), poses), N_POSES * N_BEAMS


def calls_on(grid: OccupancyGrid, n_beams: int, max_range: float) -> dict[str, Call]:
    """Return what is measured, as functions of poses."""
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, n_beams, endpoint=False), max_range)
    caster, beam = RayCaster(grid), BeamModel(grid, PARAMETERS)
    place = PLACE if grid.shape[0] * grid.resolution > PLACE[0] else anywhere(grid, np.random.default_rng(1), 1)[0]
    scan = Scan(np.clip(caster.expected_ranges(place, finder), 0.1, 0.99 * max_range), finder)
    return {
        "rays": lambda poses: caster.expected_ranges(poses, finder),
        "beam model": partial(beam.log_likelihood, scan),
        "field, nearest": partial(LikelihoodFieldModel(grid, FIELD_PARAMETERS).log_likelihood, scan),
        "field, bilinear": partial(
            LikelihoodFieldModel(grid, FIELD_PARAMETERS, interpolation="bilinear").log_likelihood, scan
        ),
    }


def with_poses(calls: dict[str, Call], poses: FloatArray) -> dict[str, Call]:
    return {name: partial(call, poses) for name, call in calls.items()}


def draw_growth(rows: list[Row]) -> Figure:
    """Draw the rows, both axes logarithmic."""
    matplotlib.rcParams["svg.hashsalt"] = "beamfield"
    figure = new_figure(9.4, 6.6)
    panels = figure.subplots(2, 2, sharey=True)
    grown = list(dict.fromkeys(what for what, _, _ in rows))
    for axes, what in zip(panels.flat, grown, strict=True):
        for colour, name in enumerate(NAMES):
            points = [(size, ns[name]) for of, size, ns in rows if of == what and name in ns]
            if points:
                axes.loglog(*zip(*points, strict=True), marker="o", markersize=4, color=f"C{colour}", label=name)
        style(axes, x=what, y="ns per pose and beam" if axes in panels[:, 0] else "")
    drawn = panels[0, 0].get_legend_handles_labels()
    figure.legend(*drawn, loc="outside upper center", ncols=len(NAMES), frameon=False)
    return figure
