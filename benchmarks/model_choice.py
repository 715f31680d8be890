"""Choose a model for our own filter by a log, and judge it on others: ``python benchmarks/model_choice.py [FOLDER]``.

FOLDER holds logs and maps (default: ../shared/data beside the checkout). They are other people's data and not part of
this repository. Both models are learned from one drive, each with the exponents of drives and of single scans (errors:
the one / the other), and `choose_model` runs the filter on it; then it runs on another drive, or on another part of the
log. In simulated drives (three offices, and the maps, sensors and changes of ``other_maps.py``) the first one has no
poses: they are fitted, as the command does it.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.context.exponent import learn_exponent
from beamfield.calibration.field.learning import learn_field_parameters
from beamfield.cli.calibrate_choice import BEAM, FIELD, models_to_try, name_of, with_better_exponent
from beamfield.cli.calibrate_exponent import N_BEAMS
from beamfield.errors import BeamfieldError
from beamfield.io.read_map import read_map
from beamfield.kernels.threads import set_threads
from beamfield.localization.fitted_poses import cross_fit_poses
from beamfield.localization.model_choice import choose_model
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import hollowed
from beamfield.models.beam import BeamModel
from beamfield.models.gaussian_motion import USUAL_MOTION
from beamfield.sensors import SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from followed_logs import BURSTS, CROWDED, LASER, LOGS, followed
from other_maps import MAPS, SENSORS, changed_map, drive
from real_logs import read_log_and_map
from tables import print_table

KINDS = FIELD, BEAM
ALWAYS_FIELD, ALWAYS_BEAM, NATS, OF_DRIVES, REPLAY = (
    "always the field", "always the beam model", "more nats per held-out drive", "replay, exponents of drives", "replay"
)  # fmt: skip
SEEDS = 4


class Case(NamedTuple):
    """A drive to learn from and to choose by, its map, and drives to judge by."""

    name: str
    log: SensorLog
    grid: OccupancyGrid
    others: Mapping[str, SensorLog]


def cases(folder: Path) -> Iterator[Case]:
    """Yield real logs, and simulated ones without poses."""
    logs = {name: read_log_and_map(folder, *paths) for name, paths in LOGS.items()}
    wean = {name: log for name, (log, _) in logs.items() if name.startswith("Wean")}
    for name in wean:
        yield Case(name, *logs[name], {other: log for other, log in wean.items() if other != name})
    for name, (log, grid) in logs.items():
        if name in wean:
            continue
        half = len(log) // 2
        if name == "TurtleBot 4":  # 46 s
            yield Case(name, log, grid, {"itself": log})
        else:
            yield Case(f"{name}, first half", log[:half], grid, {"second half": log[half:]})
    for seed in (11, 12, 13):
        plan = draw_floor_plan(seed=seed)
        first, other = (
            simulate_log(plan, LASER, CROWDED[0], duration=90.0, scan_rate=5.0, seed=k, dependence=BURSTS).only_sensor()
            for k in (seed, seed + 100)
        )
        yield Case(f"office {seed}", without_poses(first), plan, {"another drive": other})
    for name in MAPS:
        grid = read_map(next((folder / "ros_maps" / name).glob("*.yaml")))
        for sensor in SENSORS:
            first, other = without_poses(drive(grid, sensor, 1)), drive(grid, sensor, 21)
            yield Case(f"{name}, {sensor}", first, grid, {"another drive": other})
            yield Case(f"{name}, {sensor}, changed", first, changed_map(grid, 1), {"another drive": other})


def without_poses(log: SensorLog) -> SensorLog:
    """Return the log as a robot without a localizer records it."""
    return replace(log, poses=np.full_like(log.poses, np.nan))


def rows(case: Case) -> list[dict[str, Any]]:
    """Return a row per other drive; one that says why, if there is nothing to choose."""
    grid, log, error = hollowed(case.grid), case.log, 0.04
    try:
        if not log.has_poses:
            fitted = cross_fit_poses(log, grid)
            log, error = fitted.judged, fitted.reference_error
        parameters = calibrate(log, grid, CalibrationOptions(refine=False)).parameters
        counting = learn_exponent(BeamModel(grid, parameters, n_beams=N_BEAMS), log, grid, reference_error=error)
        field = learn_field_parameters(log, grid, reference_error=error)
        assert field.exponents is not None
        learned = {FIELD: field.exponents, BEAM: counting}
        models = models_to_try(grid, parameters, counting, field)
        tried = choose_model(models, grid, log)
    except BeamfieldError as problem:
        return [{"learned from": case.name, "chosen": f"nothing: {str(problem)[:60]}"}]
    of_drives = {kind: name_of(kind, exponents.drive.value) for kind, exponents in learned.items()}
    taken = {kind: name_of(kind, with_better_exponent(kind, exponents, tried).in_filter.value)
             for kind, exponents in learned.items()}  # fmt: skip
    there = {name: trials.mean("mean") for name, trials in tried.trials.items()}
    made = []
    for name, other in case.others.items():
        errors = {
            which: float(
                np.mean([run.mean for run in followed(ScanLocalizer(grid, model, USUAL_MOTION), other, SEEDS)])
            )
            for which, model in models.items()
        }
        by_rule = {
            ALWAYS_FIELD: of_drives[FIELD],
            ALWAYS_BEAM: of_drives[BEAM],
            NATS: of_drives[max(KINDS, key=lambda kind: learned[kind].drive.score)],
            OF_DRIVES: min(of_drives.values(), key=there.__getitem__),
            REPLAY: min(taken.values(), key=there.__getitem__),
        }
        made.append({
            "learned from": case.name,
            **{f"error there, {kind} [m]": of_both(kind, there) for kind in KINDS},
            "chosen": by_rule[REPLAY],
            "judged on": name,
            **{f"error, {kind} [m]": of_both(kind, errors) for kind in KINDS},
            **{rule: round(errors[which] / min(errors.values()), 2) for rule, which in by_rule.items()},
        })  # fmt: skip
    return made


def of_both(kind: str, errors: Mapping[str, float]) -> str:
    """Return the errors with both exponents of a model."""
    return " / ".join(f"{error:.3f}" for name, error in errors.items() if name.startswith(kind))


def factors(table: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return how many times the best one's error each rule makes: in the geometric mean, and at worst."""
    found = []
    for rule in (ALWAYS_FIELD, ALWAYS_BEAM, NATS, OF_DRIVES, REPLAY):
        times = np.array([row[rule] for row in table if "judged on" in row])
        found.append({
            "rule": rule, "drives": len(times), "times the best one's error": round(np.exp(np.log(times).mean()), 3),
            "at worst": round(times.max(), 2),
        })  # fmt: skip
    return found


def main(folder: Path) -> None:
    """Print two tables as Markdown."""
    table = []
    with set_threads(1):
        for case in cases(folder):
            table += rows(case)
            print(table[-1], file=sys.stderr, flush=True)
    columns = next(list(row) for row in table if "judged on" in row)
    print_table(table, columns=columns)
    print()
    print_table(factors(table))


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared" / "data")
