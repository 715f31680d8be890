"""MRPT's particle filter CMonteCarloLocalization2D, as mrpt_pf_localization and pf-localization run it."""

# ruff: noqa: N815  (the names are MRPT's)
from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, compose, wrap_angle
from beamfield.localization.replay import PoseBelief
from beamfield.sensors import Scan, SensorLog
from beamfield.stacks.emulation.parameter_checks import check_choice, check_counts, check_numbers, check_switches
from beamfield.stacks.filters.emulated_filter import EmulatedFilter
from beamfield.stacks.filters.histogram import BinSizes
from beamfield.stacks.filters.loop import scans_at_ticks, scans_with_odometry
from beamfield.stacks.filters.particles import check_particle_counts, n_effective, normalised, particle_moments
from beamfield.stacks.mrpt.motion import THRUN, MrptMotion
from beamfield.stacks.mrpt.resampling import METHODS, fast_draws, resampled
from beamfield.stacks.mrpt.sample_size import enough_particles
from beamfield.stacks.mrpt.scan import mrpt_grid
from beamfield.stacks.mrpt.start import initial_poses

ALGORITHM = "pfStandardProposal"
STANDSTILL = np.zeros((2, 3))


@dataclass(frozen=True)
class MrptFilterParameters:
    """What MRPT's files say about the particles, with the defaults of its classes.

    In an ini file this stands in [KLD_options], [PF_options] and [LocalizationExperiment], in a file of
    mrpt_pf_localization under kld_options, pf_options and beside them.

    Parameters
    ----------
    adaptiveSampleSize
        Whether every update draws as many particles as KLD sampling asks for; otherwise there are as many as at the
        start, and they are drawn anew where their effective number falls below BETA of them. True here, as in every
        configuration that comes with MRPT.
    BETA
        See adaptiveSampleSize.
    resamplingMethod
        How particles are drawn: "prMultinomial", "prResidual", "prStratified" or "prSystematic". With
        adaptiveSampleSize the first alone.
    PF_algorithm
        "pfStandardProposal"; others are not emulated.
    powFactor
        The power to which a scan's likelihood is taken.
    KLD_binSize_XY, KLD_binSize_PHI
        Sides of the bins, metres and radians.
    KLD_delta
        Probability that the bound is not kept.
    KLD_epsilon
        Bound of the divergence, nats.
    KLD_minSampleSize, KLD_maxSampleSize
        Bounds of the number of particles.
    particles_count
        How many to start with; 0 for initial_particles_per_m2.
    initial_particles_per_m2
        How many to start with, for each square metre in which the robot can be, of which there are 10 at least.
    relocalize_num_sigmas
        How many standard deviations to either side the particles start in.
    rate_hz
        How often the filter updates, with the newest scan; 0 for every scan.

    Raises
    ------
    InvalidInputError
        If a number or name cannot be computed with, or the algorithm is not emulated.
    """

    adaptiveSampleSize: bool = True
    BETA: float = 0.5
    resamplingMethod: str = METHODS[0]
    PF_algorithm: str = ALGORITHM
    powFactor: float = 1.0
    KLD_binSize_XY: float = field(default=0.2, metadata={"unit": "m"})
    KLD_binSize_PHI: float = field(default=math.radians(5.0), metadata={"unit": "rad"})
    KLD_delta: float = 0.01
    KLD_epsilon: float = 0.02
    KLD_minSampleSize: int = 250
    KLD_maxSampleSize: int = 100_000
    particles_count: int = 0
    initial_particles_per_m2: int = 10
    relocalize_num_sigmas: float = 3.0
    rate_hz: float = field(default=0.0, metadata={"unit": "Hz"})

    def __post_init__(self) -> None:
        check_switches(self, "adaptiveSampleSize")
        check_choice(self, "resamplingMethod", METHODS)
        check_choice(self, "PF_algorithm", (ALGORITHM,))
        check_numbers(
            self,
            positive=("powFactor", "KLD_binSize_XY", "KLD_binSize_PHI", "KLD_delta", "KLD_epsilon",
                      "relocalize_num_sigmas"),
            at_least_zero=("BETA", "rate_hz"),
        )  # fmt: skip
        check_counts(self, particles_count=0, initial_particles_per_m2=1)
        check_particle_counts(self, "KLD_minSampleSize", "KLD_maxSampleSize")
        if self.KLD_delta >= 1.0:
            raise InvalidInputError(f"KLD_delta: expected a probability below 1, got {self.KLD_delta}")
        if self.adaptiveSampleSize and self.resamplingMethod != METHODS[0]:
            raise InvalidInputError(
                f"resamplingMethod: expected {METHODS[0]!r}, without which MRPT stops with adaptiveSampleSize, got "
                f"{self.resamplingMethod!r}"
            )


def mrpt_filter(model: Any, motion: MrptMotion, parameters: MrptFilterParameters) -> MrptFilter:
    """Return the filter that runs one of MRPT's models on its map."""
    return MrptFilter(model, mrpt_grid(model.grid, model.map_mode), motion, parameters)


@dataclass(frozen=True, eq=False)
class MrptFilter(EmulatedFilter):
    """MRPT's particle filter on a map, as it is.

    It starts uniformly over free cells around the start; see `initial_poses`. An update moves the particles and
    multiplies their weights by the scan's likelihood. With adaptiveSampleSize they are first drawn anew by weight
    (`fast_draws`) and moved, one by one, until there are as many as KLD sampling asks for (`enough_particles`).
    Without it they are drawn anew (`resampled`) where the effective number is below BETA of all. The answer is their
    weighted mean. There is no recovery.

    Notes
    -----
    Re-derived from MRPT's PF_implementations.h (PF_SLAM_implementation_pfStandardProposal), CParticleFilter.cpp,
    CParticleFilterCapable.cpp, CMonteCarloLocalization2D.cpp and CPosePDFParticles.cpp, and from mrpt_pf_localization's
    mrpt_pf_localization_core.cpp. With mmThrun all particles of a step move by the same draw: the program draws 300
    steps, but takes the first for each particle. Without adaptiveSampleSize, particles keep their weights when they
    are drawn, so that the next update counts them twice; MRPT 2.5.8 does. Where all weights are 0 the program stops
    with an error; here all particles become equal. Random numbers are NumPy's, so that runs agree with the program's in
    distribution only.

    Not emulated: relocalisation by scan matching, which mrpt_pf_localization has if it was built with
    mola_relocalization; odometry that is newer than the scan.
    """

    motion: MrptMotion
    parameters: MrptFilterParameters = MrptFilterParameters()

    def update_scans(self, log: SensorLog) -> list[int]:
        """Return the scans with odometry, or the newest at every tick of the clock; see `EmulatedFilter`."""
        rate = self.parameters.rate_hz
        return scans_at_ticks(log, rate) if rate > 0.0 else scans_with_odometry(log)

    def _cloud(self, start: PoseBelief | None, rng: np.random.Generator) -> _Particles:
        return _Particles(self, start, rng)


class _Particles:
    """A `Cloud`."""

    def __init__(self, mrpt: MrptFilter, start: PoseBelief | None, rng: np.random.Generator) -> None:
        values = mrpt.parameters
        self._mrpt, self._rng = mrpt, rng
        self.poses = initial_poses(
            mrpt.seen, start, values.relocalize_num_sigmas, values.particles_count, values.initial_particles_per_m2, rng
        )
        self.weights = np.full(len(self.poses), 1.0 / len(self.poses))
        self.move(STANDSTILL)  # the first update has the noise of a step, too

    def move(self, odometry: FloatArray) -> None:
        moved = self._mover(odometry)
        if self._mrpt.parameters.adaptiveSampleSize:
            self._draw_enough(moved)
        else:
            self.poses = moved(self.poses)

    def weigh(self, scan: Scan) -> None:
        gained = self._mrpt._weights_of(scan, self.poses) * self._mrpt.parameters.powFactor
        with np.errstate(divide="ignore"):
            self.weights = normalised(np.log(self.weights) + gained)

    def resample_when_due(self) -> FloatArray:
        values, n = self._mrpt.parameters, len(self.weights)
        if not values.adaptiveSampleSize and n_effective(self.weights) < values.BETA * n:
            drawn = resampled(values.resamplingMethod, self.weights, self._rng)
            # The program resets as many weights as its caller asked particles for: none.
            self.poses, self.weights = self.poses[drawn], self.weights[drawn] / self.weights[drawn].sum()
        return particle_moments(self.poses, self.weights)[0]

    def _mover(self, odometry: FloatArray) -> Callable[[FloatArray], FloatArray]:
        """Return what moves poses (n, 3) by a step."""
        motion, rng = self._mrpt.motion, self._rng
        if motion.modelSelection == THRUN:
            step = motion.sample(np.zeros((1, 3)), odometry, rng)[0]
            return lambda poses: compose(poses, step)

        def moved(poses: FloatArray) -> FloatArray:
            drawn = motion.sample(poses, odometry, rng)
            drawn[:, 2] = wrap_angle(drawn[:, 2])
            return drawn

        return moved

    def _draw_enough(self, moved: Callable[[FloatArray], FloatArray]) -> None:
        values, tried = self._mrpt.parameters, 2 * len(self.poses)
        most = values.KLD_maxSampleSize
        sizes = BinSizes(values.KLD_binSize_XY, values.KLD_binSize_XY, values.KLD_binSize_PHI)
        poses = np.empty((0, 3))
        enough: int | None = None
        while enough is None and len(poses) < most:
            n = min(tried, most) - len(poses)
            poses = np.concatenate([poses, moved(self.poses[fast_draws(self.weights, n, self._rng)])])
            enough = enough_particles(poses, sizes, values.KLD_minSampleSize, values.KLD_epsilon, values.KLD_delta)
            tried *= 2
        self.poses = poses[:enough]
        self.weights = np.full(len(self.poses), 1.0 / len(self.poses))
