"""Scan a fleet: every log of a manifest into the catalogue, but for those that are there already."""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from beamfield.fleet.catalogue import Catalogue, create_catalogue, read_records
from beamfield.fleet.engine import Engine
from beamfield.fleet.manifest import ManifestRow, read_manifest
from beamfield.fleet.run_record import RunRecord
from beamfield.fleet.scan_job import ScanJob, content_of, log_address
from beamfield.fleet.scan_run import left_out, scan_run, worker_died, write_record
from beamfield.fleet.stored_map import MAPS

# Called with stage, logs done and logs in all.
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class FleetScan:
    """What a scan did.

    Parameters
    ----------
    catalogue
        With the records as they are now.
    rows, records
        Of the manifest, and the record of each.
    scanned
        Runs that were read; the others were there already.
    replaced
        Runs of logs that had been scanned with other content, which are gone.
    """

    catalogue: Catalogue
    rows: tuple[ManifestRow, ...] = field(repr=False)
    records: tuple[RunRecord, ...] = field(repr=False)
    scanned: tuple[str, ...]
    replaced: tuple[str, ...]


def scan_fleet(
    manifest: str | os.PathLike[str] | Sequence[ManifestRow],
    catalogue: str | os.PathLike[str],
    engine: Engine,
    *,
    options: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> FleetScan:
    """Scan the logs of a manifest into a catalogue.

    Parameters
    ----------
    manifest
        As for `read_manifest`, or what it returned.
    catalogue
        Its address; a new one is begun in an empty folder.
    engine
        Where to work.
    options
        Storage options for fsspec, for the catalogue and the logs.
    progress
        Called with stage, logs done and logs in all.

    Returns
    -------
    The records; logs that cannot be used are left out, with the reason.

    Raises
    ------
    FormatError
        If the manifest, or the catalogue, is no such thing.
    MissingDependencyError
        If a log needs a package that is not installed.
    OSError
        If the catalogue cannot be written.
    """
    report = progress or (lambda _stage, _done, _total: None)
    rows = read_manifest(manifest, options) if isinstance(manifest, str | os.PathLike) else tuple(manifest)
    opened = create_catalogue(catalogue, options)
    jobs = [ScanJob(row, opened.folder) for row in rows]
    contents = engine.map(content_of, jobs, progress=lambda done, n: report("looking for changes", done, n))
    before = read_records(opened.folder)
    jobs = [replace(job, content=content) for job, content in zip(jobs, contents, strict=True)]
    jobs = _planned(jobs, before)
    firsts, known = _firsts(jobs), {record.key: record for record in before}
    records = [_copy_of_another(job, firsts) or _known(job, known) for job in jobs]
    open_jobs = [job for job, record in zip(jobs, records, strict=True) if record is None]
    done = iter(
        engine.map(
            scan_run, open_jobs, lost=worker_died, progress=lambda done, n: report("scanning logs", done, n)
        )
    )  # fmt: skip
    found = tuple(next(done) if record is None else record for record in records)
    for name in (MAPS, "runs"):  # these are not written again where a killed worker was about to
        opened.folder.remove_abandoned(name)
    return FleetScan(
        Catalogue(opened.folder), rows, found, tuple(job.run for job in open_jobs),
        tuple(old.run for job in open_jobs for old in job.replaces),
    )  # fmt: skip


def _name(row: ManifestRow) -> tuple[str, str, str, str]:
    return row.site, row.robot, log_address(row), row.sensor


def _firsts(jobs: list[ScanJob]) -> dict[tuple[str, str], ScanJob]:
    """Return the first job of each log that can be read."""
    firsts: dict[tuple[str, str], ScanJob] = {}
    for job in jobs:
        if job.content.key:
            firsts.setdefault((job.content.log_hash, job.row.sensor), job)
    return firsts


def _planned(jobs: list[ScanJob], before: list[RunRecord]) -> list[ScanJob]:
    """Return the jobs with the records that they replace.

    These are of the same robot's log of that name with other content, and of the same log under another robot's name;
    but not of a copy that the manifest lists, nor of a log that the manifest lists under another name, as logs that
    rotate get one.
    """
    listed = {_name(job.row) for job in jobs}
    wanted = {job.content.key for job in _firsts(jobs).values()}
    by_name, by_log = defaultdict[Any, list[RunRecord]](list), defaultdict[Any, list[RunRecord]](list)
    for one in before:
        if one.key not in wanted:
            name = (one.site, one.robot, one.log, one.log_sensor)
            by_name[name].append(one)
            if one.log_hash != "" and (one.is_used or name not in listed):
                by_log[one.log_hash, one.log_sensor].append(one)
    planned = []
    for job in jobs:
        found = {one.run: one for one in (*by_name[_name(job.row)], *by_log[job.content.log_hash, job.row.sensor])}
        planned.append(replace(job, replaces=tuple(one for run, one in found.items() if run != job.run)))
    return planned


def _copy_of_another(job: ScanJob, firsts: Mapping[tuple[str, str], ScanJob]) -> RunRecord | None:
    """Leave a log out whose content is that of an earlier row: its beams would count twice.

    Its record has no key: it is looked at again, in case it is no copy any more.
    """
    first = firsts[job.content.log_hash, job.row.sensor] if job.content.key else job
    if first is job:
        return None
    record = replace(left_out(job, f"the same log as {log_address(first.row)} of {first.row.robot}"), key="")
    # One of the same robot and name has the name of the first.
    return record if job.run == first.run else write_record(replace(job, replaces=()), record)


def _known(job: ScanJob, known: Mapping[str, RunRecord]) -> RunRecord | None:
    """Return the record of the same content; it gets the name that the log has now, as the old one may be another's."""
    record = known.get(job.content.key) if job.content.key else None
    if record is None or record.log == log_address(job.row):
        return record
    return write_record(replace(job, replaces=()), replace(record, log=log_address(job.row)))
