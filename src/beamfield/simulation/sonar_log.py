"""Logs of a simulated robot with a ring of sonars: true poses, noisy odometry and readings from acoustics."""

from __future__ import annotations

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import NoReturnPolicy, RangeFinder, ScanLog, SensorLog, Track
from beamfield.simulation.log import scan_stamps
from beamfield.simulation.odometry import OdometryNoise, noisy_odometry
from beamfield.simulation.sonar import Progress, SonarPhysics, SonarReadings, simulate_sonar
from beamfield.simulation.surfaces import surfaces_of_grid
from beamfield.simulation.trajectory import DriveOptions, drive_through


def simulate_sonar_log(
    grid: OccupancyGrid,
    ring: RangeFinder,
    physics: SonarPhysics | None = None,
    *,
    duration: float = 180.0,
    scan_rate: float = 4.0,
    seed: int = 0,
    start: float = 100.0,
    drive: DriveOptions | None = None,
    odometry_noise: OdometryNoise | None = None,
    smoothing: float = 1.25,
    progress: Progress | None = None,
) -> tuple[ScanLog, SonarReadings]:
    """Drive a robot through a map and record what its ring of sonars would measure.

    Parameters
    ----------
    grid
        The world.
    ring
        The sensors; see `sonar_ring`.
    physics
        How sound is reflected and heard.
    duration
        Length of the log, seconds.
    scan_rate
        Scans per second; in each scan every sensor fires once.
    seed
        Chooses the drive, the odometry's errors and the readings; the same seed gives the same log, and the same drive
        as `simulate_log` with this duration and rate.
    start
        Stamp of the first scan, seconds.
    drive, odometry_noise
        How the robot drives, and how wrong its odometry is.
    smoothing
        How walls are found in the map; see `surfaces_of_grid`.
    progress
        Called with (done, total) scans.

    Returns
    -------
    The log, and the readings with their true causes. The log has one sensor, called as the ring; its `poses` are the
    truth and its `odometry` is noisy.

    Raises
    ------
    InvalidInputError
        If a number is out of range, the map has no obstacle or the robot finds no room.

    Examples
    --------
    >>> from beamfield.simulation.floor_plan import draw_floor_plan
    >>> from beamfield.simulation.sonar import sonar_ring
    >>> log, readings = simulate_sonar_log(draw_floor_plan(), sonar_ring(8), duration=5.0)
    >>> log.only_sensor().ranges.shape
    (20, 8)
    """
    stamps = scan_stamps(duration, scan_rate, start)
    drive_seed, odometry_seed, reading_seed = np.random.SeedSequence(seed).generate_state(3)
    surfaces = surfaces_of_grid(grid, smoothing=smoothing)
    truth = drive_through(grid, stamps, seed=int(drive_seed), options=drive)
    odometry = noisy_odometry(truth.poses, np.random.default_rng(odometry_seed), odometry_noise)
    rng = np.random.default_rng(reading_seed)
    readings = simulate_sonar(surfaces, truth.poses, ring, physics, rng, progress=progress)
    policy = NoReturnPolicy((), float(np.isposinf(readings.ranges).mean()), "declared", "simulated: no return is +inf")
    name = ring.name or "sonar"
    log = ScanLog(
        {name: SensorLog(ring, stamps, readings.ranges, truth.poses, odometry, policy)},
        odometry=Track(stamps, odometry),
        source="simulation",
        notes=("simulated by beamfield: the poses are the truth",),
    )
    return log, readings
