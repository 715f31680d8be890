"""What every model of range scans by expected ranges has in common: the mixture (6.12) around them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_generator, check_fields, checked, keep
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses
from beamfield.kernels.many_beams import fill_scan_log_likelihood
from beamfield.kernels.mixture_table import fill_looked_up
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_density import as_view, beam_log_density, beam_responsibilities, read_only
from beamfield.models.beam_dependence import settle_dependence
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.models.blind_zone import counted_from, expected_from
from beamfield.models.mixture_table import POSES_WITH_TABLE, mixture_table
from beamfield.sensors import RangeFinder, Scan, usable_ranges

# Rays that a thread casts before it weighs them: 0.8 MB of expected ranges, which stay in its cache.
RAYS_PER_CHUNK = 100_000


class RangeSource(Protocol):
    """Where expected ranges come from: rays or cones in a grid, the nearest landmark in a cone."""

    def expected_ranges(self, poses: ArrayLike, finder: RangeFinder) -> FloatArray:
        """Return the expected ranges z* of a sensor.

        Parameters
        ----------
        poses
            (..., 3) robot poses, metres and radians.
        finder
            The sensor, of k beams.

        Returns
        -------
        (..., k) metres in [0, finder.max_range].
        """
        ...


class GridCaster(RangeSource, Protocol):
    """Where the expected ranges of rays in a grid come from: cast one by one, or looked up."""

    @property
    def grid(self) -> OccupancyGrid:
        """The map."""
        ...

    @property
    def unknown(self) -> str:
        """Whether rays pass unknown cells ("free") or stop there ("occupied")."""
        ...


class RangeMixtureModel(ABC):
    """p(z | x, m): the product over beams of a mixture of four causes around the expected range z* of each.

    Base of `BeamModel` and `SonarModel`, which say where z* comes from; the rest is theirs in common. A subclass is a
    frozen dataclass with these fields.
    """

    parameters: BeamParameters
    exponent: float
    n_beams: int | None
    finder: RangeFinder | None
    _source: RangeSource

    @abstractmethod
    def _make_source(self) -> RangeSource:
        """Return where expected ranges come from, built from the fields."""

    def __post_init__(self) -> None:
        check_fields(self)
        settle_dependence(self)
        keep(self, _source=self._make_source())

    @property
    def is_normalized(self) -> bool:
        """Whether it is a density over scans: a power of one is none, and some beams say nothing of the others."""
        return self.exponent == 1.0 and self.n_beams is None

    def with_parameters(self, parameters: BeamParameters) -> Self:
        """Return the model with other intrinsic parameters and the same map, options and tables.

        Parameters
        ----------
        parameters
            The new ones.

        Returns
        -------
        A model of the same class; nothing is built again.
        """
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__ | {"parameters": parameters})
        return other

    @checked
    def log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return log p(z | x, m) of one scan at many poses: Table 6.1 in log space.

        Parameters
        ----------
        z
            The scan.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats, times the exponent; -inf where the parameters make a reading impossible, never NaN. A scan without
        any measurement gives 0.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).

        Notes
        -----
        From 10,000 poses on, each beam is looked up in a table over z*, within 1e-4 nats; below, it is computed.
        """
        robot = as_poses(poses)
        beams = self.used_beams(z)
        flat = robot.reshape(-1, 3)
        total: FloatArray = np.zeros(len(flat))
        if len(beams) and len(flat):
            self._add_up(_with_beams(z, beams), flat, total)
        return (self.exponent * total).reshape(robot.shape[:-1])

    @checked
    def beam_log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return what each beam contributes to `log_likelihood`, (..., k); its sum over beams is that value.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.

        Returns
        -------
        (..., k) nats, times the exponent; 0 for beams that carry no measurement or are left out by n_beams, -inf where
        the parameters make a reading impossible.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        robot = as_poses(poses)
        beams = self.used_beams(z)
        result: FloatArray = np.zeros((*robot.shape[:-1], z.finder.n_beams))
        chosen = _with_beams(z, beams)
        ranges = usable_ranges(chosen.ranges, z.finder)
        expected = self.expected(robot, chosen.finder)
        max_range, min_range = z.finder.max_range, z.finder.min_range
        each = beam_log_density(ranges, expected, max_range, self.parameters, min_range=min_range)
        result[..., beams] = self.exponent * each
        return result

    def used_beams(self, scan: Scan) -> NDArray[np.int64]:
        """Return which beams count: those with a measurement, thinned to n_beams about equally spaced ones."""
        _refuse_logs(scan)
        # What `usable_ranges` leaves, in a third of its time.
        valid: NDArray[np.int64] = (scan.ranges >= scan.finder.min_range).nonzero()[0]
        if self.n_beams is None or self.n_beams >= len(valid):
            return valid
        return np.asarray(valid[np.round(np.linspace(0, len(valid) - 1, self.n_beams)).astype(np.int64)])

    @checked
    def responsibilities(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return how likely each cause is for each reading, (..., k, 4): hit, short, max, rand.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`; exponent and n_beams do not matter here.

        Returns
        -------
        (..., k, 4) probabilities that sum to 1; all 0 for beams that carry no measurement and for impossible readings.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        _refuse_logs(z)
        expected = self.expected(poses, z.finder)
        ranges, limits = usable_ranges(z.ranges, z.finder), (z.finder.max_range, z.finder.min_range)
        return beam_responsibilities(ranges, expected, limits[0], self.parameters, min_range=limits[1])

    @checked
    def expected(self, poses: ArrayLike, finder: RangeFinder | None = None) -> FloatArray:
        """Return the expected ranges z* of a sensor, blind zone or not.

        Parameters
        ----------
        poses
            (..., 3) robot poses, metres and radians.
        finder
            The sensor; by default the model's own.

        Returns
        -------
        (..., k) metres in [0, max_range].

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), or neither the call nor the model has a finder.
        """
        return self._source.expected_ranges(as_poses(poses), self._finder(finder))

    @checked
    def sample(
        self, poses: ArrayLike, finder: RangeFinder | None = None, rng: np.random.Generator | int | None = None
    ) -> list[Scan]:
        """Draw one scan at each pose.

        Parameters
        ----------
        poses
            (n, 3) robot poses, metres and radians.
        finder
            The sensor; by default the model's own.
        rng
            Source of randomness, a seed, or None for other numbers each time.

        Returns
        -------
        n scans; readings without return are exactly max_range, none is below the sensor's min_range. Exponent and
        n_beams do not matter here: the scans are drawn from the density itself, with all beams.

        Raises
        ------
        InvalidInputError
            If neither the call nor the model has a finder, or the poses are not finite.
        """
        sensor = self._finder(finder)
        expected, draws = self.expected(as_poses(poses).reshape(-1, 3), sensor), as_generator(rng)
        ranges = sample_beams(expected, sensor.max_range, self.parameters, draws, min_range=sensor.min_range)
        return [Scan(row, sensor) for row in ranges]

    def _finder(self, finder: RangeFinder | None) -> RangeFinder:
        sensor = self.finder if finder is None else finder
        if sensor is None:
            raise InvalidInputError("finder: expected a RangeFinder, here or at the model's construction; got None")
        return sensor

    def _add_up(self, scan: Scan, poses: FloatArray, out: FloatArray) -> None:
        """Fill out (n,) with the sum over beams, chunk by chunk so that memory does not grow with the poses."""
        finder = scan.finder
        view = as_view(self.parameters, finder.max_range, finder.min_range)
        ranges = read_only(counted_from(finder.min_range, scan.ranges, finder.max_range))
        table = mixture_table(ranges, view) if len(poses) >= POSES_WITH_TABLE else None
        step = max(1, RAYS_PER_CHUNK // finder.n_beams)

        def work(start: int, stop: int) -> None:
            for at in range(start, stop, step):
                part = slice(at, min(at + step, stop))
                expected = read_only(expected_from(finder.min_range, self._source.expected_ranges(poses[part], finder)))
                if table is None:
                    fill_scan_log_likelihood(ranges, expected, view, out[part])
                else:
                    fill_looked_up(ranges, expected, view, table, out[part])

        run_in_blocks(work, len(poses), work_per_row=finder.n_beams)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the tables: they are large and quick to rebuild."""
        return {name: value for name, value in self.__dict__.items() if name != "_source"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        keep(self, _source=self._make_source())


def _refuse_logs(scan: Scan) -> None:
    """Raise for a log of scans, which has ranges and a finder, too; `checked` says whose argument it is."""
    if scan.ranges.ndim != 1:
        raise TypeError(f"expected a Scan, got {type(scan).__name__}")


def _with_beams(scan: Scan, beams: NDArray[np.int64]) -> Scan:
    """Return the scan with only these beams, which rise."""
    if len(beams) == len(scan.ranges):
        return scan
    return Scan(scan.ranges[beams], _finder_of(scan.finder, beams.tobytes()), scan.stamp)


# The same beams are chosen from most scans of a log: their finder is then the same, too, and a caster knows it already.
@lru_cache(maxsize=16)
def _finder_of(finder: RangeFinder, beams: bytes) -> RangeFinder:
    return finder.subset(np.frombuffer(beams, dtype=np.int64))
