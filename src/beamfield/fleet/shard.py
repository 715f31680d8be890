"""The beams of one run and day: one Parquet file, read whole or in parts."""

from __future__ import annotations

import datetime
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import as_count
from beamfield.errors import FormatError, InvalidInputError
from beamfield.fleet.beam_schema import COLUMNS, SCHEMA, VERSION_KEY, beam_schema, require_pyarrow
from beamfield.fleet.folder import Folder

Columns = dict[str, NDArray[Any]]

# The prime next to 2^32 over the golden ratio: its multiples are spread evenly among any number of turns.
TURNS_OF_A_SCAN = 2_654_435_761


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
        """Return columns among `COLUMNS` as arrays, in the order of the file: by scan and beam; `run` as text.

        `fit_only` leaves out the beams that are held out; one beam in `thin` is read, spread over scans, bearings and
        shards. FormatError if the file is not there, is damaged, is no Parquet, or has another schema;
        InvalidInputError if there is no such column, or thin < 1.
        """
        parts = list(self.batches(columns, fit_only=fit_only, thin=thin))
        if len(parts) == 1:
            return parts[0]
        types = {field.name: field.type for field in beam_schema()}
        empty = {name: np.empty(0, object if name == "run" else types[name].to_pandas_dtype()) for name in columns}
        return {name: np.concatenate([empty[name], *(part[name] for part in parts)]) for name in columns}

    def batches(
        self, columns: Sequence[str], rows: int = 1_000_000, *, fit_only: bool = False, thin: int = 1
    ) -> Iterator[Columns]:
        """Yield what `read` returns in parts of at most so many rows; none of them is empty."""
        if unknown := [name for name in columns if name not in COLUMNS]:
            raise InvalidInputError(f"columns: expected names among {', '.join(COLUMNS)}; got {unknown[0]!r}")
        as_count(thin, "thin", least=1)
        as_count(rows, "rows", least=1)
        pa = require_pyarrow()
        try:
            fragment = self._fragment(pa)
            scanner = fragment.scanner(
                schema=beam_schema(), columns=list(columns), filter=self._filter(pa, fit_only, thin),
                batch_size=rows,
                batch_readahead=1, use_threads=False,
            )  # fmt: skip
            for batch in scanner.to_batches():
                if batch.num_rows:
                    yield {name: batch.column(name).to_numpy(zero_copy_only=False) for name in columns}
        except FileNotFoundError:
            raise FormatError(self.address, "the run's record names this file, but it is not there") from None
        except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
            raise FormatError(self.address, f"damaged, or no Parquet: {error}") from error

    def _fragment(self, pa: Any) -> Any:
        """Return the file for PyArrow, once its schema and size are what they should be."""
        checked = pa.dataset.ParquetFragmentScanOptions(page_checksum_verification=True)
        fragment = pa.dataset.ParquetFileFormat(default_fragment_scan_options=checked).make_fragment(
            self.folder.path(self.path), filesystem=self.folder.arrow_system
        )
        schema = fragment.physical_schema
        version = (schema.metadata or {}).get(VERSION_KEY, b"none").decode("ascii", "backslashreplace")
        if version != str(SCHEMA):
            raise FormatError(self.address, f"expected beams of schema {SCHEMA}, got schema {version}")
        for column in beam_schema():
            if column.name not in schema.names:
                raise FormatError(self.address, f"the column {column.name!r} is missing")
            if schema.field(column.name).type != column.type:
                got = schema.field(column.name).type
                raise FormatError(self.address, f"expected {column.type} in the column {column.name!r}, got {got}")
        if fragment.metadata.num_rows != self.rows:
            raise FormatError(
                self.address, f"expected {self.rows} rows, as the run's record says, got {fragment.metadata.num_rows}"
            )
        return fragment

    def _filter(self, pa: Any, fit_only: bool, thin: int) -> Any:
        """Return what is left of the rows, as PyArrow takes it, before they are in memory."""
        wanted = None
        if fit_only:
            wanted = ~pa.compute.field("held_out")
        if thin > 1:
            scan, beam = (pa.compute.field(name).cast("int64") for name in ("scan", "beam"))
            # Shards begin at turns of their own: else the first beam of each would always be taken.
            turn = scan * TURNS_OF_A_SCAN + beam + zlib.crc32(self.run.encode())
            # Integers are divided without a remainder.
            its_turn = turn / thin * thin == turn
            wanted = its_turn if wanted is None else wanted & its_turn
        return wanted
