"""The beam model of range finders: section 6.3, Table 6.1."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses
from beamfield.kernels.beam import fill_scan_log_likelihood
from beamfield.kernels.threads import run_in_slices
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_density import (
    CAUSES,
    as_view,
    beam_cdf,
    beam_components,
    beam_log_density,
    beam_pit,
    beam_responsibilities,
)
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.sensors import RangeFinder, Scan, usable_ranges

__all__ = [
    "CAUSES",
    "BeamModel",
    "beam_cdf",
    "beam_components",
    "beam_log_density",
    "beam_pit",
    "beam_responsibilities",
    "sample_beams",
]

# Rays in memory at a time: 8 MB of expected ranges, whatever the number of poses.
RAYS_PER_CHUNK = 1_000_000


@dataclass(frozen=True, eq=False)
class BeamModel:
    """p(z | x, m) of a range scan by ray casting (6.3): the product over beams of a mixture of four causes.

    For each beam, the expected range z* comes from casting the ray in the map; the reading is a hit of that obstacle,
    an unexpected object before it, no return, or random (6.12). Beams are taken as independent given pose and map
    (6.2).
    It is a proper density over scans, so values can be compared between parameters and with other models.

    Use it when wrong readings have physical causes that matter, for calibration, and where rays must not see through
    walls. It is not smooth in the pose: a likelihood field is the better choice for climbing hills and for scan
    matching in clutter.

    Parameters
    ----------
    grid
        The map.
    parameters
        Weights and shapes of the four densities.
    exponent
        Power of each beam's value (the alpha of 6.3.4), because neighbouring beams are dependent; 1 leaves the product
        as it is. With another value the result is no longer normalised over z.
    n_beams
        Use only so many beams of each scan (6.3.4): about equally spaced among those that carry a measurement, so that
        NaN and too close readings do not use up the number. None uses all.
    unknown
        Whether rays pass unknown cells ("free") or stop there ("occupied").
    finder
        The sensor, for `sample` and `expected`; scans bring their own.
    threads
        Number of threads; None uses every processor. It changes no bit of any result.

    Raises
    ------
    InvalidInputError
        If the exponent is not positive and finite or n_beams < 1.

    Notes
    -----
    Readings follow `Scan`: NaN, and ranges below the sensor's min_range, contribute 0; ranges from max_range on are "no
    return" and have the probability z_max. A pose inside an obstacle has z* = 0 for all beams, a ray that meets none
    has z* = max_range; both have finite values. See `beam_log_density` for what the chapter leaves open.

    Instances are immutable, can be pickled and may be used from several threads.

    References
    ----------
    Probabilistic Robotics, section 6.3: (6.2), (6.4) to (6.12), Table 6.1, and 6.3.4 for exponent and n_beams.

    Examples
    --------
    >>> room = np.zeros((40, 40))
    >>> room[[0, -1]] = 100
    >>> room[:, [0, -1]] = 100
    >>> grid = OccupancyGrid.from_ros(room, resolution=0.1)
    >>> parameters = BeamParameters(z_hit=0.8, z_short=0.1, z_max=0.05, z_rand=0.05, sigma_hit=0.1, lambda_short=0.5)
    >>> finder = RangeFinder.from_bearings([0.0, np.pi / 2], max_range=8.0)
    >>> model = BeamModel(grid, parameters)
    >>> model.log_likelihood(Scan([1.95, 0.95], finder), [[1.95, 2.95, 0.0], [2.95, 1.95, 0.0]]).round(2).tolist()
    [2.36, -7.95]
    """

    is_normalized: ClassVar[bool] = True

    grid: OccupancyGrid
    parameters: BeamParameters
    exponent: float = field(default=1.0, kw_only=True)
    n_beams: int | None = field(default=None, kw_only=True)
    unknown: Literal["free", "occupied"] = field(default="free", kw_only=True)
    finder: RangeFinder | None = field(default=None, kw_only=True)
    threads: int | None = field(default=None, kw_only=True)
    _caster: RayCaster = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not 0.0 < self.exponent < np.inf:
            raise InvalidInputError(f"exponent: expected a positive, finite number, got {self.exponent}")
        if self.n_beams is not None and self.n_beams < 1:
            raise InvalidInputError(f"n_beams: expected at least 1 or None, got {self.n_beams}")
        object.__setattr__(self, "_caster", RayCaster(self.grid, unknown=self.unknown))

    def with_parameters(self, parameters: BeamParameters) -> BeamModel:
        """Return the model with other intrinsic parameters and the same map, options and ray casting tables."""
        other = object.__new__(type(self))
        for name, value in {**self.__dict__, "parameters": parameters}.items():
            object.__setattr__(other, name, value)
        return other

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
        """
        robot = as_poses(poses)
        beams = self.used_beams(z)
        flat = robot.reshape(-1, 3)
        total: FloatArray = np.zeros(len(flat))
        if len(beams) and len(flat):
            self._add_up(z.subset(beams), flat, total)
        return (self.exponent * total).reshape(robot.shape[:-1])

    def beam_log_likelihood(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return what each beam contributes to `log_likelihood`, (..., k); its sum over beams is that value.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`.

        Returns
        -------
        (..., k) nats, times the exponent; 0 for beams that carry no measurement or are left out by n_beams.
        """
        robot = as_poses(poses)
        beams = self.used_beams(z)
        result: FloatArray = np.zeros((*robot.shape[:-1], z.finder.n_beams))
        chosen = z.subset(beams)
        ranges = usable_ranges(chosen.ranges, z.finder)
        expected = self.expected(robot, chosen.finder)
        result[..., beams] = self.exponent * beam_log_density(
            ranges, expected, z.finder.max_range, self.parameters, threads=self.threads
        )
        return result

    def used_beams(self, scan: Scan) -> NDArray[np.int64]:
        """Return the indices of the beams that count: those with a measurement, thinned to n_beams."""
        valid = np.flatnonzero(~np.isnan(usable_ranges(scan.ranges, scan.finder)))
        if self.n_beams is None or self.n_beams >= len(valid):
            return valid
        return np.asarray(valid[np.round(np.linspace(0, len(valid) - 1, self.n_beams)).astype(np.int64)])

    def responsibilities(self, z: Scan, poses: ArrayLike) -> FloatArray:
        """Return how likely each cause is for each reading, (..., k, 4): hit, short, max, rand.

        Parameters
        ----------
        z, poses
            As for `log_likelihood`; exponent and n_beams do not matter here.

        Returns
        -------
        (..., k, 4) probabilities that sum to 1; all 0 for beams that carry no measurement and for impossible readings.
        """
        expected = self.expected(poses, z.finder)
        ranges = usable_ranges(z.ranges, z.finder)
        return beam_responsibilities(ranges, expected, z.finder.max_range, self.parameters, threads=self.threads)

    def expected(self, poses: ArrayLike, finder: RangeFinder | None = None) -> FloatArray:
        """Return the expected ranges z* in metres, (..., k), of a sensor at robot poses (..., 3).

        Parameters
        ----------
        poses
            (..., 3) robot poses, metres and radians.
        finder
            The sensor; by default the model's own.
        """
        return self._caster.expected_ranges(as_poses(poses), self._finder(finder), threads=self.threads)

    def sample(self, poses: ArrayLike, rng: np.random.Generator, finder: RangeFinder | None = None) -> list[Scan]:
        """Draw one scan at each pose.

        Parameters
        ----------
        poses
            (n, 3) robot poses, metres and radians.
        rng
            Source of randomness.
        finder
            The sensor; by default the model's own.

        Returns
        -------
        n scans; readings without return are exactly max_range. Exponent and n_beams do not matter here: the scans are
        drawn from the density itself, with all beams. Draws below the sensor's min_range stay as they are; by the
        conventions of `Scan` they are too close to count.

        Raises
        ------
        InvalidInputError
            If neither the call nor the model has a finder.
        """
        sensor = self._finder(finder)
        expected = self.expected(as_poses(poses).reshape(-1, 3), sensor)
        ranges = sample_beams(expected, sensor.max_range, self.parameters, rng)
        return [Scan(row, sensor) for row in ranges]

    def _finder(self, finder: RangeFinder | None) -> RangeFinder:
        sensor = self.finder if finder is None else finder
        if sensor is None:
            raise InvalidInputError("finder: expected a RangeFinder, here or at the model's construction; got None")
        return sensor

    def _add_up(self, scan: Scan, poses: FloatArray, out: FloatArray) -> None:
        """Fill out (n,) with the sum over beams, chunk by chunk so that memory does not grow with the poses."""
        step = max(1, RAYS_PER_CHUNK // scan.finder.n_beams)
        for start in range(0, len(poses), step):
            part = poses[start : start + step]
            self._fill(scan, self.expected(part, scan.finder), out[start : start + step])

    def _fill(self, scan: Scan, expected: FloatArray, out: FloatArray) -> None:
        """Fill out (n,) with the sum over beams, given the expected ranges (n, k)."""
        ranges = usable_ranges(scan.ranges, scan.finder)
        view = as_view(self.parameters, scan.finder.max_range)
        run_in_slices(
            lambda a, b: fill_scan_log_likelihood(ranges, expected[a:b], view, out[a:b]),
            len(out),
            threads=self.threads,
            work_per_row=len(ranges),
        )

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the ray caster: its tables are large and quick to rebuild."""
        return {name: value for name, value in self.__dict__.items() if name != "_caster"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        for name, value in state.items():
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_caster", RayCaster(self.grid, unknown=self.unknown))
