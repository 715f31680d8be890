"""What windows of scans say of the poses that compete in them, as a function of a model's parameters.

Both kinds of evidence take parameters as points, in coordinates without bounds, and return log-likelihoods (w, n) of w
windows at their n poses, near ones before far ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.intrinsic.likelihood import (
    OFFSET,
    RATE,
    SLOPE,
    VARIANCE,
    W_HIT,
    W_RAND,
    W_SHORT,
    IntrinsicLikelihood,
    parameters_of,
    theta_of,
)
from beamfield.calibration.pose_windows import Window
from beamfield.geometry import FloatArray
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.range_mixture import RangeMixtureModel
from beamfield.sensors import SensorLog, usable_ranges

# A weight that is 0 has no logarithm; one that is learned starts from here.
LEAST_WEIGHT = 1e-4
# An expected range of max_range would be no hit's.
BELOW_MAX = 1.0 - 1e-9
# Metres: no hit is so far from its obstacle, and infinity times nothing is no number.
FAR = 1e6


class BeamEvidence:
    """Evidence for a model around expected ranges.

    Coordinates are the logarithms of z_hit and z_short over z_rand, of sigma_hit^2, sigma_slope^2 and lambda_short, and
    range_offset over its start; those that are 0 stay so. z_max does too: no pose makes "no return" likelier.

    Parameters
    ----------
    model, log, windows
        The model to start from, the log, and w windows of it.
    """

    def __init__(self, model: RangeMixtureModel, log: SensorLog, windows: Sequence[Window]) -> None:
        ranges, expected, rows, first = [], [], [], 0
        for window in windows:
            for i, near, far in zip(window.scans, window.near, window.far, strict=True):
                scan = log.scan(int(i))
                chosen = scan.subset(model.used_beams(scan))
                z_star = model.expected(np.concatenate([near, far]), chosen.finder)
                ranges.append(np.tile(usable_ranges(chosen.ranges, chosen.finder), len(z_star)))
                expected.append(z_star.ravel())
                rows.append(np.repeat(first + np.arange(len(z_star)), z_star.shape[1]))
            first += windows[0].near.shape[1] + windows[0].far.shape[1]
        self._shape = (len(windows), first // len(windows))
        self._finder = log.finder
        self._ranges = np.concatenate(ranges)
        self._expected = np.minimum(np.concatenate(expected), log.finder.max_range * BELOW_MAX)
        self._rows: NDArray[np.int64] = np.concatenate(rows)
        self._likelihood = IntrinsicLikelihood(
            self._ranges, self._expected, log.finder.max_range, min_range=log.finder.min_range
        )
        theta = theta_of(model.parameters)
        theta[[W_HIT, W_RAND]] = np.maximum(theta[[W_HIT, W_RAND]], LEAST_WEIGHT)
        self._theta = theta
        self._weights = [i for i in (W_HIT, W_SHORT) if theta[i] > 0.0]
        self._shapes = [i for i in (VARIANCE, SLOPE, RATE, OFFSET) if theta[i] != 0.0]
        shapes = [1.0 if i == OFFSET else float(np.log(theta[i])) for i in self._shapes]
        self.start = np.array([*np.log(theta[self._weights] / theta[W_RAND]), *shapes])

    def parameters(self, point: FloatArray) -> BeamParameters:
        """Return the parameters at a point."""
        return parameters_of(self._at(point))

    def log_likelihood(self, point: FloatArray) -> FloatArray:
        """Return log p (w, n) of the windows."""
        finder = self._finder
        each = beam_log_density(
            self._ranges, self._expected, finder.max_range, self.parameters(point), min_range=finder.min_range
        )
        return _sums(self._rows, each, self._shape)

    def gradient(self, point: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the derivative by the coordinates of the log-likelihoods' sum with weights (w, n)."""
        theta = self._at(point)
        slopes = self._likelihood.reweighted(weights.ravel()[self._rows]).derivatives(theta)[1]
        mixed = [*self._weights, W_RAND]
        shares = theta[mixed] / theta[mixed].sum()
        by_weight = theta[mixed] * slopes[mixed] - shares * float(theta[mixed] @ slopes[mixed])
        by_shape = [slopes[i] * (self._theta[i] if i == OFFSET else theta[i]) for i in self._shapes]
        return np.array([*by_weight[:-1], *by_shape])

    def _at(self, point: FloatArray) -> FloatArray:
        theta = self._theta.copy()
        mixed = [*self._weights, W_RAND]
        ratios = np.exp(np.append(point[: len(self._weights)], 0.0))
        theta[mixed] = theta[mixed].sum() * ratios / ratios.sum()
        for i, value in zip(self._shapes, point[len(self._weights) :], strict=True):
            theta[i] = self._theta[i] * value if i == OFFSET else np.exp(value)
        theta[:4] /= theta[:4].sum()
        return theta


class FieldEvidence:
    """Evidence for a likelihood field that is continued into unknown space.

    Coordinates are the logarithms of z_hit over z_rand and of sigma_hit; z_hit + z_rand stays.

    Parameters
    ----------
    model, log, windows
        The model to start from, the log, and w windows of it.
    """

    def __init__(self, model: LikelihoodFieldModel, log: SensorLog, windows: Sequence[Window]) -> None:
        squares, rows, first = [], [], 0
        for window in windows:
            for i, near, far in zip(window.scans, window.near, window.far, strict=True):
                distances = model.distances_to_obstacles(log.scan(int(i)), np.concatenate([near, far]))
                pose, beam = np.nonzero(~np.isnan(distances))
                squares.append(np.square(np.minimum(distances[pose, beam], FAR)))
                rows.append(first + pose)
            first += windows[0].near.shape[1] + windows[0].far.shape[1]
        self._shape = (len(windows), first // len(windows))
        self._squares, self._rows = np.concatenate(squares), np.concatenate(rows)
        self._max_range = log.finder.max_range
        p = model.parameters
        hit, rand = max(p.z_hit, LEAST_WEIGHT), max(p.z_rand, LEAST_WEIGHT)
        self._total = p.z_hit + p.z_rand
        self.start = np.array([np.log(hit / rand), np.log(p.sigma_hit)])

    def parameters(self, point: FloatArray) -> LikelihoodFieldParameters:
        """Return the parameters at a point."""
        hit = self._total / (1.0 + np.exp(-point[0]))
        return LikelihoodFieldParameters(float(hit), float(self._total - hit), float(np.exp(point[1])))

    def log_likelihood(self, point: FloatArray) -> FloatArray:
        """Return log q (w, n) of the windows."""
        hit, rand = self._terms(point)
        return _sums(self._rows, np.log(hit + rand), self._shape)

    def gradient(self, point: FloatArray, weights: FloatArray) -> FloatArray:
        """Return the derivative by the coordinates of the log-likelihoods' sum with weights (w, n)."""
        hit, rand = self._terms(point)
        parts = hit / (hit + rand)
        p = self.parameters(point)
        by_share = parts - p.z_hit / (p.z_hit + p.z_rand)
        by_sigma = parts * (self._squares / p.sigma_hit**2 - 1.0)
        return np.array(
            [float((weights * _sums(self._rows, each, self._shape)).sum()) for each in (by_share, by_sigma)]
        )

    def _terms(self, point: FloatArray) -> tuple[FloatArray, float]:
        p = self.parameters(point)
        peak = p.z_hit / (np.sqrt(2.0 * np.pi) * p.sigma_hit)
        return peak * np.exp(-0.5 * self._squares / p.sigma_hit**2), p.z_rand / self._max_range


Evidence = BeamEvidence | FieldEvidence


def _sums(rows: NDArray[np.int64], each: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Add up what beams say, by the rows of all poses."""
    sums: FloatArray = np.bincount(rows, each, shape[0] * shape[1]).astype(np.float64)
    return sums.reshape(shape)
