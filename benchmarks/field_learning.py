"""Ways to learn a likelihood field, on held-out blocks of real logs: ``python benchmarks/field_learning.py [FOLDER]``.

Each way is judged by the posteriors that 60 beams of a scan make around the reference poses, in nats over knowing
nothing, and by the share of them whose 90% region holds the truth. FOLDER holds the logs and maps (default:
../shared/data beside the checkout).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit, logit

from beamfield.calibration.calibrate import calibrate
from beamfield.calibration.context.exponent import (
    EXPONENTS,
    LEVEL,
    scan_log_likelihoods,
    score_exponents,
    suited_exponent,
)
from beamfield.calibration.context.posterior_judge import PosteriorScores
from beamfield.calibration.field.learning import learn_field_parameters
from beamfield.calibration.pose_windows import HELD_OUT, Rivals, Window, WindowOptions, cut_windows, draw_rivals
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import EXTENSIONS
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import SensorLog
from real_logs import LOGS, read_log_and_map
from tables import print_table

N_BEAMS = 60
NAV2_DEFAULTS = LikelihoodFieldParameters(0.5, 0.5, 0.2)
# Steps of the first simplex in the logit of z_hit, log sigma_hit and log exponent.
FIRST_STEPS = np.array([2.0, -0.7, -0.7])


@dataclass(frozen=True, eq=False)
class World:
    """A log cut into windows."""

    log: SensorLog
    grid: OccupancyGrid
    rivals: Rivals
    windows: list[Window]

    @classmethod
    def of(cls, log: SensorLog, grid: OccupancyGrid) -> World:
        options = WindowOptions()
        rivals = draw_rivals(options, grid)
        return cls(log, grid, rivals, cut_windows(log, grid, rivals, options))

    def values(self, parameters: LikelihoodFieldParameters, *, held_out: bool) -> FloatArray:
        """Return log q of the windows, (w, n)."""
        model = LikelihoodFieldModel(self.grid, parameters, n_beams=N_BEAMS)
        windows = [w for w in self.windows if (w.fold == HELD_OUT) == held_out]
        return scan_log_likelihoods(model, self.log, windows).sum(axis=1)

    def scores(self, values: FloatArray, exponents: FloatArray) -> list[PosteriorScores]:
        return score_exponents(values, exponents, self.rivals)

    def suited_exponent(self, parameters: LikelihoodFieldParameters) -> float:
        values = self.values(parameters, held_out=False)
        return suited_exponent(np.array([score.coverage_at(LEVEL) for score in self.scores(values, EXPONENTS)]))

    def by_posterior(self, start: LikelihoodFieldParameters, exponent: float | None) -> tuple[Any, float]:
        """Return the parameters, and the exponent if none is given, whose posteriors are best on windows to fit to."""

        def loss(x: FloatArray) -> float:
            power = exponent if exponent is not None else min(1.0, float(np.exp(x[2])))
            values = self.values(_field(x), held_out=False)
            return -self.scores(values, np.array([power]))[0].mean

        first = [logit(start.z_hit / (start.z_hit + start.z_rand)), np.log(start.sigma_hit), np.log(0.2)]
        first = np.array(first[: 2 if exponent is not None else 3])
        simplex = first + np.vstack([np.zeros(len(first)), np.diag(FIRST_STEPS[: len(first)])])
        options = {"initial_simplex": simplex, "maxfev": 150, "xatol": 0.01, "fatol": 0.001}
        found = minimize(loss, first, method="Nelder-Mead", options=options).x
        return _field(found), exponent if exponent is not None else min(1.0, float(np.exp(found[2])))


def _field(x: FloatArray) -> LikelihoodFieldParameters:
    return LikelihoodFieldParameters(float(expit(x[0])), float(expit(-x[0])), float(np.exp(x[1])))


def ways(world: World) -> dict[str, tuple[LikelihoodFieldParameters, float]]:
    """Return what each way of learning makes of the log: parameters and exponent."""
    learned = learn_field_parameters(world.log, world.grid, n_beams=N_BEAMS)
    beam = calibrate(world.log, world.grid).parameters
    of_beam = LikelihoodFieldParameters.from_beam_parameters(beam, drop=EXTENSIONS)
    density = replace(learned.parameters, sigma_hit=learned.density_sigma)
    return {
        "nav2's defaults": (NAV2_DEFAULTS, 1.0),
        "beam model's": (of_beam, 1.0),
        "beam model's, exponent by coverage": (of_beam, world.suited_exponent(of_beam)),
        "density": (density, 1.0),
        "density, exponent by coverage": (density, world.suited_exponent(density)),
        "**density and the reference's error, exponent by coverage**": (learned.parameters, learned.exponent),
        "z_hit : z_rand and sigma_hit by the posterior": world.by_posterior(NAV2_DEFAULTS, 1.0),
        "all by the posterior": world.by_posterior(learned.parameters, None),
    }


def run(folder: Path) -> list[dict[str, Any]]:
    """Return one row per log and way."""
    rows = []
    for name, *paths in LOGS:
        if "mcap" in name:
            continue  # the same log as another
        world = World.of(*read_log_and_map(folder, *paths))
        for way, (parameters, exponent) in ways(world).items():
            [score] = world.scores(world.values(parameters, held_out=True), np.array([exponent]))
            rows.append({
                "log": name, "way": way, "z_hit": parameters.z_hit, "z_rand": parameters.z_rand,
                "sigma_hit [m]": parameters.sigma_hit, "exponent": exponent, "nats": score.mean,
                "covered [%]": 100.0 * score.coverage_at(LEVEL),
            })  # fmt: skip
    return rows


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    print_table(run(Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared" / "data"), digits=3)
