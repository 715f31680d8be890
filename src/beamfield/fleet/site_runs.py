"""What all runs at one site say about the squares of its map."""

from __future__ import annotations

import datetime
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.fleet.place_counts import READINGS, RunCounts
from beamfield.fleet.shard import Shard
from beamfield.geometry import FloatArray
from beamfield.scan_fit.changed_places import SHORT_SHARE, WALL_SHARE, Reading
from beamfield.scan_fit.place_tallies import Lattice
from beamfield.scan_fit.place_visits import Tally, Visits
from beamfield.short_repr import short_repr

# Share of a run's beams at a square that must differ, for the run to count as one that differs there.
LEAST_SHARES: dict[Reading, float] = {"short": SHORT_SHARE, "beyond": WALL_SHARE, "no return": WALL_SHARE}


@dataclass(frozen=True, eq=False)
class SquareRates:
    """Rates per square of the map, over all runs; only squares that were seen.

    Parameters
    ----------
    x, y
        (m,) lower left corner of each square, metres.
    crossed, short
        Beams that crossed the square or ended there, and short readings that end there.
    tested, beyond, no_return
        Beams that tested a mapped surface in the square; those that went beyond it, and those without return.
    runs, robots
        That saw the square.
    """

    x: FloatArray
    y: FloatArray
    crossed: NDArray[np.int64]
    short: NDArray[np.int64]
    tested: NDArray[np.int64]
    beyond: NDArray[np.int64]
    no_return: NDArray[np.int64]
    runs: NDArray[np.int64]
    robots: NDArray[np.int64]

    __repr__ = short_repr

    @property
    def disagreement(self) -> FloatArray:
        """(m,) the larger one of the share of short readings and that of tested beams which differ."""
        walls = (self.beyond + self.no_return) / np.maximum(self.tested, 1)
        return np.asarray(np.maximum(self.short / np.maximum(self.crossed, 1), walls))


class SiteRuns(NamedTuple):
    """What the runs at one site saw: a `visit` of a tally is the number of a run."""

    lattice: Lattice
    tallies: tuple[Tally, ...]
    robots: tuple[str, ...]
    days: tuple[datetime.date, ...]
    robot: NDArray[np.int64]
    day: NDArray[np.int64]

    @classmethod
    def of(cls, shards: list[Shard], counts: list[RunCounts], lattice: Lattice) -> SiteRuns:
        """Put the counts of runs together."""
        tallies = []
        for reading in READINGS:
            rows = [one.rows(reading) for one in counts]
            place, beams, readings = np.concatenate(rows, axis=1).astype(np.int64)
            tallies.append(
                Tally(place, np.repeat(np.arange(len(rows)), [len(one[0]) for one in rows]), beams, readings)
            )
        robots, robot = np.unique([shard.robot for shard in shards], return_inverse=True)
        days, day = np.unique([shard.day.toordinal() for shard in shards], return_inverse=True)
        dates = tuple(datetime.date.fromordinal(number) for number in days.tolist())
        return cls(lattice, tuple(tallies), tuple(robots.tolist()), dates, robot.reshape(-1), day.reshape(-1))

    def without(self, robots: NDArray[np.int64]) -> SiteRuns:
        """Return what the other robots saw."""
        kept = (~np.isin(self.robot[tally.visit], robots) for tally in self.tallies)
        tallies = (Tally(*(column[rows] for column in tally)) for tally, rows in zip(self.tallies, kept, strict=True))
        return self._replace(tallies=tuple(tallies))

    def visits(self) -> list[Visits]:
        """Return at which squares runs differ, for each of `READINGS`."""
        return [tally.visits(LEAST_SHARES[reading]) for reading, tally in zip(READINGS, self.tallies, strict=True)]

    def rates(self) -> SquareRates:
        """Return the sums of beams per square over all runs."""
        short, beyond, silent = self.tallies
        n = self.lattice.rows * self.lattice.cols

        def total(tally: Tally, what: str) -> NDArray[np.int64]:
            return np.asarray(np.bincount(tally.place, getattr(tally, what), n)[seen].astype(np.int64))

        place, visit = (np.concatenate([getattr(one, name) for one in self.tallies]) for name in ("place", "visit"))
        runs = np.unique(np.column_stack([place, visit]), axis=0)
        robots = np.unique(np.column_stack([runs[:, 0], self.robot[runs[:, 1]]]), axis=0)
        seen = np.unique(place)
        x, y = self.lattice.corners(seen).T
        return SquareRates(
            x=x,
            y=y,
            crossed=total(short, "beams"),
            short=total(short, "readings"),
            tested=total(beyond, "beams"),
            beyond=total(beyond, "readings"),
            no_return=total(silent, "readings"),
            runs=np.bincount(runs[:, 0], minlength=n)[seen],
            robots=np.bincount(robots[:, 0], minlength=n)[seen],
        )
