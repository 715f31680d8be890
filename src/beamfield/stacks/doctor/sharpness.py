"""How much one scan changes a set of particles: nearly nothing, or nearly everything."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.doctor.subject import Subject
from beamfield.stacks.filters.particles import n_effective, normalised
from beamfield.stacks.formula import Formula
from beamfield.stacks.registry import build_model
from beamfield.stacks.stack import FIELD_CUBES, FIELD_PRODUCT

# The test: so many particles around the true pose, metres and radians.
N_PARTICLES = 2000
POSITION_SD, HEADING_SD = 0.2, 0.035
# Readings: walls of a room in four directions; noise of a laser on a map; some see something else.
NOISE, OUTLIERS, ROOM = 0.04, 0.1, (1.0, 6.0)
# A share of the particles beyond which the scan says little (as by default), beyond which it says nothing, and below
# which it says too much.
FLAT, FLATTEST, SHARP = 0.6, 0.99, 0.01
DEFAULT_BEAMS = 60
# The sensor's longest range where nobody knows it, and the side of a map's cells, metres.
PLAIN_LIMIT, USUAL_CELL = 10.0, 0.05
N_SCANS = 9
# No scan has more.
MOST_BEAMS = 2000


def sharpness(subject: Subject) -> Iterator[Finding]:
    """Find parameters with which a scan hardly moves the particles, or with which a handful take all the weight."""
    if not all(item.is_clear for item in subject.typed.unusable):
        return
    try:
        effective, where = _effective(subject)
    except InvalidInputError:  # the program would not return; another check says so
        return
    if effective == 0.0 and _meets_nan(subject):
        return  # by NaN, which another check names
    if effective == 0.0:
        yield subject.finding(
            "all-weights-zero", "error", f"one scan gives all {N_PARTICLES} particles around the true pose {where} the "
            "weight 0", "weights are divided by their sum, which is 0: poses can no longer be told apart",
            "give random readings (z_rand) a few percent, and z_hit more than 0",
        )  # fmt: skip
        return
    share = effective / N_PARTICLES
    seen = (
        f"one scan leaves an effective {effective:.0f} of {N_PARTICLES} particles that are spread by {POSITION_SD:g} m "
        f"around the true pose {where}"
    )
    numbers = {"effective_sample_size": effective, "particles": float(N_PARTICLES)}
    if share > FLAT:
        yield subject.finding(
            "nearly-flat", "warning" if share > FLATTEST else "info", seen,
            "weights hardly differ: the filter follows odometry and corrects only over many scans",
            f"calibrate (beamfield calibrate --stack){_product(subject)}",
            values=numbers,
        )  # fmt: skip
    elif share < SHARP:
        yield subject.finding(
            "absurdly-sharp", "warning", seen,
            "beams err together, but count as if they were independent: one bad scan can discard the true pose",
            f"calibrate (beamfield calibrate --stack), or use {subject.stack.flatter}",
            values=numbers,
        )  # fmt: skip


def _meets_nan(subject: Subject) -> bool:
    """Return whether readings make weights NaN, which no value changes."""
    log = subject.log
    return log is not None and not subject.model.emulator.tests_nan and bool(np.isnan(log.ranges).any())


def _product(subject: Subject) -> str:
    """Return what else to try where a field adds up cubes."""
    products = [name for name, model in subject.stack.models.items() if model.weight == FIELD_PRODUCT]
    return f", or use {products[0]} with few beams" if products and subject.model.weight == FIELD_CUBES else ""


def effective_sample_size(log_weights: FloatArray) -> float:
    """Return the effective number of particles with weights given by their logarithms; 0 if all are 0."""
    return n_effective(normalised(log_weights)) if log_weights.max() > -np.inf else 0.0


def _effective(subject: Subject) -> tuple[float, str]:
    """Return the effective sample size after one scan, and where that was."""
    log, grid = subject.log, subject.grid
    if log is not None and grid is not None and log.has_poses:
        return _effective_in_log(subject, log, grid), f"in the log (median of up to {N_SCANS} scans)"
    return effective_sample_size(_room_weights(subject)), "in a plain room"


def _effective_in_log(subject: Subject, log: SensorLog, grid: OccupancyGrid) -> float:
    model = build_model(subject.file.stack, subject.file.model, grid, subject.parameters)
    with_pose = np.flatnonzero(np.isfinite(log.poses).all(axis=1))
    chosen = with_pose[np.linspace(0, len(with_pose) - 1, min(N_SCANS, len(with_pose))).astype(np.int64)]
    rng = np.random.default_rng(0)
    spread = np.array([POSITION_SD, POSITION_SD, HEADING_SD])
    weights = [
        model.log_likelihood(log.scan(int(i)), log.poses[i] + rng.normal(0.0, spread, (N_PARTICLES, 3))) for i in chosen
    ]
    return float(np.median([effective_sample_size(each) for each in weights]))


def _room_weights(subject: Subject) -> FloatArray:
    formula, limit = Formula(subject.stack, subject.model, subject.parameters), _range_limit(subject)
    readings, expected = _room(np.random.default_rng(0), _n_beams(subject))
    if subject.model.weight.of_field:
        return formula.field_weights(np.abs(readings - expected), limit, USUAL_CELL)
    return formula.ray_weights(readings, expected, limit, USUAL_CELL)


def _range_limit(subject: Subject) -> float:
    """Return the range that random readings are spread over, metres; at least what the room needs."""
    asked = subject.value("laser_max_range")
    limit = float(asked) if asked is not None and asked > 0.0 else PLAIN_LIMIT
    if subject.log is not None and subject.stack.takes_lesser_limit:
        limit = min(limit, subject.log.finder.max_range)
    return max(limit, 1.5 * ROOM[1])


def _n_beams(subject: Subject) -> int:
    asked = subject.beams_used()
    if asked is None:
        return DEFAULT_BEAMS
    return min(asked, MOST_BEAMS if subject.log is None else subject.log.finder.n_beams)


def _room(rng: np.random.Generator, n_beams: int) -> tuple[FloatArray, FloatArray]:
    """Return readings (k,) and expected ranges (n, k), metres.

    Beams meet walls at right angles, in the four directions of a room. A pose that is off by (x, y) and turned expects
    them longer or shorter.
    """
    directions = rng.integers(0, 4, n_beams) * (np.pi / 2.0)
    ranges = rng.uniform(*ROOM, n_beams)
    lever = rng.uniform(-1.0, 1.0, n_beams) * ranges
    offsets = rng.normal(0.0, POSITION_SD, (N_PARTICLES, 2))
    turns = rng.normal(0.0, HEADING_SD, N_PARTICLES)
    expected = ranges - offsets[:, :1] * np.cos(directions) - offsets[:, 1:] * np.sin(directions)
    expected += turns[:, None] * lever
    readings = ranges + rng.normal(0.0, NOISE, n_beams)
    outlier = rng.random(n_beams) < OUTLIERS
    readings[outlier] = rng.uniform(0.3, 1.0, int(outlier.sum())) * ranges[outlier]
    return np.asarray(readings), np.asarray(np.maximum(expected, 0.05))
