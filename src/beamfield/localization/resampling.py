"""Drawing particles by their weights: systematic draws, and as many as the spread of the cloud needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_count, as_floats, as_writeable, check_fields, checked, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels import particles as kernels

IndexArray = NDArray[np.int64]
# The weights' sum may miss 1 by so much.
SUM_TOLERANCE = 1e-6
# Bins of poses: squares with sides of so many metres in x and y, and so many sectors of the heading.
BIN_SIDE, BIN_SECTORS = 0.5, 36


@dataclass(frozen=True)
class KldSampling:
    """How many particles are enough: so many that the error of the drawn bins' distribution is small.

    With k occupied bins, n particles keep the Kullback-Leibler distance between the drawn and the true distribution
    over bins below `error` with the given probability, where n is `particles_needed`.

    Parameters
    ----------
    least
        Fewest particles, however small the cloud: as many are drawn of one that fits into a single bin. From a handful
        it hardly spreads again; 1 leaves one particle for good, which follows the odometry and no measurement.
    error
        The distance, nats.
    probability
        That the distance is kept.

    Raises
    ------
    InvalidInputError
        If a number is out of range.

    References
    ----------
    Fox, "Adapting the sample size in particle filters through KLD-sampling" (2003).
    """

    least: int = 500
    error: float = 0.05
    probability: float = 0.99

    def __post_init__(self) -> None:
        check_fields(self)
        as_count(self.least, "least", least=1)
        require(0.0 < self.error < math.inf, "error", "a positive, finite number", self.error)
        require(0.0 < self.probability < 1.0, "probability", "a number between 0 and 1", self.probability)

    def particles_needed(self, n_bins: ArrayLike) -> NDArray[np.int64]:
        """Return how many particles are enough for so many occupied bins: the bound (7) of Fox, and at least `least`.

        Parameters
        ----------
        n_bins
            (...) numbers of bins; one bin needs only `least`.

        Returns
        -------
        (...) whole numbers.

        Examples
        --------
        >>> KldSampling(least=100).particles_needed([1, 2, 10, 100]).tolist()
        [100, 100, 217, 1347]
        """
        more = np.maximum(as_floats(n_bins, "n_bins") - 1.0, 1e-9)
        share = 2.0 / (9.0 * more)
        quantile = NormalDist().inv_cdf(self.probability)
        # Wilson and Hilferty's approximation of the chi-square quantile with `more` degrees of freedom.
        bound = more / (2.0 * self.error) * np.maximum(1.0 - share + np.sqrt(share) * quantile, 0.0) ** 3
        enough = np.maximum(np.ceil(np.where(more < 0.5, 0.0, bound)), self.least)
        return np.minimum(enough, 2**40).astype(np.int64)


@checked
def systematic_indices(weights: ArrayLike, n: int, rng: np.random.Generator) -> IndexArray:
    """Draw n indices by weight with equally spaced points: low-variance resampling (Probabilistic Robotics, Table 4.4).

    Each index comes n w times in the mean, and the number of times differs from that by less than one. They do not
    fall, and one random number is drawn. InvalidInputError if the weights (m,) are not at least 0 with the sum 1, or n
    < 1.

    >>> systematic_indices([0.5, 0.0, 0.25, 0.25], 4, np.random.default_rng(0)).tolist()
    [0, 0, 2, 3]
    """
    out = np.empty(as_count(n, "n", least=1), np.int64)
    kernels.draw_systematically(as_weights(weights), rng.random(), out)
    return out


def draw_enough(
    weights: FloatArray, bins: IndexArray, n_bins: int, most: int, kld: KldSampling, rng: np.random.Generator
) -> IndexArray:
    """Draw indices by weight, as many as the bins that are hit need but at most `most`, in no order.

    The points on the cumulated weights follow each other at the golden ratio: they are spread nearly as evenly as
    systematic ones, whenever the drawing stops. Weights (m,) sum to 1; bins (m,) are numbered as `bin_numbers` does.
    One number is drawn from the generator.
    """
    out = np.empty(most, np.int64)
    enough = kld.particles_needed(np.arange(n_bins + 1))
    n = kernels.draw_until_enough(weights, bins, n_bins, enough, rng.random(), out)
    return out[:n]


def bin_numbers(poses: FloatArray) -> tuple[IndexArray, int, IndexArray, NDArray[np.int32]]:
    """Return the bin of each pose (n,), how many there are, their keys, and the table in which keys are looked up."""
    numbers, keys = np.empty(len(poses), np.int64), np.empty(len(poses), np.int64)
    slots = np.full(1 << max(4, (2 * len(poses) - 1).bit_length()), -1, np.int32)
    n_bins = kernels.number_bins(poses, BIN_SIDE, BIN_SECTORS, slots, keys, numbers)
    return numbers, n_bins, keys[:n_bins], slots


def as_weights(weights: ArrayLike, n: int | None = None) -> FloatArray:
    """Return weights as an array (n,), any n by default; refuse those below 0, and those whose sum is not 1."""
    values = as_writeable(as_floats(weights, "weights"))
    shape = (max(values.size, 1) if n is None else n,)
    require(values.shape == shape, "weights", f"shape {shape}", values.shape)
    total = float(values.sum())
    if not (values >= 0.0).all() or abs(total - 1.0) > SUM_TOLERANCE:
        raise InvalidInputError(f"weights: expected numbers >= 0 with the sum 1, got the sum {total:.9g}")
    return values
