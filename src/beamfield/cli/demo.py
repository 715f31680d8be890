"""Simulate a robot, calibrate it from its log, and show what that does for its filter.

A simulated robot drives through an office. From its log (scans and odometry, no poses) and the map, the poses are
fitted, and the laser, the odometry and nav2's AMCL are calibrated. On a second drive nav2's filter then runs as nav2
ships it and with the new values. Prints true parameters beside fitted ones, and the filter's error before and after;
each step with the command that does it.

for example:

  beamfield demo
  beamfield demo --seed 5 --duration 600
"""

from __future__ import annotations

import argparse
import json
import shlex
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from beamfield.cli import calibrate, evaluate, options, simulate
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, positive
from beamfield.cli.terminal import say
from beamfield.errors import TooLittleDataError
from beamfield.stacks.files.calibration_record import MOVED_MAP

# Neighbouring beams and scans err alike, as those of real robots do: readings that people and moved furniture cut short
# come in bursts. Everything else is as `simulate` has it.
SIMULATED = ("--odometry-only", "--scan-rate", "5", "--dependence-angle", "4", "--dependence-time", "1")
DEFAULTS = """\
# as nav2 ships it
amcl:
  ros__parameters:
    laser_model_type: "likelihood_field"
"""
# Runs of the filter before and after.
SEEDS = 10
BEFORE, AFTER = "nav2_defaults.yaml", "nav2.yaml"
SHOWN = {"mean": "position error [m]", "p95": "95% of position errors [m]", "yaw_mean_deg": "heading error [deg]"}


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "demo", __doc__)
    options.add_out(parser, "beamfield_demo", metavar="DIR", what="output folder")
    options.add_seed(parser, 1)
    parser.add_argument("--duration", type=positive, default=100.0, metavar="S",
                        help="of the drive to calibrate from; the other is half as long (default: 100)")  # fmt: skip


def run(arguments: argparse.Namespace) -> Outcome:
    """Simulate, calibrate, drive again, compare."""
    from beamfield.io.files.atomic import write_file

    out: Path = arguments.out
    drive, result, other = out / "drive", out / "calibration", out / "second_drive"
    _say(arguments, "1. A simulated robot drives through an office. Its log has laser scans and odometry, no poses.")
    _run(arguments, simulate, [
        "simulate", "--out", drive, "--seed", arguments.seed, "--duration", f"{arguments.duration:g}", *SIMULATED,
    ])  # fmt: skip
    _say(arguments, "2. From log and map, the poses are fitted, and laser, odometry and nav2's amcl are calibrated.")
    calibrated = _run(arguments, calibrate, [
        "calibrate", drive / simulate.CARMEN, "--lone-poses", "odometry", "--map", drive / simulate.MAP,
        "--odometry-noise", "--stack", "nav2", "--out", result,
    ])  # fmt: skip
    found = json.loads((result / "calibration.json").read_text(encoding="utf-8"))
    if "missing" in found["stack"]:
        raise TooLittleDataError(f"{drive / simulate.CARMEN}: {found['stack']['missing']}; give a longer --duration")
    _say(arguments, "3. The robot drives again in the same office: a log that calibration has not seen.")
    _run(arguments, simulate, [
        "simulate", "--out", other, "--map", drive / simulate.MAP, "--seed", arguments.seed + 1,
        "--duration", f"{arguments.duration / 2:g}", *SIMULATED,
    ])  # fmt: skip
    _say(arguments, f"4. nav2's filter runs on it, emulated, {SEEDS} times as nav2 ships it and {SEEDS} times with the "
         "new values. Its errors are those against the simulator's exact poses.")  # fmt: skip
    write_file(out / BEFORE, DEFAULTS.encode())
    is_moved = (found["stack"].get("replay") or {}).get("chosen", {}).get("origin_shift", 0.0) > 0.0
    compared = _run(arguments, evaluate, [
        "evaluate", other / simulate.CARMEN, "--lone-poses", "odometry", "--poses", other / simulate.POSES,
        "--map", drive / simulate.MAP, "--params", out / BEFORE, result / AFTER,
        "--filter-maps", drive / simulate.MAP, result / MOVED_MAP if is_moved else drive / simulate.MAP,
        "--seeds", SEEDS, "--out", out / "evaluation",
    ])  # fmt: skip
    truth = true_parameters(json.loads((drive / simulate.TRUTH).read_text(encoding="utf-8")))
    fit = fitted_parameters(found)
    evaluation = {name: (compared.document or {})[name] for name in ("filters", "differences")}
    document = {"truth": truth, "fit": fit, "evaluation": evaluation}
    text = f"{parameter_comparison(truth, fit)}\n\n{error_comparison(evaluation)}"
    line = f"look at {result / 'report.html'}"
    return Outcome(line, text, document, (), [out], calibrated.code, calibrated.problem, compared.brief)


def _say(arguments: argparse.Namespace, text: str) -> None:
    if not (arguments.quiet or arguments.json):
        say(text)


def _run(arguments: argparse.Namespace, command: ModuleType, words: list[Any]) -> Outcome:
    """Run another command as the command line would, and show how it is typed."""
    typed = [str(word) for word in words]
    _say(arguments, f"   beamfield {shlex.join(typed)}\n")
    parser = Parser(prog="beamfield")
    command.add_parser(parser.add_subparsers(required=True, parser_class=Parser))
    parsed = parser.parse_args([*typed, *(f"--{name}" for name in ("quiet", "verbose") if getattr(arguments, name))])
    outcome: Outcome = parsed.run(parsed)
    return outcome


def true_parameters(truth: Mapping[str, Any]) -> dict[str, float]:
    """Return what calibration should find, from the content of a truth.json.

    Its odometry is too long by a scale s; calibration says by how much the truth is longer than odometry:
    1 / (1 + s) - 1.
    """
    noise = truth["odometry_noise"]
    scales = {name: 1.0 / (1.0 + noise[name]) - 1.0 for name in ("distance_scale", "turn_scale")}
    return {**truth["parameters"], **scales, "drift": 0.0, "yaw": 0.0}


def fitted_parameters(calibration: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return value and interval of the sensor's parameters that were learned, and of the odometry's systematic errors.

    Parameters
    ----------
    calibration
        The content of a calibration.json.
    """
    sensor = {
        name: {"value": entry["value"], "interval_95": entry["interval_95"]}
        for name, entry in calibration["parameters"].items()
        if entry["interval_95"] is not None
    }
    odometry = {
        name: {"value": entry["value"], "interval_95": [entry["low"], entry["high"]]}
        for name, entry in calibration["odometry"].get("systematic", {}).items()
    }
    return {**sensor, **odometry}


def parameter_comparison(truth: Mapping[str, float], fitted: Mapping[str, Mapping[str, Any]]) -> str:
    """Return a table of true and fitted parameters (see `fitted_parameters`), and how many intervals hold the truth."""
    from beamfield.report.text_table import aligned

    rows, held = [], 0
    for name, entry in fitted.items():
        low, high = entry["interval_95"]
        holds = low <= truth[name] <= high
        held += holds
        numbers = f"{truth[name]:.4f}", f"{entry['value']:.4f}", f"[{low:.4f}, {high:.4f}]"
        rows.append((name, *numbers, "yes" if holds else "NO"))
    table = aligned(("parameter", "truth", "fit", "95% interval", "holds the truth"), rows, right=(1, 2))
    return f"{table}\n{held} of {len(rows)} intervals hold the truth"


def error_comparison(evaluation: Mapping[str, Any]) -> str:
    """Return a table of the filter's errors before and after.

    From ``filters`` and ``differences`` of an evaluation.json.
    """
    from beamfield.report.text_table import aligned

    before, after = (one["tracking"][0] for one in evaluation["filters"].values())
    (differences,) = evaluation["differences"].values()
    changes = {one["measure"]: one for one in differences}
    rows = []
    for measure, what in SHOWN.items():
        change, (old, new) = changes[measure], (one["means"][measure] for one in (before, after))
        interval = f"{change['low']:+.3f} to {change['high']:+.3f}"
        rows.append((what, f"{old:.3f}", f"{new:.3f}", f"{change['difference']:+.3f}", interval))
    n = len(before["runs"])
    rows.append(("lost runs", f"{before['lost_runs']} of {n}", f"{after['lost_runs']} of {n}", "", ""))
    header = ("nav2's filter on the second drive", "before", "after", "change", "95% interval")
    return aligned(header, rows, right=(1, 2, 3))
