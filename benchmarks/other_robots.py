"""What `calibrate --stack nav2` does for other robots, in maps that are right and in maps that are out of date.

Simulated offices, four laser scanners, odometry of worn wheels. As a user would, each is calibrated from a drive of two
minutes without poses, from nav2's defaults; nav2's filter, emulated, then runs on a second drive, from one start with
10 seeds, with the values before and after. Errors are those against exact poses. In maps that are out of date, walls
are 3 cm off (standard deviation; differently every few metres), half or most of the small things are gone, and boxes
have come. "Agrees": with the map, of the readings of the median scan. "Start given": no trajectory was found until the
start was given to half a metre. "Code": of `calibrate`.

Run: python benchmarks/other_robots.py [SEED ...]     (12; an hour on two processors)
     python benchmarks/other_robots.py otherwise      (one robot, half moved, with one thing otherwise; half an hour)
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from beamfield.cli.demo import DEFAULTS
from beamfield.cli.main import main as beamfield
from beamfield.geometry import between, chained, compose, interpolate_poses, wrap_angle
from beamfield.io.logs.carmen import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.read_map import read_map
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import scan_agreement
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, ScanLog, Track
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import drawn_readings, simulate_log
from beamfield.simulation.odometry import OdometryNoise
from beamfield.simulation.trajectory import DriveOptions
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.registry import STACKS
from crowd import with_crowd
from tables import print_table

SEEDS = range(10)
WORN = OdometryNoise(0.02, 0.02, 0.03, 0.02, 0.03)
# Share of the small things (up to 2 m2) that are still there, and boxes of 0.3 to 1.2 m that the map does not show.
MAPS = {"right": None, "half moved": (0.5, 40), "most moved": (0.2, 100)}
SMALL, BOX, WALLS, SMOOTH = 2.0, (0.3, 1.2), 0.03, 2.0
DEPENDENCE = Dependence(np.radians(4.0), 1.0)
# nav2's defaults with its other likelihood field.
PRODUCT = DEFAULTS.replace("likelihood_field", "likelihood_field_prob")


@dataclass(frozen=True)
class Laser:
    """A scanner: first and last bearing in degrees, beams, ranges in metres, what is true of it, scans per second."""

    bearings: tuple[float, float, int]
    limits: tuple[float, float]
    truth: BeamParameters
    rate: float = 5.0
    wheels: OdometryNoise = WORN
    slip_deg: float = 0.0
    """By how much the odometry turns wrongly between two scans in the middle of a drive."""
    sideways: bool = False
    """Whether the robot moves to its left; the laser is in its middle then."""
    stamped_at: float | None = None
    """Where in its sweep, from one scan to the next, a scan is stamped: 0 at the first beam, 0.5 midway; None: all
    beams are measured at once."""
    people: int = 0
    """How many go with the robot."""

    def drive(self, world: OccupancyGrid, seconds: float, seed: int) -> ScanLog:
        """Return a log with exact poses."""
        first, last, n = self.bearings
        ahead = 0.0 if self.sideways else 0.1  # CARMEN logs have no laser to the left of the robot
        finder = RangeFinder.from_bearings(
            np.radians(np.linspace(first, last, n)), self.limits[1], min_range=self.limits[0], mount=(ahead, 0.0, 0.0)
        )
        log = simulate_log(
            world, finder, self.truth, duration=seconds, scan_rate=self.rate, seed=seed, odometry_noise=self.wheels,
            drive=DriveOptions(speed=0.6), dependence=DEPENDENCE,
        )  # fmt: skip
        log = log if self.slip_deg == 0.0 else slipped(log, np.radians(self.slip_deg))
        log = log if self.stamped_at is None else self.swept(log, world, seed)
        log = log if self.people == 0 else crowded(log, self.people, seed)
        return turned_right(log) if self.sideways else log

    def swept(self, log: ScanLog, world: OccupancyGrid, seed: int) -> ScanLog:
        """Return a log whose beams are measured one after the other."""
        sensor, caster = log.only_sensor(), RayCaster(world, unknown="free")
        stamps, finder = sensor.stamps, sensor.finder
        expected = np.empty_like(sensor.ranges)
        for j, mount in enumerate(finder.mounts):
            times = stamps + (j / finder.n_beams - self.stamped_at) / self.rate
            poses = interpolate_poses(stamps, sensor.poses, times.clip(stamps[0], stamps[-1]))
            expected[:, j] = caster.expected_ranges(poses, replace(finder, mounts=mount[None]))[:, 0]
        ranges = drawn_readings(expected, finder, self.truth, np.random.default_rng(seed), stamps, DEPENDENCE)
        return replace(log, sensors=dict.fromkeys(log.sensors, replace(sensor, ranges=ranges)))


def slipped(log: ScanLog, turn: float) -> ScanLog:
    """Return a log of which one step of the odometry, in the middle, turns by so much too far."""
    sensor = log.only_sensor()
    steps = between(sensor.odometry[:-1], sensor.odometry[1:])
    steps[len(steps) // 2, 2] += turn
    odometry = chained(sensor.odometry[0], steps)
    odometry[:, 2] = wrap_angle(odometry[:, 2])
    return replace(
        log, sensors=dict.fromkeys(log.sensors, replace(sensor, odometry=odometry)),
        odometry=Track(sensor.stamps, odometry),
    )  # fmt: skip


def crowded(log: ScanLog, people: int, seed: int) -> ScanLog:
    """Return a log of a drive in a crowd."""
    sensor, _ = with_crowd(log.only_sensor(), people, seed)
    return replace(log, sensors=dict.fromkeys(log.sensors, sensor))


def turned_right(log: ScanLog) -> ScanLog:
    """Return the same drive of a robot whose x axis points to the right of where it goes."""
    sensor, right = log.only_sensor(), (0.0, 0.0, -np.pi / 2.0)
    odometry = compose(sensor.odometry, right)
    finder = replace(sensor.finder, mounts=between(right, sensor.finder.mounts))
    sensor = replace(sensor, finder=finder, poses=compose(sensor.poses, right), odometry=odometry)
    return replace(log, sensors=dict.fromkeys(log.sensors, sensor), odometry=Track(sensor.stamps, odometry))


LASERS = {
    "360 deg, 3.5 m": Laser((-180.0, 179.0, 360), (0.12, 3.5), BeamParameters(0.80, 0.05, 0.08, 0.07, 0.015, 0.5)),
    "360 deg, 12 m": Laser((-180.0, 179.0, 360), (0.15, 12.0), BeamParameters(0.75, 0.08, 0.12, 0.05, 0.03, 0.5)),
    "270 deg, 30 m": Laser((-135.0, 135.0, 541), (0.1, 30.0), BeamParameters(0.85, 0.07, 0.03, 0.05, 0.02, 0.5)),
    "86 deg, 8 m": Laser((-43.0, 43.0, 87), (0.3, 8.0), BeamParameters(0.70, 0.10, 0.10, 0.10, 0.05, 0.5)),
}
USUAL = LASERS["360 deg, 12 m"]


@dataclass(frozen=True)
class File:
    """A user's parameter file: the program, and what stands in it."""

    stack: str = "nav2"
    text: str = DEFAULTS


def ros1(model: str) -> File:
    """Return a file that sets the model alone, of ROS 1's amcl."""
    return File("ros1", f"amcl:\n  laser_model_type: {model}\n")


OMNI = "    robot_model_type: nav2_amcl::OmniMotionModel\n"
# What is otherwise than a drive of two minutes of `USUAL` with nav2's defaults.
OTHERWISE: dict[str, dict[str, Any]] = {
    "nothing": {},
    "nav2, likelihood_field_prob": {"file": File(text=PRODUCT)},
    "nav2, beam": {"file": File(text=DEFAULTS.replace("likelihood_field", "beam"))},
    "ROS 1 amcl": {"file": ros1("likelihood_field")},
    "ROS 1 amcl, beam": {"file": ros1("beam")},
    "Beluga": {"file": File("beluga")},
    "Beluga, likelihood_field_prob": {"file": File("beluga", PRODUCT)},
    "MRPT": {"file": File("mrpt", "[MetricMap_occupancyGrid_00_likelihoodOpts]\nlikelihoodMethod = 4\n")},
    "map of 0.02 m": {"resolution": 0.02},
    "map of 0.1 m": {"resolution": 0.1},
    "drive of 30 s": {"seconds": 30.0},
    "drive of 45 s": {"seconds": 45.0},
    "1 scan a second": {"laser": replace(USUAL, rate=1.0)},
    "40 scans a second": {"laser": replace(USUAL, rate=40.0)},
    "30 beams": {"laser": replace(USUAL, bearings=(-180.0, 168.0, 30))},
    "laser turned by 180 degrees": {"laser": replace(USUAL, bearings=(0.0, 359.0, 360))},
    "odometry slips by 20 degrees": {"laser": replace(USUAL, slip_deg=20.0)},
    "wheels three times as worn": {"laser": replace(USUAL, wheels=OdometryNoise(0.06, 0.06, 0.09, 0.06, 0.09))},
    "scans of 0.2 s, stamped at the first beam": {"laser": replace(USUAL, stamped_at=0.0)},
    "scans of 0.2 s, stamped midway": {"laser": replace(USUAL, stamped_at=0.5)},
    "10 people about the robot": {"laser": replace(USUAL, people=10)},
    "20 people": {"laser": replace(USUAL, people=20)},
    "20 people, nav2's likelihood_field_prob": {"laser": replace(USUAL, people=20), "file": File(text=PRODUCT)},
    "moves sideways": {"laser": replace(USUAL, sideways=True), "file": File(text=PRODUCT)},
    "moves sideways, OmniMotionModel": {"laser": replace(USUAL, sideways=True), "file": File(text=PRODUCT + OMNI)},
    "wheels nearly perfect": {"laser": replace(USUAL, wheels=OdometryNoise(0.001, 0.0005, 0.001, 0.0005, 0.0005))},
}


def otherwise() -> None:
    """Calibrate and run one robot in a map that is half out of date, with one thing otherwise, and print the table."""
    rows = []
    for name, what in OTHERWISE.items():
        with tempfile.TemporaryDirectory() as folder:
            rows.append({"otherwise": name} | outcome(**{"laser": USUAL} | what, changes=MAPS["half moved"],
                                                      seed=12, folder=Path(folder)))  # fmt: skip
        print(rows[-1], file=sys.stderr, flush=True)
    print_table(rows)


def main(seeds: Sequence[int]) -> None:
    """Calibrate and run every robot in every map, and print the table."""
    rows = []
    for seed in seeds:
        for name, laser in LASERS.items():
            for state, changes in MAPS.items():
                with tempfile.TemporaryDirectory() as folder:
                    rows.append(
                        {"laser": name, "map": state, "office": seed} | outcome(laser, changes, seed, Path(folder))
                    )
                print(rows[-1], file=sys.stderr, flush=True)
    print_table(rows)


def outcome(
    laser: Laser, changes: tuple[float, int] | None, seed: int, folder: Path, *, seconds: float = 120.0,
    resolution: float = 0.05, file: File = File(), plan: OccupancyGrid | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return what the filter does before and after; the plan is an office's unless given."""
    plan = draw_floor_plan(seed=seed, resolution=resolution) if plan is None else plan
    rng = np.random.default_rng(seed)
    world = plan if changes is None else changed(plan, *changes, rng)
    write_map(plan if changes is None else bent(plan, rng), folder / "map.yaml", mode="trinary")
    learned, judged = (laser.drive(world, duration, 10 * seed + i) for i, duration in enumerate((seconds, 90.0)))
    sensor = learned.only_sensor()
    hidden = replace(sensor, poses=np.full_like(sensor.poses, np.nan))
    write_carmen(folder / "log.carmen", replace(learned, sensors=dict.fromkeys(learned.sensors, hidden)))
    before, after = (folder / f"{when}.{STACKS[file.stack].syntax}" for when in ("before", "after"))
    for path in (before, after):
        path.write_text(file.text)
    x, y, theta = sensor.poses[0]
    words = [
        "calibrate", folder / "log.carmen", "--lone-poses", "odometry", "--map", folder / "map.yaml", "--max-range",
        laser.limits[1], "--stack", file.stack, "--patch", after, "--out", folder / "out", "--quiet",
    ]  # fmt: skip
    start = ["--start", round(2.0 * x) / 2.0, round(2.0 * y) / 2.0, round(np.degrees(theta), -1)]
    code = beamfield([str(word) for word in words])
    given = code == 1
    if given:
        code = beamfield([str(word) for word in [*words, *start]])
    grid, shifted = read_map(folder / "map.yaml"), folder / "out/amcl_map.yaml"
    agrees = np.nanmedian(scan_agreement(sensor, grid, sensor.poses))
    said: dict[str, Any] = {"agrees": f"{agrees:.0%}", "start given": "yes" if given else "no", "code": code}
    for when, path in (("before", before), ("after", after)):
        settings = read_filter_settings(read_stack_file(path, stack=file.stack))
        its = read_map(shifted) if when == "after" and shifted.exists() else grid
        trials = run_trials(settings.filter(its), settings.at_ticks(judged.only_sensor()), SEEDS)
        said |= {f"{when} [m]": f"{trials.mean('mean'):.3f}", f"lost {when}": f"{trials.n_lost} of {len(trials)}"}
    return said


def changed(plan: OccupancyGrid, kept: float, boxes: int, rng: np.random.Generator) -> OccupancyGrid:
    """Return the place as it is now, where the map was drawn before."""
    cells = plan.probability.copy()
    things, n = ndimage.label(plan.occupied, np.ones((3, 3)))
    areas = ndimage.sum(plan.occupied, things, range(1, n + 1)) * plan.resolution**2
    small = np.flatnonzero(areas < SMALL) + 1
    cells[np.isin(things, small[rng.random(len(small)) > kept])] = 0.0
    free = np.argwhere(plan.free)
    for row, col in free[rng.integers(len(free), size=boxes)]:
        height, width = (rng.uniform(*BOX, 2) / plan.resolution).astype(int)
        box = np.s_[row : row + height, col : col + width]
        cells[box] = np.where(plan.free[box], 1.0, cells[box])
    return replace(plan, probability=cells)


def bent(plan: OccupancyGrid, rng: np.random.Generator) -> OccupancyGrid:
    """Return the map with walls a little off, differently every few metres."""
    moved = [ndimage.gaussian_filter(rng.normal(size=plan.shape), SMOOTH / plan.resolution) for _ in range(2)]
    row, col = (
        np.clip(np.rint(at + by / by.std() * WALLS / plan.resolution).astype(int), 0, n - 1)
        for at, by, n in zip(np.indices(plan.shape), moved, plan.shape, strict=True)
    )
    return replace(plan, probability=plan.probability[row, col])


if __name__ == "__main__":
    if sys.argv[1:] == ["otherwise"]:
        otherwise()
    else:
        main([int(word) for word in sys.argv[1:]] or [12])
