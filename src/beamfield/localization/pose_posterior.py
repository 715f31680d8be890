"""The posterior over poses given one measurement, on a lattice, and its entropy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import as_count, check_fields, checked, require
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray, as_poses, transform_points, wrap_angle
from beamfield.localization.likelihood_map import free_cells, lattice_shape, over_headings
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.models.base import MeasurementModel, check_takes_poses_alone
from beamfield.short_repr import short_repr

# 8 bytes each, several arrays.
MAX_POSES = 200_000_000


@dataclass(frozen=True, eq=False)
class PoseLattice:
    """Poses at the centres of equal cells in x, y and theta; the prior is uniform over the cells.

    Parameters
    ----------
    corner
        (3,) pose of the lower-left corner of the cells in the map frame, metres and radians.
    resolution
        Side of a cell, metres.
    inside
        (rows, cols) which cells there are; row 0 has the lowest y of the corner's frame.
    headings
        (h,) middles of the heading cells in the map frame, radians.
    heading_step
        Width of a heading cell, radians.

    Raises
    ------
    InvalidInputError
        If a number is out of range, or there is no cell, or more than 200 million poses.

    Examples
    --------
    >>> lattice = PoseLattice.around([2.0, 1.0, 0.0], reach=0.1, resolution=0.1, heading_reach=0.02, heading_step=0.01)
    >>> lattice.n_poses, lattice.centres()[4].round(12).tolist()
    (45, [2.0, 1.0])
    """

    corner: FloatArray
    resolution: float
    inside: BoolArray
    headings: FloatArray
    heading_step: float

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("resolution", "heading_step"):
            require(0.0 < getattr(self, name) < np.inf, name, "a positive, finite number", getattr(self, name))
        if self.heading_step * len(self.headings) > 2.0 * np.pi * (1.0 + 1e-9):
            raise InvalidInputError(
                f"headings: {len(self.headings)} cells of {self.heading_step:g} rad are more than a full turn"
            )
        if not self.n_poses:
            raise InvalidInputError("inside: expected at least one cell and one heading, got none")
        if self.n_poses > MAX_POSES:
            raise InvalidInputError(f"resolution: {self.n_poses:,} poses are more than {MAX_POSES:,}")

    @classmethod
    @checked
    def over_map(cls, grid: OccupancyGrid, *, resolution: float = 0.1, headings: int = 72) -> PoseLattice:
        """Cover what is free in a map, with all headings.

        Parameters
        ----------
        grid
            The map.
        resolution
            Side of a cell, metres.
        headings
            Number of headings over the full turn, from 0 on.

        Returns
        -------
        A lattice of the cells whose centre is free, in the map's own frame; its corner is the map's origin.

        Raises
        ------
        InvalidInputError
            As for the class, or if no cell is free.
        """
        as_count(headings, "headings", least=1, most=MAX_POSES)
        rows, cols = lattice_shape(grid, resolution, MAX_POSES // headings)
        angles = wrap_angle(2.0 * np.pi * np.arange(headings) / headings)
        inside = free_cells(grid, (rows, cols), resolution)
        return cls(grid.origin, resolution, inside, angles, 2.0 * np.pi / headings)

    @classmethod
    @checked
    def around(
        cls, pose: ArrayLike, *, reach: float, resolution: float, heading_reach: float, heading_step: float
    ) -> PoseLattice:
        """Cover a box around a pose, turned with it; the pose is the middle of a cell.

        Parameters
        ----------
        pose
            (3,) metres and radians.
        reach, resolution
            Half the side of the box and the side of a cell, metres.
        heading_reach, heading_step
            Half the range of headings and the width of a cell, radians; pi and more is a full turn.

        Returns
        -------
        A lattice of an odd number of cells a side; of headings too, unless they cover the full turn.

        Raises
        ------
        InvalidInputError
            As for the class, or if a number is not positive.
        """
        middle = as_poses(pose, "pose")
        if not (0.0 < resolution <= reach < np.inf and 0.0 < heading_step <= heading_reach):
            raise InvalidInputError(
                f"reach, heading_reach: expected at least one positive step, got {reach} / {resolution}, "
                f"{heading_reach} / {heading_step}"
            )
        if not 4.0 * (reach / resolution) ** 2 * max(1.0, 2.0 * min(heading_reach, np.pi) / heading_step) <= MAX_POSES:
            raise InvalidInputError(f"resolution, heading_step: these make more than {MAX_POSES:,} poses")
        n = 2 * round(reach / resolution) + 1
        if heading_reach >= np.pi:
            h = max(1, round(2.0 * np.pi / heading_step))
            heading_step, offsets = 2.0 * np.pi / h, np.asarray(2.0 * np.pi * np.arange(h) / h)
        else:
            steps = round(heading_reach / heading_step)
            offsets = np.asarray(heading_step * np.arange(-steps, steps + 1))
        half = -0.5 * n * resolution
        corner = np.array([*transform_points(middle, [half, half]), middle[2]])
        return cls(corner, resolution, np.ones((n, n), np.bool_), wrap_angle(middle[2] + offsets), heading_step)

    @property
    def n_poses(self) -> int:
        """Number of cells in x, y and theta."""
        return int(self.inside.sum()) * len(self.headings)

    def centres(self) -> FloatArray:
        """Return the middles of the cells that are inside, row by row.

        Returns
        -------
        (c, 2) metres in the map frame.
        """
        rows, cols = np.nonzero(self.inside)
        return transform_points(self.corner, (np.column_stack([cols, rows]) + 0.5) * self.resolution)


@dataclass(frozen=True, eq=False)
class PosePosterior:
    """p(x | z, m) under a uniform prior over the cells of a lattice.

    Parameters
    ----------
    lattice
        The cells.
    log_mass
        (c, h) log probability of each cell, c as in `PoseLattice.centres`; the probabilities sum to 1.
    log_evidence
        Log of the mean likelihood over the lattice: of p(z | m) if the model is a density.
    """

    lattice: PoseLattice
    log_mass: FloatArray
    log_evidence: float

    __repr__ = short_repr

    @property
    def entropy(self) -> float:
        """-sum p log p over the cells, nats: 0 if one cell has it all. Half as wide steps add up to log 8."""
        p = np.exp(self.log_mass)
        return max(0.0, float(-(p * np.where(p > 0.0, self.log_mass, 0.0)).sum()))

    @property
    def prior_entropy(self) -> float:
        """Entropy of the uniform prior: log of the number of cells, nats."""
        return float(np.log(self.lattice.n_poses))

    @property
    def information(self) -> float:
        """How much the measurement told: prior entropy minus entropy, nats, >= 0.

        It is also the divergence of the posterior from the prior. Finer lattices leave it as it is once their steps are
        smaller than the posterior's peaks.
        """
        return max(0.0, self.prior_entropy - self.entropy)

    def divergence_from(self, other: PosePosterior) -> float:
        """Return the Kullback-Leibler divergence sum p log(p / q) to another posterior q on the same lattice.

        Nats, >= 0; inf where q excludes a cell that p allows. InvalidInputError if the lattices are not the same
        object.
        """
        if other.lattice is not self.lattice:
            raise InvalidInputError("lattice: expected posteriors on the same lattice, got two lattices")
        p = np.exp(self.log_mass)
        with np.errstate(invalid="ignore"):
            difference = np.where(p > 0.0, self.log_mass - other.log_mass, 0.0)
            return max(0.0, float(np.where(p > 0.0, p * difference, 0.0).sum()))

    def best_pose(self) -> FloatArray:
        """Return the middle of the most probable cell; of equal ones the first.

        Returns
        -------
        (3,) metres and radians.
        """
        cell, heading = np.unravel_index(int(np.argmax(self.log_mass)), self.log_mass.shape)
        return np.array([*self.lattice.centres()[cell], self.lattice.headings[heading]])


@checked
def pose_posterior(model: MeasurementModel[Any], z: Any, lattice: PoseLattice) -> PosePosterior:
    """Return the posterior over the cells of a lattice, from the likelihood at their middles.

    Steps must be narrower than the peaks of the likelihood: then half the steps leave `information` as it is.
    `beamfield.localization.lattice_noise` widens the peaks.

    Parameters
    ----------
    model
        Any measurement model. How dependent its beams or features are taken to be is the model's own choice.
    z
        What it measures.
    lattice
        Where the robot may be.

    Returns
    -------
    The posterior; -inf is the log mass of a cell where the measurement is impossible.

    Raises
    ------
    TooLittleDataError
        If the measurement is impossible at every pose of the lattice: there is no posterior.
    InvalidInputError
        If the model weighs poses together.

    Examples
    --------
    A landmark seen 2 m ahead: the robot knows how far away it is, and little else.

    >>> from beamfield.detections import Detections
    >>> from beamfield.maps.landmarks import LandmarkMap
    >>> from beamfield.models.landmark import LandmarkModel
    >>> from beamfield.models.landmark_parameters import LandmarkParameters
    >>> noise = LandmarkParameters(sigma_range=0.2, sigma_bearing=0.1)
    >>> model = LandmarkModel(LandmarkMap([[3.0, 1.0]]), noise, correspondence="known")
    >>> lattice = PoseLattice.around([1.0, 1.0, 0.0], reach=1.0, resolution=0.1, heading_reach=0.4, heading_step=0.05)
    >>> posterior = pose_posterior(model, Detections([2.0], [0.0], ids=[1]), lattice)
    >>> posterior.best_pose().round(12).tolist()
    [1.0, 1.0, 0.0]
    >>> 0.0 < posterior.entropy < posterior.prior_entropy
    True
    """
    check_takes_poses_alone(model)
    centres = lattice.centres()
    values: FloatArray = np.empty((len(centres), len(lattice.headings)))
    for part, each in over_headings(model, z, centres, lattice.headings):
        values[part] = each
    return posterior_of(values, lattice)


def posterior_of(log_likelihood: FloatArray, lattice: PoseLattice) -> PosePosterior:
    """Normalise the log-likelihoods (c, h) of a lattice's poses, in the order of `PoseLattice.centres`; uniform prior.

    InvalidInputError if the shape is another or a value is NaN or +inf, TooLittleDataError if every value is -inf.
    """
    shape = (int(lattice.inside.sum()), len(lattice.headings))
    require(log_likelihood.shape == shape, "log_likelihood", f"shape {shape}", log_likelihood.shape)
    top = float(log_likelihood.max())
    if np.isnan(top) or top == np.inf:
        raise InvalidInputError(f"log_likelihood: expected numbers below infinity, got {top}")
    if top == -np.inf:
        raise TooLittleDataError(f"the measurement is impossible at all {lattice.n_poses} poses of the lattice")
    # Sums of exponentials of differences to the largest: nothing overflows, and what underflows adds nothing.
    log_total = top + float(np.log(np.exp(log_likelihood - top).sum()))
    return PosePosterior(lattice, log_likelihood - log_total, log_total - float(np.log(lattice.n_poses)))
