"""Calibrate other programs' models on one log and judge them on others: ``python benchmarks/stack_fit.py [FOLDER]``.

FOLDER holds the logs and maps (default: ../shared/data beside the checkout). They are other people's data and not part
of this repository. Options: ``--stacks nav2,beluga`` and ``--logs wean``, ``tb4`` or ``stage`` do a part.

For each stack and model three tables compare the stack's defaults with values calibrated on the first log: the score
and coverage of windows, one update of a particle set, and the position error of a small bootstrap filter that replays
the log with the stack's weights. The filter is the same for all, so that weights are all that differs; it is no
stack's own filter.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.pose_windows import HELD_OUT, WindowOptions, cut_windows, draw_rivals
from beamfield.geometry import between, compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.fit.fit import fit_stack
from beamfield.stacks.fit.particle_update import update_particles
from beamfield.stacks.fit.window_evidence import gather_evidence, score_windows
from beamfield.stacks.registry import STACKS, build_model, parameter_class
from real_logs import read_log_and_map

WEAN = "wean_hall/derived_wean.yaml"
# Fitted to the first; where there are no others, every third block of time is held out.
SETS = {
    "wean": [(f"Wean Hall {i}", f"wean_hall/robotdata{i}.log.gz", WEAN, f"wean_hall/reference_robotdata{i}.csv.gz")
             for i in (1, 3, 5)],
    "tb4": [("TurtleBot 4", "olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/map/mac_1st_floor_final.yaml",
             "olin_mac_tb4/derived_ref_take_2.csv.gz")],
    "stage": [("simulated Pioneer", "uob_stage_sim/simpath2.bag", "uob_stage_sim/derived_meeting_stageframe.yaml",
               None)],
}  # fmt: skip
# Stage knows where its robot is; its map was fitted to the scans.
REFERENCE_ERROR = {"stage": 0.02}
N_PARTICLES, N_SEEDS, START_ERROR, START_TURN = 1000, 6, 0.25, 0.1
# Every alpha of the odometry motion model, as is nav2's default.
ALPHA = 0.2


def rows(folder: Path, name: str, stacks: Iterable[str]) -> list[dict[str, Any]]:
    """Return one row per stack, model, parameters and log."""
    logs = [(title, *read_log_and_map(folder, *paths)) for title, *paths in SETS[name]]
    error = REFERENCE_ERROR.get(name, 0.04)
    options = WindowOptions(reference_error=error)
    _, log, grid = logs[0]
    learned = calibrate(log, grid, CalibrationOptions(refine=False))
    chapter = next(form.result.parameters for form in learned.candidates if form.name == "chapter")
    table = []
    for stack in stacks:
        for model in STACKS[stack].models:
            kind = parameter_class(stack, model)
            start = kind(**({"laser_model_type": model} if hasattr(kind, "laser_model_type") else {}))
            began = time.perf_counter()
            fit = fit_stack(stack, model, log, grid, start=start, beam_parameters=chapter, options=options)
            seconds = time.perf_counter() - began
            usable = fit.before.parameters
            for which, parameters in (("default", usable), ("calibrated", fit.parameters)):
                for place, (title, other, its_grid) in enumerate(logs):
                    emulator = build_model(stack, model, its_grid, parameters)
                    table.append({"stack": stack, "model": model, "values": which, "log": title,
                                  "fitted to": "in part" if place == 0 else "no", "seconds": round(seconds, 1)}
                                 | judge(emulator, other, its_grid, options, held_out=place == 0))  # fmt: skip
                    print(table[-1], flush=True)
            print({key: value for key, value in vars(fit.parameters).items() if value != getattr(start, key)})
    return table


def judge(
    model: StackModel[Any, Any], log: SensorLog, grid: OccupancyGrid, options: WindowOptions, *, held_out: bool
) -> dict[str, Any]:
    """Return what the weights of a model do on a log; on held-out windows only if it was fitted to the others."""
    options = replace(options, windows=options.windows if held_out else 40)
    rivals = draw_rivals(options, grid)
    windows = cut_windows(log, grid, rivals, options)
    if held_out:
        windows = [window for window in windows if window.fold == HELD_OUT]
    (scores,) = score_windows(model, gather_evidence(model, log, windows), [model.parameters], rivals)
    update = update_particles(model, log, [int(window.scans[0]) for window in windows])
    errors, inside = replay(model, log)
    return {
        "score": round(scores.mean, 2), "coverage": round(scores.coverage, 2),
        "effective": round(float(np.median(update.effective))), "after": round(float(update.error_after.mean()), 3),
        "replay": round(float(errors.mean()), 3), "worst": round(float(errors.max()), 3), "inside": round(inside, 2),
    }  # fmt: skip


def replay(model: StackModel[Any, Any], log: SensorLog) -> tuple[np.ndarray, float]:
    """Return mean position errors (seeds,) in metres, and how often the reference is in the 95% ellipse."""
    rng = np.random.default_rng(7)
    known = np.isfinite(log.poses).all(axis=1) & np.isfinite(log.odometry).all(axis=1)
    last = first = int(np.argmax(known))
    widths = START_ERROR, START_ERROR, START_TURN
    poses = compose(log.poses[first], rng.normal(0.0, widths, (N_SEEDS, N_PARTICLES, 3)))
    errors, inside = [], []
    for scan in np.flatnonzero(np.isfinite(log.odometry).all(axis=1))[first:]:
        step = between(log.odometry[last], log.odometry[scan])
        if scan > first:
            if np.hypot(step[0], step[1]) < 0.25 and abs(step[2]) < 0.2:
                continue
            poses = np.array([_move(some, step, rng) for some in poses])
        last = int(scan)
        # A set per call: with beam skipping a weight depends on the others.
        log_weights = np.array([model.log_likelihood(log.scan(last), some) for some in poses])
        top = log_weights.max(axis=1, keepdims=True)
        weights = np.exp(np.where(top > -np.inf, log_weights - np.where(top > -np.inf, top, 0.0), 0.0))
        weights /= weights.sum(axis=1, keepdims=True)
        if known[last]:
            mean = np.einsum("sn,snd->sd", weights, poses[..., :2])
            error, apart = mean - log.poses[last, :2], poses[..., :2] - mean[:, None]
            errors.append(np.hypot(error[:, 0], error[:, 1]))
            # The reference itself is off by some 4 cm.
            cloud = np.einsum("sn,sni,snj->sij", weights, apart, apart) + 0.04**2 * np.eye(2)
            inside.append(np.einsum("si,sij,sj->s", error, np.linalg.inv(cloud), error) < 5.99)
        for some, weight in zip(poses, weights, strict=True):
            points = (np.arange(N_PARTICLES) + rng.random()) / N_PARTICLES
            some[:] = some[np.minimum(np.searchsorted(np.cumsum(weight), points), N_PARTICLES - 1)]
    return np.mean(errors, axis=0), float(np.mean(inside))


def _move(poses: np.ndarray, step: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return poses after a step with the noise of the odometry motion model (chapter 5, as AMCL has it)."""
    forward = float(np.hypot(step[0], step[1]))
    first = float(np.arctan2(step[1], step[0])) if forward > 0.01 else 0.0
    second = float((step[2] - first + np.pi) % (2.0 * np.pi) - np.pi)
    # Driving backwards is no half turn.
    turns = [min(abs(turn), np.pi - abs(turn)) for turn in (first, second)]
    n = len(poses)
    noise = np.sqrt(ALPHA * np.array([turns[0] ** 2 + forward**2, forward**2 + turns[0] ** 2 + turns[1] ** 2,
                                      turns[1] ** 2 + forward**2]))  # fmt: skip
    a, b, c = rng.normal([[first], [forward], [second]], noise[:, None], (3, n))
    heading = poses[:, 2] + a
    return np.column_stack([poses[:, 0] + b * np.cos(heading), poses[:, 1] + b * np.sin(heading), heading + c])


def main() -> None:
    """Print a Markdown table."""
    here = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=here)
    parser.add_argument("--stacks", default=",".join(STACKS))
    parser.add_argument("--logs", default=",".join(SETS))
    given = parser.parse_args()
    table = [row for name in given.logs.split(",") for row in rows(given.folder, name, given.stacks.split(","))]
    print(f"| {' | '.join(table[0])} |\n|{'---|' * len(table[0])}")
    for row in table:
        print(f"| {' | '.join(str(value) for value in row.values())} |")


if __name__ == "__main__":
    main()
