"""Logs that robots are followed on, the filter as `beamfield localize` makes it, and its errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from beamfield.cli.localize import DEFAULT_BEAMS, DEFAULTS, INDEPENDENT_BEAMS
from beamfield.localization.replay import ReplayErrors, judge_replay, reference_start
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import hollowed
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.gaussian_motion import USUAL_MOTION
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log

WEAN = "wean_hall/derived_wean.yaml"
LOGS = {
    **{f"Wean Hall {k}": (f"wean_hall/robotdata{k}.log.gz", WEAN, f"wean_hall/reference_robotdata{k}.csv.gz")
       for k in (1, 3, 5)},
    "TurtleBot 4": ("olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/map/mac_1st_floor_final.yaml",
                    "olin_mac_tb4/derived_ref_take_2.csv.gz"),
    "simulated Pioneer": ("uob_stage_sim/simpath2.bag", "uob_stage_sim/derived_meeting_stageframe.yaml", None),
}  # fmt: skip
PARAMETERS = BeamParameters(**DEFAULTS)
KINDS = ("likelihood field", "beam model")
LASER = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 181), 12.0)
# Few and many people, who hide neighbouring beams for a while.
CROWDED = tuple(BeamParameters(0.95 - share, share, 0.02, 0.03, 0.05, 0.3) for share in (0.1, 0.4, 0.7))
BURSTS = Dependence(angle=0.3, time=1.0)


def offices() -> dict[str, tuple[SensorLog, OccupancyGrid]]:
    """Return simulated logs on which nothing was tuned: one minute of driving with odometry that drifts."""
    logs = {}
    for seed in (11, 12, 13):
        grid = draw_floor_plan(seed=seed)
        drive = simulate_log(grid, LASER, CROWDED[0], duration=60.0, scan_rate=5.0, seed=seed, dependence=BURSTS)
        logs[f"simulated office {seed}"] = drive.only_sensor(), grid
    return logs


def model_of(kind: str, grid: OccupancyGrid, exponent: float) -> Any:
    """Return a model as the command makes it."""
    if kind == "beam model":
        return BeamModel(grid, PARAMETERS, n_beams=DEFAULT_BEAMS, exponent=exponent)
    field = LikelihoodFieldParameters.from_beam_parameters(PARAMETERS)
    return LikelihoodFieldModel(hollowed(grid), field, n_beams=DEFAULT_BEAMS, exponent=exponent)


def localizer_of(kind: str, grid: OccupancyGrid, exponent: float = INDEPENDENT_BEAMS / DEFAULT_BEAMS) -> ScanLocalizer:
    """Return the filter as the command makes it."""
    return ScanLocalizer(grid, model_of(kind, grid, exponent), USUAL_MOTION)


def followed(localizer: ScanLocalizer, log: SensorLog, seeds: int) -> list[ReplayErrors]:
    """Return the errors of each seed, from a start known roughly."""
    first, start = reference_start(log)
    log = log[first:]
    return [judge_replay(localizer.run(log, start, np.random.default_rng(seed)), log.poses) for seed in range(seeds)]


def numbers(errors: Sequence[ReplayErrors]) -> dict[str, Any]:
    """Return means over seeds."""

    def mean(name: str) -> float:
        return float(np.mean([getattr(e, name) for e in errors]))

    each = np.array([e.mean for e in errors])
    return {
        "mean error [m]": f"{each.mean():.3f} +- {each.std(ddof=1) / np.sqrt(len(each)):.3f}",
        "95% [m]": round(mean("p95"), 3),
        "heading, rms [deg]": round(mean("yaw_rmse_deg"), 2),
        "inside": round(mean("inside_noisy"), 2),
        "NEES, median": round(mean("nees_median"), 2),
        "lost": f"{sum(e.lost for e in errors)} of {len(errors)}",
    }
