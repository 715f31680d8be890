"""Scan one run: read it, find its poses, cast its beams, write them, and its record last."""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict, replace
from itertools import chain
from typing import Any
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.time_split import held_out_mask
from beamfield.errors import BeamfieldError, MissingDependencyError
from beamfield.fleet.beam_rows import BeamRows
from beamfield.fleet.beam_schema import ENCODINGS, beam_schema, require_pyarrow
from beamfield.fleet.folder import Folder, without_secrets
from beamfield.fleet.posed_run import PosedRun, odometry_errors, read_run
from beamfield.fleet.run_record import RunRecord, ShardFile, record_from_json
from beamfield.fleet.scan_job import ScanJob, log_address, reason_of, run_files
from beamfield.fleet.stored_map import map_info, store_map

EPOCH = datetime.date(1970, 1, 1)
NO_BEAMS = "no beam has both a measurement and an expected range: is it the map of this place?"
WORKER_DIED = "the workers that read it died, of too little memory most often"


def scan_run(job: ScanJob) -> RunRecord:
    """Scan a run, whose content is known, into a catalogue; its record has its beams, or says why they are left out.

    Beams are written first and the record last: a run that is interrupted is not there, and done again. Nothing is done
    if another scan has done it. MissingDependencyError if its log needs a package that is not installed, OSError if the
    catalogue cannot be written.
    """
    done = _record_of(job)
    if done is not None and done.key == job.content.key != "":
        return done
    if job.content.reason:
        return write_record(job, left_out(job, job.content.reason))
    files = None
    with ExitStack() as stack:
        try:
            files = stack.enter_context(run_files(job))
            run = read_run(job.row, files)
        except MissingDependencyError:
            raise
        except (BeamfieldError, OSError, MemoryError) as error:
            # What the content says stays as it is; a disk or memory may not.
            key = job.content.key if isinstance(error, BeamfieldError) else ""
            reason = reason_of(error, job, files) or "too little memory"
            return write_record(job, replace(left_out(job, reason), key=key))
        if run.doubt:
            return write_record(job, replace(left_out(job, run.doubt), findings=run.findings, notes=run.notes))
        return write_record(job, _cast(job, run))


def left_out(job: ScanJob, reason: str) -> RunRecord:
    """Return the record of a run that cannot be used."""
    row = job.row
    return RunRecord(
        run=job.run, robot=row.robot, site=row.site, key=job.content.key, log=log_address(row),
        map=without_secrets(row.map), poses=without_secrets(row.poses), log_sensor=row.sensor,
        log_hash=job.content.log_hash,
        status="left out", reason=reason,
    )  # fmt: skip


def worker_died(job: ScanJob) -> RunRecord:
    """Record a run whose workers died, to be tried again by the next scan."""
    return write_record(job, replace(left_out(job, WORKER_DIED), key=""))


def write_record(job: ScanJob, record: RunRecord) -> RunRecord:
    """Write a record, in the place of those that it replaces: readers never find two of them."""
    folder = job.folder
    for old in job.replaces:
        folder.remove(f"runs/{old.run}.json")
    folder.write(f"runs/{record.run}.json", record.to_json())
    kept = {file.path for file in record.files}
    for old in job.replaces:
        for file in old.files:
            if file.path not in kept:
                folder.remove(file.path)
    return record


def _record_of(job: ScanJob) -> RunRecord | None:
    name = f"runs/{job.run}.json"
    try:
        return record_from_json(job.folder.read(name), job.folder.shown_path(name))
    except FileNotFoundError:
        return None


def _cast(job: ScanJob, run: PosedRun) -> RunRecord:
    """Write a run's beams and map, and return the record that says so."""
    used = np.flatnonzero(run.selection.used)
    held_out = np.zeros(len(run.log), dtype=np.bool_)
    held_out[used] = held_out_mask(run.log.stamps[used])
    rows = BeamRows(run.parts, run.grid, run.covariances, held_out)
    files = []
    for day in np.unique(run.days[used]).tolist():
        file = _write_day(job, day, rows.of_scans(used[run.days[used] == day]))
        if file is not None:
            files.append(file)
    if not files:
        return left_out(job, NO_BEAMS)
    info, (odometry, why) = map_info(run.grid), odometry_errors(run)
    store_map(job.folder, run.grid, info)
    finder, stamps = run.log.finder, run.log.stamps[used]
    return replace(
        left_out(job, ""),
        status="used",
        first_stamp=float(stamps.min()),
        last_stamp=float(stamps.max()),
        scans=len(used),
        beams=sum(file.rows for file in files),
        files=tuple(files),
        sensor={**asdict(finder), "mounts": finder.mounts.tolist()},
        map_info=info,
        pose_source=run.pose_source,
        share_trusted=run.share_trusted,
        odometry=odometry,
        odometry_reason=why,
        selection={"used": len(used), **run.selection.dropped},
        left_out=rows.left_out,
        findings=run.findings,
        notes=run.notes,
    )


def _write_day(job: ScanJob, day: int, parts: Iterator[dict[str, NDArray[Any]]]) -> ShardFile | None:
    """Write the beams of a day, part by part; None if there are none."""
    first = next(parts, None)
    if first is None:
        return None
    date = (EPOCH + datetime.timedelta(days=day)).isoformat()
    site, robot = (quote(name, safe="") for name in (job.row.site, job.row.robot))
    path = f"beams/site={site}/robot={robot}/day={date}/{job.run}.parquet"
    rows, size = _write_beams(job.folder, path, job.run, chain([first], parts))
    return ShardFile(path, date, rows, size)


def _write_beams(folder: Folder, path: str, run: str, parts: Iterator[dict[str, NDArray[Any]]]) -> tuple[int, int]:
    pa, schema, rows = require_pyarrow(), beam_schema(), 0
    numbered = [name for name in schema.names if name not in ENCODINGS and name != "held_out"]
    with folder.writing(path) as file:
        with pa.parquet.ParquetWriter(
            file,
            schema,
            compression="zstd",
            use_dictionary=numbered,
            column_encoding=ENCODINGS,
            write_page_checksum=True,
        ) as writer:
            for part in parts:
                n = len(part["scan"])
                names = pa.DictionaryArray.from_arrays(np.zeros(n, np.int32), [run])
                columns = [names if name == "run" else pa.array(part[name]) for name in schema.names]
                writer.write_batch(pa.RecordBatch.from_arrays(columns, schema=schema))
                rows += n
        return rows, file.stat().st_size
