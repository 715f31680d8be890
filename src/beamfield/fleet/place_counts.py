"""What the beams of one run say about the squares of a map: how many could tell, and how many differ."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable
from beamfield.fleet.catalogue import Catalogue
from beamfield.fleet.run_record import RunRecord
from beamfield.fleet.shard import Shard
from beamfield.fleet.shard_passes import metres, sensor_limits
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.changed_places import Reading
from beamfield.scan_fit.place_beams import MOST_BEAMS, judge_table
from beamfield.scan_fit.place_tallies import Lattice, tally_short, tally_walls

READINGS: tuple[Reading, ...] = ("short", "beyond", "no return")
# Poses may be off by so much, metres; a quarter of it in radians.
REFERENCE_ERROR = 0.04
COLUMNS = ("scan", "beam", "stamp", "range", "expected_range", "x", "y", "heading")


class CountJob(NamedTuple):
    """A run's beams on a day, to be judged with the parameters of its robot."""

    catalogue: Catalogue
    shard: Shard
    record: RunRecord
    parameters: BeamParameters

    @property
    def map_hash(self) -> str:
        """Which map."""
        assert self.record.map_info is not None  # of every run that is used
        return self.record.map_info.content


class RunCounts(NamedTuple):
    """What the beams of a run say about squares; arrays of int32, as there may be many runs.

    Parameters
    ----------
    crossed
        (3, m) the squares that beams crossed or ended in, how many did, and how many short readings end there.
    tested
        (4, n) the squares whose walls beams tested, how many did, and how many of these went beyond, or had no return.
    """

    crossed: NDArray[np.int32]
    tested: NDArray[np.int32]

    def rows(self, reading: Reading) -> NDArray[np.int32]:
        """Return squares, beams with the chance to tell, and those that differ, (3, ...)."""
        return self.crossed if reading == "short" else self.tested[[0, 1, READINGS.index(reading) + 1]]


def count_places(job: CountJob) -> RunCounts:
    """Return what the beams of a run say about each square of the map."""
    grid = _grid(job.catalogue, job.map_hash, job.record)
    lattice, finder = Lattice.over(grid), job.record.finder
    columns = job.shard.read(COLUMNS, thin=1 + job.shard.rows // MOST_BEAMS)
    ranges, expected, _ = metres(columns["range"], columns["expected_range"], sensor_limits(job.record))
    table = BeamTable(
        ranges, expected, columns["scan"], columns["beam"], columns["stamp"], finder.max_range,
        min_range=finder.min_range,
    )  # fmt: skip
    poses = np.column_stack([columns["x"], columns["y"], columns["heading"]])
    beams = judge_table(
        table, compose(poses, finder.mounts[table.beam]), np.zeros(len(table), np.int64), grid, job.parameters,
        reference_error=REFERENCE_ERROR, longest_error=lattice.side,
    )  # fmt: skip
    every: NDArray[np.int32] = np.arange(lattice.rows * lattice.cols, dtype=np.int32).reshape(lattice.shape)
    short, through, silent = (
        tally_short(beams, lattice, every),
        tally_walls(beams, lattice, every, beams.through),
        tally_walls(beams, lattice, every, beams.silent),
    )
    # Both of the latter count the same beams.
    tested = np.stack([through.place, through.beams, through.readings, silent.readings])
    return RunCounts(
        np.stack([short.place, short.beams, short.readings]).astype(np.int32), tested.astype(np.int32)
    )  # fmt: skip


# The map of the last job: jobs come site by site.
_GRIDS: dict[tuple[str, str], OccupancyGrid] = {}


def _grid(catalogue: Catalogue, map_hash: str, record: RunRecord) -> OccupancyGrid:
    key = (repr(catalogue), map_hash)
    if key not in _GRIDS:
        _GRIDS.clear()
        _GRIDS[key] = catalogue.grid(record)
    return _GRIDS[key]
