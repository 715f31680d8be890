"""How often the posterior given walls, or corners, holds the reference pose:
``python -m benchmarks.feature_study.coverage``.

Maps of real logs are drawn from every second group of scans; the other groups are judged. Their noise is learned from
every second one of those, the rest is held out. A posterior over the whole map holds the pose if the pose's cell is
among the most probable ones that make up 95% of it; that must happen for 95% of all scans. "Told" is the information
of the posterior, "found" the log of how much more probable the pose's cell became; their means are the same where
posteriors are honest. To save time, a random part of the map's cells is taken for all there are; the reference poses'
cells are always among them.

Run: python -m benchmarks.feature_study.coverage [FOLDER WITH DATA] [--only NAME ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.tables import print_table

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.detections import Detections
from beamfield.features.corners import Corner
from beamfield.features.feature import stack_features
from beamfield.features.map_features import MapFeatures, map_features
from beamfield.features.straight_line import Line
from beamfield.geometry import wrap_angle
from beamfield.io.read_log import read_log
from beamfield.localization.lattice_noise import widened_for_lattice
from beamfield.localization.pose_posterior import PoseLattice, PosePosterior, pose_posterior
from beamfield.maps.mapping import build_map
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

from .field_of_view import FieldOfView
from .learning import CornerSightings, learn_corner_noise
from .noise import CornerNoise, FeatureNoise
from .posteriors import (
    SCORED_BEAMS,
    corner_likelihood,
    features_of_scan,
    learn_feature_noise,
    posterior_of_corners,
    posterior_of_lines,
)

# What the constants chosen by hand go with: a scan is taken for so many independent beams.
INDEPENDENT_BEAMS = 12
DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
# Log, and how many consecutive scans change sides together.
LOGS = {
    "Intel": ("intel_gfs/derived_intel_rawodom.log.gz", 5),
    "Freiburg 079": ("carmen_radish_corrected/freiburg-079-corrected.log.gz", 40),
    "Belgioioso": ("carmen_radish_corrected/belgioioso-corrected.log.gz", 5),
    "CSAIL": ("csail_gfs/csail.corrected.gfs.gz", 5),
    "ACES": ("carmen_radish_corrected/aces-corrected.log.gz", 5),
}
OFFICES = {"simulated office 1": 1, "simulated office 2": 2}
TRUTH = BeamParameters(z_hit=0.9, z_short=0.06, z_max=0.02, z_rand=0.02, sigma_hit=0.05, lambda_short=0.5)
# Posteriors given walls and whole scans take longer: every so many scans have theirs judged.
WALLS_EVERY = 3
RESOLUTION, HEADINGS, SCANS, CELLS = 0.25, 60, 100, 1000


@dataclass(frozen=True, eq=False)
class Place:
    """A log with its map, of which no scan that is judged was a part."""

    name: str
    log: SensorLog
    grid: OccupancyGrid
    parameters: BeamParameters
    features: MapFeatures
    lattice: PoseLattice
    learned_from: np.ndarray
    judged: np.ndarray


def places(data: Path, names: list[str] | None) -> Iterator[Place]:
    """Yield simulated offices and real logs with their maps."""
    for name, seed in OFFICES.items():
        if names is None or name in names:
            grid = draw_floor_plan(seed=seed)
            laser = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.5)), 20.0, mount=(0.2, 0.0, 0.0))
            log = simulate_log(grid, laser, TRUTH, duration=240.0, scan_rate=1.0, seed=seed).only_sensor()
            yield place(name, log, grid, np.arange(len(log)), TRUTH)
    for name, (path, group) in LOGS.items():
        if names is None or name in names:
            log = read_log(data / path).only_sensor()
            half = (np.arange(len(log)) // group) % 2
            yield place(name, log, build_map(log, scans=half == 0), np.flatnonzero(half == 1))


def place(
    name: str, log: SensorLog, grid: OccupancyGrid, scans: np.ndarray, parameters: BeamParameters | None = None
) -> Place:
    """Choose scans with poses on free cells; calibrate the sensor with those to learn from."""
    scans = scans[np.isfinite(log.poses[scans]).all(axis=1)]
    scans = scans[grid.look_up(grid.free, log.poses[scans, :2])]
    chosen = scans[np.linspace(0, len(scans) - 1, min(len(scans), SCANS)).astype(int)]
    learned_from, judged = chosen[::2], chosen[1::2]
    if parameters is None:
        poses = np.full((len(log), 3), np.nan)
        poses[np.setdiff1d(scans, judged)] = log.poses[np.setdiff1d(scans, judged)]
        parameters = calibrate(log.with_poses(poses), grid, CalibrationOptions(refine=False)).parameters
    lattice = PoseLattice.over_map(grid, resolution=RESOLUTION, headings=HEADINGS)
    return Place(
        name, log, grid, parameters, map_features(grid), thinned(lattice, log.poses[chosen]), learned_from, judged
    )


def thinned(lattice: PoseLattice, poses: np.ndarray) -> PoseLattice:
    """Keep a random part of the cells, and those of the poses."""
    centres = lattice.centres()
    rng = np.random.default_rng(3)
    kept = np.zeros(len(centres), dtype=np.bool_)
    kept[rng.choice(len(centres), min(CELLS, len(centres)), replace=False)] = True
    kept[[cell_of(lattice, centres, pose)[0] for pose in poses]] = True
    inside = np.zeros_like(lattice.inside)
    inside[lattice.inside] = kept
    return replace(lattice, inside=inside)


def cell_of(lattice: PoseLattice, centres: np.ndarray, pose: np.ndarray) -> tuple[int, int]:
    """Return the nearest position and heading."""
    heading = np.abs(wrap_angle(lattice.headings - pose[2])).argmin()
    return int(np.hypot(*(centres - pose[:2]).T).argmin()), int(heading)


def judge(posterior: PosePosterior, pose: np.ndarray) -> tuple[float, float, float]:
    """Return the mass of all that is more probable than the pose's cell, nats found, and nats told."""
    cell = cell_of(posterior.lattice, posterior.lattice.centres(), pose)
    value = posterior.log_mass[cell]
    above = float(np.exp(posterior.log_mass[posterior.log_mass > value + 1e-9]).sum())
    return above, float(value) + posterior.prior_entropy, posterior.information


def noise_from_others(here: Place, all_places: list[Place]) -> CornerNoise:
    """Learn the noise of corners from all real logs but this one."""
    parts = [sightings(other) for other in all_places if other is not here and other.name not in OFFICES]
    return learn_corner_noise(CornerSightings.stacked(parts)) if parts else FeatureNoise().corners


def sightings(here: Place) -> CornerSightings:
    """Return the corners of the scans to learn from."""
    scans = [features_of_scan(here.log.scan(int(i)), here.parameters)[1] for i in here.learned_from]
    poses = here.log.poses[here.learned_from]
    return CornerSightings.of(scans, poses, here.grid, here.features.corners, FieldOfView.of(here.log.finder))


def rows(here: Place, others: CornerNoise, walls: bool) -> Iterator[dict[str, Any]]:
    """Yield a row for each kind of feature and each noise."""
    shown = here.features if walls else MapFeatures(None, here.features.corners)
    learned = learn_feature_noise(here.log, here.learned_from, here.grid, here.parameters, shown, here.lattice)
    print(here.name, learned, flush=True)
    likelihood = corner_likelihood(here.grid, here.features, here.lattice, here.log.finder)
    results: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    for t, i in enumerate(here.judged):
        lines, corners = features_of_scan(here.log.scan(int(i)), here.parameters)
        posteriors = {}
        if walls and t % WALLS_EVERY == 0:
            posteriors["scan", "12 beams"] = posterior_of_whole(here, int(i))
        if walls and lines and t % WALLS_EVERY == 0:
            posteriors["walls", "chosen"] = chosen_for_lines(lines, here)
            posteriors["walls", "learned"] = posterior_of_lines(lines, here.features.lines, here.lattice, learned.lines)
        if corners:
            posteriors["corners", "chosen"] = chosen_for_corners(corners, here)
            for name, noise in (("learned", learned.corners), ("learned elsewhere", others)):
                posteriors["corners", name] = posterior_of_corners(corners, likelihood, here.lattice, noise)
        for key, posterior in posteriors.items():
            results.setdefault(key, []).append(judge(posterior, here.log.poses[i]))
    for (kind, name), judged in sorted(results.items()):
        above, found, told = np.transpose(judged)
        yield {
            "place": here.name,
            "features": kind,
            "noise": name,
            "scans": len(above),
            "in 50%": f"{np.mean(above < 0.5):.2f}",
            "in 95%": f"{np.mean(above < 0.95):.2f}",
            "in 99%": f"{np.mean(above < 0.99):.2f}",
            "told": f"{told.mean():.2f}",
            "found": f"{found.mean():.2f}",
        }


def posterior_of_whole(here: Place, index: int) -> PosePosterior:
    """Return the posterior given a whole scan, taken for a few independent beams."""
    n = here.log.finder.n_beams
    scored = min(n, SCORED_BEAMS)
    wide = widened_for_lattice(here.parameters, resolution=RESOLUTION, headings=HEADINGS)
    model = BeamModel(here.grid, wide, exponent=min(1.0, INDEPENDENT_BEAMS / scored), n_beams=scored)
    return pose_posterior(model, here.log.scan(index), here.lattice)


def chosen_for_lines(lines: list[Line], here: Place) -> PosePosterior:
    """Return the posterior with constants chosen by hand, and clutter anywhere within the sensor's limit."""
    place = np.hypot(0.03, here.lattice.resolution / np.sqrt(12.0))
    turn = np.hypot(0.01, here.lattice.heading_step / np.sqrt(12.0))
    noise = LineParameters(float(place), float(turn), 0.2, here.log.finder.max_range)
    seen = LineDetections.from_lines(lines)
    wide = np.asarray(seen.covariances) * here.log.finder.n_beams / INDEPENDENT_BEAMS
    model = LineModel(here.features.lines, noise, correspondence="sum", min_overlap=0.5)
    return pose_posterior(model, LineDetections(seen.lines, wide, seen.segments), here.lattice)


def chosen_for_corners(corners: list[Corner], here: Place) -> PosePosterior:
    """Return the same for corners: each of the map's is as likely to be seen as any other, hidden or not."""
    place = np.hypot(0.03, here.lattice.resolution / np.sqrt(12.0))
    turn = np.hypot(0.01, here.lattice.heading_step / np.sqrt(12.0))
    measured, covariances = stack_features(corners)
    beams = here.log.finder.n_beams / INDEPENDENT_BEAMS
    typical = np.sqrt(np.median(covariances[:, [0, 1], [0, 1]], axis=0) * beams)
    across = place / np.median(measured[:, 0])
    noise = LandmarkParameters(
        float(np.hypot(typical[0], place)),
        float(np.hypot(np.hypot(typical[1], across), turn)),
        sigma_signature=0.15,
        spurious_rate=0.5,
        max_range=here.log.finder.max_range,
    )
    model = LandmarkModel(here.features.corners, noise, correspondence="sum")
    return pose_posterior(model, Detections(*measured.T), here.lattice)


def main() -> None:
    """Print the table as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", nargs="?", type=Path, default=DATA)
    parser.add_argument("--only", nargs="+")
    parser.add_argument("--walls", action="store_true", help="judge walls and whole scans too; takes much longer")
    options = parser.parse_args()
    found = list(places(options.data, options.only))
    table = [row for here in found for row in rows(here, noise_from_others(here, found), options.walls)]
    real = [sightings(here) for here in found if here.name not in OFFICES]
    if real:
        print("all real logs", learn_corner_noise(CornerSightings.stacked(real)))
    print_table(table)


if __name__ == "__main__":
    main()
