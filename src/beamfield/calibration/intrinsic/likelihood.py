"""The log-likelihood of a set of beams as a function of the intrinsic parameters (6.13), prepared for many passes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.kernels import intrinsics as kernels
from beamfield.kernels.device import require_device
from beamfield.kernels.narrow_bins import BIN_BEAMS, NODE_WEIGHTS, NODES, TERMS, Bins, Mixture, cut_into_bins
from beamfield.kernels.threads import run_in_blocks
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.blind_zone import counted_from, expected_from

# Order of the working vector theta: the four weights, the variance sigma_hit^2, its slope sigma_slope^2, offset, rate.
W_HIT, W_SHORT, W_MAX, W_RAND, VARIANCE, SLOPE, OFFSET, RATE = range(8)
N_PARAMETERS = 8
# Positions of the kernel's derivatives in theta.
_KERNEL_ORDER = np.array([W_HIT, W_SHORT, W_RAND, VARIANCE, SLOPE, OFFSET, RATE])
# Beams that one thread takes at a time; fixed, so that sums have the same bits for any number of threads.
_BEAMS_PER_TASK = 32 * BIN_BEAMS


@dataclass(frozen=True)
class ExpectedStatistics:
    """What the M-step needs to know of the responsibilities.

    Parameters
    ----------
    log_likelihood
        Nats, summed over beams.
    counts
        Expected number of beams per cause: hit, short, max, rand; shape (4,).
    node_ranges
        Expected ranges of the nodes that stand for all beams, counted from the sensor's min_range, shape (m,).
    node_hit
        Node weights of e_hit, e_hit r and e_hit r^2 with r = z - z*, shape (3, m).
    node_short
        Node weights of e_short, shape (m,).
    sum_short_range
        Sum of e_short z, metres, counted likewise.
    cut_matters
        Whether some hit is cut off noticeably at 0 or at the maximum range.
    """

    log_likelihood: float
    counts: FloatArray
    node_ranges: FloatArray
    node_hit: FloatArray
    node_short: FloatArray
    sum_short_range: float
    cut_matters: bool


class LikelihoodPasses(Protocol):
    """What a climb asks of a set of beams, wherever they lie."""

    @property
    def n_beams(self) -> float:
        """Number of beams, by weight."""

    @property
    def n_max(self) -> float:
        """Readings at maximum range among them."""

    def expected_statistics(self, theta: FloatArray, *, slope_is_free: bool = False) -> ExpectedStatistics:
        """Do the E-step, see `IntrinsicLikelihood`."""

    def derivatives(self, theta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the log-likelihood, its gradient and its Hessian, see `IntrinsicLikelihood`."""


class IntrinsicLikelihood:
    """Beams sorted by expected range, and passes over them.

    Parameters
    ----------
    ranges, expected_ranges
        Metres, shape (n,), valid: ranges not below `min_range`, 0 <= expected range < `max_range`; a range of
        `max_range` or more is no return.
    max_range
        Limit of the sensor, metres.
    min_range
        Ranges below were not measured, metres. The beams are kept with their ranges counted from here, `max_range` too.
    weights
        How often each beam counts, shape (n,); None for once.
    device
        Where passes over the beams run: "cpu", or "cuda", a GPU, to which the beams are sent with the first.

    Raises
    ------
    InvalidInputError
        If device is "cuda" and there is no GPU, or, with the first pass, one with too little free memory.
    MissingDependencyError
        If device is "cuda" and numba-cuda is not installed.

    Notes
    -----
    Readings at maximum range only count (6.10): no pass touches them. Memory: two doubles per beam beside the caller's
    arrays, three with weights.
    """

    def __init__(
        self,
        ranges: FloatArray,
        expected_ranges: FloatArray,
        max_range: float,
        *,
        min_range: float = 0.0,
        weights: FloatArray | None = None,
        device: str = "cpu",
    ) -> None:
        require_device(device)
        self.device = device
        returned = ranges < max_range
        n_returned = int(np.count_nonzero(returned))
        order = np.flatnonzero(returned) if n_returned < ranges.size else None
        expected = expected_ranges if order is None else expected_ranges[order]
        by_range = np.argsort(expected, kind="stable")
        self.order = by_range if order is None else order[by_range]
        self.returned = returned
        self.expected = expected_from(min_range, np.ascontiguousarray(expected[by_range]))
        self.ranges = counted_from(min_range, np.ascontiguousarray(ranges[self.order]), max_range)
        self.max_range = float(max_range) - float(min_range)
        self.min_range = float(min_range)
        self._set_weights(weights, n_max=float(ranges.size - n_returned))

    def _set_weights(self, weights: FloatArray | None, n_max: float) -> None:
        if weights is None:
            self.weights = np.empty(0)
            self.n_returned = float(self.ranges.size)
            self.n_max = n_max
        else:
            self.weights = np.ascontiguousarray(weights[self.order])
            self.n_returned = float(self.weights.sum())
            self.n_max = float(weights[~self.returned].sum())

    @property
    def n_beams(self) -> float:
        """Number of beams, by weight."""
        return self.n_returned + self.n_max

    def reweighted(self, weights: FloatArray) -> IntrinsicLikelihood:
        """Return the same beams, shared, each counted as often as the weights (n,) say in the caller's order."""
        other = self._shallow_copy()
        other._set_weights(weights, n_max=0.0)
        return other

    def thinned(self, n: int) -> IntrinsicLikelihood:
        """Return about n of the beams, never fewer, evenly spread over the expected ranges.

        It is a likelihood on the CPU whose readings at maximum range count in proportion; self where there are fewer
        than 2 n beams with a return.
        """
        stride = self.ranges.size // n
        if stride < 2:
            return self
        other = self._shallow_copy()
        other.device = "cpu"
        # Beams of one expected range keep their order in time: a stride beside a scan's length must not alias with it.
        chosen = np.sort(np.random.default_rng(0).permutation(self.ranges.size)[: self.ranges.size // stride])
        other.order = self.order[chosen]
        other.ranges = self.ranges[chosen]
        other.expected = self.expected[chosen]
        other.weights = self.weights[chosen] if self.weights.size else self.weights
        other.n_returned = float(other.weights.sum()) if other.weights.size else float(chosen.size)
        other.n_max = self.n_max * other.n_returned / self.n_returned if self.n_returned else self.n_max
        return other

    def _shallow_copy(self) -> IntrinsicLikelihood:
        other = object.__new__(IntrinsicLikelihood)
        other.__dict__.update(self.__dict__)
        other.__dict__.pop("_on_device", None)
        return other

    def expected_statistics(self, theta: FloatArray, *, slope_is_free: bool = False) -> ExpectedStatistics:
        """Do the E-step at the working vector theta (8,): one pass over the beams.

        `slope_is_free`: the M-step will need the moments for a slope though it is 0 here. The log-likelihood is -inf
        where readings at maximum range have weight 0.
        """
        bins = self._cut(theta)
        n_bins = bins.starts.size
        all_moments = bool(slope_is_free or theta[SLOPE] > 0.0)
        sums = np.zeros((n_bins, 5))
        moments = np.zeros((n_bins, 4, TERMS))
        mixture = self._mixture(theta)
        if self.device == "cuda":
            from beamfield.kernels import cuda_em

            cuda_em.em_pass(self._on_device, mixture, bins, sums, moments)
        else:

            def work(first: int, last: int) -> None:
                kernels.em_pass(self._beams, mixture, bins, all_moments, first, last, sums, moments)

            self._over_bins(work, bins)
        totals = sums.sum(axis=0)
        nodes = moments @ NODE_WEIGHTS
        log_max = 0.0
        if self.n_max > 0.0:
            log_max = self.n_max * np.log(theta[W_MAX]) if theta[W_MAX] > 0.0 else -np.inf
        return ExpectedStatistics(
            log_likelihood=float(totals[0] + log_max),
            counts=np.array([totals[1], totals[2], self.n_max, totals[3]]),
            node_ranges=(bins.centres[:, None] + bins.half_widths[:, None] * NODES).reshape(-1),
            node_hit=np.ascontiguousarray(nodes[:, :3].transpose(1, 0, 2).reshape(3, -1)),
            node_short=np.ascontiguousarray(nodes[:, 3].reshape(-1)),
            sum_short_range=float(totals[4]),
            cut_matters=bool(bins.edge.any()),
        )

    def derivatives(self, theta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        """Return the log-likelihood, nats summed over beams, its gradient (8,) and its Hessian (8, 8) at theta (8,).

        The weights are taken as independent.
        """
        bins = self._cut(theta)
        n = kernels.N_DERIVATIVES
        out = np.zeros((bins.starts.size, 1 + n + n * (n + 1) // 2))
        mixture = self._mixture(theta)
        if self.device == "cuda":
            from beamfield.kernels import cuda_em

            cuda_em.newton_pass(self._on_device, mixture, bins, out)
        else:

            def work(first: int, last: int) -> None:
                kernels.newton_pass(self._beams, mixture, bins, first, last, out)

            self._over_bins(work, bins)
        totals = out.sum(axis=0)
        inner = np.zeros((n, n))
        inner[np.tril_indices(n)] = totals[1 + n :]
        inner += np.tril(inner, -1).T
        gradient = np.zeros(N_PARAMETERS)
        hessian = np.zeros((N_PARAMETERS, N_PARAMETERS))
        gradient[_KERNEL_ORDER] = totals[1 : 1 + n]
        hessian[np.ix_(_KERNEL_ORDER, _KERNEL_ORDER)] = inner
        log_likelihood = float(totals[0])
        if self.n_max > 0.0:
            share = theta[W_MAX]
            log_likelihood = log_likelihood + self.n_max * float(np.log(share)) if share > 0.0 else -np.inf
            gradient[W_MAX] = self.n_max / max(share, 1e-300)
            hessian[W_MAX, W_MAX] = -self.n_max / max(share, 1e-150) ** 2
        return log_likelihood, gradient, hessian

    @property
    def _beams(self) -> kernels.Beams:
        return kernels.Beams(self.ranges, self.expected, self.weights)

    @cached_property
    def _on_device(self) -> kernels.Beams:
        from beamfield.kernels.cuda_target import upload

        return kernels.Beams(*(upload(column) for column in self._beams))

    def _mixture(self, theta: FloatArray) -> Mixture:
        return mixture_of(theta, self.max_range, self.min_range)

    def _cut(self, theta: FloatArray) -> Bins:
        return cut(self.expected, self._mixture(theta))

    def _over_bins(self, work: Callable[[int, int], None], bins: Bins) -> None:
        # Tasks of about equal numbers of beams: bins differ in size.
        n_tasks = max(1, self.ranges.size // _BEAMS_PER_TASK)
        limits = np.searchsorted(bins.stops, np.arange(1, n_tasks) * self.ranges.size // n_tasks)
        limits = np.concatenate([[0], limits, [bins.stops.size]])

        def task(first: int, last: int) -> None:
            work(int(limits[first]), int(limits[last]))

        run_in_blocks(task, n_tasks, work_per_row=_BEAMS_PER_TASK)


def mixture_of(theta: FloatArray, span: float, min_range: float) -> Mixture:
    """Return a working vector (8,) as kernels take it, ranges counted from min_range up to `span`, metres."""
    w_hit, w_short, _, w_rand, v, q, b, rate = (float(value) for value in theta)
    return Mixture(span, w_hit, w_short, w_rand, v, q, b, rate, min_range)


def cut(expected: FloatArray, mixture: Mixture) -> Bins:
    """Cut expected ranges (n,), ascending, into the bins of `cut_into_bins`."""
    capacity = 4096 + 2 * expected.size // BIN_BEAMS
    while True:
        bins = Bins(
            np.empty(capacity, dtype=np.int64),
            np.empty(capacity, dtype=np.int64),
            np.empty(capacity),
            np.empty(capacity),
            np.empty(capacity, dtype=np.bool_),
        )
        n_bins = cut_into_bins(expected, mixture, bins)
        if n_bins <= capacity:
            return Bins._make(column[:n_bins] for column in bins)
        capacity = n_bins


def theta_of(parameters: BeamParameters) -> FloatArray:
    """Return the working vector (8,) of parameters: weights, squares of sigma_hit and sigma_slope, offset, rate."""
    return np.array(
        [
            *parameters.weights,
            parameters.sigma_hit**2,
            parameters.sigma_slope**2,
            parameters.range_offset,
            parameters.lambda_short,
        ]
    )


def parameters_of(theta: FloatArray) -> BeamParameters:
    """Return the parameters of a working vector (8,), its weights scaled to sum to 1."""
    weights = theta[:4] / theta[:4].sum()
    return BeamParameters(
        z_hit=float(weights[W_HIT]),
        z_short=float(weights[W_SHORT]),
        z_max=float(weights[W_MAX]),
        z_rand=float(weights[W_RAND]),
        sigma_hit=float(np.sqrt(theta[VARIANCE])),
        lambda_short=float(theta[RATE]),
        range_offset=float(theta[OFFSET]),
        sigma_slope=float(np.sqrt(theta[SLOPE])),
    )
