"""Time the likelihood of one scan over a whole building: ``python benchmarks/likelihood_map.py``.

The building is simulated, 40 m x 24 m; set WEAN to a folder with Wean Hall's map (80 m x 80 m) and first log to time
these as well.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.localization.lattice_noise import widened_field_for_lattice, widened_for_lattice
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.maps.mapping import local_map, scan_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.models.map_matching import MapMatchingModel
from beamfield.sensors import RangeFinder, Scan
from beamfield.simulation.floor_plan import draw_floor_plan
from measure import least_elapsed
from tables import print_table

PARAMETERS = BeamParameters(z_hit=0.8, z_short=0.08, z_max=0.02, z_rand=0.1, sigma_hit=0.1, lambda_short=0.4)
RESOLUTION, HEADINGS = 0.10, 72
LOCAL_RESOLUTION = 0.2


def run() -> list[dict[str, Any]]:
    """Return one row per map, model and number of beams."""
    grid = draw_floor_plan(seed=1, resolution=0.1)
    finder = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.0)), 20.0, mount=(0.25, 0.0, 0.0))
    scan = BeamModel(grid, PARAMETERS).sample(np.array([8.0, 5.0, 0.1]), finder, np.random.default_rng(1))[0]
    rows = time_map("simulated office", grid, scan)
    folder = os.environ.get("WEAN")
    if folder:
        hall = read_map(Path(folder) / "wean.dat.gz")
        sensor = read_log(Path(folder) / "robotdata1.log.gz").only_sensor()
        rows += time_map("Wean Hall", hall, sensor.scan(300))
        for resolution in (LOCAL_RESOLUTION, 0.1, 0.05):
            local = local_map(sensor, 300, n=10, resolution=resolution, poses=sensor.odometry)
            rows += time_matching("Wean Hall", f"10 scans, {resolution:g} m", hall, local)
    return rows


def time_map(name: str, grid: OccupancyGrid, scan: Scan) -> list[dict[str, Any]]:
    """Time every model on one map."""
    lattice = {"resolution": RESOLUTION, "headings": HEADINGS}
    beam = widened_for_lattice(PARAMETERS, **lattice)
    of_field = widened_field_for_lattice(LikelihoodFieldParameters.from_beam_parameters(PARAMETERS), scan, **lattice)
    rows = []
    for n_beams in (30, None):
        fields = LikelihoodFieldModel(grid, of_field, n_beams=n_beams)
        rows.append(one_row(name, "beam", n_beams, BeamModel(grid, beam, n_beams=n_beams), scan, grid))
        rows.append(one_row(name, "field", n_beams, fields, scan, grid))
    return rows + time_matching(
        name, f"1 scan, {LOCAL_RESOLUTION:g} m", grid, scan_map(scan, resolution=LOCAL_RESOLUTION)
    )


def time_matching(name: str, what: str, grid: OccupancyGrid, local: OccupancyGrid) -> list[dict[str, Any]]:
    """Time map matching."""
    cells = int((~np.isnan(local.probability)).sum())
    return [one_row(name, f"matching, {what}: {cells:,} cells", None, MapMatchingModel(grid), local, grid)]


def one_row(name: str, kind: str, n_beams: int | None, model: Any, z: Any, grid: OccupancyGrid, **options: Any) -> Any:
    """Return the seconds for all poses, after a run on few poses that compiles."""
    few = likelihood_map(model, z, grid, resolution=RESOLUTION, headings=2, **options)
    seconds = least_elapsed(
        lambda: likelihood_map(model, z, grid, resolution=RESOLUTION, headings=HEADINGS, **options), repeats=2
    )
    return {
        "map": name,
        "model": kind,
        "beams": n_beams or "all",
        "poses": f"{few.n_poses // 2 * HEADINGS:,}",
        "seconds": round(seconds, 2),
    }


def main() -> None:
    """Print the rows as a Markdown table."""
    print_table(run())


if __name__ == "__main__":
    main()
