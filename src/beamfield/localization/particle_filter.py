"""Monte Carlo localization: a belief of weighted poses, moved by odometry and weighed by measurements."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from beamfield.argument_kinds import expect
from beamfield.arguments import as_count, as_floats, as_generator, check_fields, checked, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, Pose, after_step, as_poses, pose_rows, step_between
from beamfield.localization.continuous_odometry import ContinuousOdometry
from beamfield.localization.distance_scale import DistanceScale, ScaleEstimate
from beamfield.localization.particles import Estimate, Particles
from beamfield.localization.recovery import LikelihoodAverages, PoseSource, Recovery, reweigh
from beamfield.localization.resampling import IndexArray, KldSampling, draw_enough, systematic_indices
from beamfield.localization.short_readings import ShortReadings
from beamfield.models.base import MeasurementModel, checked_log_likelihood
from beamfield.models.motion import MotionModel
from beamfield.sensors import Scan

Z = TypeVar("Z")

# A robot that can be anywhere is found once the cloud is so narrow, metres and radians (standard deviations). Until
# then there are so many particles: with 2000, three of 72 starts at Wean Hall are sure of a wrong place.
FOUND_SPREAD, FOUND_TURN = 0.5, 0.5
LEAST_SEARCHING, MOST_SEARCHING = 5000, 50_000
# Particles have relative errors of the odometry's distances from when on the cloud is so narrow, metres: the few that
# are left of a wide one would have a few errors only.
SCALED_SPREAD = 0.25
# After a jump of the odometry the robot may be this far from where it was, metres and radians (standard deviations).
JUMP_SPREAD = np.array([0.3, 0.3, 0.3])


@dataclass(frozen=True)
class FilterOptions:
    """How a particle filter runs.

    Parameters
    ----------
    n_particles
        How many; with `kld`, the most.
    kld
        Adapt the number to the spread of the cloud; None: always n_particles.
    update_distance, update_turn
        A measurement is used once the robot has moved so far, metres, or turned so far, radians, since the last one
        that was used: a robot at rest would count the same evidence again and again. 0: all are used.
    resample_below
        Particles are drawn anew when their effective number falls below this share of their number: 1 draws after
        each measurement, 0 never.
    least_effective
        No single measurement may leave less than this share of the effective number: its likelihood is flattened (taken
        to a power below 1) as far as that needs. It keeps a sparse cloud, as after a global start, from collapsing onto
        the particle that happens to lie nearest to one of many peaks. 0: never.
    recovery
        Draw poses anew when measurements fit worse than they did; needs a source of poses.
    distance_scale
        How far off all of the odometry's distances may be alike; None: they have the motion model's noise alone.

    Raises
    ------
    InvalidInputError
        If a number is out of range.
    """

    n_particles: int = 2000
    kld: KldSampling | None = None
    update_distance: float = 0.5
    update_turn: float = 0.5
    resample_below: float = 0.5
    least_effective: float = 0.02
    recovery: Recovery | None = None
    distance_scale: DistanceScale | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        as_count(self.n_particles, "n_particles", least=1, most=10_000_000)
        for name in ("update_distance", "update_turn"):
            require(0.0 <= getattr(self, name) < math.inf, name, "a finite number >= 0", getattr(self, name))
        for name in ("resample_below", "least_effective"):
            require(0.0 <= getattr(self, name) <= 1.0, name, "a share from 0 to 1", getattr(self, name))
        if self.kld is not None and self.kld.least > self.n_particles:
            raise InvalidInputError(
                f"kld: expected least at most n_particles, {self.n_particles}, got {self.kld.least}"
            )


class Update(NamedTuple):
    """What one measurement did to the belief."""

    belief: Particles
    """After the measurement, before particles were drawn anew."""
    log_evidence: float
    """log sum_i w_i p(z | x_i): how well the measurement fits the belief, nats; -inf if it was impossible."""
    effective: float
    """Effective number of particles after it."""
    power: float
    """To which the likelihood was taken; below 1 where `least_effective` needed it."""
    n_replaced: int
    """Particles that were drawn from the source of poses."""

    @property
    def is_impossible(self) -> bool:
        """Whether no particle could explain the measurement; the weights then stay as they were."""
        return self.log_evidence == -math.inf


class ParticleFilter(Generic[Z]):
    """Monte Carlo localization with any measurement model and any motion model.

    Parameters
    ----------
    model
        p(z | x, m). Its exponent matters: taken for independent, the beams of a scan make the belief far too sure.
    motion
        p(x' | u, x).
    options
        How it runs.
    source
        Where poses come from in a recovery; None without one.
    short_readings
        Leaves out readings of people before a scan is used; None uses all.
    rng
        Source of all randomness; the same seed and calls give the same bits.

    Notes
    -----
    What could go wrong, and what is done:

    - All particles impossible: the measurement changes no weight (`Update.is_impossible`); it counts as 0 in the
      averages of the recovery, which then draws poses anew.
    - Odometry that jumps or is reset: the step is not followed, the cloud is spread by 0.3 m and 0.3 rad, and the next
      measurement is used however little the robot moved (`odometry_jumps` counts).
    - Odometry that is not finite: the measurement is not used, and the next finite pose bridges the gap.
    - A model that returns +inf, NaN or another shape: InvalidInputError. After an error in a model the
      belief is as before, and the next measurement makes up for the motion.

    References
    ----------
    Probabilistic Robotics, Tables 8.2 (MCL) and 8.3 (Augmented_MCL).

    Examples
    --------
    A robot on a corridor's axis that measures its own x:

    >>> from beamfield.models.gaussian_motion import GaussianMotion
    >>> class Position:
    ...     is_normalized = True
    ...     def log_likelihood(self, z, poses):
    ...         return -0.5 * ((np.asarray(poses)[..., 0] - z) / 0.1) ** 2
    >>> own = ParticleFilter(Position(), GaussianMotion(), rng=0)
    >>> own.start(np.random.default_rng(1).uniform([0, -1, 0], [10, 1, 0], (2000, 3)))
    >>> for x in (2.0, 3.0, 4.0):
    ...     update = own.update(x, odometry=[x, 0.0, 0.0])
    >>> own.pose.round(1).tolist()[0], len(own.belief)
    (4.0, 2000)
    """

    def __init__(
        self,
        model: MeasurementModel[Z],
        motion: MotionModel,
        options: FilterOptions | None = None,
        *,
        source: PoseSource[Z] | None = None,
        short_readings: ShortReadings | None = None,
        rng: np.random.Generator | int | None = None,
    ) -> None:
        for name, given, hint in (
            ("model", model, MeasurementModel), ("motion", motion, MotionModel),
            ("options", options, FilterOptions | None),
            ("source", source, PoseSource | None), ("short_readings", short_readings, ShortReadings | None),
        ):  # fmt: skip
            expect(name, given, hint)
        self.options = options or FilterOptions()
        if self.options.recovery is not None and source is None:
            raise InvalidInputError("source: a recovery needs a source of poses, as FreePoses(grid); got None")
        self._model, self._motion, self._source, self._short = model, motion, source, short_readings
        self._rng = as_generator(rng)
        self._belief: Particles | None = None
        self._coarse: MeasurementModel[Z] | None = None
        self._odometry = ContinuousOdometry()

    def __repr__(self) -> str:
        state = "not started" if self._belief is None else f"{len(self._belief)} particles, pose={self.pose.tolist()}"
        return f"ParticleFilter({type(self._model).__name__}, {type(self._motion).__name__}, {state})"

    @checked
    def start(
        self, poses: ArrayLike, weights: ArrayLike | None = None, *, coarse: MeasurementModel[Z] | None = None
    ) -> None:
        """Begin with a cloud; the next measurement is used however little the robot moves.

        Parameters
        ----------
        poses
            (n, 3) poses, as `belief_poses` and `free_poses` draw them. There may be more than n_particles; at the next
            drawing there are as many as the options say.
        weights
            (n,) with the sum 1; None: equal ones.
        coarse
            For a robot that can be anywhere: weighs measurements until the cloud's standard deviations are 0.5 m and
            0.5 rad, with 5000 to 50,000 particles and without recovery. A model that is right about a place may be far
            too sure which of two places it is.

        Raises
        ------
        InvalidInputError
            If the cloud is not finite (n, 3), or the weights do not fit.
        """
        # Copies: the caller may fill the same arrays again.
        given = None if weights is None else np.array(as_floats(weights, "weights"))
        self._belief = Particles(np.array(as_poses(poses), order="C"), given)
        self._scales: FloatArray | None = None
        self._coarse = coarse
        self._odometry = ContinuousOdometry()
        self._used: Pose | None = None
        self._jumps_used = 0
        self._averages = None if self.options.recovery is None else LikelihoodAverages(self.options.recovery)
        self._at_used: Pose | None = None

    @property
    def belief(self) -> Particles:
        """The cloud, as the next measurement will find it before the motion.

        Raises
        ------
        InvalidInputError
            Before `start`.
        """
        if self._belief is None:
            raise InvalidInputError("the filter has no belief yet: start(poses) gives it one")
        return self._belief

    @property
    def pose(self) -> FloatArray:
        """(3,) where the robot is now: the best cluster's mean at the last measurement used, moved on by odometry.

        NaN before the first measurement.
        """
        if self._belief is None or self._at_used is None or self._used is None:
            return np.full(3, np.nan)
        return np.array(after_step(self._at_used, step_between(self._used, self._odometry.pose)))

    @property
    def is_found(self) -> bool:
        """Whether the place is known: not before the start, nor with a coarse model until the cloud is narrow."""
        return self._belief is not None and self._coarse is None

    @property
    def distance_scale(self) -> ScaleEstimate | None:
        """The relative error of the odometry's distances.

        None without a `DistanceScale`, and until the cloud's spread has been 0.25 m.
        """
        if self._belief is None or self._scales is None:
            return None
        mean = float(self._belief.weights @ self._scales)
        return ScaleEstimate(mean, math.sqrt(float(self._belief.weights @ np.square(self._scales - mean))))

    @property
    def odometry_jumps(self) -> int:
        """Steps of the odometry that no robot can have made, and that were not followed."""
        return self._odometry.jumps

    @checked
    def update(self, z: Z, odometry: ArrayLike, stamp: float | None = None) -> Update | None:
        """Take in a measurement and where the odometry is.

        Parameters
        ----------
        z
            What the model takes.
        odometry
            (3,) pose in the odometry frame, at the time of the measurement; NaN where there is none.
        stamp
            Seconds, to tell a fast robot from a jump of the odometry; None: every step is followed.

        Returns
        -------
        What the measurement did; None where it was not used: the robot has hardly moved, or there is no odometry.

        Raises
        ------
        InvalidInputError
            If the filter has not started, the odometry is not (3,), or a model returns what it must not.
        """
        belief = self.belief
        pose = as_floats(odometry, "odometry")
        if pose.shape != (3,):
            raise InvalidInputError(f"odometry: expected (x, y, theta), got shape {pose.shape}")
        if not self._odometry.add(pose, stamp) or not self._has_moved():
            return None
        moved, scales = self._moved(belief)
        if self._short is not None and isinstance(z, Scan):
            z = self._short.leave_out(z, moved, self._rng)  # type: ignore[assignment]  # a scan is what Z is
        model = self._model if self._coarse is None else self._coarse
        log_likelihood = checked_log_likelihood(model, z, moved.poses)
        weights, log_evidence, effective, power = reweigh(moved.weights, log_likelihood, self.options.least_effective)
        weighed = Particles.unchecked(moved.poses, weights)
        if log_evidence == -math.inf:
            effective = 1.0 / float(np.square(weights).sum())
        if self._averages is not None and self.is_found:
            self._averages.add(log_evidence)
        if not self.is_found and _is_narrow(weighed.whole):
            self._coarse = None
        if scales is None and self.is_found and weighed.whole.spread <= SCALED_SPREAD:
            scales = self._drawn_scales(len(weighed))
        self._belief, self._scales, n_replaced = self._drawn(weighed, scales, effective, z)
        self._used, self._jumps_used = self._odometry.pose, self._odometry.jumps
        x, y, theta = weighed.best_cluster.pose.tolist()
        self._at_used = x, y, theta
        return Update(weighed, log_evidence, effective, power, n_replaced)

    def _has_moved(self) -> bool:
        if self._used is None or self._odometry.jumps > self._jumps_used:
            return True
        ahead, left, turn = step_between(self._used, self._odometry.pose)
        return bool(math.hypot(ahead, left) >= self.options.update_distance or abs(turn) >= self.options.update_turn)

    def _moved(self, belief: Particles) -> tuple[Particles, FloatArray | None]:
        """Return the cloud after the motion since the last measurement used, and its errors of distance."""
        scales = self._scales
        if self._used is None:
            return belief, scales
        drawn = self._motion.sample(belief.poses, np.array([self._used, self._odometry.pose]), self._rng)
        poses = as_poses(drawn, "motion")
        if poses.shape != belief.poses.shape:
            raise InvalidInputError(
                f"motion: expected as many poses as there are, {len(belief)}, got shape {poses.shape}"
            )
        if self._odometry.jumps > self._jumps_used:
            poses = poses + JUMP_SPREAD * self._rng.standard_normal(poses.shape)
        elif self.options.distance_scale is not None and scales is not None:
            ahead, left, _ = step_between(self._used, self._odometry.pose)
            distance = math.hypot(ahead, left)
            poses, scales = self.options.distance_scale.move(belief.poses, poses, scales, distance, self._rng)
        return Particles.unchecked(pose_rows(poses), belief.weights), scales

    def _drawn(
        self, belief: Particles, scales: FloatArray | None, effective: float, z: Z
    ) -> tuple[Particles, FloatArray | None, int]:
        """Return the cloud and its errors of distance, drawn anew where due, and how many are poses of the source."""
        share = self._averages.share if self._averages is not None else 0.0
        if share == 0.0 and effective >= self.options.resample_below * len(belief):
            return belief, scales, 0
        indices = self._indices(belief)
        n_replaced = self._rng.binomial(len(indices), share) if share > 0.0 else 0
        fresh = np.zeros((0, 3))
        if n_replaced and self._source is not None:
            fresh = as_poses(self._source.draw(z, n_replaced, self._rng), "source")
            if fresh.ndim != 2 or len(fresh) > n_replaced:
                raise InvalidInputError(f"source: expected at most {n_replaced} poses (n, 3), got shape {fresh.shape}")
            # Which particles go must not depend on their order.
            indices = self._rng.permutation(indices)[len(fresh) :]
        poses = belief.poses[indices]
        poses = np.concatenate([poses, fresh]) if len(fresh) else poses
        if scales is not None:
            scales = scales[indices]
            if (of_fresh := self._drawn_scales(len(fresh))) is not None:
                scales = np.concatenate([scales, of_fresh])
        return Particles.unchecked(poses, np.full(len(poses), 1.0 / len(poses))), scales, len(fresh)

    def _drawn_scales(self, n: int) -> FloatArray | None:
        option = self.options.distance_scale
        return None if option is None else option.draw(n, self._rng)

    def _indices(self, belief: Particles) -> IndexArray:
        kld, most = self.options.kld, self.options.n_particles
        if not self.is_found:
            least = max(LEAST_SEARCHING, most if kld is None else kld.least)
            kld, most = KldSampling(least=least), max(most, MOST_SEARCHING)
        if kld is None:
            return systematic_indices(belief.weights, most, self._rng)
        numbers, n_bins, _, _ = belief.numbered_bins
        return draw_enough(belief.weights, numbers, n_bins, most, kld, self._rng)


def _is_narrow(cloud: Estimate) -> bool:
    return cloud.spread <= FOUND_SPREAD and bool(cloud.covariance[2, 2] <= FOUND_TURN**2)
