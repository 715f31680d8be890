"""How much beams may count, and what parameters learned in context gain (docs/evidence/in_context.md).

    python benchmarks/context.py coverage   what exponents learned from one log hold in others, and in blocks
    python benchmarks/context.py lattice    the same for single scans, by posteriors on a lattice of poses
    python benchmarks/context.py learning   the start (EM), an exponent alone, and parameters by gradient
    python benchmarks/context.py beams      4 to all beams of a scan
    python benchmarks/context.py filter     what was learned from one log or half, in the particle filter on another

Real logs and maps are in ../shared/data beside the checkout. More words choose logs by name: `beams Wean TurtleBot`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.calibration.calibrate import calibrate
from beamfield.calibration.context.exponent import (
    LEVEL,
    ExponentLearning,
    learn_exponent,
    scan_log_likelihoods,
    score_exponents,
)
from beamfield.calibration.context.learning import learn_in_context
from beamfield.calibration.cross_fit import build_cross_fit_maps
from beamfield.calibration.evaluation import block_standard_error
from beamfield.calibration.field.learning import learn_field_parameters
from beamfield.calibration.odometry.learning import calibrate_odometry
from beamfield.calibration.pose_windows import HELD_OUT, WindowOptions, cut_windows, draw_rivals_of_each
from beamfield.calibration.selection import select_scans
from beamfield.calibration.time_split import time_blocks
from beamfield.geometry import FloatArray, between, compose
from beamfield.io.read_log import read_log
from beamfield.localization.pose_posterior import PoseLattice, pose_posterior
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from followed_logs import followed, numbers
from real_logs import LOGS, read_log_and_map
from tables import print_table

PRIOR = np.array([0.25, 0.25, 0.1])
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
WEAN_MAP = "wean_hall/derived_wean.yaml"
NEAR = Dependence(float(np.radians(4.0)), 1.0)
WORLDS = {"independent": Dependence(), "dependent": NEAR, "dependent, wrong map": NEAR}
ODOMETRY = ("Wean Hall 1", "TurtleBot", "Pioneer")
CORRECTED = ("belgioioso", "intel", "freiburg-079")
BEAM_COUNTS = (4, 8, 15, 30, 60, 120, 180)
N_BEAMS = {"beam": 30, "field": 60}
# Many drives of few scans: coverage of 100 posteriors is known to 3%.
MANY = 150
N_SEEDS = 6
# A drive shorter than this, seconds, has too few windows in its half.
SHORTEST_HALVED = 60.0
TRUTH = BeamParameters(0.80, 0.10, 0.03, 0.07, 0.05, 0.6)


@dataclass(frozen=True, eq=False)
class Place:
    """A log to learn from, with its map, and logs of the same place to judge by."""

    name: str
    log: SensorLog
    grid: OccupancyGrid
    others: dict[str, SensorLog]
    reference_error: float = 0.04


def places(chosen: Sequence[str]) -> Iterator[Place]:
    """Yield simulated and real logs, those whose name has one of the words, or all."""
    makers = {
        **{f"simulated, {name}": partial(simulated, name) for name in WORLDS},
        "Wean Hall 1": wean,
        **{name: partial(real, name, *paths) for name, *paths in LOGS[2:]},
        **{f"{name}, map from the other half": partial(corrected, name) for name in CORRECTED},
    }
    for name, make in makers.items():
        if not chosen or any(word.lower() in name.lower() for word in chosen):
            yield make()


def wean() -> Place:
    """Return three logs of one hall."""
    logs = [
        read_log_and_map(DATA, f"wean_hall/robotdata{i}.log.gz", WEAN_MAP, f"wean_hall/reference_robotdata{i}.csv.gz")
        for i in (1, 3, 5)
    ]
    return Place("Wean Hall 1", *logs[0], {"Wean Hall 3": logs[1][0], "Wean Hall 5": logs[2][0]})


def real(name: str, *paths: str) -> Place:
    """Return a log with a map of its own."""
    return Place(name, *read_log_and_map(DATA, *paths), {}, 0.01 if "Stage" in name else 0.04)


def corrected(name: str) -> Place:
    """Return every other group of a log's scans, with the map that the others draw."""
    log = read_log(DATA / f"carmen_radish_corrected/{name}-corrected.log.gz").only_sensor()
    maps = build_cross_fit_maps(log)
    return Place(f"{name}, map from the other half", log.select(maps.half == 0), maps.halves[1], {})


def simulated(name: str) -> Place:
    """Return drives through an office: independent beams, dependent ones, or boxes that the map does not have."""
    office, finder = draw_floor_plan(seed=3), RangeFinder.from_bearings(np.linspace(-1.57, 1.57, 180), 12.0)
    world = with_boxes(office) if "wrong" in name else office
    logs = [
        simulate_log(world, finder, TRUTH, duration=300.0, scan_rate=4.0, seed=seed, dependence=WORLDS[name])
        for seed in (1, 2)
    ]
    learned, judged = (log.only_sensor() for log in logs)
    return Place(f"simulated, {name}", learned, office, {"another drive": judged}, 0.01)


def with_boxes(grid: OccupancyGrid) -> OccupancyGrid:
    """Return the map with thirty boxes of 0.4 m in its free space."""
    rng, free = np.random.default_rng(0), np.argwhere(grid.free)
    cells, size = grid.probability.copy(), round(0.4 / grid.resolution)
    for row, col in free[rng.integers(0, len(free), 30)]:
        cells[row : row + size, col : col + size] = 1.0
    return OccupancyGrid(cells, grid.resolution, grid.origin)


def models_of(place: Place) -> dict[str, BeamModel | LikelihoodFieldModel]:
    """Return the models learned from a log by EM."""
    field = learn_field_parameters(place.log, place.grid, reference_error=place.reference_error)
    return {
        "beam": BeamModel(place.grid, calibrate(place.log, place.grid).parameters, n_beams=N_BEAMS["beam"]),
        "field": LikelihoodFieldModel(place.grid, field.parameters, n_beams=N_BEAMS["field"]),
    }


def options_of(place: Place, windows: int = MANY) -> WindowOptions:
    return WindowOptions(reference_error=place.reference_error, windows=windows)


def coverage(chosen: Sequence[str]) -> list[dict[str, Any]]:
    """Return one row per log to learn from, model and log to judge by."""
    rows = []
    for place in places(chosen):
        for name, model in models_of(place).items():
            learned = learn_exponent(model, place.log, place.grid, reference_error=place.reference_error)
            for where, log in {"held-out blocks": place.log, **place.others}.items():
                rows.append(
                    {"learned from": place.name, "model": name, "judged by": where, **_exponents(learned)}
                    | _coverages(place, model, log, learned, only_held_out=log is place.log)
                )
    return rows


def _exponents(learned: ExponentLearning) -> dict[str, float]:
    return {
        "beams, one scan": learned.independent_beams,
        "in a drive": learned.independent_beams_in_drive,
        "if exact": learned.single.if_reference_exact * learned.n_beams,
    }


def _coverages(
    place: Place, model: BeamModel | LikelihoodFieldModel, log: SensorLog, learned: ExponentLearning, *,
    only_held_out: bool,
) -> dict[str, Any]:  # fmt: skip
    """Return the share of 90% regions that hold the truth, of single scans and drives, in percent."""
    # Guesses that the exponents were not learned with: the same ones would hide how far their draw matters.
    options = replace(options_of(place), seed=1)
    windows = cut_windows(log, place.grid, draw_rivals_of_each(options, place.grid), options)
    if only_held_out:
        windows = [window for window in windows if window.fold == HELD_OUT]
    values, rivals = scan_log_likelihoods(model, log, windows), [window.rivals for window in windows]
    blocks = time_blocks(log.stamps)[[window.scans[0] for window in windows]]
    row: dict[str, Any] = {"n": len(windows)}
    for name, power, each in (
        ("one scan [%]", learned.single.value, values[:, 0]),
        ("drive [%]", learned.drive.value, values.sum(axis=1)),
        ("exponent 1 [%]", 1.0, values[:, 0]),
    ):
        (scores,) = score_exponents(each, np.array([power]), rivals)
        error = block_standard_error((scores.denser < LEVEL).mean(axis=1), blocks)
        row[name] = f"{100.0 * scores.coverage_at(LEVEL):.0f} ± {100.0 * error:.0f}"
    return row


def lattice(chosen: Sequence[str]) -> list[dict[str, Any]]:
    """Return the coverage of single scans at exponents learned from Wean Hall 1, on a lattice of poses.

    The prior is that of the windows; nothing else but the model is shared with what the exponents were learned by.
    """
    del chosen
    place = wean()
    rng, rows = np.random.default_rng(5), []
    for name, model in models_of(place).items():
        learned = learn_exponent(model, place.log, place.grid)
        tempered = type(model)(
            place.grid, model.parameters, n_beams=model.n_beams, exponent=learned.single.value
        )  # fmt: skip
        for where, log in place.others.items():
            held = []
            usable = np.flatnonzero(select_scans(log, place.grid).used)
            for scan in usable[np.linspace(0, len(usable) - 1, 60).astype(int)]:
                for _ in range(2):
                    truth = compose(log.poses[scan], rng.normal(0.0, (0.04, 0.04, 0.01)))
                    held.append(_mass_above(tempered, log, int(scan), truth, rng) < LEVEL)
            rows.append({"model": name, "judged by": where, "n": len(held), "one scan [%]": 100.0 * np.mean(held)})
    return rows


def _mass_above(
    model: BeamModel | LikelihoodFieldModel, log: SensorLog, scan: int, truth: FloatArray, rng: np.random.Generator
) -> float:
    """Return the posterior probability of the cells of a lattice that are denser than the truth's."""
    middle = compose(truth, rng.normal(0.0, PRIOR))
    lattice = PoseLattice.around(middle, reach=0.75, resolution=0.03, heading_reach=0.3, heading_step=0.015)
    poses = np.empty((len(lattice.centres()), len(lattice.headings), 3))
    poses[..., :2], poses[..., 2] = lattice.centres()[:, None], lattice.headings
    values = pose_posterior(model, log.scan(scan), lattice).log_mass + _log_prior(middle, poses)
    here = model.log_likelihood(log.scan(scan), truth) + _log_prior(middle, truth)
    # What the posterior was divided by.
    here -= model.log_likelihood(log.scan(scan), poses[0, 0]) + _log_prior(middle, poses[0, 0]) - values[0, 0]
    mass = np.exp(values - values.max())
    return float(mass[values > here].sum() / mass.sum())


def _log_prior(middle: FloatArray, poses: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * np.square(between(middle, poses) / PRIOR).sum(axis=-1))


def learning(chosen: Sequence[str]) -> list[dict[str, Any]]:
    """Return one row per log, model and way of learning: held-out scores."""
    rows = []
    for place in places(chosen):
        for name, model in models_of(place).items():
            result = learn_in_context(model, place.log, place.grid, options=options_of(place, 90))
            for way in result.held_out:
                error = way.scores.log_score.std(ddof=1) / np.sqrt(len(way.scores.log_score))
                rows.append({
                    "log": place.name, "model": name, "way": way.name, "steps": result.steps, "exponent": way.exponent,
                    "sigma_hit [m]": way.parameters.sigma_hit, "z_hit": way.parameters.z_hit,
                    "z_rand": way.parameters.z_rand, "nats": way.scores.mean, "s.e.": float(error),
                    "covered [%]": 100.0 * way.scores.coverage_at(LEVEL),
                })  # fmt: skip
    return rows


def filtered(chosen: Sequence[str]) -> list[dict[str, Any]]:
    """Return one row per log, model and way of learning: errors of the particle filter on what was not learned from."""
    rows = []
    for place in drives(chosen):
        error = place.reference_error
        motion = calibrate_odometry(place.log).filter_motion
        for name, model in models_of(place).items():
            learned = learn_exponent(model, place.log, place.grid, reference_error=error)
            context = learn_in_context(model, place.log, place.grid, options=options_of(place, 90))
            ways = {
                "EM, exponent 1": (model.parameters, 1.0),
                "EM, one scan's": (model.parameters, learned.single.value),
                "EM, a filter's": (model.parameters, learned.drive.value),
                f"in context, {context.steps} steps": (context.parameters, context.exponent),
            }
            for where, log in place.others.items():
                for way, (parameters, power) in ways.items():
                    tempered = type(model)(place.grid, parameters, n_beams=model.n_beams, exponent=power)
                    localizer = ScanLocalizer(place.grid, tempered, motion)
                    errors = numbers(followed(localizer, log, N_SEEDS))
                    rows.append({"log": where, "model": name, "learned": way, "exponent": power, **errors})
    return rows


def drives(chosen: Sequence[str]) -> Iterator[Place]:
    """Yield logs with odometry; without another log of the place, to learn from the first half and judge the second."""
    names = [name for name in ODOMETRY if not chosen or any(word.lower() in name.lower() for word in chosen)]
    for place in places(names) if names else ():
        yield place if place.others else halved(place)
    if not chosen or any(word.lower() in "intel" for word in chosen):
        log = read_log(DATA / "intel_gfs/derived_intel_rawodom.log.gz").only_sensor()
        maps = build_cross_fit_maps(log)
        yield halved(Place("Intel, map from the other half", log.select(maps.half == 0), maps.halves[1], {}))


def halved(place: Place) -> Place:
    """Return the place with the second half of its log to judge by; all of a log too short for that."""
    log, middle = place.log, len(place.log) // 2
    if log.stamps[-1] - log.stamps[0] < SHORTEST_HALVED:
        return replace(place, others={f"{place.name}, learned from itself": log})
    return replace(place, log=log[:middle], others={f"{place.name}, second half": log[middle:]})


def beams(chosen: Sequence[str]) -> list[dict[str, Any]]:
    """Return one row per log, model and number of beams."""
    rows = []
    for place in places(chosen):
        if place.name.startswith("simulated") or "other half" in place.name:
            continue
        for name, model in models_of(place).items():
            for n in BEAM_COUNTS:
                fewer = type(model)(place.grid, model.parameters, n_beams=n)
                learned = learn_exponent(fewer, place.log, place.grid, reference_error=place.reference_error)
                rows.append({
                    "log": place.name, "model": name, "beams": n, "independent, one scan": learned.independent_beams,
                    "nats, one scan": learned.single.score, "in a drive": learned.independent_beams_in_drive,
                    "nats, drive": learned.drive.score,
                })  # fmt: skip
    return rows


if __name__ == "__main__":
    what, *words = sys.argv[1:]
    tables = {"coverage": coverage, "lattice": lattice, "learning": learning, "beams": beams, "filter": filtered}
    print_table(tables[what](words), digits=3)
