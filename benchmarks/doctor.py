"""Measure what the doctor's findings cost: ``python benchmarks/doctor.py``.

One update of 2,000 particles by one scan, in the stacks' own formulas, in a simulated office: how far the weighted
particles are from the truth afterwards, and how many stay effective. Each row is a fault beside the same without it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.fit.particle_update import update_particles
from beamfield.stacks.registry import build_model, parameter_class

TRUTH = BeamParameters(0.78, 0.12, 0.03, 0.07, 0.03, 0.6)
FINDER = RangeFinder.from_bearings(np.linspace(-0.75 * np.pi, 0.75 * np.pi, 360), 12.0, name="laser")
DEPENDENCE = Dependence(angle=np.radians(6.0), time=1.0)
N_SCANS = 120
YAW = np.radians(2.0)
# What calibration finds, about: enough to show a fault by itself.
CHAPTER = {"sigma_hit": 0.08, "z_hit": 0.97, "z_rand": 0.03, "max_beams": 30}


def main() -> None:
    """Print a Markdown table."""
    fine, coarse = draw_floor_plan(seed=31), draw_floor_plan(seed=31, resolution=0.1)
    log, coarse_log = drive(fine), drive(coarse)
    x, y, _ = fine.origin
    turned = OccupancyGrid(fine.probability, fine.resolution, np.array([x, y, YAW]))
    turned_log = drive(turned)
    field, prob, beam = "likelihood_field", "likelihood_field_prob", "beam"
    rows: list[tuple[str, str, StackModel[Any, Any], SensorLog]] = [
        ("nearly-flat", "nav2 likelihood_field, defaults", model("nav2", field, fine), log),
        ("", "nav2 likelihood_field_prob, 60 beams", model("nav2", prob, fine), log),
        ("absurdly-sharp", "nav2 prob, sigma_hit 0.03, 180 beams",
         model("nav2", prob, fine, **{**CHAPTER, "sigma_hit": 0.03, "max_beams": 180}), log),
        ("", "nav2 prob, sigma_hit 0.08, 30 beams", model("nav2", prob, fine, **CHAPTER), log),
        ("", "nav2 prob, sigma_hit 0.2, 15 beams", model("nav2", prob, fine, **{**CHAPTER, "sigma_hit": 0.2,
                                                                                  "max_beams": 15}), log),
        ("weights-sum", "nav2 likelihood_field, z_hit 0.3, z_rand 0.3",
         model("nav2", field, fine, z_hit=0.3, z_rand=0.3), log),
        ("", "nav2 likelihood_field, z_hit 0.5, z_rand 0.5", model("nav2", field, fine), log),
        ("sigma-below-resolution", "nav2 prob, sigma_hit 0.01", model("nav2", prob, fine, **{**CHAPTER,
                                                                                             "sigma_hit": 0.01}), log),
        ("sigma-huge", "nav2 prob, sigma_hit 1", model("nav2", prob, fine, **{**CHAPTER, "sigma_hit": 1.0}), log),
        ("distance-limit", "nav2 prob, sigma_hit 0.2, limit 0.2",
         model("nav2", prob, fine, **{**CHAPTER, "sigma_hit": 0.2, "laser_likelihood_max_dist": 0.2}), log),
        ("", "nav2 prob, sigma_hit 0.2, limit 2",
         model("nav2", prob, fine, **{**CHAPTER, "sigma_hit": 0.2}), log),
        ("no-random-readings", "nav2 prob, z_rand 0", model("nav2", prob, fine, **{**CHAPTER, "z_rand": 0.0}), log),
        ("few-usable-beams", "nav2 prob, 4 beams", model("nav2", prob, fine, **{**CHAPTER, "max_beams": 4}), log),
        ("many-beams-in-product", "nav2 prob, 360 beams",
         model("nav2", prob, fine, **{**CHAPTER, "max_beams": 360}), log),
        ("map-yaw-ignored", "nav2 prob, origin turned by 2 degrees",
         model("nav2", prob, turned, **CHAPTER), turned_log),
        ("half-cell-shift", "nav2 prob, cells of 0.1 m", model("nav2", prob, coarse, **CHAPTER), coarse_log),
        ("", "the same, origin put right", model("nav2", prob, moved(coarse), **CHAPTER), coarse_log),
        ("range-limit-above-sensor", "Beluga prob, laser_max_range 100",
         model("beluga", prob, fine, sigma_hit=0.08, z_hit=0.83, z_rand=0.17, max_beams=30), log),
        ("", "Beluga prob, laser_max_range 12",
         model("beluga", prob, fine, sigma_hit=0.08, z_hit=0.83, z_rand=0.17, max_beams=30, laser_max_range=12.0), log),
        ("z-max-unreachable", "nav2 beam, driver reports +inf", model("nav2", beam, fine), log),
        ("", "nav2 beam, driver reports range_max", model("nav2", beam, fine, options={"no_return": "range_max"}), log),
    ]  # fmt: skip
    print("| finding | model | error after [mm] | effective |\n|---|---|---|---|")
    for name, text, made, run in rows:
        chosen = np.linspace(0, len(run) - 1, N_SCANS).astype(int).tolist()
        result = update_particles(made, run, chosen)
        print(f"| {name} | {text} | {1e3 * np.median(result.error_after):.0f} | {np.median(result.effective):.0f} |")
    print(f"\nError before: {1e3 * np.median(result.error_before):.0f} mm; median of {N_SCANS} scans.")


def drive(grid: OccupancyGrid) -> SensorLog:
    """Return a simulated log with true poses."""
    return simulate_log(
        grid, FINDER, TRUTH, duration=240.0, scan_rate=2.0, seed=5, dependence=DEPENDENCE
    ).only_sensor()  # fmt: skip


def model(
    stack: str, name: str, grid: OccupancyGrid, *, options: dict[str, Any] | None = None, **values: Any
) -> StackModel[Any, Any]:
    """Return a stack's model with its defaults but for the values given."""
    parameters = parameter_class(stack, name)(laser_model_type=name, **values)
    return build_model(stack, name, grid, parameters, **(options or {}))


def moved(grid: OccupancyGrid) -> OccupancyGrid:
    """Return the map with an origin that makes up for amcl's half cell."""
    half = grid.resolution / 2.0
    return OccupancyGrid(grid.probability, grid.resolution, grid.origin + np.array([half, half, 0.0]))


if __name__ == "__main__":
    main()
