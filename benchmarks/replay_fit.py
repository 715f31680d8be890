"""Calibrate a stack by replay, evaluate its filter on logs: ``python benchmarks/replay_fit.py [FOLDER]``.

FOLDER holds the logs and maps (default: ../shared/data beside the checkout): other people's data, no part of this
repository. Fitted to Wean Hall 1 alone and evaluated on 1, 3 and 5; simulated Pioneer and TurtleBot 4 are evaluated on
the log they were fitted to; intel, fr079 and csail on the second half of the way, chosen by the first, with maps that
no scan helped to draw (``half_maps``). ``--stack``, ``--model``, ``--sets wean,tb4,stage`` and ``--seeds N`` do a part;
``--sets others`` does the same for six more logs, with drawn odometry.

The filter is the stack's own, emulated, over whole logs from one start 0.5 m and 15 degrees wide.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.pose_windows import WindowOptions
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report.replay_choice import describe, replay_tables
from beamfield.sensors import SensorLog
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.fit.fit import StackFit, fit_stack
from beamfield.stacks.fit.motion_candidates import BEFORE, motion_candidates
from beamfield.stacks.fit.replay_amount import replay_options
from beamfield.stacks.fit.replay_choice import ReplayChoice, choose_by_replay
from beamfield.stacks.fit.replay_segments import cut_segments
from beamfield.stacks.registry import STACKS
from beamfield.stacks.stack import FIELD_PRODUCT
from half_maps import LOGS, OTHER_LOGS, HalfMaps, HalfMapSettings, half_maps
from real_logs import read_log_and_map
from stack_fit import REFERENCE_ERROR, SETS
from tables import print_table


@dataclass(frozen=True, eq=False)
class Place:
    """A log to choose by, logs to judge by, and the map."""

    name: str
    log: SensorLog
    """To replay; windows are cut from `scans`, which may be fewer."""
    scans: SensorLog
    grid: OccupancyGrid
    others: dict[str, SensorLog]
    error: float
    maps: HalfMaps | None = None

    def settings(self, settings: FilterSettings) -> FilterSettings:
        """Return settings of a filter on the map, or on the two."""
        return settings if self.maps is None else HalfMapSettings.of(settings, self.maps)


def read_place(folder: Path, name: str) -> Place:
    """Return one of `SETS`, `LOGS` or `OTHER_LOGS`."""
    if name not in SETS:
        maps = half_maps(folder, name)
        half = len(maps.log) // 2
        others = {f"{name}, second half": maps.log[half:]}
        return Place(name, maps.log[:half], *maps.to_fit, others, 0.04, maps)
    logs = {title: read_log_and_map(folder, *paths) for title, *paths in SETS[name]}
    log, grid = next(iter(logs.values()))
    others = {title: log for title, (log, _) in logs.items()}
    return Place(name, log, log, grid, others, REFERENCE_ERROR.get(name, 0.04))


def choose(stack: str, model: str, place: Place, *, any_model: bool) -> tuple[ReplayChoice, float]:
    """Return what `beamfield calibrate --stack` chooses, from the stack's defaults, and the seconds of replay."""
    described = STACKS[stack]
    fit = fit_model(stack, model, place)
    sensors = {BEFORE: (model, fit.before.parameters), "fitted": (model, fit.parameters)}
    for other in described.models.values() if any_model else ():
        if other.weight == FIELD_PRODUCT and not described.model(model).weight.is_product:
            sensors[f"{other.name} fitted"] = other.name, fit_model(stack, other.name, place).parameters
    began = time.process_time()
    before = place.settings(
        FilterSettings(stack, model, fit.before.parameters, described.filter.motion(), described.filter.parameters())
    )
    amount = replay_options(before, place.log, 0)
    stretches = cut_segments(place.log, *before.update_distances, most=amount.most_stretches, longest=amount.longest)
    choice = choose_by_replay(
        before, sensors, motion_candidates(before, place.log, place.error),
        0.5 * place.grid.resolution if described.half_cell_low else 0.0, stretches, place.grid, amount,
    )  # fmt: skip
    return choice, time.process_time() - began


def fit_model(stack: str, model: str, place: Place) -> StackFit:
    """Fit a model from its defaults, and print what changes."""
    described = STACKS[stack]
    chapter = None
    if not described.model(model).weight.of_field:
        learned = calibrate(place.scans, place.grid, CalibrationOptions(refine=False))
        chapter = next(form.result.parameters for form in learned.candidates if form.is_chapter)
    options = WindowOptions(reference_error=place.error)
    fit = fit_stack(
        stack, model, place.scans, place.grid, start=described.start(model), beam_parameters=chapter, options=options
    )
    print({name: value for name, value in asdict(fit.parameters).items() if value != getattr(fit.start, name)})
    return fit


def rows(place: Place, stack: str, model: str, n_seeds: int, *, any_model: bool) -> list[dict[str, Any]]:
    """Return a row per log and setting: before, and chosen."""
    choice, seconds = choose(stack, model, place, any_model=any_model)
    print(f"{replay_tables(choice)}\n{seconds:.0f} s of processor time", flush=True)
    table = []
    for title, log in place.others.items():
        settings = {"before": choice.before}
        if choice.chosen is not choice.before:
            settings[describe(choice.chosen)] = choice.chosen
        for which, setting in settings.items():
            trials = run_trials(setting.filter.filter(setting.map_of(place.grid)), log, range(n_seeds))
            table.append({
                "stack": stack, "model": model, "log": title, "values": which,
                "mean error [m]": f"{trials.mean('mean'):.3f}",
                "median run": f"{np.median(trials.column('mean')):.3f}", "lost": f"{trials.n_lost} of {n_seeds}",
                "inside": f"{trials.mean('inside'):.2f}", "inside, 3 cm": f"{trials.mean('inside_noisy'):.2f}",
            })  # fmt: skip
            print(table[-1], flush=True)
    return table


def main() -> None:
    """Print a Markdown table."""
    here = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=here)
    parser.add_argument("--stack", default="nav2")
    parser.add_argument("--model", default="likelihood_field_prob")
    parser.add_argument("--sets", default=",".join((*SETS, *LOGS)))
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument(
        "--any-model", action="store_true", help="let replay choose a field's product, too, as --patch does"
    )
    given = parser.parse_args()
    names = OTHER_LOGS if given.sets == "others" else given.sets.split(",")
    places = (read_place(given.folder, name) for name in names)
    print_table([
        row for place in places for row in rows(place, given.stack, given.model, given.seeds, any_model=given.any_model)
    ])  # fmt: skip


if __name__ == "__main__":
    main()
