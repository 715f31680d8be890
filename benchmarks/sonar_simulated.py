"""Calibrate simulated rings of sonars: where the cone model holds, among mirrors, and with cross-talk.

Run: python benchmarks/sonar_simulated.py

Three minutes of a drive through the simulated office, four scans a second. "heard right" is the share of readings
within 15 cm of the nearest thing in the cone, "silent" those without return, "cross-talk" those of another sensor's
pulse: what the simulator knows. The other columns are what calibration finds without knowing it.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.kernels.threads import set_threads
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.simulation.sonar import EchoCause, SonarPhysics, sonar_ring
from beamfield.simulation.sonar_log import simulate_sonar_log
from tables import print_table

SEED = 3
DURATION, SCAN_RATE = 180.0, 4.0
NEAR = 0.15
RINGS = (8, 16, 24)
TRUTH = BeamParameters(z_hit=0.62, z_short=0.16, z_max=0.13, z_rand=0.09, sigma_hit=0.12, lambda_short=0.45)
ROUGH = SonarPhysics.diffuse(sigma=0.06, dropout=0.08, phantoms=0.05)
# Without cross-talk, then with it.
WORLDS: dict[str, SonarPhysics] = {
    "rough walls (0.87, 0, 0.08, 0.05; 0.06)": ROUGH,
    "half rough": SonarPhysics(roughness=0.5, cross_talk=0.0),
    "smooth": SonarPhysics(roughness=0.1, cross_talk=0.0),
    "mirrors": SonarPhysics(roughness=0.0, edge_echo=0.0, cross_talk=0.0),
    "half rough, cross-talk 0.3": SonarPhysics(roughness=0.5, cross_talk=0.3),
    "half rough, cross-talk 0.6": SonarPhysics(roughness=0.5, cross_talk=0.6),
    "the same, one sensor every 30 ms": SonarPhysics(
        roughness=0.5, cross_talk=0.6, firing_groups=None, firing_interval=0.03
    ),
}


def run() -> list[dict[str, Any]]:
    """Return one row per ring and world."""
    grid = draw_floor_plan(seed=1)
    rows = []
    for n in RINGS:
        log = simulate_log(grid, sonar_ring(n), TRUTH, duration=DURATION, scan_rate=SCAN_RATE, seed=SEED)
        rows.append({"world": "drawn from the model (0.62, 0.16, 0.13, 0.09; 0.12, 0.45)", "sensors": n} | empty()
                    | fit(grid, log.only_sensor()))  # fmt: skip
    for name, physics in WORLDS.items():
        ring = sonar_ring(16)
        log, readings = simulate_sonar_log(grid, ring, physics, duration=DURATION, scan_rate=SCAN_RATE, seed=SEED)
        sensor = log.only_sensor()
        known = {
            "heard right": f"{(np.abs(readings.ranges - readings.nearest) < NEAR).mean():.2f}",
            "silent": f"{np.isposinf(readings.ranges).mean():.2f}",
            "cross-talk": f"{(readings.causes == EchoCause.CROSS_TALK).mean():.2f}",
        }
        rows.append({"world": name, "sensors": 16} | known | fit(grid, sensor))
        if physics is ROUGH:
            rows.append({"world": "the same, taken as beams", "sensors": 16} | known | fit(grid, as_beams(sensor)))
    return rows


def empty() -> dict[str, str]:
    """Return the columns of what only the acoustics know."""
    return {"heard right": "", "silent": "", "cross-talk": ""}


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
