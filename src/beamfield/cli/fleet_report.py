"""Report the state of a fleet: which robots need attention, and which maps are out of date.

Takes a manifest (or a folder of logs), and scans what is not yet in the catalogue; or a catalogue. Writes one page with
a traffic light per robot, why, since when and what to do; drift over the days; parameters of fleet, sites and robots;
places to map again, drawn over each site's map. Beside it, the same as JSON and Parquet, and the places as maps and
GeoJSON. All files are written, or none.

for example:

  beamfield fleet report fleet/manifest.yaml --out report
  beamfield fleet report s3://company/catalogue --out report
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli import options
from beamfield.cli.fleet_scan import add_engine
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command
from beamfield.errors import InvalidInputError

if TYPE_CHECKING:
    from beamfield.fleet.catalogue import Catalogue
    from beamfield.fleet.fleet_report import FleetReport
    from beamfield.fleet.manifest import ManifestRow

CATALOGUE = "catalogue"


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "report", __doc__)
    parser.add_argument("fleet", metavar="MANIFEST|CATALOGUE",
                        help="a manifest (.yaml, .csv), a folder of logs, or the address of a catalogue")  # fmt: skip
    options.add_out(parser, "beamfield_fleet_report", metavar="DIR", what="output folder")
    parser.add_argument("--catalogue", metavar="ADDRESS",
                        help="where a manifest's beams are kept (default: catalogue in the output folder)")  # fmt: skip
    add_engine(parser)
    parser.set_defaults(command="fleet report")


def run(arguments: argparse.Namespace) -> Outcome:
    """Scan what is new, judge, draw, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.fleet.beam_schema import require_pyarrow
    from beamfield.fleet.catalogue import Catalogue
    from beamfield.fleet.engine import Engine
    from beamfield.fleet.fleet_report import judge_fleet
    from beamfield.fleet.report_files import report_as_dict, write_fleet_report
    from beamfield.fleet.scan import scan_fleet
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable
    from beamfield.report.text_table import finding_line

    check_folder_writable(arguments.out)
    require_pyarrow()
    given = _catalogue_or_manifest(arguments)
    with options.progress(arguments) as progress:
        progress("starting workers", 0, 1)
        with Engine(arguments.scheduler, arguments.workers) as engine:
            if not isinstance(given, Catalogue):
                kept = arguments.catalogue or str(arguments.out / CATALOGUE)
                given = scan_fleet(given, kept, engine, progress=progress).catalogue
            report = judge_fleet(given, engine, progress=progress)
        progress("drawing", 0, 1)
        with atomic_folder(arguments.out) as folder:
            names = write_fleet_report(folder, report)
    return Outcome(
        f"wrote {', '.join(name for name in names if '/' not in name)} and maps into {arguments.out}",
        _summary(report),
        report_as_dict(report),
        [finding_line(finding) for finding in report.findings],
        [arguments.out],
    )


def _catalogue_or_manifest(arguments: argparse.Namespace) -> Catalogue | tuple[ManifestRow, ...]:
    """Read what is given, before workers are started for it."""
    from beamfield.fleet.catalogue import CATALOGUE_FILE, open_catalogue
    from beamfield.fleet.folder import is_address, without_secrets
    from beamfield.fleet.manifest import read_manifest

    given = arguments.fleet
    is_address_of_manifest = without_secrets(given).lower().endswith((".yaml", ".yml", ".csv"))
    if is_address_of_manifest if is_address(given) else not (Path(given) / CATALOGUE_FILE).is_file():
        return read_manifest(given)
    if arguments.catalogue is not None:
        raise InvalidInputError("--catalogue: is for a manifest, and a catalogue is given")
    return open_catalogue(given)


def _summary(report: FleetReport) -> str:
    """Return the lights that are not green, the maps that are out of date, what was not tested, and runs left out."""
    from beamfield.fleet.made_tests import FEWEST_MAP_DAYS

    lines = [
        f"{state.light:<6s} {state.robot}: {' '.join(finding.text for finding in state.findings)}"
        for state in report.states
        if state.light != "green"
    ]
    lines.append(f"green  {sum(state.light == 'green' for state in report.states)} of {len(report.states)} robots")
    for stale in report.stale_maps:
        n = len(stale.lasting)
        said = f"{n} place{'s' * (n != 1)} to map again"
        if stale.days < FEWEST_MAP_DAYS:
            said = f"not tested, which takes {FEWEST_MAP_DAYS} days of runs"
        lines.append(f"map    {stale.site}: {said}")
    lines += [f"tests  {test.sentence}" for test in report.tests if test.made < test.of and test.what != "map"]
    if left_out := sum(not record.is_used for record in report.records):
        lines.append(f"runs   {left_out} of {len(report.records)} left out; the page says why")
    return "\n".join(lines)
