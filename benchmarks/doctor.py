"""Measure what the doctor's findings cost: ``python benchmarks/doctor.py [FOLDER]``.

One update of 2,000 particles by one scan, in the stacks' own formulas, in a simulated office: how far the weighted
particles are from the truth afterwards, and how many stay effective. Each row is a fault beside the same without it.

A second table has the finding `replayed` for some files of nav2 on simulated and real drives: lost runs of all, and
the mean position error. FOLDER holds the real logs (default: ../shared/data beside the checkout): other people's data,
no part of this repository; without it only simulated ones are replayed.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.stacks.doctor.replayed import replayed
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.fit.particle_update import update_particles
from beamfield.stacks.registry import build_model, parameter_class
from real_logs import read_log_and_map

TRUTH = BeamParameters(0.78, 0.12, 0.03, 0.07, 0.03, 0.6)
FINDER = RangeFinder.from_bearings(np.linspace(-0.75 * np.pi, 0.75 * np.pi, 360), 12.0, name="laser")
DEPENDENCE = Dependence(angle=np.radians(6.0), time=1.0)
N_SCANS = 120
YAW = np.radians(2.0)
# What calibration finds, about: enough to show a fault by itself.
CHAPTER = {"sigma_hit": 0.08, "z_hit": 0.97, "z_rand": 0.03, "max_beams": 30}

FIELD, PRODUCT = "likelihood_field", "likelihood_field_prob"
# Values of nav2 that are replayed, beside its defaults.
FILES: dict[str, dict[str, Any]] = {
    "defaults": {"laser_model_type": FIELD},
    "alphas 0.04": {"laser_model_type": FIELD, **{f"alpha{i}": 0.04 for i in range(1, 5)}},
    "alphas 0.5": {"laser_model_type": FIELD, **{f"alpha{i}": 0.5 for i in range(1, 5)}},
    "100 particles": {"laser_model_type": FIELD, "min_particles": 50, "max_particles": 100},
    "likelihood_field_prob": {"laser_model_type": PRODUCT},
    "the same, 15 beams, sigma_hit 0.1, z_hit 0.8, alphas 0.04": {
        "laser_model_type": PRODUCT, "max_beams": 15, "sigma_hit": 0.1, "z_hit": 0.8, "z_rand": 0.2,
        **{f"alpha{i}": 0.04 for i in range(1, 5)},
    },
}  # fmt: skip
WEAN = "wean_hall/derived_wean.yaml"
REAL = {
    "Wean Hall 1": ("wean_hall/robotdata1.log.gz", WEAN, "wean_hall/reference_robotdata1.csv.gz"),
    "Wean Hall 3": ("wean_hall/robotdata3.log.gz", WEAN, "wean_hall/reference_robotdata3.csv.gz"),
    "Wean Hall 5": ("wean_hall/robotdata5.log.gz", WEAN, "wean_hall/reference_robotdata5.csv.gz"),
    "TurtleBot 4": ("olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/map/mac_1st_floor_final.yaml",
                    "olin_mac_tb4/derived_ref_take_2.csv.gz"),
    "Pioneer": ("uob_stage_sim/simpath2.bag", "uob_stage_sim/derived_meeting_stageframe.yaml", None),
}  # fmt: skip


def main(folder: Path) -> None:
    """Print two Markdown tables."""
    print_updates()
    print_replays(folder)


def print_replays(folder: Path) -> None:
    """Print what the doctor says of files when it replays them."""
    worlds = {f"office {seed}": (drive(grid), grid) for seed in (31, 32) if (grid := draw_floor_plan(seed=seed))}
    if folder.is_dir():
        worlds |= {name: read_log_and_map(folder, *paths) for name, paths in REAL.items()}
    print(f"\n| nav2 | {' | '.join(worlds)} |\n|{'---|' * (len(worlds) + 1)}")
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch, "nav2.yaml")
        for name, values in FILES.items():
            path.write_text("amcl:\n  ros__parameters:\n" + "".join(f"    {k}: {v}\n" for k, v in values.items()))
            file = read_stack_file(path, stack="nav2")
            said = [replayed(file, grid, log).values for log, grid in worlds.values()]
            cells = [f"{one['lost']} of {one['runs']}, {one['error_m']:.3f} m" for one in said]
            print(f"| {name} | {' | '.join(cells)} |")


def print_updates() -> None:
    """Print what faults do to one update."""
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
    here = Path(__file__).resolve().parents[1]
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared/data")
