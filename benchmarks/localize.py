"""Localize real and simulated logs with the particle filter as the command does it, and print nine tables.

Run: python benchmarks/localize.py [FOLDER [SEEDS [TABLE ...]]]

FOLDER holds the logs and maps (default: ../shared/data beside the checkout). They are other people's data and not part
of this repository. The first table follows robots from a start known to 0.5 m and 15 degrees, and finds them from
anywhere; the second does so with what Wean Hall 1 teaches; the third starts in the middle of its logs, too; the fourth
does so in other buildings; the fifth compares the right place of Wean Hall 5 with a rival; the sixth has other
exponents; the seventh leaves out readings of people; the eighth finds robots again that were carried elsewhere; in the
ninth the odometry's distances are too long or too short. TABLE is accuracy, calibrated, starts, elsewhere, rival,
exponents, people, recovery or wheels.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from beamfield.calibration.calibrate import calibrate
from beamfield.calibration.context.exponent import learn_exponent
from beamfield.calibration.field.learning import learn_field_parameters
from beamfield.cli.calibrate_choice import name_of, with_better_exponent
from beamfield.cli.localize import DEFAULT_BEAMS, INDEPENDENT_BEAMS
from beamfield.geometry import FloatArray, between, chained, compose
from beamfield.kernels.threads import set_threads
from beamfield.localization.coarse_model import CoarseModel
from beamfield.localization.model_choice import choose_model
from beamfield.localization.particle_filter import FOUND_SPREAD, FilterOptions, Update
from beamfield.localization.recovery import PosesFromScan, Recovery
from beamfield.localization.replay import PoseBelief, reference_start
from beamfield.localization.resampling import KldSampling
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.localization.short_readings import ShortReadings
from beamfield.models.beam import BeamModel
from beamfield.models.gaussian_motion import USUAL_MOTION
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from crowd import with_crowd
from followed_logs import (
    BURSTS,
    CROWDED,
    KINDS,
    LASER,
    LOGS,
    PARAMETERS,
    followed,
    localizer_of,
    model_of,
    numbers,
    offices,
)
from half_maps import ByOtherMap, half_maps, way_of
from real_logs import read_log_and_map
from tables import print_table

WEAN_LOGS = ("Wean Hall 1", "Wean Hall 3", "Wean Hall 5")
EXPONENTS = (1.0, 0.1, 0.03, 0.01)
# Found: within this distance of the reference in 95% of the last fifth of the scans. Wrong: farther than that.
FOUND_WITHIN, WRONG_FROM = 0.5, 1.0
# Where a robot at the start of Wean Hall 5 would be that sees much the same for 80 s.
RIVAL = (52.2, 40.55, -1.62)
MOMENTS = (10.0, 20.0, 40.0, 60.0, 75.0, 80.0, 84.0, 90.0, 98.0)
# A robot that starts later in a log has so long to find its place, seconds.
LEFT_TO_FIND = 50.0
# Of other logs a start has so much of the way, metres.
LEAST_WAY, MOST_WAY = 5.0, 60.0


class Start(NamedTuple):
    """A start from anywhere on the map."""

    found: bool
    at_end: bool
    sure_after: float
    """Seconds, nan if never."""
    sure_of_wrong: bool
    wrong_at_end: bool
    """Sure of a wrong place, and nothing said."""

    @classmethod
    def of(cls, localizer: ScanLocalizer, log: SensorLog, seed: int) -> Start:
        """Start at a log's first scan."""
        run = localizer.run(log, None, np.random.default_rng(seed))
        distance = np.hypot(*(run.poses - log.poses)[:, :2].T)
        known = distance[np.isfinite(distance)]
        sure = np.trace(run.covariances[:, :2, :2], axis1=1, axis2=2) <= FOUND_SPREAD**2
        at_last = sure & (run.updates >= run.searched_from)
        is_said = any(finding.name == "not-found" for finding in run.findings)
        return cls(
            bool((known[-(len(known) // 5) :] < FOUND_WITHIN).mean() > 0.95),
            bool(known[-1] < FOUND_WITHIN),
            float(log.stamps[run.updates[at_last][0]] - log.stamps[0]) if at_last.any() else np.nan,
            bool((sure & (distance[run.updates] > WRONG_FROM)).any()),
            bool(at_last.any() and known[-1] > WRONG_FROM and not is_said),
        )


def found_from_anywhere(localizer: ScanLocalizer, log: SensorLog, seeds: int) -> dict[str, Any]:
    """Return how many seeds find the robot from anywhere on the map, and when the filter is sure."""
    log = log[reference_start(log)[0] :]
    starts = [Start.of(localizer, log, seed) for seed in range(seeds)]
    return {
        "found from anywhere": f"{sum(one.found for one in starts)} of {seeds}",
        "sure after [s]": round(float(np.nanmedian([one.sure_after for one in starts])), 1),
        "sure of a wrong place": f"{sum(one.sure_of_wrong for one in starts)} of {seeds}",
    }


def starts(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return starts from anywhere every 10 s of three logs, by what weighs scans until the robot is found."""
    rows: dict[str, list[Start]] = {}
    field = learned_models(folder)["likelihood field"]
    learned = ScanLocalizer(field.grid, field, USUAL_MOTION)
    typical = localizer_of("likelihood field", field.grid)
    ways = {
        "typical values throughout": replace(typical, coarse=typical.model),
        "learned values throughout": replace(learned, coarse=learned.model),
        "the coarse model, then typical values": typical,
        "the coarse model, then learned values": learned,
    }
    for name in WEAN_LOGS:
        log = read_log_and_map(folder, *LOGS[name])[0]
        since = log.stamps - log.stamps[0]
        for second in np.arange(0.0, since[-1] - LEFT_TO_FIND, 10.0):
            later = log[int(np.searchsorted(since, second)) :]
            later = later[reference_start(later)[0] :]
            for way, localizer in ways.items():
                rows.setdefault(way, []).extend(Start.of(localizer, later, seed) for seed in range(seeds))
    return [{"until found, and then": way, **summed(of)} for way, of in rows.items()]


def summed(of: Sequence[Start]) -> dict[str, Any]:
    """Return what became of starts."""
    return {
        "runs": len(of),
        "at the right place at the end": f"{np.mean([one.at_end for one in of]):.0%}",
        "sure of a wrong place": f"{np.mean([one.sure_of_wrong for one in of]):.0%}",
        "and at the end": f"{np.mean([one.wrong_at_end for one in of]):.0%}",
        "not sure at the end": f"{np.mean(np.isnan([one.sure_after for one in of])):.0%}",
        "sure after [s], median": round(float(np.nanmedian([one.sure_after for one in of])), 1),
    }


def elsewhere(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return starts from anywhere at every eighth of the way of logs on which nothing was tuned, 60 m of each."""
    rows = []
    for name in ("TurtleBot 4", "simulated Pioneer", "real Pioneer", "intel", "fr079", "Belgioioso"):
        log, localizer = log_and_localizer(folder, name)
        log = log[np.isfinite(np.hstack([log.poses, log.odometry])).all(axis=1)]
        way = way_of(log)
        begins = [begin for begin in np.arange(8) / 8 * way[-1] if way[-1] - begin >= LEAST_WAY]
        parts = [log[slice(*np.searchsorted(way, [begin, begin + MOST_WAY]))] for begin in begins]
        rows.append({"log": name, **summed([Start.of(localizer, part, s) for part in parts for s in range(seeds)])})
    return rows


def log_and_localizer(folder: Path, name: str) -> tuple[SensorLog, ScanLocalizer]:
    """Return a log and the filter as the command makes it; a log without a map has those that no scan has a part in."""
    if name in LOGS or name.startswith("simulated office"):
        log, grid = read_log_and_map(folder, *LOGS[name]) if name in LOGS else offices()[name]
        return log, localizer_of("likelihood field", grid)
    maps = half_maps(folder, name)
    model = ByOtherMap(maps, partial(model_of, "likelihood field", exponent=INDEPENDENT_BEAMS / DEFAULT_BEAMS))
    return maps.log, ScanLocalizer(maps.grids[1], model, USUAL_MOTION, coarse=ByOtherMap(maps, CoarseModel))


def accuracy(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return one row per log and model."""
    logs = {name: read_log_and_map(folder, *paths) for name, paths in LOGS.items()}
    rows = []
    for name, (log, grid) in {**logs, **offices()}.items():
        for kind in KINDS:
            localizer = localizer_of(kind, grid)
            row = {"log": name, "model": kind, **numbers(followed(localizer, log, seeds))}
            if kind == "likelihood field":
                row |= found_from_anywhere(localizer, log, 2 * seeds)
            rows.append(row)
    return rows


def calibrated(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return one row per log of Wean Hall and model, with parameters and exponent learned from the first log."""
    rows = []
    for kind, model in learned_models(folder).items():
        localizer = ScanLocalizer(model.grid, model, USUAL_MOTION)
        for name in WEAN_LOGS:
            log = read_log_and_map(folder, *LOGS[name])[0]
            row = {"log": name, "model": kind, **numbers(followed(localizer, log, seeds))}
            found = found_from_anywhere(localizer, log, seeds) if kind in KINDS else {}
            rows.append(row | ahead_and_sideways(localizer, log) | found)
    return rows


def ahead_and_sideways(localizer: ScanLocalizer, log: SensorLog) -> dict[str, Any]:
    """Return the standard deviations of the errors along and across the robot's heading, of one seed."""
    first, start = reference_start(log)
    run, known = localizer.run(log[first:], start, np.random.default_rng(0)), np.isfinite(log[first:].poses[:, 0])
    ahead, left, _ = between(log[first:].poses[known], run.poses[known]).std(axis=0)
    return {"ahead [m]": round(float(ahead), 3), "sideways [m]": round(float(left), 3)}


def learned_models(folder: Path) -> dict[str, Any]:
    """Return models with parameters and exponents of the first log of Wean Hall; one beam model has wide hits."""
    log, grid = read_log_and_map(folder, *LOGS["Wean Hall 1"])
    beam = calibrate(log, grid).parameters
    models: dict[str, Any] = {
        "likelihood field": LikelihoodFieldModel(grid, learn_field_parameters(log, grid).parameters, n_beams=60),
        "beam model": BeamModel(grid, beam, n_beams=30),
        "beam model, sigma_hit 0.3 m": BeamModel(grid, replace(beam, sigma_hit=0.3, sigma_slope=0.0), n_beams=30),
    }
    for kind, model in models.items():
        learned = learn_exponent(model, log, grid)
        tried = {
            name_of(kind, exponent): type(model)(grid, model.parameters, n_beams=model.n_beams, exponent=exponent)
            for exponent in (learned.drive.value, learned.single.value)
        }
        better = with_better_exponent(kind, learned, choose_model(tried, grid, log))
        models[kind] = tried[name_of(kind, better.in_filter.value)]
    return models


def rival(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return how much more the scans of Wean Hall 5 say for the right place than for its rival, by model, in nats."""
    log, grid = read_log_and_map(folder, *LOGS["Wean Hall 5"])
    log = log[reference_start(log)[0] :]
    learned = learned_models(folder)
    models = {
        "field, learned": learned["likelihood field"],
        "field, typical": model_of("likelihood field", grid, INDEPENDENT_BEAMS / DEFAULT_BEAMS),
        "coarse": CoarseModel(grid),
        "beam model, learned": learned["beam model"],
        "beam model, typical": model_of("beam model", grid, INDEPENDENT_BEAMS / DEFAULT_BEAMS),
    }
    rows = []
    for name, model in models.items():
        localizer, said = ScanLocalizer(grid, model, USUAL_MOTION), []
        for seed in range(seeds):
            for sign, pose in ((1.0, log.poses[0]), (-1.0, np.array(RIVAL))):
                nats = np.zeros(len(log))
                watch = partial(_keep_evidence, nats, sign)
                localizer.run(log, PoseBelief.around(pose), np.random.default_rng(seed), watch=watch)
                said.append(nats.cumsum() / seeds)
        ahead = np.sum(said, axis=0)
        since = log.stamps - log.stamps[0]
        rows.append({"model": name, **{f"{t:.0f} s": round(float(ahead[since <= t][-1]), 1) for t in MOMENTS}})
    return rows


def _keep_evidence(nats: FloatArray, sign: float, i: int, update: Update) -> None:
    nats[i] = sign * update.log_evidence


def exponents(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return one row per log and exponent of the field."""
    rows = []
    for name in ("Wean Hall 1", "Wean Hall 5", "simulated Pioneer"):
        log, grid = read_log_and_map(folder, *LOGS[name])
        for exponent in EXPONENTS:
            localizer = localizer_of("likelihood field", grid, exponent)
            rows.append({"log": name, "exponent": exponent, **numbers(followed(localizer, log, seeds))})
    return rows


# Who go with the robot, and hide a quarter and half of the readings.
PEOPLE_ABOUT = (10, 20)


def people(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return one row per log, model and whether readings of people are left out."""
    office = draw_floor_plan(seed=3)
    logs = {}
    for crowd in CROWDED:
        drive = simulate_log(office, LASER, crowd, duration=120.0, scan_rate=5.0, seed=2, dependence=BURSTS)
        logs[f"simulated, {crowd.z_short:.0%} short"] = drive.only_sensor(), office
    real = {name: read_log_and_map(folder, *paths) for name, paths in LOGS.items()}
    logs |= real
    for n in PEOPLE_ABOUT:
        logs |= {f"{name}, {n} people": (with_crowd(log, n, 0)[0], grid) for name, (log, grid) in real.items()}
    rows = []
    for name, (log, grid) in logs.items():
        for kind in KINDS:
            for left_out in (False, True):
                localizer = localizer_of(kind, grid)
                if left_out:
                    localizer = replace(localizer, short_readings=ShortReadings(grid, sigma=PARAMETERS.sigma_hit))
                said = numbers(followed(localizer, log, seeds))
                rows.append({"log": name, "model": kind, "left out": "yes" if left_out else "no", **said})
    return rows


def recovery(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return one row per log and rule: errors with nothing wrong, and how many robots carried elsewhere are found."""
    rows = []
    for name in CARRIED_IN:
        log, localizer = log_and_localizer(folder, name)
        log = log[reference_start(log)[0] :]
        log = log[np.isfinite(np.hstack([log.poses, log.odometry])).all(axis=1)]
        way = way_of(log)
        log = log[: int(np.searchsorted(way, MOST_WAY_CARRIED))]
        carried = [cut for part in CUTS if (cut := kidnapped(log, *part)) is not None]
        for rule, change in RULES.items():
            changed = change(localizer)
            errors = followed(changed, log, seeds)
            rows.append({
                "log": name, "way [m]": round(float(way[min(len(log), len(way) - 1)])), "rule": rule,
                "lost though never carried": f"{sum(e.lost for e in errors)} of {seeds}",
                "mean error then [m]": round(float(np.mean([e.mean for e in errors])), 3),
                "found again": f"{sum(ends_right(changed, cut, seed) for cut in carried for seed in range(seeds))} "
                f"of {len(carried) * seeds}",
            })  # fmt: skip
            print(rows[-1], file=sys.stderr, flush=True)
    return rows


def with_averages(localizer: ScanLocalizer) -> ScanLocalizer:
    """Return the filter with Table 8.3's averages of the likelihood of one reading, at most a tenth drawn anew."""
    options = FilterOptions(
        n_particles=50_000,
        kld=KldSampling(least=localizer.options.n_particles),
        recovery=Recovery(readings=INDEPENDENT_BEAMS),
    )
    # A scan that helped to draw a map may propose poses by that map.
    source = PosesFromScan(localizer.grid, localizer_of("likelihood field", localizer.grid).model)
    return replace(localizer, options=options, source=source, relocalize=False)


RULES: dict[str, Callable[[ScanLocalizer], ScanLocalizer]] = {
    "none": partial(replace, relocalize=False),
    "averages (Table 8.3)": with_averages,
    "a second search": lambda localizer: localizer,
}
CARRIED_IN = (
    *WEAN_LOGS, "simulated Pioneer", *(f"simulated office {k}" for k in (11, 12, 13)), "real Pioneer", "intel", "fr079",
    "Belgioioso", "csail",
)  # fmt: skip
# Parts of a log that are cut out, and how far the robot is carried then at least, metres; so much of a log is used.
CUTS = ((0.2, 0.4), (0.2, 0.55), (0.35, 0.6), (0.5, 0.65), (0.5, 0.75))
CARRIED_FAR, MOST_WAY_CARRIED = 2.0, 250.0


def kidnapped(log: SensorLog, begin: float, end: float) -> SensorLog | None:
    """Return the log without a part, whose motion the odometry has not noticed; None if the robot is hardly moved."""
    first, last = int(begin * len(log)), int(end * len(log))
    if np.hypot(*(log.poses[last] - log.poses[first - 1])[:2]) < CARRIED_FAR:
        return None
    rest = log[np.r_[:first, last : len(log)]]
    odometry = np.array(rest.odometry)
    odometry[first:] = compose(odometry[first - 1], between(odometry[first], odometry[first:]))
    return replace(rest, odometry=odometry)


def ends_right(localizer: ScanLocalizer, log: SensorLog, seed: int) -> bool:
    """Return whether the last tenth of a log's poses is right."""
    found = localizer.run(log, reference_start(log)[1], np.random.default_rng(seed))
    off = np.hypot(*(found.poses - log.poses)[:, :2].T)[-(len(log) // 10) :]
    return bool((off < FOUND_WITHIN).mean() > 0.95)


# By how much odometry's distances are too long.
TOO_LONG = (-0.1, -0.05, 0.0, 0.05, 0.1)


def wheels(folder: Path, seeds: int) -> list[dict[str, Any]]:
    """Return errors with noise alone, and with a relative error of distances in each particle."""
    logs = {name: read_log_and_map(folder, *LOGS[name]) for name in LOGS} | offices()
    rows = []
    for name, (log, grid) in logs.items():
        with_scale = localizer_of("likelihood field", grid)
        alone = replace(with_scale, options=FilterOptions())
        row: dict[str, Any] = {"log": name}
        for too_long in TOO_LONG:
            worn = with_worn_wheels(log, too_long)
            both = [followed(localizer, worn, seeds) for localizer in (alone, with_scale)]
            row[f"{too_long:+.0%} [m]"] = ", ".join(f"{np.mean([one.mean for one in runs]):.3f}" for runs in both)
        rows.append(row)
        print(row, file=sys.stderr, flush=True)
    return rows


def with_worn_wheels(log: SensorLog, too_long: float) -> SensorLog:
    """Return a log whose odometry's distances are longer by a share."""
    known = np.flatnonzero(np.isfinite(log.odometry).all(axis=1))
    steps = between(log.odometry[known[:-1]], log.odometry[known[1:]])
    steps[:, :2] *= 1.0 + too_long
    odometry = np.array(log.odometry)
    odometry[known] = chained(odometry[known[0]], steps)
    return replace(log, odometry=odometry)


TABLES = {
    table.__name__: table
    for table in (accuracy, calibrated, starts, elsewhere, rival, exponents, people, recovery, wheels)
}


def main(folder: Path, seeds: int, tables: Sequence[str]) -> None:
    """Print the tables as Markdown."""
    with set_threads(1):
        for table in tables:
            print_table(TABLES[table](folder, seeds))
            print(flush=True)


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    main(
        Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared" / "data",
        int(sys.argv[2]) if len(sys.argv) > 2 else 10,
        sys.argv[3:] or list(TABLES),
    )
