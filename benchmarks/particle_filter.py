"""Time updates of the particle filter on one thread, beside the bare call of its measurement model.

Run: python benchmarks/particle_filter.py
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from beam_model import near, office
from beamfield.kernels.threads import set_threads
from beamfield.localization.particle_filter import FilterOptions, ParticleFilter
from beamfield.localization.resampling import KldSampling
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder
from tables import print_table

N_PARTICLES, N_BEAMS, N_UPDATES = 2000, 60, 60
PARAMETERS = BeamParameters(z_hit=0.8, z_short=0.08, z_max=0.02, z_rand=0.1, sigma_hit=0.1, lambda_short=0.4)
MOTION = GaussianMotion()
ROUNDS = 9


def run() -> list[dict[str, Any]]:
    """Return one row per model and way of drawing."""
    rng = np.random.default_rng(7)
    grid = office(rng)
    finder = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, N_BEAMS), 20.0)
    odometry = np.column_stack([0.02 * np.arange(N_UPDATES), np.zeros(N_UPDATES), np.zeros(N_UPDATES)])
    truth = odometry + np.array([25.0, 25.0, 0.0])
    beam = BeamModel(grid, PARAMETERS, exponent=0.05)
    scans = beam.sample(truth, finder, rng)
    field = LikelihoodFieldModel(grid, LikelihoodFieldParameters.from_beam_parameters(PARAMETERS), exponent=0.05)
    cloud = near(truth[0], rng, N_PARTICLES)
    rows = []
    for name, model in (("likelihood field", field), ("beam model", beam)):
        for drawing, how in (
            ("systematic, below half", {}),
            ("systematic, always", {"resample_below": 1.0}),
            ("KLD, always", {"resample_below": 1.0, "kld": KldSampling(least=N_PARTICLES)}),
        ):
            options = FilterOptions(n_particles=N_PARTICLES, update_distance=0.0, update_turn=0.0, **how)
            whole, bare = times(model, options, cloud, scans, odometry)
            rows.append(
                {
                    "model": name,
                    "drawing": drawing,
                    "updates/s": round(1.0 / whole),
                    "model alone [us]": round(1e6 * bare),
                    "the rest [us]": round(1e6 * (whole - bare)),
                    "update / model alone": round(whole / bare, 2),
                }
            )
    return rows


def times(model: Any, options: FilterOptions, cloud: Any, scans: Any, odometry: Any) -> tuple[float, float]:
    """Return the mean over updates of the least processor time of each, and of the model's call on the same clouds."""
    wholes, bares = np.empty((ROUNDS, len(scans))), np.empty((ROUNDS, len(scans)))
    for k in range(ROUNDS):
        own = ParticleFilter(model, MOTION, options, rng=1)
        own.start(cloud)
        for i, (scan, pose) in enumerate(zip(scans, odometry, strict=True)):
            start = time.thread_time()
            update = own.update(scan, pose)
            middle = time.thread_time()
            model.log_likelihood(scan, update.belief.poses)
            wholes[k, i], bares[k, i] = middle - start, time.thread_time() - middle
    return wholes.min(axis=0).mean(), bares.min(axis=0).mean()


def main() -> None:
    """Print the rows as a Markdown table."""
    with set_threads(1):
        print(f"{N_PARTICLES} particles x {N_BEAMS} beams, one thread\n")
        print_table(run())


if __name__ == "__main__":
    main()
