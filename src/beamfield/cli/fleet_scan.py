"""Scan a fleet's logs into a catalogue of beams.

Each log is read, its poses are fitted to its map if it has none, and its beams are cast: they become Parquet files by
site, robot and day. Logs that are there already are not read again; a log that has changed is scanned anew and takes
the place of what it was. One that cannot be used is left out, with the reason. An interrupted scan goes on where it
was, and two at once do no harm.

MANIFEST is a YAML or CSV file with the log, map, robot and site of each run, or a folder SITE/ROBOT/LOG.

for example:

  beamfield fleet scan fleet.yaml --out catalogue
  beamfield fleet scan fleet.csv --out s3://bucket/catalogue --scheduler tcp://10.0.0.5:8786
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from beamfield.cli import options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count

if TYPE_CHECKING:
    from beamfield.fleet.run_record import RunRecord
    from beamfield.fleet.scan import FleetScan

SHOWN = 20
CATALOGUE = "a folder, or an fsspec address such as s3://bucket/fleet"


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "scan", __doc__)
    parser.add_argument(
        "manifest", metavar="MANIFEST", help="YAML or CSV file, its fsspec address, or a folder of logs"
    )
    parser.add_argument("-o", "--out", default="beamfield_fleet", metavar="CATALOGUE",
                        help=f"the catalogue, new or of earlier scans: {CATALOGUE} (default: %(default)s)")  # fmt: skip
    add_engine(parser)
    parser.set_defaults(command="fleet scan")


def add_engine(parser: argparse.ArgumentParser) -> None:
    """Add --scheduler and --workers."""
    parser.add_argument("--scheduler", metavar="ADDRESS",
                        help="a Dask scheduler to work on, as tcp://host:8786; processes: some of this machine; "
                        "serial: this process (default: processes, if there are several processors)")  # fmt: skip
    parser.add_argument("--workers", type=count, metavar="N", help="how many processes (default: one per processor)")


def run(arguments: argparse.Namespace) -> Outcome:
    """Read the manifest, scan what is new."""
    from beamfield.fleet.beam_schema import require_pyarrow
    from beamfield.fleet.engine import Engine
    from beamfield.fleet.manifest import read_manifest
    from beamfield.fleet.run_findings import leftover_finding, run_findings
    from beamfield.fleet.scan import scan_fleet
    from beamfield.report.text_table import finding_line

    require_pyarrow()
    rows = read_manifest(arguments.manifest)
    with options.progress(arguments) as progress:
        progress("starting workers", 0, 1)
        with Engine(arguments.scheduler, arguments.workers) as engine:
            done = scan_fleet(rows, arguments.out, engine, progress=progress)
    findings = (*leftover_finding(done.catalogue.files_of_no_run()), *run_findings(done.catalogue.runs))
    notes = [finding_line(finding) for finding in findings]
    place = done.catalogue.folder.shown
    used, runs = sum(record.is_used for record in done.records), done.catalogue.used
    line = (
        f"{used} of {len(done.records)} logs used, {len(done.scanned)} scanned now; the catalogue {place} has "
        f"{sum(record.beams for record in runs):,} beams of {len(runs)} run{'s' * (len(runs) != 1)}"
    )
    return Outcome(
        line, _text(done), _document(done, findings), notes, [place], 0 if used else 3,
        "" if used else "no log could be used",
    )  # fmt: skip


def _text(done: FleetScan) -> str:
    from beamfield.report.text_table import aligned

    header = ("site", "robot", "runs", "left out", "days", "scans", "beams", "poses")
    text = aligned(header, [_robot_row(*each) for each in _by_robot(done.records).items()], right=(2, 3, 4, 5, 6))
    out = [(row, record) for row, record in zip(done.rows, done.records, strict=True) if not record.is_used]
    lines = [f"{row.place}: {record.reason}" for row, record in out[:SHOWN]]
    if len(out) > SHOWN:
        lines.append(f"and {len(out) - SHOWN} more; --json lists all")
    return text + ("\n\nleft out:\n" + "\n".join(f"  {line}" for line in lines) if lines else "")


def _by_robot(records: Sequence[RunRecord]) -> dict[tuple[str, str], list[RunRecord]]:
    robots: dict[tuple[str, str], list[RunRecord]] = {}
    for record in records:
        robots.setdefault((record.site, record.robot), []).append(record)
    return dict(sorted(robots.items()))


def _robot_row(name: tuple[str, str], records: Sequence[RunRecord]) -> tuple[str, ...]:
    from beamfield.printable import printable

    used = [record for record in records if record.is_used]
    days = {file.day for record in used for file in record.files}
    sources = ", ".join(sorted({record.pose_source for record in used}))
    return (
        printable(name[0]), printable(name[1]), str(len(used)), str(len(records) - len(used)), str(len(days)),
        f"{sum(record.scans for record in used):,}", f"{sum(record.beams for record in used):,}", sources or "-",
    )  # fmt: skip


def _document(done: FleetScan, findings: Sequence[Any]) -> Mapping[str, Any]:
    from beamfield.report.as_json import plain

    runs = []
    for row, record in zip(done.rows, done.records, strict=True):
        said = plain(record)
        # The beams' mounts are in the record's file.
        del said["sensor"]
        runs.append({"line": row.line, **said})
    return {
        "catalogue": done.catalogue.folder.shown,
        "runs": runs,
        "scanned": list(done.scanned),
        "replaced": list(done.replaced),
        "findings": plain(findings),
    }
