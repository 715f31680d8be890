"""Calibrate a stack by replay, evaluate its filter on logs: ``python benchmarks/replay_fit.py [FOLDER]``.

FOLDER holds the logs and maps (default: ../shared/data beside the checkout): other people's data, no part of this
repository. Fitted to Wean Hall 1 alone and evaluated on 1, 3 and 5; simulated Pioneer and TurtleBot 4 are evaluated on
the log they were fitted to. ``--stack``, ``--model``, ``--sets wean,tb4,stage`` and ``--seeds N`` do a part.

The filter is the stack's own, emulated, over whole logs from one start 0.5 m and 15 degrees wide.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.stack_fit import REFERENCE_ERROR, SETS, _read
from benchmarks.tables import print_table

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.pose_windows import WindowOptions
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report.replay_choice import describe, replay_tables
from beamfield.sensors import SensorLog
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.fit.fit import fit_stack
from beamfield.stacks.fit.motion_candidates import BEFORE, motion_candidates
from beamfield.stacks.fit.replay_choice import ReplayChoice, choose_by_replay, replay_options, shifted_map
from beamfield.stacks.fit.replay_segments import cut_segments
from beamfield.stacks.registry import STACKS


def choose(stack: str, model: str, log: SensorLog, grid: OccupancyGrid, error: float) -> tuple[ReplayChoice, float]:
    """Return what `beamfield calibrate --stack` chooses, from the stack's defaults, and the seconds of replay."""
    described = STACKS[stack]
    chapter = None
    if not described.model(model).weight.of_field:
        learned = calibrate(log, grid, CalibrationOptions(refine=False))
        chapter = next(form.result.parameters for form in learned.candidates if form.is_chapter)
    options = WindowOptions(reference_error=error, reference_turn_error=error / 4.0)
    fit = fit_stack(stack, model, log, grid, start=described.start(model), beam_parameters=chapter, options=options)
    print({name: value for name, value in asdict(fit.parameters).items() if value != getattr(fit.start, name)})
    began = time.process_time()
    before = FilterSettings(
        stack, model, fit.before.parameters, described.filter.motion(), described.filter.parameters()
    )
    amount = replay_options(stack, model, 0)
    segments = cut_segments(log, *before.update_distances, most=amount.most_stretches, longest=amount.longest)
    choice = choose_by_replay(
        before, {BEFORE: fit.before.parameters, "fitted": fit.parameters},
        motion_candidates(before, log, error, error / 4.0),
        0.5 * grid.resolution if described.half_cell_low else 0.0, segments, grid, amount,
    )  # fmt: skip
    return choice, time.process_time() - began


def rows(folder: Path, name: str, stack: str, model: str, n_seeds: int) -> list[dict[str, Any]]:
    """Return a row per log and setting: before, and chosen."""
    logs = [(title, *_read(folder, *paths)) for title, *paths in SETS[name]]
    choice, seconds = choose(stack, model, *logs[0][1:], REFERENCE_ERROR.get(name, 0.04))
    print(f"{replay_tables(choice)}\n{seconds:.0f} s of processor time", flush=True)
    table = []
    for title, log, grid in logs:
        for which, setting in (("before", choice.before), (describe(choice.chosen), choice.chosen)):
            trials = run_trials(setting.filter.filter(shifted_map(grid, setting.shift)), log, range(n_seeds))
            table.append({
                "stack": stack, "model": model, "log": title, "values": which, "seeds": n_seeds,
                "mean error [m]": f"{trials.mean('mean'):.3f}",
                "median run": f"{np.median(trials.column('mean')):.3f}", "lost": trials.n_lost,
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
    parser.add_argument("--sets", default=",".join(SETS))
    parser.add_argument("--seeds", type=int, default=10)
    given = parser.parse_args()
    print_table([
        row for name in given.sets.split(",")
        for row in rows(given.folder, name, given.stack, given.model, given.seeds)
    ])  # fmt: skip


if __name__ == "__main__":
    main()
