"""Beluga's AMCL: its particle filter, with the names and defaults of its ROS node."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beamfield.geometry import FloatArray, between, wrap_angle
from beamfield.localization.replay import PoseBelief
from beamfield.models.motion import MotionModel
from beamfield.sensors import Scan, SensorLog
from beamfield.stacks.beluga.clusters import heaviest_cluster
from beamfield.stacks.emulation.parameter_checks import check_numbers, check_switches
from beamfield.stacks.filters.amcl_filter import AmclFilterParameters
from beamfield.stacks.filters.emulated_filter import AmclParticles, EmulatedFilter
from beamfield.stacks.filters.histogram import BinSizes, Histogram, kld_limits
from beamfield.stacks.filters.loop import scans_after_motion
from beamfield.stacks.filters.particles import draw_by_weight, n_effective, reweighed, uniform_poses
from beamfield.stacks.filters.recovery import WeightAverages


@dataclass(frozen=True)
class BelugaFilterParameters(AmclFilterParameters):
    """What stands under ``amcl: ros__parameters:`` about the particles.

    Parameters
    ----------
    min_particles, max_particles
        Bounds of the number of particles; the maximum holds where it is below the minimum.
    pf_err, pf_z, resample_interval, recovery_alpha_slow, recovery_alpha_fast
        As for `AmclFilterParameters`, with its defaults.
    update_min_d, update_min_a
        The filter updates when odometry has moved farther than this, metres, or turned by more, radians.
    spatial_resolution_x, spatial_resolution_y, spatial_resolution_theta
        Sides of the bins of KLD sampling, metres and radians.
    selective_resampling
        Only if the effective number of particles is below half their number.

    Raises
    ------
    InvalidInputError
        As for `AmclFilterParameters`, or if a side is not positive.
    """

    spatial_resolution_x: float = field(default=0.5, metadata={"unit": "m"})
    spatial_resolution_y: float = field(default=0.5, metadata={"unit": "m"})
    spatial_resolution_theta: float = field(default=math.radians(10.0), metadata={"unit": "rad"})
    selective_resampling: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        sides = "spatial_resolution_x", "spatial_resolution_y", "spatial_resolution_theta"
        check_numbers(self, positive=sides)
        check_switches(self, "selective_resampling")


def beluga_filter(model: Any, motion: MotionModel, parameters: BelugaFilterParameters) -> BelugaFilter:
    """Return the filter that runs one of Beluga's models on its map."""
    return BelugaFilter(model, model.seen, motion, parameters)


@dataclass(frozen=True, eq=False)
class BelugaFilter(EmulatedFilter):
    """Beluga's AMCL on a map, as it is.

    The loop is AMCL's with these differences: motion counts by its length; particles are drawn until they are more
    than KLD sampling asks for, and the one too many is left out; one and two bins ask for as many as there may be;
    headings are wrapped before they are counted in bins; every update has a new answer, the mean of the heaviest of
    `heaviest_cluster`'s clusters.

    Notes
    -----
    Re-derived from Beluga's amcl.cpp, take_while_kld.hpp and cluster_based_estimation.hpp. Its averages of weights
    are taken after the weights have been normalised, so that they tell only how many particles there are: with
    recovery rates above 0, random poses come in after the number of particles has grown. That is emulated. Where all
    weights are 0 the program computes NaN; here all particles become equal.
    """

    parameters: BelugaFilterParameters = BelugaFilterParameters()

    def update_scans(self, log: SensorLog) -> list[int]:
        """Return the first scan and those after enough motion; see `EmulatedFilter.update_scans`."""
        return scans_after_motion(log, self._has_moved)

    def _has_moved(self, last: FloatArray, now: FloatArray) -> bool:
        step = between(last, now)
        return bool(
            np.hypot(step[0], step[1]) > self.parameters.update_min_d or abs(step[2]) > self.parameters.update_min_a
        )

    def _cloud(self, start: PoseBelief | None, rng: np.random.Generator) -> _Particles:
        return _Particles(self, start, rng)


class _Particles(AmclParticles):
    """A `Cloud`."""

    def __init__(self, beluga: BelugaFilter, start: PoseBelief | None, rng: np.random.Generator) -> None:
        values, n = beluga.parameters, beluga.parameters.max_particles
        super().__init__(beluga, start, n, rng)
        self._beluga = beluga
        self._sizes = BinSizes(
            values.spatial_resolution_x, values.spatial_resolution_y, values.spatial_resolution_theta
        )
        self._limits = np.maximum(kld_limits(n, values.pf_err, values.pf_z), values.min_particles)
        self._limits[:2] = np.inf
        self._averages = WeightAverages(values.recovery_alpha_slow, values.recovery_alpha_fast)

    def move(self, odometry: FloatArray) -> None:
        self.poses = self._beluga.motion.sample(self.poses, odometry, self._rng)
        self.poses[:, 2] = wrap_angle(self.poses[:, 2])

    def weigh(self, scan: Scan) -> None:
        self.weights, _ = reweighed(self.weights, self._weights_of(scan, self.poses))
        self._averages.add(1.0 / len(self.weights))
        self._n_updates += 1

    def resample_when_due(self) -> FloatArray:
        values = self._beluga.parameters
        is_due = self._n_updates % values.resample_interval == 0
        if is_due and (not values.selective_resampling or n_effective(self.weights) < 0.5 * len(self.weights)):
            self._resample()
        return heaviest_cluster(self.poses, self.weights)

    def _resample(self) -> None:
        most = self._beluga.parameters.max_particles
        poses = self.poses[draw_by_weight(self.weights, most, self._rng)]
        random_share = self._averages.random_share()
        if random_share > 0.0:
            # The first is never random.
            is_random = self._rng.random(most) < random_share
            is_random[0] = False
            poses[is_random] = uniform_poses(self._beluga.seen, int(is_random.sum()), self._rng)
            self._averages.reset()
        drawn = Histogram(poses, self._sizes, self._limits)
        n = drawn.n_particles - 1 if drawn.is_enough else most
        self.poses, self.weights = poses[:n], np.full(n, 1.0 / n)
