"""Compare the emulated filter of nav2 with its own code: ``python benchmarks/replay_oracle.py [FOLDER]``.

FOLDER holds ``data`` and ``oracle`` (default: ../shared beside the checkout): other people's logs and what nav2's
compiled filter did on them; neither is part of this repository. ``--sets prob_default,lf_default`` and ``--logs
wean1,sim`` do a part, ``--seeds N`` sets how many runs of ours there are.

For each set of parameters and log the table has the mean position error of both over seeds, how many runs each lost,
the share of references inside the particles' ellipse, their spread and number, and how surprising the difference
between the two samples of mean errors is (Mann-Whitney and Kolmogorov-Smirnov, two-sided).
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import ks_2samp, mannwhitneyu

from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.nav2.motion import Nav2Motion
from beamfield.stacks.registry import build_filter, build_model, parameter_class

if __package__:
    from benchmarks.real_logs import read_log_and_map
    from benchmarks.tables import print_table
else:
    from real_logs import read_log_and_map
    from tables import print_table

WEAN = "wean_hall/derived_wean.yaml"
# Log, map, reference poses; Stage knows where its robot is.
LOGS = {
    **{f"wean{i}": (f"wean_hall/robotdata{i}.log.gz", WEAN, f"wean_hall/reference_robotdata{i}.csv.gz")
       for i in (1, 3, 5)},
    "sim": ("uob_stage_sim/simpath2.bag", "uob_stage_sim/derived_meeting_stageframe.yaml", None),
}  # fmt: skip
# What the oracle calls our columns.
COLUMNS = {
    "mean": "mean", "median": "median", "p95": "p95", "end": "end", "lost": "lost", "yaw_rmse_deg": "yaw_rmse_deg",
    "nees_median": "nees_med", "inside": "in2", "inside_noisy": "in2ref", "sd_position": "sd_pos",
    "particles": "particles", "updates": "updates",
}  # fmt: skip


def read_oracle(folder: Path) -> list[dict[str, Any]]:
    """Return the oracle's runs: set, log, parameters, map_origin_shift, and its seeds' rows as columns by name."""
    document = json.loads((folder / "oracle/amcl_replay/results.json").read_text())
    runs = []
    for run in document["runs"]:
        rows = np.array(run["seeds"], dtype=float)
        runs.append({**run, "columns": dict(zip(document["columns"], rows.T, strict=True))})
    return runs


def read_inputs(folder: Path, name: str) -> tuple[OccupancyGrid, SensorLog]:
    """Return the map and the log of this name."""
    log, grid = read_log_and_map(folder / "data", *LOGS[name])
    return grid, log


def emulate(run: dict[str, Any], grid: OccupancyGrid, log: SensorLog, seeds: range) -> ReplayTrials:
    """Run the emulated filter as the oracle's program was run."""
    shift = run["map_origin_shift"]
    shifted = replace(grid, origin=grid.origin + np.array([shift, shift, 0.0]))
    alphas = {name: value for name, value in run["parameters"].items() if name.startswith("alpha")}
    rest = {name: value for name, value in run["parameters"].items() if name not in alphas}
    kind = rest["laser_model_type"]
    # The program's own distances, which are too long in places, where it has any.
    options = {} if kind == "beam" else {"distance": "brushfire"}
    model = build_model("nav2", kind, shifted, parameter_class("nav2", kind)(**rest), **options)
    return run_trials(build_filter("nav2", model, Nav2Motion(**alphas)), log, seeds, name=run["log"])


def agreement(ours: ReplayTrials, theirs: dict[str, np.ndarray]) -> dict[str, Any]:
    """Return one row of the table."""
    row: dict[str, Any] = {"log": ours.log, "runs": f"{len(ours)} / {len(theirs['mean'])}"}
    row["mean error"] = f"{ours.mean('mean'):.3f} / {theirs['mean'].mean():.3f}"
    row["median run"] = f"{np.median(ours.column('mean')):.3f} / {np.median(theirs['mean']):.3f}"
    row["lost"] = f"{ours.n_lost} / {int(theirs['lost'].sum())}"
    for name, digits in (("inside", 2), ("nees_median", 2), ("sd_position", 3), ("particles", 0)):
        row[name] = f"{ours.mean(name):.{digits}f} / {theirs[COLUMNS[name]].mean():.{digits}f}"
    a, b = ours.column("mean"), theirs["mean"]
    row["Mann-Whitney"], row["Kolmogorov-Smirnov"] = f"{mannwhitneyu(a, b).pvalue:.2f}", f"{ks_2samp(a, b).pvalue:.2f}"
    return row


def p_values(ours: ReplayTrials, theirs: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the Mann-Whitney p-value of every column."""
    return {name: float(mannwhitneyu(ours.column(name), theirs[other]).pvalue) for name, other in COLUMNS.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).resolve().parents[2] / "shared")
    parser.add_argument("--sets", help="names of sets of parameters, by commas (default: all)")
    parser.add_argument("--logs", default=",".join(LOGS))
    parser.add_argument("--seeds", type=int, help="runs of ours (default: as many as the oracle has)")
    arguments = parser.parse_args()
    wanted = arguments.sets and arguments.sets.split(",")
    inputs: dict[str, tuple[OccupancyGrid, SensorLog]] = {}
    rows, all_p_values, updates, seconds = [], [], 0, 0.0
    for run in read_oracle(arguments.folder):
        name = run["log"]
        if name not in arguments.logs.split(",") or (wanted and run["set"] not in wanted):
            continue
        if name not in inputs:
            inputs[name] = read_inputs(arguments.folder, name)
        n = arguments.seeds or len(run["seeds"])
        began = time.process_time()
        # Seeds of ours are independent of theirs whatever they are called.
        ours = emulate(run, *inputs[name], range(n))
        seconds += time.process_time() - began
        updates += int(ours.column("updates").sum())
        rows.append({"set": run["set"], **agreement(ours, run["columns"])})
        all_p_values += list(p_values(ours, run["columns"]).values())
        print(rows[-1], flush=True)
    print_table(rows)
    low = np.mean(np.array(all_p_values) < 0.05)
    print(f"\n{len(all_p_values)} tests over all columns, {low:.1%} below 0.05; {updates / seconds:.0f} updates/s")


if __name__ == "__main__":
    main()
