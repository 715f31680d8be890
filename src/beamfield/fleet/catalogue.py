"""A fleet's catalogue: records of runs, maps, and beams in Parquet, partitioned by site, robot and day."""

from __future__ import annotations

import datetime
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from beamfield.errors import FormatError, InvalidInputError
from beamfield.fleet.beam_schema import SCHEMA, beam_schema, require_pyarrow
from beamfield.fleet.folder import Folder, is_address
from beamfield.fleet.run_record import RunRecord, record_from_json
from beamfield.fleet.shard import Shard
from beamfield.fleet.stored_map import load_map
from beamfield.maps.occupancy import OccupancyGrid

CATALOGUE_FILE, BEAMS, RUNS = "catalogue.json", "beams", "runs"
# Files that are in memory at a time.
READ_AT_ONCE = 200


@dataclass(frozen=True)
class Catalogue:
    """A fleet's runs and beams.

    Parameters
    ----------
    folder
        Where it is.
    """

    folder: Folder

    @cached_property
    def runs(self) -> tuple[RunRecord, ...]:
        """All records as they were when first asked for, by site, robot, first stamp and run.

        Raises
        ------
        FormatError
            If a file is not the record of its run.
        """
        records = read_records(self.folder)
        return tuple(sorted(records, key=lambda one: (one.site, one.robot, one.is_used, one.first_stamp, one.run)))

    @property
    def used(self) -> tuple[RunRecord, ...]:
        """The records of runs whose beams are used."""
        return tuple(record for record in self.runs if record.is_used)

    def files_of_no_run(self) -> tuple[str, ...]:
        """Return the files of beams that no record names, if asked before the records are.

        Scans that were killed have left them, or others are writing their records now: nothing tells these apart.
        """
        files = self.folder.files_below(BEAMS)
        named = {file.path for record in self.runs for file in record.files}
        return tuple(path for path in files if path not in named)

    def shards(self, robot: str | None = None) -> tuple[Shard, ...]:
        """Return the files of beams of the runs used, by path; those of a robot alone."""
        found = (
            Shard(record.site, record.robot, datetime.date.fromisoformat(file.day), record.run, file.rows, file.path,
                  self.folder)
            for record in self.used
            for file in record.files
            if robot in (None, record.robot)
        )  # fmt: skip
        return tuple(sorted(found, key=lambda one: one.path))

    def dataset(self) -> Any:
        """Return all beams as a `pyarrow.dataset.Dataset`, with the columns site, robot and day.

        Other programs read it, too (docs/fleet.md). It holds the files that records name, and no others that may lie
        in the folder.
        """
        pa = require_pyarrow()
        parts = pa.schema([("site", pa.string()), ("robot", pa.string()), ("day", pa.date32())])
        fields = [*beam_schema(), *parts]
        return pa.dataset.dataset(
            [self.folder.path(shard.path) for shard in self.shards()],
            schema=pa.schema(fields),
            format="parquet",
            filesystem=self.folder.arrow_system,
            partitioning=pa.dataset.partitioning(parts, flavor="hive"),
            partition_base_dir=self.folder.path(BEAMS),
        )

    def grid(self, record: RunRecord) -> OccupancyGrid:
        """Return the map of a run.

        Raises
        ------
        FormatError
            If its file is not there, is damaged, or is another map.
        InvalidInputError
            If the run was left out and has none.
        """
        if record.map_info is None:
            raise InvalidInputError(f"{record.run}: the run was left out and has no map: {record.reason}")
        return load_map(self.folder, record.map_info)


def open_catalogue(address: str | os.PathLike[str], options: Mapping[str, Any] | None = None) -> Catalogue:
    """Open a catalogue.

    Parameters
    ----------
    address
        A folder, or an fsspec address such as ``s3://bucket/fleet``.
    options
        Storage options for fsspec.

    Raises
    ------
    FormatError
        If it is none, or of another schema.
    OSError
        As the file system says.
    """
    require_pyarrow()
    folder = _folder(address, options)
    shown = folder.shown_path(CATALOGUE_FILE)
    try:
        said = json.loads(folder.read(CATALOGUE_FILE))
        schema = said["schema"]
    except (FileNotFoundError, NotADirectoryError):
        raise FormatError(folder.shown, f"no catalogue of a fleet: it has no {CATALOGUE_FILE}") from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise FormatError(shown, "expected the version of a fleet's catalogue, got something else") from error
    if schema != SCHEMA:
        raise FormatError(
            shown, f"the catalogue has schema {schema!r}, this version of beamfield reads {SCHEMA}: scan into a new one"
        )
    return Catalogue(folder)


def create_catalogue(address: str | os.PathLike[str], options: Mapping[str, Any] | None = None) -> Catalogue:
    """Open a catalogue, or begin one in a folder that is empty or not there; FormatError if it holds other files."""
    from beamfield import __version__

    folder = _folder(address, options)
    if not folder.exists(CATALOGUE_FILE):
        # What another scan writes at this moment is in hidden folders.
        foreign = [name for name in folder.names() if not name.startswith(".") and name != CATALOGUE_FILE]
        if foreign:
            raise FormatError(
                folder.shown, f"expected a catalogue or an empty folder, got {foreign[0]!r} and no {CATALOGUE_FILE}"
            )
        said = {"schema": SCHEMA, "beamfield": __version__}
        folder.write(CATALOGUE_FILE, (json.dumps(said) + "\n").encode())
    return open_catalogue(address, options)


def _folder(address: str | os.PathLike[str], options: Mapping[str, Any] | None) -> Folder:
    given = str(address)
    # Workers may have another working folder.
    return Folder(given if is_address(given) else os.path.abspath(given), options or {})  # noqa: PTH100


def read_records(folder: Folder) -> list[RunRecord]:
    """Return all records of a catalogue; FormatError if a file is not the record of its run."""
    paths = [f"{RUNS}/{name}" for name in folder.names(RUNS) if name.endswith(".json")]
    records = []
    sensors: dict[str, Mapping[str, Any]] = {}
    for start in range(0, len(paths), READ_AT_ONCE):
        some = paths[start : start + READ_AT_ONCE]
        for path, content in zip(some, folder.read_all(some), strict=True):
            if content is None:  # another scan has replaced it since
                continue
            record = record_from_json(content, folder.shown_path(path), sensors)
            if path != f"{RUNS}/{record.run}.json":
                raise FormatError(folder.shown_path(path), f"the record of another run, {record.run!r}")
            records.append(record)
    return records
