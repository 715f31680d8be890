"""A fleet's catalogue: records of runs, maps, and beams in Parquet, partitioned by site, robot and day."""

from __future__ import annotations

import datetime
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from beamfield.fleet.folder import Folder
from beamfield.fleet.run_record import RunRecord
from beamfield.maps.occupancy import OccupancyGrid

CATALOGUE_FILE, BEAMS, RUNS, MAPS = "catalogue.json", "beams", "runs", "maps"
Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Shard:
    """The beams of one run and day.

    Parameters
    ----------
    site, robot, day, run
        Whose, and when (UTC).
    rows
        Beams.
    path
        Its file in the catalogue.
    folder
        The catalogue's.
    """

    site: str
    robot: str
    day: datetime.date
    run: str
    rows: int
    path: str
    folder: Folder = field(repr=False)

    @property
    def address(self) -> str:
        """The file's address, without secrets."""
        return self.folder.shown_path(self.path)

    def read(self, columns: Sequence[str], *, fit_only: bool = False, thin: int = 1) -> Columns:
        """Return columns as arrays, in the order of the file: scan by scan.

        Parameters
        ----------
        columns
            Names among those of `beam_schema`.
        fit_only
            Without the beams that are held out.
        thin
            One beam in this many: those where `scan` + `beam` is a multiple of it, so that each beam has its turn.

        Returns
        -------
        Arrays of the types of the schema; `run` as text.

        Raises
        ------
        FormatError
            If the file is damaged, is no Parquet, or has another schema.
        InvalidInputError
            If there is no such column, or thin < 1.
        """
        return _arrays(self._scanner(columns, fit_only, thin), self.address, columns)

    def batches(
        self, columns: Sequence[str], rows: int = 1_000_000, *, fit_only: bool = False, thin: int = 1
    ) -> Iterator[Columns]:
        """Yield what `read` returns in parts of at most so many rows."""
        raise NotImplementedError

    def _scanner(self, columns: Sequence[str], fit_only: bool, thin: int) -> Any:
        raise NotImplementedError


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
        """All records as they were when first asked for, by site, robot, first stamp and run."""
        raise NotImplementedError

    @property
    def used(self) -> tuple[RunRecord, ...]:
        """The records of runs whose beams are used."""
        return tuple(record for record in self.runs if record.is_used)

    def shards(
        self,
        site: str | None = None,
        robot: str | None = None,
        day: datetime.date | None = None,
        runs: Sequence[str] | None = None,
    ) -> tuple[Shard, ...]:
        """Return the files of beams of the runs used, by path; those of a site, robot, day or of some runs alone."""
        raise NotImplementedError

    def dataset(self) -> Any:
        """Return all beams as a `pyarrow.dataset.Dataset`, with the columns site, robot and day."""
        raise NotImplementedError

    def grid(self, record: RunRecord) -> OccupancyGrid:
        """Return the map of a run."""
        raise NotImplementedError


def open_catalogue(address: str, options: Mapping[str, Any] | None = None) -> Catalogue:
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
    """
    raise NotImplementedError


def _arrays(scanner: Any, address: str, columns: Sequence[str]) -> Columns:
    raise NotImplementedError
