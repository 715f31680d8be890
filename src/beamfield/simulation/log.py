"""Logs of a simulated robot: true poses, noisy odometry and readings drawn from the beam model itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from beamfield.arguments import as_count, checked, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.maps.cone import ConeCaster, make_caster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import beams_from_uniforms, sample_beams
from beamfield.sensors import NoReturnPolicy, RangeFinder, ScanLog, SensorLog, Track
from beamfield.simulation.dependence import Dependence, dependent_uniforms
from beamfield.simulation.odometry import OdometryNoise, noisy_odometry
from beamfield.simulation.sonar import heard_ranges
from beamfield.simulation.trajectory import DriveOptions, drive_through

Progress = Callable[[int, int], None]

# Scans per call of the ray caster: keeps memory small and progress alive.
SCANS_PER_CHUNK = 256
MAX_SCANS = 1_000_000


@checked
def simulate_log(
    grid: OccupancyGrid,
    finder: RangeFinder,
    parameters: BeamParameters,
    *,
    duration: float = 180.0,
    scan_rate: float = 10.0,
    seed: int = 0,
    start: float = 100.0,
    drive: DriveOptions | None = None,
    odometry_noise: OdometryNoise | None = None,
    dependence: Dependence | None = None,
    unknown: Literal["free", "occupied"] = "free",
    roughness: float = 1.0,
    progress: Progress | None = None,
) -> ScanLog:
    """Drive a robot through a map and record what its range finder would measure.

    Parameters
    ----------
    grid
        The world.
    finder
        The sensor. If it has an opening angle, the readings are those of `SonarModel`.
    parameters
        The true parameters of the beam model.
    duration
        Length of the log, seconds.
    scan_rate
        Scans per second.
    seed
        Chooses the drive, the odometry's errors and the readings; the same seed gives the same log.
    start
        Stamp of the first scan, seconds.
    drive, odometry_noise
        How the robot drives, and how wrong its odometry is.
    dependence
        How far neighbouring beams and scans err alike; None: all are independent. Each beam alone has the model's
        distribution either way.
    unknown
        Whether rays pass unknown cells ("free") or stop there ("occupied").
    roughness
        Share of pulses of a sonar that come back from walls that it does not face: see `heard_ranges`.
    progress
        Called with (done, total) scans.

    Returns
    -------
    ScanLog
        One sensor, called as the finder or "scan". Its `poses` are the truth and its `odometry` is noisy. Readings
        without return are +inf.

    Raises
    ------
    InvalidInputError
        If a number is out of range, the map has no obstacle or the robot finds no room.

    Notes
    -----
    Where a ray meets no obstacle within max_range, nothing can be hit: there the weight z_hit is added to "no return".
    The model as written cuts p_hit off at max_range instead and would return such readings just below max_range, which
    no sensor does; learning leaves these beams out (see `calibration.beam_table`).

    All beams of a scan are taken at once, at the scan's stamp.

    References
    ----------
    Probabilistic Robotics, section 6.3.1: the generative reading of (6.12).

    Examples
    --------
    >>> from beamfield.simulation.floor_plan import draw_floor_plan
    >>> finder = RangeFinder.from_bearings(np.linspace(-1.5, 1.5, 16), max_range=12.0)
    >>> truth = BeamParameters(z_hit=0.85, z_short=0.1, z_max=0.02, z_rand=0.03, sigma_hit=0.05, lambda_short=0.5)
    >>> log = simulate_log(draw_floor_plan(), finder, truth, duration=5.0).only_sensor()
    >>> len(log), log.finder.n_beams
    (50, 16)
    """
    as_count(seed, "seed", least=0)
    stamps = scan_stamps(duration, scan_rate, start)
    drive_seed, odometry_seed, reading_seed, mirror_seed = np.random.SeedSequence(seed).generate_state(4)
    if not grid.occupied.any():
        raise InvalidInputError("the map has no occupied cell: there is nothing to measure")
    truth = drive_through(grid, stamps, seed=int(drive_seed), options=drive)
    odometry = noisy_odometry(truth.poses, np.random.default_rng(odometry_seed), odometry_noise)
    caster = make_caster(grid, finder, unknown=unknown)
    if isinstance(caster, ConeCaster):
        expected = heard_ranges(caster, truth.poses, finder, roughness, np.random.default_rng(mirror_seed))
    else:
        expected = _expected_ranges(caster, truth.poses, finder, progress)
    ranges = drawn_readings(expected, finder, parameters, np.random.default_rng(reading_seed), stamps, dependence)
    policy = NoReturnPolicy((), float(np.isinf(ranges).mean()), "declared", "simulated: no return is +inf")
    sensors = {finder.name or "scan": SensorLog(finder, stamps, ranges, truth.poses, odometry, policy)}
    notes = ("simulated by beamfield: the poses are the truth",)
    return ScanLog(sensors, odometry=Track(stamps, odometry), source="simulation", notes=notes)


def scan_stamps(duration: float, scan_rate: float, start: float) -> FloatArray:
    """Return the stamps (t,) of a log's scans, evenly spaced from the start on, seconds.

    InvalidInputError names a number that is out of range, or makes no scan or too many.
    """
    for name, value in (("duration", duration), ("scan_rate", scan_rate)):
        require(0.0 < value < np.inf, name, "a positive, finite number", value)
    require(not isinstance(start, complex) and abs(start) < np.inf, "start", "a finite number of seconds", start)
    n_scans = duration * scan_rate
    require(1.0 <= n_scans <= MAX_SCANS, "duration x scan_rate", f"1 to {MAX_SCANS} scans", n_scans)
    return np.asarray(start + np.arange(round(n_scans)) / scan_rate)


def _expected_ranges(
    caster: RayCaster, poses: FloatArray, finder: RangeFinder, progress: Progress | None
) -> FloatArray:
    expected: FloatArray = np.empty((len(poses), finder.n_beams))
    for first in range(0, len(poses), SCANS_PER_CHUNK):
        part = slice(first, min(first + SCANS_PER_CHUNK, len(poses)))
        expected[part] = caster.expected_ranges(poses[part], finder)
        if progress is not None:
            progress(part.stop, len(poses))
    return expected


def drawn_readings(
    expected: FloatArray,
    finder: RangeFinder,
    parameters: BeamParameters,
    rng: np.random.Generator,
    stamps: FloatArray | None = None,
    dependence: Dependence | None = None,
) -> FloatArray:
    """Draw readings (t, k) from the beam model, metres; where nothing can be hit, hits are missing returns, +inf.

    Expected ranges (t, k) are max_range where there is nothing. Stamps (t,) are needed with a dependence alone:
    without, all readings are independent. See `simulate_log`.
    """
    nothing = expected >= finder.max_range
    without_hits = replace(parameters, z_hit=0.0, z_max=parameters.z_max + parameters.z_hit)
    farthest, nearest = finder.max_range, finder.min_range
    if stamps is None or dependence is None or dependence.is_none:
        ranges = sample_beams(expected, farthest, parameters, rng, min_range=nearest)
        ranges[nothing] = sample_beams(expected[nothing], farthest, without_hits, rng, min_range=nearest)
    else:
        u, v = (dependent_uniforms(stamps, finder.bearings, dependence, rng) for _ in range(2))
        ranges = beams_from_uniforms(u, v, expected, farthest, parameters, min_range=nearest)
        u, v, expected = u[nothing], v[nothing], expected[nothing]
        ranges[nothing] = beams_from_uniforms(u, v, expected, farthest, without_hits, min_range=nearest)
    ranges[ranges >= finder.max_range] = np.inf
    return ranges
