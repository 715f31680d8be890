"""How often one scan tells where a robot stands: ``python benchmarks/one_scan.py [LOG ...]``.

Of each log 24 scans, at equal spaces, are compared with the whole map as `beamfield likelihood --resolution 0.2` does,
by the beam model and by the likelihood field, with typical values and 30 beams. Printed: how often the maximum lies
within 0.5 m of the reference, and how often it does where the next place, 1 m away or more, is at least 5 nats less
likely. Words choose logs by name; all take six minutes on one processor. Logs and maps are in ../shared/data beside the
checkout, no part of this repository; the maps of intel and freiburg-079 are drawn by every other group of scans.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.calibration.cross_fit import build_cross_fit_maps
from beamfield.cli.likelihood import DEFAULT_BEAMS, DEFAULTS
from beamfield.io.read_log import read_log
from beamfield.localization.lattice_noise import widened_field_for_lattice, widened_for_lattice
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.base import MeasurementModel
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import Scan, SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from fitted_poses import LASER
from real_logs import LOGS, read_log_and_map
from tables import print_table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
TYPICAL = BeamParameters(**DEFAULTS)
TRUTH = BeamParameters(0.82, 0.09, 0.03, 0.06, 0.04, 0.5)
LATTICE = {"resolution": 0.2, "headings": 72}
N_SCANS, NEAR, SURE = 24, 0.5, 5.0

Place = tuple[SensorLog, OccupancyGrid]


def drawn_by_others(name: str) -> Place:
    """Return every other group of a log's scans, and the map that the others draw."""
    log = read_log(DATA / f"carmen_radish_corrected/{name}-corrected.log.gz").only_sensor()
    maps = build_cross_fit_maps(log)
    return log.select(maps.half == 0), maps.halves[1]


def office(seed: int) -> Place:
    """Return a simulated drive with exact poses, and its map."""
    plan = draw_floor_plan(seed=seed)
    return simulate_log(plan, LASER, TRUTH, duration=120.0, scan_rate=2.0, seed=seed).only_sensor(), plan


PLACES = {
    **{name.removesuffix(", text"): partial(read_log_and_map, DATA, *paths) for name, *paths in (LOGS[0], *LOGS[2:])},
    **{name: partial(drawn_by_others, name) for name in ("intel", "freiburg-079")},
    **{f"simulated office {seed}": partial(office, seed) for seed in (21, 22)},
}


def models(scan: Scan, grid: OccupancyGrid) -> dict[str, MeasurementModel[Scan]]:
    """Return what compares poses."""
    field = widened_field_for_lattice(LikelihoodFieldParameters.from_beam_parameters(TYPICAL), scan, **LATTICE)
    return {
        "beam model": BeamModel(grid, widened_for_lattice(TYPICAL, **LATTICE), n_beams=DEFAULT_BEAMS),
        "field": LikelihoodFieldModel(grid, field, n_beams=DEFAULT_BEAMS),
    }


def row(name: str) -> dict[str, Any]:
    """Return what the scans of a log tell."""
    log, grid = PLACES[name]()
    known = np.flatnonzero(np.isfinite(log.poses).all(axis=1))
    chosen = known[np.linspace(0, len(known) - 1, N_SCANS).astype(int)]
    seen: dict[str, list[tuple[bool, bool]]] = {}
    for i in chosen.tolist():
        for model_name, model in models(log.scan(i), grid).items():
            found = likelihood_map(model, log.scan(i), grid, resolution=0.2, headings=72)
            off = np.hypot(*(found.best_pose - log.poses[i])[:2])
            rival = found.rival()
            seen.setdefault(model_name, []).append((bool(off < NEAR), rival is None or rival[1] >= SURE))
    said: dict[str, Any] = {"log": name}
    for model_name, scans in seen.items():
        right, sure = np.array(scans).T
        said[f"{model_name}: right"] = f"{right.sum()} of {N_SCANS}"
        said[f"{model_name}: right where sure"] = f"{(right & sure).sum()} of {sure.sum()}"
    return said


def main(words: Sequence[str]) -> None:
    """Print a row for each log."""
    print_table([row(name) for name in PLACES if not words or any(word in name for word in words)])


if __name__ == "__main__":
    main(sys.argv[1:])
