"""Calibrate simulated rings of sonars: where the cone model holds, and among walls that mirror sound.

Run: python benchmarks/sonar_simulated.py

Three minutes of a drive through the simulated office, four scans a second. "heard right" is the share of readings
within 15 cm of the nearest thing in the cone, "silent" those without return. The other columns are what calibration
finds.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.kernels.threads import set_threads
from beamfield.maps.cone import ConeCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.simulation.sonar import sonar_ring
from tables import print_table

SEED = 3
DURATION, SCAN_RATE = 180.0, 4.0
NEAR = 0.15
RINGS = (8, 16, 24)
TRUTH = BeamParameters(z_hit=0.62, z_short=0.16, z_max=0.13, z_rand=0.09, sigma_hit=0.12, lambda_short=0.45)
ROUGHNESS = (1.0, 0.5, 0.1)


def run() -> list[dict[str, Any]]:
    """Return one row per ring and world."""
    grid = draw_floor_plan(seed=1)
    rows = []
    for n, roughness in [*((n, 1.0) for n in RINGS), *((16, roughness) for roughness in ROUGHNESS[1:])]:
        ring = sonar_ring(n)
        log = simulate_log(
            grid, ring, TRUTH, duration=DURATION, scan_rate=SCAN_RATE, seed=SEED, roughness=roughness
        ).only_sensor()
        nearest = ConeCaster(grid).expected_ranges(log.poses, ring)
        known = {
            "roughness": roughness,
            "sensors": n,
            "heard right": f"{(np.abs(log.ranges - nearest) < NEAR).mean():.2f}",
            "silent": f"{np.isposinf(log.ranges).mean():.2f}",
        }
        rows.append(known | fit(grid, log))
        if n == 16 and roughness == 1.0:
            rows.append(known | {"roughness": "the same, taken as beams"} | fit(grid, as_beams(log)))
    return rows


def as_beams(log: SensorLog) -> SensorLog:
    """Return the log with cones of no width."""
    finder: RangeFinder = replace(log.finder, opening_angle=0.0)
    return replace(log, finder=finder)


def fit(grid: Any, log: SensorLog) -> dict[str, str]:
    """Calibrate, and return the parameters and the time."""
    start = time.perf_counter()
    result = calibrate(log, grid, CalibrationOptions(refine=False))
    seconds = time.perf_counter() - start
    p = result.parameters
    values = {name: f"{getattr(p, name):.3f}" for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit")}
    rate = f"{p.lambda_short:.2f}" if p.z_short > 0.01 else ""
    return values | {"lambda_short": rate, "converged": str(result.converged), "seconds": f"{seconds:.1f}"}


def main() -> None:
    """Print the rows as a Markdown table."""
    print_table(run())


if __name__ == "__main__":
    set_threads(1)
    main()
