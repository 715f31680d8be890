"""Many robots and many logs: which lidars are dirty or askew, where maps are stale, which parameters serve all.

The logs of a fleet are scanned into a catalogue of beams once; robots are compared from there. Needs the extra
beamfield[fleet].

for example:

  beamfield fleet scan fleet.yaml --out catalogue
  beamfield fleet report catalogue --out report
"""

from __future__ import annotations

import argparse

from beamfield.cli import fleet_report, fleet_scan, fleet_simulate
from beamfield.cli.parser import Parser, add_group

COMMANDS = (fleet_scan, fleet_report, fleet_simulate)


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command and its own commands."""
    commands = add_group(subparsers, "fleet", __doc__)
    for command in COMMANDS:
        command.add_parser(commands)
