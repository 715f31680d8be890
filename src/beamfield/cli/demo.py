"""Simulate, calibrate, print truth beside fit.

Simulate a robot that drives through an office, write its log and map, calibrate the beam model from these files as
`beamfield calibrate` does, and print the true parameters beside the fitted ones.

for example:

  beamfield demo
  beamfield demo --seed 5 --duration 600
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from types import ModuleType
from typing import Any

from beamfield.cli import calibrate, options, simulate
from beamfield.cli.outcome import Outcome, show
from beamfield.cli.parser import Parser, add_command, positive


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "demo", __doc__)
    options.add_out(parser, "beamfield_demo", metavar="DIR", what="output folder")
    options.add_seed(parser, 1)
    parser.add_argument("--duration", type=positive, default=300.0, metavar="S", help="of the drive (default: 300)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Simulate, calibrate, compare."""
    world, result = arguments.out / "world", arguments.out / "calibration"
    # Neighbouring beams and scans err alike, as those of real robots do: only then do the intervals have to prove
    # themselves.
    _run(arguments, simulate, [
        "simulate", "--out", str(world), "--seed", str(arguments.seed), "--duration", str(arguments.duration),
        "--scan-rate", "5", "--dependence-angle", "4", "--dependence-time", "1",
    ])  # fmt: skip
    done = _run(arguments, calibrate, [
        "calibrate", str(world / simulate.CARMEN), "--map", str(world / simulate.MAP), "--out", str(result),
    ])  # fmt: skip
    truth = json.loads((world / simulate.TRUTH).read_text(encoding="utf-8"))["parameters"]
    fit = json.loads((result / "calibration.json").read_text(encoding="utf-8"))["parameters"]
    line = f"look at {result / 'report.html'}"
    document = {"truth": truth, "fit": fit}
    # It was said before, unless that was not to be.
    problem = done.problem if arguments.quiet or arguments.json else ""
    return Outcome(line, comparison(truth, fit), document, (), [arguments.out], done.code, problem)


def _run(arguments: argparse.Namespace, command: ModuleType, words: list[str]) -> Outcome:
    """Run another command as the command line would."""
    parser = Parser(prog="beamfield")
    command.add_parser(parser.add_subparsers(required=True, parser_class=Parser))
    parsed = parser.parse_args([*words, *(f"--{name}" for name in ("quiet", "verbose") if getattr(arguments, name))])
    outcome: Outcome = parsed.run(parsed)
    if not (arguments.quiet or arguments.json):
        show(outcome, parsed)
    return outcome


def comparison(truth: Mapping[str, float], fitted: Mapping[str, Any]) -> str:
    """Return a table of true and fitted parameters, and how many intervals hold the truth.

    Parameters
    ----------
    truth
        True value by parameter.
    fitted
        ``parameters`` of a calibration.json.
    """
    lines = [f"{'parameter':<14}{'truth':>10}{'fit':>10}   95 % interval         holds the truth"]
    held = total = 0
    for name, entry in fitted.items():
        if entry["interval_95"] is None:
            continue
        low, high = entry["interval_95"]
        holds = low <= truth[name] <= high
        held += holds
        total += 1
        lines.append(
            f"{name:<14}{truth[name]:>10.4f}{entry['value']:>10.4f}   [{low:.4f}, {high:.4f}]"
            f"{'':<6}{'yes' if holds else 'NO'}"
        )
    lines.append(f"{held} of {total} intervals hold the truth")
    return "\n".join(lines)
