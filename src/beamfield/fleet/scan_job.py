"""A run that is to be scanned: its files, what they hold, and its name by that."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from beamfield.errors import BeamfieldError
from beamfield.fleet.beam_schema import SCHEMA
from beamfield.fleet.folder import Folder, is_address, without_secrets
from beamfield.fleet.local_copy import local_copy
from beamfield.fleet.manifest import ManifestRow, log_stem
from beamfield.fleet.run_record import RunRecord
from beamfield.io.files.content_hash import file_hash
from beamfield.io.maps.ros_map import image_path

LONGEST_STEM = 60


class RunContent(NamedTuple):
    """What a run's beams come from.

    Parameters
    ----------
    key
        Hash of it all; "" if something cannot be read.
    log_hash
        SHA-256 of the log; "" if it cannot be read.
    reason
        Why something cannot be read; "" if all can.
    """

    key: str
    log_hash: str
    reason: str


NOT_LOOKED_AT = RunContent("", "", "")


@dataclass(frozen=True)
class ScanJob:
    """A run that is to be scanned.

    Parameters
    ----------
    row
        Of the manifest.
    folder
        The catalogue's. Its options open logs, too.
    content
        By `content_of`.
    replaces
        Records of the same log with other content, whose place it takes.
    """

    # Dask shows what its tasks work on, and addresses may hold secrets.
    row: ManifestRow = field(repr=False)
    folder: Folder
    content: RunContent = NOT_LOOKED_AT
    replaces: tuple[RunRecord, ...] = field(default=(), repr=False)

    @property
    def run(self) -> str:
        """The name of the run in the catalogue."""
        log = log_stem(log_address(self.row).rstrip("/").rpartition("/")[2])
        stem = re.sub(r"[^A-Za-z0-9_.-]", "_", log).lstrip(".")[:LONGEST_STEM]
        # A log that cannot be read has one record, too.
        unread = repr((self.row.site, self.row.robot, log_address(self.row), self.row.sensor)).encode()
        return f"{stem or 'run'}-{(self.content.key or hashlib.sha256(unread).hexdigest())[:12]}"


class RunFiles(NamedTuple):
    """The files of a run on this machine; no poses: None."""

    log: Path
    map: Path
    poses: Path | None


@contextmanager
def run_files(job: ScanJob) -> Iterator[RunFiles]:
    """Yield the files of a run on this machine; they are there while the block runs."""
    row = job.row
    with ExitStack() as stack:

        def fetch(given: str) -> Path:
            return stack.enter_context(local_copy(row.resolve(given), job.folder.options))

        yield RunFiles(fetch(row.log), fetch(row.map), fetch(row.poses) if row.poses else None)


def content_of(job: ScanJob) -> RunContent:
    """Return the hashes of what a run is made from: equal content gives equal beams."""
    row, log_hash = job.row, ""
    try:
        with run_files(job) as files:
            log_hash = file_hash(files.log)
            picture = file_hash(image_path(files.map)) if files.map.suffix in (".yaml", ".yml") else ""
            poses = file_hash(files.poses) if files.poses is not None else ""
            parts = (SCHEMA, log_hash, file_hash(files.map), picture, poses)
    except (BeamfieldError, OSError) as error:
        return RunContent("", log_hash, reason_of(error, job))
    # A mount counts only where one is given, so that catalogues from before there were any hold.
    mount = () if row.mount is None else (row.mount,)
    named = (*parts, row.robot, row.site, row.start, row.sensor, row.lone_poses, *mount)
    return RunContent(hashlib.sha256(repr(named).encode()).hexdigest(), log_hash, "")


def reason_of(error: Exception, job: ScanJob, files: RunFiles | None = None) -> str:
    """Return an error in one line for a record: with the files' addresses as the manifest gives them."""
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    row = job.row
    for given, path in zip((row.log, row.map, row.poses), files or (), strict=False):
        if is_address(given) and path is not None:
            text = text.replace(str(path), without_secrets(given))
    return " ".join(text.split())


def log_address(row: ManifestRow) -> str:
    """Return how records name the log of a row."""
    return without_secrets(row.log)
