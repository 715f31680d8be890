"""A calibration made by hand: a rectangular room, a drive along its middle, readings drawn from a known model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.calibrate import Calibration, CalibrationOptions
from beamfield.calibration.evaluation import (
    DEFAULTS,
    likely_causes,
    pit_deviation,
    randomized_pit,
    score_models,
    timeline,
    uniform_parameters,
)
from beamfield.calibration.hit_forms import Candidate
from beamfield.calibration.intrinsic.block_intervals import IntervalResult
from beamfield.calibration.intrinsic.em import LearningResult
from beamfield.calibration.opposite_beams import opposite_beams
from beamfield.calibration.pose_refinement import PoseRefinement
from beamfield.calibration.selection import REASONS, Selection
from beamfield.calibration.time_split import held_out_mask, time_blocks
from beamfield.finding import Finding
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog

# The room: [0, 12] x [0, 6] metres.
WIDTH, HEIGHT = 12.0, 6.0
TRUTH = BeamParameters(0.8, 0.1, 0.04, 0.06, 0.05, 0.3)


@dataclass(frozen=True)
class Case:
    """What a report is made from."""

    calibration: Calibration
    grid: OccupancyGrid
    log: SensorLog
    provenance: dict[str, Any] = field(default_factory=dict)


@pytest.fixture(scope="session")
def make_case() -> Callable[..., Case]:
    """A function that makes a calibration; its keywords replace fields of the result."""
    return _make_case


@pytest.fixture(scope="session")
def case() -> Case:
    """An ordinary calibration: everything there."""
    return _make_case()


def _make_case(
    *,
    truth: BeamParameters = TRUTH,
    n_scans: int = 120,
    n_beams: int = 72,
    bearings: np.ndarray | None = None,
    max_range: float = 10.0,
    same_place: bool = False,
    name: str = "/scan",
    start: float = 1.7e9,
    with_refinement: bool = True,
    options: CalibrationOptions | None = None,
    **changes: Any,
) -> Case:
    rng = np.random.default_rng(7)
    options = options or CalibrationOptions()
    angles = np.radians(np.arange(n_beams) * 360.0 / n_beams - 180.0) if bearings is None else bearings
    finder = RangeFinder.from_bearings(angles, max_range, name=name)
    along = np.full(n_scans, 0.5) if same_place else np.linspace(0.1, 0.9, n_scans)
    poses = np.column_stack([along * WIDTH, np.full(n_scans, HEIGHT / 2), np.zeros(n_scans)])
    expected = np.minimum(_room_ranges(poses, angles), max_range)
    ranges = _draw(expected, truth, max_range, rng)
    stamps = start + np.arange(n_scans) * 1.0
    log = SensorLog(finder, stamps, np.where(ranges >= max_range, np.inf, ranges), poses, poses)
    scan, beam = (index.ravel().astype(np.int32) for index in np.indices(expected.shape))
    table = BeamTable(ranges.ravel(), expected.ravel(), scan, beam, stamps[scan], max_range, 5, 7)
    held_out = held_out_mask(table.stamps, options.block_s)
    blocks = time_blocks(table.stamps, options.block_s)
    learning = _learned(truth, int((~held_out).sum()))
    models = {"fit": truth, **DEFAULTS, "uniform": uniform_parameters(truth.z_max)}
    scores = score_models(models, table.select(held_out), blocks[held_out])
    pit = randomized_pit(table.select(held_out), truth, rng)
    reason = np.full(n_scans, -1, dtype=np.int8)
    reason[:3] = REASONS.index("standing still")
    shifts = rng.normal(0.0, (0.02, 0.02, 0.005), (30, 3))
    calibration = Calibration(
        parameters=truth,
        intervals=_intervals(truth),
        learning=learning,
        candidates=(
            Candidate("chapter", learning, scores[0].log_likelihood, 0.0, 0.0, chosen=True),
            Candidate("range offset", learning, scores[0].log_likelihood, 0.0007, 0.0005, has_offset=True),
        ),
        scores=scores,
        selection=Selection(reason < 0, reason),
        table=table,
        held_out=held_out,
        pit=pit,
        pit_deviation=pit_deviation(pit),
        causes=likely_causes(table, truth),
        timeline=timeline(table, truth, held_out),
        opposite=opposite_beams(log, table, blocks),
        refinement=PoseRefinement(np.arange(30), shifts, 0.05, 0.047) if with_refinement else None,
        findings=(
            Finding(
                "poor-map",
                "warning",
                "The map is poor.",
                {"share": 0.25},
                why="It matters.",
                do="Draw a better one.",
            ),
            Finding("pose-refinement", "info", "The poses are good.", {"n": 30.0}),
        ),
        options=options,
        finder=finder,
    )
    provenance = {
        "program": "beamfield 0.0.test",
        "inputs": {
            "log": {"name": "drive.log", "sha256": "ab" * 32},
            "map": {"name": "room.yaml", "sha256": "cd" * 32},
        },
        "options": {"block": None},
        "seed": 0,
    }
    return Case(replace(calibration, **changes), _room(), log, provenance)


def _room() -> OccupancyGrid:
    """Walls around the room, unknown space around the walls."""
    probability = np.full((160, 280), np.nan, dtype=np.float32)
    probability[18:142, 18:262] = 1.0
    probability[20:140, 20:260] = 0.0
    return OccupancyGrid(probability, 0.05, np.array([-1.0, -1.0, 0.0]))


def _room_ranges(poses: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """(t, k) distance to the rectangle's sides."""
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, WIDTH - poses[:, :1], poses[:, :1]) / np.abs(cos)
        to_y = np.where(sin > 0, HEIGHT - poses[:, 1:2], poses[:, 1:2]) / np.abs(sin)
    return np.minimum(to_x, to_y)


def _draw(expected: np.ndarray, truth: BeamParameters, max_range: float, rng: np.random.Generator) -> np.ndarray:
    """Readings from the four causes."""
    cause = rng.choice(4, expected.shape, p=truth.weights)
    sigma = np.hypot(truth.sigma_hit, truth.sigma_slope * expected)
    hit = np.clip(expected + truth.range_offset + sigma * rng.standard_normal(expected.shape), 0.0, max_range * 0.9999)
    u = rng.random(expected.shape)
    rate = truth.lambda_short
    short = -np.log1p(-u * -np.expm1(-rate * expected)) / rate if rate > 0 else u * expected
    return np.choose(cause, [hit, short, np.full(expected.shape, max_range), u * max_range * 0.9999])


def _learned(truth: BeamParameters, n_beams: int) -> LearningResult:
    return LearningResult(
        parameters=truth,
        log_likelihood=0.5,
        trace=(0.1, 0.4, 0.49, 0.5),
        iterations=3,
        em_steps=2,
        newton_steps=1,
        converged=True,
        n_beams=float(n_beams),
        n_excluded=0,
        n_no_measurement=0,
        modes=(),
        findings=(),
    )


def _intervals(truth: BeamParameters) -> IntervalResult:
    names = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
    return IntervalResult(
        intervals={name: (0.96 * getattr(truth, name), 1.05 * getattr(truth, name)) for name in names},
        standard_errors={name: 0.02 * getattr(truth, name) for name in names},
        level=0.95,
        n_blocks=9,
        findings=(),
    )
