"""What one scan does to a set of particles: how many stay effective, and how wrong they are afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, compose
from beamfield.sensors import SensorLog
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.filters.particles import n_effective, normalised

N_PARTICLES = 2000
# Mean distance of a particle from the truth before the update, metres, and standard deviation of its heading.
START_ERROR, START_TURN = 0.25, 0.1


@dataclass(frozen=True, eq=False)
class ParticleUpdate:
    """One update of a particle set per scan.

    Parameters
    ----------
    error_before, error_after
        (t,) mean distance of the weighted particles from the reference, metres.
    effective
        (t,) effective sample size after the update, of `n_particles`.
    n_particles
        Number of particles.
    """

    error_before: FloatArray
    error_after: FloatArray
    effective: FloatArray
    n_particles: int


def update_particles(
    model: StackModel[Any, Any], log: SensorLog, scans: Sequence[int], *, n_particles: int = N_PARTICLES
) -> ParticleUpdate:
    """Weigh particles around the reference poses by one scan each.

    Particles start `START_ERROR` off in the mean (a normal distribution in x and y), with headings spread by
    `START_TURN`; their offsets are the same for all scans and all calls. InvalidInputError if there are no scans or too
    few particles.
    """
    if n_particles < 2 or len(scans) == 0:
        raise InvalidInputError(f"expected scans and at least 2 particles, got {len(scans)} and {n_particles}")
    rng = np.random.default_rng(0)
    sigma = START_ERROR / np.sqrt(np.pi / 2.0)  # the mean of a Rayleigh distribution
    offsets = rng.normal(0.0, (sigma, sigma, START_TURN), (n_particles, 3))
    distance = np.hypot(offsets[:, 0], offsets[:, 1])
    after, effective = np.empty(len(scans)), np.empty(len(scans))
    for i, scan in enumerate(scans):
        log_weights = model.log_likelihood(log.scan(scan), compose(log.poses[scan], offsets))
        weights = normalised(log_weights)
        after[i], effective[i] = float(weights @ distance), n_effective(weights)
    return ParticleUpdate(np.full(len(scans), distance.mean()), after, effective, n_particles)
