"""Measure how many changes of a map are found, and how many false: ``python benchmarks/changed_places.py [FOLDER]``.

Simulated robots drive through buildings whose maps are out of date (furniture moved or gone, walls built later), and
through unchanged ones; people walk by and stand about. FOLDER holds real logs (default: ../shared/data beside the
checkout), whose places are listed.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy import ndimage

from beamfield.calibration.calibrate import calibrate
from beamfield.calibration.time_split import time_blocks
from beamfield.geometry import compose
from beamfield.io.read_map import read_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.changed_places import KINDS, ChangedPlace, ChangedPlaces, find_changed_places
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import drawn_readings, simulate_log
from scan_fit import OPTIONS, POSE_NOISE, furniture_moved, posed, walls_missing
from tables import print_table

# Not those that the numbers in `scan_fit.changed_places` were chosen on (seeds 40 to 43).
SEEDS = range(20, 28)
TRUTH = BeamParameters(0.90, 0.03, 0.03, 0.04, 0.03, 0.6)
FINDER = RangeFinder.from_bearings(np.linspace(-2.2, 2.2, 181), 12.0, name="laser")
DEPENDENCE = Dependence(angle=np.radians(3.0), time=0.5)
SCAN_RATE = 4.0
PERSON_RADIUS, WALKING_SPEED = 0.2, 1.1
# How often somebody comes, seconds, and how long who stands still stays.
PERSON_EVERY, LONGEST_STAY = 6.0, 40.0
PER_DRIVE = {
    "no return, a drive": "no return (glass?)",
    "passing, a drive": "passing (people)",
    "undecided, a drive": "undecided",
}
# A thing was seen if so many beams in at least two visits should have met it; it is found if a place is so near, m.
SEEN_BEAMS, SEEN_CHANGE, NEAR = 20, 0.5, 0.25


@dataclass(frozen=True)
class Trial:
    """Places found in one world beside what changed there."""

    found: ChangedPlaces
    new: np.ndarray
    gone: np.ndarray
    new_seen: list[np.ndarray]
    gone_seen: list[np.ndarray]
    grid: OccupancyGrid


def simulated(seed: int, duration: float, change: str) -> Trial:
    """Return what is found in one building."""
    world, bare = draw_floor_plan(seed=seed), draw_floor_plan(seed=seed, furnished=False)
    rng = np.random.default_rng(seed)
    changes = {"furniture moved": furniture_moved, "walls built": walls_missing}
    grid = changes[change](world, bare, rng) if change in changes else world
    log, truth = drive(world, seed + 1, duration)
    found = find_changed_places(log, grid, calibrate(log, grid, OPTIONS).parameters)
    new, gone = world.occupied & grid.free, grid.occupied & world.free
    blocks = time_blocks(log.stamps)
    before, now = RayCaster(grid), RayCaster(world)
    z_before, z_now = (caster.expected_ranges(truth, FINDER) for caster in (before, now))
    # What lies within the tolerance of something mapped is not a change that anything could show.
    apart = ndimage.distance_transform_edt(~grid.occupied) * grid.resolution > NEAR
    new_seen = seen_things(new & apart, now.expected_hits(truth, FINDER), z_now < z_before - SEEN_CHANGE, blocks)
    gone_seen = seen_things(gone, before.expected_hits(truth, FINDER), z_now > z_before + SEEN_CHANGE, blocks)
    return Trial(found, new, gone, new_seen, gone_seen, grid)


def drive(world: OccupancyGrid, seed: int, duration: float) -> tuple[SensorLog, np.ndarray]:
    """Return a log among people, whose reference poses are a little off, and the true poses."""
    rng = np.random.default_rng(seed + 77)
    plain = simulate_log(world, FINDER, TRUTH, duration=duration, scan_rate=SCAN_RATE, seed=seed).only_sensor()
    expected = np.minimum(RayCaster(world).expected_ranges(plain.poses, FINDER), to_people(world, plain, rng))
    ranges = drawn_readings(expected, FINDER, TRUTH, rng, plain.stamps, DEPENDENCE)
    error = rng.standard_normal((len(plain), 3))
    keep = np.exp(-1.0 / SCAN_RATE / 2.0)
    for i in range(1, len(error)):
        error[i] = keep * error[i - 1] + np.sqrt(1.0 - keep**2) * error[i]
    return replace(plain, ranges=ranges, poses=plain.poses + error * POSE_NOISE), plain.poses


def to_people(world: OccupancyGrid, log: SensorLog, rng: np.random.Generator) -> np.ndarray:
    """Return the range of each beam to the nearest person, inf where there is none; half of them walk, half stand."""
    rays = compose(log.poses[:, None], FINDER.mounts)
    nearest = np.full(rays.shape[:2], np.inf)
    time = log.stamps - log.stamps[0]
    for start in np.arange(rng.uniform(0, PERSON_EVERY), time[-1], PERSON_EVERY):
        at = log.poses[np.searchsorted(time, start)]
        place = at[:2] + rng.uniform(1.0, 5.0) * direction(rng.uniform(-np.pi, np.pi))
        if not world.look_up(world.free, place[None])[0]:
            continue
        walks = rng.random() < 0.5
        stay = 8.0 if walks else rng.uniform(3.0, LONGEST_STAY)
        speed = WALKING_SPEED * walks * direction(rng.uniform(-np.pi, np.pi))
        for i in np.flatnonzero((time >= start) & (time < start + stay)):
            nearest[i] = np.minimum(nearest[i], to_circle(rays[i], place + speed * (time[i] - start)))
    return nearest


def direction(angle: float) -> np.ndarray:
    return np.array([np.cos(angle), np.sin(angle)])


def to_circle(rays: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """Return the range of rays (k, 3) to a circle around a point; inf for those that miss it."""
    to = centre - rays[:, :2]
    along = to[:, 0] * np.cos(rays[:, 2]) + to[:, 1] * np.sin(rays[:, 2])
    inside = PERSON_RADIUS**2 - (to**2).sum(axis=1) + along**2
    z = along - np.sqrt(np.maximum(inside, 0.0))
    return np.where((inside > 0.0) & (z > 0.0), z, np.inf)


def seen_things(changed: np.ndarray, hits: np.ndarray, differs: np.ndarray, blocks: np.ndarray) -> list[np.ndarray]:
    """Return the connected things among changed cells that enough beams should show, as masks."""
    things, n = ndimage.label(ndimage.binary_dilation(changed, iterations=2), np.ones((3, 3)))
    things[~changed] = 0
    met = np.where(differs, things[hits[..., 0], hits[..., 1]], 0)
    counts = np.stack([np.bincount(met[blocks == b].ravel(), minlength=n + 1) for b in np.unique(blocks)])
    seen = ((counts >= SEEN_BEAMS).sum(axis=0) >= 2).nonzero()[0]
    return [things == number for number in seen if number > 0]


def distance(place: ChangedPlace, mask: np.ndarray, grid: OccupancyGrid, side: float) -> float:
    """Return the distance from a place's squares to the nearest cell of a mask, metres."""
    cells = np.argwhere(mask)[:, ::-1] + 0.5
    if not len(cells):
        return np.inf
    points = grid.to_map(cells)
    gap = np.maximum(np.abs(points[:, None] - (place.corners + side / 2)) - side / 2, 0.0)
    return float(np.hypot(gap[..., 0], gap[..., 1]).min())


def scores(trial: Trial) -> dict[str, tuple[int, int]]:
    """Return right places of all found ones, things found of all seen ones, and how many other places there are."""
    rows = {}
    for kind, mask, things, names in (
        ("new obstacle", trial.new, trial.new_seen, ("new obstacles that are right", "new things found")),
        ("missing wall", trial.gone, trial.gone_seen, ("missing walls that are right", "gone things found")),
    ):
        places = trial.found.of_kind(kind)
        near = [distance(p, mask, trial.grid, trial.found.side) <= NEAR for p in places]
        found = [any(distance(p, thing, trial.grid, trial.found.side) <= NEAR for p in places) for thing in things]
        rows |= dict(zip(names, ((sum(near), len(near)), (sum(found), len(found))), strict=True))
    for name, kind in PER_DRIVE.items():
        rows[name] = (len(trial.found.of_kind(kind)), 1)
    return rows


def simulated_table(seeds: range) -> None:
    rows = []
    for change in ("nothing", "furniture moved", "walls built"):
        for duration in (120.0, 480.0):
            every = [scores(simulated(seed, duration, change)) for seed in seeds]
            total = {name: np.sum([one[name] for one in every], axis=0) for name in every[0]}
            row = {"world": change, "drive": f"{duration:g} s"}
            for name, (found, of) in total.items():
                row[name] = f"{found} of {of}" if name not in PER_DRIVE else f"{found / len(every):.1f}"
            rows.append(row)
    print_table(rows)


def real_table(folder: Path) -> None:
    wean = read_map(folder / "wean_hall/derived_wean.yaml")
    cases = {
        f"Wean Hall {n}": (
            wean, posed(folder, f"wean_hall/robotdata{n}.log.gz", f"wean_hall/reference_robotdata{n}.csv.gz",
                        max_range=81.83),
        )
        for n in (1, 3, 5)
    }  # fmt: skip
    cases["TurtleBot 4"] = (
        read_map(folder / "olin_mac_tb4/map/mac_1st_floor_final.yaml"),
        posed(folder, "olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/derived_ref_take_2.csv.gz"),
    )
    rows = []
    for name, (grid, log) in cases.items():
        found = find_changed_places(log, grid, calibrate(log, grid, OPTIONS).parameters)
        rows.append({"log": name, **{kind: len(found.of_kind(kind)) for kind in KINDS}})
        print(f"\n{name}\n{found.summary()}")
    print()
    print_table(rows)


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    data = Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared" / "data"
    simulated_table(SEEDS)
    if data.is_dir():
        real_table(data)
