"""``beamfield demo``: the main job on a simulated robot whose true parameters are known."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from beamfield.cli import calibrate, simulate
from beamfield.cli.terminal import say

DESCRIPTION = """
Simulate a robot that drives through an office, write its log and map, calibrate the beam model from these files as
`beamfield calibrate` does, and print the true parameters beside the fitted ones.
"""
SEED = 1


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser("demo", help="simulate, calibrate, print truth beside fit", description=DESCRIPTION)
    parser.add_argument("--out", type=Path, default=Path("beamfield-demo"), metavar="DIR",
                        help="output folder (default: %(default)s)")  # fmt: skip
    parser.add_argument("--seed", type=int, default=SEED,
                        help="of the office, the drive and the readings (default: %(default)s)")  # fmt: skip
    parser.add_argument("--duration", type=float, default=300.0, metavar="S", help="of the drive (default: 300)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Simulate, calibrate, compare."""
    world, result = arguments.out / "world", arguments.out / "calibration"
    quiet = ["--quiet"] if arguments.quiet else []
    # Neighbouring beams and scans err alike, as those of real robots do: only then do the intervals have to prove
    # themselves.
    _run(simulate, [
        "simulate", str(world), "--overwrite", "--seed", str(arguments.seed), "--duration", str(arguments.duration),
        "--scan-rate", "5", "--dependence-deg", "4", "--dependence-s", "1", *quiet,
    ])  # fmt: skip
    code = _run(calibrate, [
        "calibrate", str(world / simulate.CARMEN), "--map", str(world / simulate.MAP), "--out", str(result), *quiet,
    ])  # fmt: skip
    truth = json.loads((world / simulate.TRUTH).read_text(encoding="utf-8"))["parameters"]
    fit = json.loads((result / "calibration.json").read_text(encoding="utf-8"))
    say()
    say(comparison(truth, fit["parameters"]))
    say(f"\nlook at {result / 'report.html'}")
    return code


def _run(command: Any, words: Sequence[str]) -> int:
    """Run another command as the command line would."""
    parser = argparse.ArgumentParser(prog="beamfield")
    command.add_parser(parser.add_subparsers(required=True))
    parsed = parser.parse_args(words)
    return int(parsed.run(parsed))


def comparison(truth: dict[str, float], fitted: dict[str, Any]) -> str:
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
