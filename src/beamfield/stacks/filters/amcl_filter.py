"""AMCL's particle filter, as nav2 and ROS 1 run it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.kernels.motion import wrap_rotations
from beamfield.localization.replay import PoseBelief
from beamfield.models.differential_motion import SHORTEST_TRANSLATION
from beamfield.models.motion_steps import rotations_and_translation
from beamfield.sensors import Scan, SensorLog
from beamfield.stacks.emulation.parameter_checks import check_counts, check_numbers
from beamfield.stacks.filters.emulated_filter import AmclParticles, EmulatedFilter
from beamfield.stacks.filters.histogram import BinSizes, Histogram, kld_limits
from beamfield.stacks.filters.loop import scans_after_motion
from beamfield.stacks.filters.particles import (
    at_points,
    check_particle_counts,
    n_effective,
    particle_moments,
    reweighed,
    uniform_poses,
)
from beamfield.stacks.filters.recovery import WeightAverages

BINS = BinSizes(0.5, 0.5, np.radians(10.0))
# A filter has converged when all particles are as close to their mean in x and in y, metres.
CONVERGED_DISTANCE = 0.5
# So many more particles than there are now are looked up first.
MARGIN = 100


@dataclass(frozen=True)
class AmclFilterParameters:
    """What amcl's files say about the particles, with nav2's names and defaults.

    Parameters
    ----------
    min_particles, max_particles
        Bounds of the number of particles; a maximum below the minimum is raised to it.
    pf_err, pf_z
        Bound of the divergence and quantile of KLD sampling, see `kld_limits`.
    resample_interval
        Particles are resampled at every so many-th update.
    update_min_d, update_min_a
        The filter updates when odometry has moved by more than this in x or in y, metres, or turned by more, radians.
    recovery_alpha_slow, recovery_alpha_fast
        Rates of the averages of weights by which random poses are mixed in; 0 for none.

    Raises
    ------
    InvalidInputError
        If a count is below 1, pf_err is not positive, or another number is negative or not finite.
    """

    min_particles: int = 500
    max_particles: int = 2000
    pf_err: float = 0.05
    pf_z: float = 0.99
    resample_interval: int = 1
    update_min_d: float = field(default=0.25, metadata={"unit": "m"})
    update_min_a: float = field(default=0.2, metadata={"unit": "rad"})
    recovery_alpha_slow: float = 0.0
    recovery_alpha_fast: float = 0.0

    def __post_init__(self) -> None:
        check_filter(self, {})


def check_filter(parameters: Any, names: Mapping[str, str]) -> None:
    """Refuse values that AMCL's filter cannot compute with; `names` says what it calls nav2's, where that differs."""
    check_counts(parameters, resample_interval=1)
    check_particle_counts(parameters, "min_particles", "max_particles")
    pf_err, pf_z = (names.get(name, name) for name in ("pf_err", "pf_z"))
    rest = pf_z, "update_min_d", "update_min_a", "recovery_alpha_slow", "recovery_alpha_fast"
    check_numbers(parameters, positive=(pf_err,), at_least_zero=rest)


@dataclass(frozen=True, eq=False)
class AmclFilter(EmulatedFilter):
    """AMCL on a map: the filter of nav2 and ROS 1 as it is.

    It starts with max_particles from the start's normal distribution (or uniform over the centres of free cells). The
    first scan, and every scan after enough motion, updates it: particles move, their weights are multiplied by the
    measurement model's and normalised, and (every resample_interval updates) particles are drawn by weight until KLD
    sampling has enough, counted in bins of 0.5 m, 0.5 m and 10 degrees. Its answer is the mean of the heaviest cluster
    of bins that touch; between updates it goes on with the odometry. Where no update resamples, the answer stays the
    last one, continued by odometry.

    Parameters
    ----------
    model, seen, motion, parameters
        As for `EmulatedFilter`.
    selective_resampling
        Whether particles are kept while the effective number of them is above half their number (ROS 1).
    wraps_rotations
        Whether the program wraps the first and the second noisy rotation of a step each for itself, as it does in the
        differential models; see `as_wrapped_rotations`.

    Raises
    ------
    InvalidInputError
        If the map has no free cell.

    Notes
    -----
    Re-derived from nav2's and ROS 1's pf.c, pf_kdtree.c and amcl_node.cpp. Random numbers are NumPy's, so that runs
    agree with the programs' in distribution only. Where all weights are 0, or too small for a double, all particles
    become equal. Headings of particles run on past pi, as the programs' do: particles that differ by a full turn lie
    in different bins. Scans without odometry are left out.
    """

    parameters: AmclFilterParameters = AmclFilterParameters()
    selective_resampling: bool = False
    wraps_rotations: bool = True

    def update_scans(self, log: SensorLog) -> list[int]:
        """Return the first scan and those after enough motion; see `EmulatedFilter.update_scans`."""
        return scans_after_motion(log, self._has_moved)

    def _has_moved(self, last: FloatArray, now: FloatArray) -> bool:
        x, y, turn = map(float, now - last)
        # `wrap_angle` takes ten times as long, for every scan.
        turned = abs(math.pi - (math.pi - turn) % math.tau) > self.parameters.update_min_a
        return turned or max(abs(x), abs(y)) > self.parameters.update_min_d

    def _cloud(self, start: PoseBelief | None, rng: np.random.Generator) -> _Particles:
        return _Particles(self, start, rng)


def as_wrapped_rotations(before: FloatArray, after: FloatArray, odometry: FloatArray) -> FloatArray:
    """Return poses after a step (n, 3) with headings as AMCL has them: other ones may be full turns away.

    Its differential models draw a first rotation, a translation and a second rotation, and wrap each rotation before
    they are added up. Where a robot drives backwards the first is about a half turn, to one side for some particles and
    to the other for the rest: their headings end up a full turn apart, and the particles in bins that do not touch.

    The first rotation follows from the particles before and after the step (n, 3); odometry is (2, 3).
    """
    wrapped = after.copy()
    wrap_rotations(before, wrapped, rotations_and_translation(odometry, SHORTEST_TRANSLATION)[0])
    return wrapped


class _Particles(AmclParticles):
    """A `Cloud`."""

    def __init__(self, amcl: AmclFilter, start: PoseBelief | None, rng: np.random.Generator) -> None:
        values = amcl.parameters
        self._amcl, self._most = amcl, max(values.min_particles, values.max_particles)
        super().__init__(amcl, start, self._most, rng)
        limits = kld_limits(self._most, values.pf_err, values.pf_z)
        self._limits = np.clip(limits, values.min_particles, self._most)
        self._averages = WeightAverages(values.recovery_alpha_slow, values.recovery_alpha_fast)
        self._converged = False

    def move(self, odometry: FloatArray) -> None:
        moved = self._amcl.motion.sample(self.poses, odometry, self._rng)
        self.poses = as_wrapped_rotations(self.poses, moved, odometry) if self._amcl.wraps_rotations else moved

    def weigh(self, scan: Scan) -> None:
        log_weights = self._weights_of(scan, self.poses, converged=self._converged)
        self.weights, total = reweighed(self.weights, log_weights)
        if total > 0.0:
            self._averages.add(total / len(self.weights))
        self._n_updates += 1

    def resample_when_due(self) -> FloatArray | None:
        if self._n_updates % self._amcl.parameters.resample_interval == 0:
            keeps = self._amcl.selective_resampling and n_effective(self.weights) > 0.5 * len(self.weights)
            histogram = None if keeps else self._resample()
            return self._heaviest_cluster(self.weights, histogram)
        if self._n_updates == 1:
            # Clusters are counted when particles are drawn: the first scan has not told on them yet.
            return self._heaviest_cluster(np.full(len(self.weights), 1.0 / len(self.weights)))
        return None

    def _resample(self) -> Histogram:
        """Draw particles by weight until there are enough, and return their bins."""
        random_share = self._averages.random_share()
        points = self._rng.random(self._most)
        # About as many as the last time are enough, mostly: the others need not be looked up.
        few = self._most if random_share > 0.0 else min(self._most, MARGIN + len(self.weights))
        histogram, poses = self._drawn(points[:few], random_share)
        if few < self._most and not histogram.is_enough:
            histogram, poses = self._drawn(points, random_share)
        n = histogram.n_particles
        self.poses, self.weights = poses[:n], np.full(n, 1.0 / n)
        off = np.abs(self.poses[:, :2] - self.poses[:, :2].mean(axis=0))
        self._converged = bool(off.max() <= CONVERGED_DISTANCE)
        return histogram

    def _drawn(self, points: FloatArray, random_share: float) -> tuple[Histogram, FloatArray]:
        poses = self.poses[at_points(self.weights, points)]
        if random_share > 0.0:
            is_random = self._rng.random(len(points)) < random_share
            poses[is_random] = uniform_poses(self._amcl.seen, int(is_random.sum()), self._rng)
            self._averages.reset()
        return Histogram(poses, BINS, self._limits), poses

    def _heaviest_cluster(self, weights: FloatArray, histogram: Histogram | None = None) -> FloatArray:
        labels = (histogram or Histogram(self.poses, BINS)).clusters()
        return particle_moments(self.poses, weights, labels, int(np.argmax(np.bincount(labels, weights))))[0]
