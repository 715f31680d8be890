"""How much of a scan its features keep (6.6.5): ``python benchmarks/feature_information.py [FOLDER]``.

Rooms: simulated scans whose beams are independent, so that the beam model with exponent 1 is the truth; the prior is
uniform over a box around the true pose. Maps: simulated and real scans, all poses of the map possible. FOLDER holds the
real logs and maps (default: ../shared/data beside the checkout; left out if it is not there).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.detections import Detections
from beamfield.features.corners import find_corners
from beamfield.features.feature import stack_features
from beamfield.features.lines import find_lines
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import compose
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.localization.feature_map import map_features
from beamfield.localization.feature_posteriors import ScanAndFeatures, posteriors_of_scan
from beamfield.localization.information import FeatureInformation, information_of_features
from beamfield.localization.pose_posterior import PoseLattice, PosePosterior
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log

if __package__:
    from benchmarks.rooms import drawn_room
    from benchmarks.tables import print_table
else:
    from rooms import drawn_room
    from tables import print_table

SIGMA = 0.05
FINDER = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0, 3.0)), 8.0)
BEAMS = BeamParameters(z_hit=0.97, z_short=0.0, z_max=0.01, z_rand=0.02, sigma_hit=SIGMA, lambda_short=1.0)
BOX = {"reach": 0.2, "resolution": 0.01, "heading_reach": 0.06, "heading_step": 0.004}
SOUTH = [(0, 0), (2, 0), (2, 0.3), (2.3, 0.3), (2.3, 0), (4, 0), (4, 0.3), (4.3, 0.3), (4.3, 0), (6, 0)]
PILASTERS = [*SOUTH, *((6 - x, 4 - y) for x, y in SOUTH)]
ROOMS = {
    "rectangle": ([(0, 0), (6, 0), (6, 4), (0, 4)], [0.8, 0.8], [5.2, 3.2]),
    "with a niche": ([(0, 0), (6, 0), (6, 4), (4, 4), (4, 5), (3, 5), (3, 4), (0, 4)], [0.8, 0.8], [5.2, 3.2]),
    "with pilasters": (PILASTERS, [0.8, 0.8], [5.2, 3.2]),
    "corridor, ends out of reach": ([(0, 0), (30, 0), (30, 2), (0, 2)], [13.0, 0.6], [17.0, 1.4]),
}
POSES_PER_ROOM = 20
# Over maps: step, headings, scans, and for how many independent beams a scan is taken.
RESOLUTION, HEADINGS, SCANS, INDEPENDENT_BEAMS = 0.25, 60, 10, 12
# Mass nearer to the reference than this counts as right, metres.
NEAR = 1.0
# Parameters as calibrated in docs/results.md.
LOGS = {
    "Wean Hall log 1": (
        "wean_hall/robotdata1.log.gz",
        "wean_hall/derived_wean.yaml",
        "wean_hall/reference_robotdata1.csv.gz",
        BeamParameters(0.881, 0.067, 0.004, 0.048, 0.081, 0.392, range_offset=0.259, sigma_slope=0.135),
    ),
    "TurtleBot 4": (
        "olin_mac_tb4/macfirst_floor_take_2",
        "olin_mac_tb4/map/mac_1st_floor_final.yaml",
        "olin_mac_tb4/derived_ref_take_2.csv.gz",
        BeamParameters(0.599, 0.006, 0.185, 0.21, 0.0139, 0.0, range_offset=0.0408, sigma_slope=0.0129),
    ),
}


def run(folder: Path | None) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of both tables."""
    tables = {"rooms": [row for name in ROOMS for row in room_rows(name)]}
    tables["maps"] = [map_row("simulated office", *office())]
    if folder is not None and folder.is_dir():
        tables["maps"] += [map_row(name, *real(folder, *paths)) for name, paths in LOGS.items()]
    return tables


def room_rows(name: str) -> Iterator[dict[str, Any]]:
    """Return what lines and what corners keep of scans of a room."""
    outline, low, high = ROOMS[name]
    rng = np.random.default_rng(5)
    grid, walls, corners = drawn_room(outline)
    model = BeamModel(grid, BEAMS)
    of_lines = LineModel(walls, LineParameters(0.0, 0.0, 0.01, 8.0), correspondence="sum", min_overlap=0.3)
    noise = LandmarkParameters(0.03, 0.01, sigma_signature=0.1, spurious_rate=0.02, max_range=8.0)
    of_corners = LandmarkModel(corners, noise, correspondence="sum")
    results: dict[str, list[tuple[int, FeatureInformation]]] = {"lines": [], "corners": []}
    for _ in range(POSES_PER_ROOM):
        pose = np.array([*rng.uniform(low, high), rng.uniform(-np.pi, np.pi)])
        [scan] = model.sample(pose[None], rng, FINDER)
        lattice = PoseLattice.around(pose, **BOX)
        lines = find_lines(scan, RangeNoise(SIGMA))
        measured, _ = stack_features(find_corners(lines))
        for kind, count, of_kind, seen in (
            ("lines", len(lines), of_lines, LineDetections.from_lines(lines)),
            ("corners", len(measured), of_corners, Detections(*measured.T)),
        ):
            results[kind].append((count, information_of_features(model, scan, of_kind, seen, lattice)))
    for kind, found in results.items():
        lost = np.array([both.lost for _, both in found])
        yield {
            "room": name,
            "features": f"{np.mean([count for count, _ in found]):.1f} {kind}",
            "scan tells (nats)": f"{np.mean([both.scan.information for _, both in found]):.2f}",
            "features tell": f"{np.mean([both.features.information for _, both in found]):.2f}",
            "lost": f"{lost.mean():.2f} +- {lost.std() / np.sqrt(len(lost)):.2f}",
            "divergence": f"{np.mean([both.divergence for _, both in found]):.2f}",
        }


def office() -> tuple[OccupancyGrid, SensorLog, BeamParameters]:
    grid = draw_floor_plan(seed=1)
    truth = BeamParameters(z_hit=0.9, z_short=0.06, z_max=0.02, z_rand=0.02, sigma_hit=0.05, lambda_short=0.5)
    laser = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.5)), 20.0, mount=(0.2, 0.0, 0.0), name="laser")
    return grid, simulate_log(grid, laser, truth, duration=240.0, scan_rate=1.0, seed=1).only_sensor(), truth


def real(
    folder: Path, log_path: str, map_path: str, poses_path: str, parameters: BeamParameters
) -> tuple[OccupancyGrid, SensorLog, BeamParameters]:
    log = attach_poses(read_log(folder / log_path), read_trajectory(folder / poses_path))
    return read_map(folder / map_path), log.only_sensor(), parameters


def map_row(name: str, grid: OccupancyGrid, log: SensorLog, parameters: BeamParameters) -> dict[str, Any]:
    """Return what walls and corners of scans tell about the place in a map."""
    lattice = PoseLattice.over_map(grid, resolution=RESOLUTION, headings=HEADINGS)
    features = map_features(grid)
    posed = np.flatnonzero(np.isfinite(log.poses).all(axis=1))
    posed = posed[grid.look_up(grid.free, log.poses[posed, :2])]
    chosen = posed[np.linspace(0, len(posed) - 1, SCANS).astype(int)]
    exponent = INDEPENDENT_BEAMS / log.finder.n_beams
    results = [posteriors_of_scan(log.scan(i), grid, parameters, features, lattice, exponent=exponent) for i in chosen]
    poses = log.poses[chosen]

    def tells(which: str) -> str:
        told = [getattr(result, which).information for result in results]
        near = [mass_near(getattr(result, which), pose) for result, pose in zip(results, poses, strict=True)]
        return f"{np.mean(told):.1f} ({np.mean(near):.2f})"

    return {
        "map": name,
        "prior (nats)": f"{results[0].scan.prior_entropy:.1f}",
        "walls, corners": f"{mean(results, 'n_lines'):.1f}, {mean(results, 'n_corners'):.1f}",
        "scan tells": tells("scan"),
        "walls tell": tells("lines"),
        "corners tell": tells("corners"),
    }


def mean(results: list[ScanAndFeatures], name: str) -> float:
    return float(np.mean([getattr(result, name) for result in results]))


def mass_near(posterior: PosePosterior, pose: np.ndarray) -> float:
    """Return the probability of positions near a pose."""
    near = np.hypot(*(posterior.lattice.centres() - compose(pose, np.zeros(3))[:2]).T) < NEAR
    return float(np.exp(posterior.log_mass[near]).sum())


def main(folder: Path) -> None:
    """Print both tables as Markdown."""
    for title, rows in run(folder).items():
        print(f"### {title}\n")
        print_table(rows)
        print()


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared" / "data")
