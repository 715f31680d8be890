"""The main job: from a log and a map to the parameters of a beam model, with proof."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable, UnknownRule, build_beam_table
from beamfield.calibration.bootstrap import IntervalResult, bootstrap_intervals
from beamfield.calibration.cross_fit import CrossFitMaps, cross_fit_finding, cross_fit_table
from beamfield.calibration.em import LearningResult, learn_intrinsic_parameters
from beamfield.calibration.evaluation import (
    DEFAULTS,
    ModelScore,
    Timeline,
    block_standard_error,
    likely_causes,
    pit_deviation,
    randomized_pit,
    score_models,
    timeline,
    uniform_parameters,
)
from beamfield.calibration.finding import Finding
from beamfield.calibration.opposite_beams import OppositeBeams, map_findings, opposite_beams
from beamfield.calibration.pose_refinement import PoseRefinement, refine_poses, refinement_findings
from beamfield.calibration.reference_checks import pose_findings
from beamfield.calibration.selection import Selection, SelectionOptions, select_scans
from beamfield.calibration.time_split import held_out_mask, time_blocks
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import SensorLog
from beamfield.thread_count import check_threads

Choice = Literal["auto", "on", "off"]
Progress = Callable[[str, int, int], None]

FEWEST_BEAMS = 500


@dataclass(frozen=True)
class CalibrationOptions:
    """Everything that changes the result besides the data.

    Parameters
    ----------
    selection
        Which scans are used.
    unknown
        What rays do in unknown cells, see `build_beam_table`.
    block_s
        Length of the time blocks that are held out or fitted whole, seconds; None chooses 20 s or less.
    range_offset
        Whether hits may be centred beside the expected range: "auto" keeps it if held-out likelihood asks for it.
    sigma_slope
        Whether sigma may grow with the expected range: likewise.
    hold
        Parameters held at given values.
    n_bootstrap
        Replicates for the intervals.
    refine
        Whether to refine reference poses to see their share in sigma_hit.
    seed
        For the bootstrap and the randomised PIT.
    threads
        None uses all processors.
    """

    selection: SelectionOptions = field(default_factory=SelectionOptions)
    unknown: UnknownRule = "skip"
    block_s: float | None = None
    range_offset: Choice = "auto"
    sigma_slope: Choice = "auto"
    hold: Mapping[str, float] = field(default_factory=dict)
    n_bootstrap: int = 200
    refine: bool = True
    seed: int = 0
    threads: int | None = None

    def __post_init__(self) -> None:
        check_threads(self.threads)
        for name, allowed in (
            ("unknown", ("skip", "free", "occupied")),
            ("range_offset", ("auto", "on", "off")),
            ("sigma_slope", ("auto", "on", "off")),
        ):
            if getattr(self, name) not in allowed:
                raise InvalidInputError(f"{name}: expected one of {allowed}, got {getattr(self, name)!r}")
        if self.n_bootstrap < 20:
            raise InvalidInputError(f"n_bootstrap: expected at least 20, got {self.n_bootstrap}")


@dataclass(frozen=True)
class Candidate:
    """One form of the hit component, fitted on the fit blocks and scored on the held-out ones.

    Parameters
    ----------
    name
        "chapter", "range offset", "sigma slope" or "range offset + sigma slope".
    result
        The fit.
    held_out
        Mean log-likelihood per held-out beam, nats.
    gain, gain_se
        Gain over the simplest candidate per held-out beam, nats, and its standard error from blocks of time.
    chosen
        Whether it is the result.
    """

    name: str
    result: LearningResult
    held_out: float
    gain: float
    gain_se: float
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of `calibrate`.

    Parameters
    ----------
    parameters
        The fitted parameters.
    intervals
        95 % intervals by parameter, and what they rest on.
    learning
        Trace, iterations and convergence of the chosen fit.
    candidates
        All fitted forms.
    scores
        Held-out scores: the fit, the stacks' defaults, a uniform.
    selection
        Which scans were used.
    table
        All beams of the used scans.
    held_out
        (n,) which beams of the table were held out.
    pit, pit_deviation
        Randomised PIT of the held-out beams and its largest distance from uniform.
    causes
        (n,) most likely cause per beam of the table: 0 hit, 1 short, 2 max, 3 rand.
    timeline
        Mean log-likelihood per scan.
    opposite
        Measured against mapped widths; None if the sensor cannot tell.
    refinement
        What refining the reference poses does to sigma; None if not asked for.
    findings
        What to know before trusting the result, warnings first.
    options
        The options used.
    """

    parameters: BeamParameters
    intervals: IntervalResult
    learning: LearningResult
    candidates: tuple[Candidate, ...]
    scores: tuple[ModelScore, ...]
    selection: Selection
    table: BeamTable
    held_out: NDArray[np.bool_]
    pit: FloatArray
    pit_deviation: float
    causes: NDArray[np.int8]
    timeline: Timeline
    opposite: OppositeBeams | None
    refinement: PoseRefinement | None
    findings: tuple[Finding, ...]
    options: CalibrationOptions

    @property
    def converged(self) -> bool:
        """Whether the fit converged."""
        return self.learning.converged

    @property
    def n_fit(self) -> int:
        """Number of beams the parameters were fitted to."""
        return self.learning.n_beams


def calibrate(
    log: SensorLog,
    grid: OccupancyGrid | CrossFitMaps,
    options: CalibrationOptions | None = None,
    *,
    progress: Progress | None = None,
) -> Calibration:
    """Learn the intrinsic parameters of the beam model from a log with reference poses and a map.

    Scans are selected, their expected ranges cast, blocks of time held out; the chapter's parameters (and, where
    held-out likelihood asks for them, a range offset and a sigma that grows with range) are learned by exact EM on the
    other blocks, judged on the held-out ones, and the map and the reference poses are checked.

    Where the sensor has an opening angle (sonars), expected ranges are those of cones: `SonarModel` is learned instead
    of `BeamModel`. To treat its readings as beams, give a finder without opening angle.

    Parameters
    ----------
    log
        Scans of one sensor with reference poses in the map frame.
    grid
        The map; or, for a log that has none, the two maps drawn from its halves (`build_cross_fit_maps`).
    options
        See `CalibrationOptions`.
    progress
        Called with (stage, done, total).

    Raises
    ------
    InvalidInputError
        If the log has no reference poses, lies off the map, or the map has no obstacle.
    TooLittleDataError
        If too few scans or beams remain; the text says where they went.

    References
    ----------
    Sections 6.3.2 and 6.3.3, Table 6.2.
    """
    options = options or CalibrationOptions()
    report = progress or _silent
    rng = np.random.default_rng(options.seed)
    whole = grid.whole if isinstance(grid, CrossFitMaps) else grid
    if not whole.occupied.any():
        raise InvalidInputError("the map has no occupied cell: no expected range can be computed")

    # 1. Scans that moved, lie on the map and have a plausible reference pose.
    selection = select_scans(log, whole, options.selection)

    # 2. Expected ranges.
    table = _cast(log, grid, selection.used, options, lambda done, total: report("casting rays", done, total))

    # 3. Whole blocks of time are held out.
    blocks = time_blocks(table.stamps, options.block_s)
    held_out = held_out_mask(table.stamps, options.block_s)
    _require_beams(table, held_out, selection)

    # 4. Learn each form of the hit component, keep the one that held-out likelihood asks for.
    candidates = _fit_candidates(table, blocks, held_out, options, report)
    chosen = next(c for c in candidates if c.chosen)
    fit = chosen.result.parameters
    fit_rows = ~held_out & ~table.hits_nothing
    intervals = bootstrap_intervals(
        table.ranges[fit_rows],
        table.expected_ranges[fit_rows],
        table.stamps[fit_rows],
        table.max_range,
        fit,
        min_range=table.min_range,
        fit_offset="range offset" in chosen.name,
        fit_sigma_slope="sigma slope" in chosen.name,
        hold=options.hold,
        block_s=options.block_s,
        n_replicates=options.n_bootstrap,
        seed=options.seed,
        threads=options.threads,
        progress=lambda done, total: report("bootstrap", done, total),
    )

    # 5. Judge it on the held-out blocks.
    test = table.select(held_out)
    max_share = float((table.ranges[fit_rows] >= table.max_range).mean())
    models = {"fit": fit, **DEFAULTS, "uniform": uniform_parameters(max_share)}
    scores = score_models(models, test, blocks[held_out])
    pit = randomized_pit(test, fit, rng)

    # 6. Check what it rests on: the map and the reference poses.
    opposite = opposite_beams(log, table, blocks)
    refinement = None
    if options.refine:
        refinement = refine_poses(
            log,
            grid.halves[1] if isinstance(grid, CrossFitMaps) else grid,
            np.flatnonzero(selection.used & (grid.half == 0) if isinstance(grid, CrossFitMaps) else selection.used),
            fit,
            unknown_occupied=options.unknown == "occupied",
            progress=lambda done, total: report("refining poses", done, total),
        )
    findings = [
        *map_findings(opposite, whole.resolution),
        *pose_findings(log, whole),
        *refinement_findings(refinement),
        *_selection_findings(selection),
        *_score_findings(scores),
        *_cone_findings(log),
        *chosen.result.findings,
        *intervals.findings,
        *([cross_fit_finding(grid, table)] if isinstance(grid, CrossFitMaps) else _table_findings(table)),
    ]
    return Calibration(
        parameters=fit,
        intervals=intervals,
        learning=chosen.result,
        candidates=candidates,
        scores=scores,
        selection=selection,
        table=table,
        held_out=held_out,
        pit=pit,
        pit_deviation=pit_deviation(pit),
        causes=likely_causes(table, fit),
        timeline=timeline(table, fit, held_out),
        opposite=opposite,
        refinement=refinement,
        findings=tuple(sorted(findings, key=lambda finding: finding.severity != "warning")),
        options=options,
    )


def _cast(
    log: SensorLog,
    grid: OccupancyGrid | CrossFitMaps,
    scans: NDArray[np.bool_],
    options: CalibrationOptions,
    progress: Callable[[int, int], None],
) -> BeamTable:
    """Cast the beams of the chosen scans in the map, or in the map that the other half drew."""
    if isinstance(grid, CrossFitMaps):
        return cross_fit_table(log, grid, scans, unknown=options.unknown, threads=options.threads, progress=progress)
    return build_beam_table(log, grid, scans, unknown=options.unknown, threads=options.threads, progress=progress)


def _silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


def _require_beams(table: BeamTable, held_out: NDArray[np.bool_], selection: Selection) -> None:
    usable = ~table.hits_nothing
    for name, rows in (("fit", ~held_out), ("held-out", held_out)):
        n = int((usable & rows).sum())
        if n < FEWEST_BEAMS:
            raise TooLittleDataError(
                f"{n} beams in the {name} blocks, need {FEWEST_BEAMS}: {selection.describe()}; of their beams "
                f"{table.n_no_measurement} carry no measurement, {table.n_unknown} cross unknown space, "
                f"{int(table.hits_nothing.sum())} hit nothing"
            )


def _fit_candidates(
    table: BeamTable,
    blocks: NDArray[np.int64],
    held_out: NDArray[np.bool_],
    options: CalibrationOptions,
    report: Progress,
) -> tuple[Candidate, ...]:
    """Fit every allowed form of the hit component and mark the one to keep."""
    rows = ~held_out & ~table.hits_nothing
    test = held_out & ~table.hits_nothing
    forms = [
        (offset, slope)
        for offset in (False, True)
        for slope in (False, True)
        if _allowed(offset, options.range_offset) and _allowed(slope, options.sigma_slope)
    ]
    results: list[LearningResult] = []
    densities: list[FloatArray] = []
    for number, (offset, slope) in enumerate(forms):
        report("learning", number, len(forms))
        result = learn_intrinsic_parameters(
            table.ranges[rows],
            table.expected_ranges[rows],
            table.max_range,
            min_range=table.min_range,
            fit_offset=offset,
            fit_sigma_slope=slope,
            hold=options.hold,
            threads=options.threads,
        )
        results.append(result)
        densities.append(
            beam_log_density(
                table.ranges[test],
                table.expected_ranges[test],
                table.max_range,
                result.parameters,
                min_range=table.min_range,
            )
        )
    report("learning", len(forms), len(forms))
    best = _choose(densities, blocks[test])
    return tuple(
        Candidate(
            _form_name(*form),
            result,
            float(density.mean()),
            float((density - densities[0]).mean()),
            block_standard_error(density - densities[0], blocks[test]),
            chosen=i == best,
        )
        for i, (form, result, density) in enumerate(zip(forms, results, densities, strict=True))
    )


def _allowed(present: bool, choice: Choice) -> bool:
    return choice == "auto" or present == (choice == "on")


def _form_name(offset: bool, slope: bool) -> str:
    parts = [name for name, present in (("range offset", offset), ("sigma slope", slope)) if present]
    return " + ".join(parts) or "chapter"


# An extra parameter must gain this much per held-out beam (nats), and twice its standard error.
LEAST_GAIN = 0.005


def _choose(densities: list[FloatArray], blocks: NDArray[np.int64]) -> int:
    """Start with the simplest form; move to another only for a gain that is more than noise."""
    best = 0
    for i, density in enumerate(densities):
        gain = density - densities[best]
        noise = block_standard_error(gain, blocks)
        if gain.mean() > max(LEAST_GAIN, 2.0 * noise if np.isfinite(noise) else 0.0):
            best = i
    return best


# A fit that gains less than this per held-out beam (nats) over a uniform has learned hardly anything from the map: with
# maps of other places the gain is 0 to 0.3, good fits on real logs gain 2 to 5.
LEAST_GAIN_OVER_UNIFORM = 0.5


def _score_findings(scores: tuple[ModelScore, ...]) -> list[Finding]:
    found = [
        Finding(
            "fit-not-better",
            "warning",
            f"On held-out beams the fit is not better than {score.name}: {score.behind_fit:+.4f} nats per beam. "
            "Fit and held-out blocks differ too much, or there is too little data.",
            {"behind_fit": score.behind_fit},
        )
        for score in scores[1:]
        if score.behind_fit <= 0
    ]
    found += [
        Finding(
            "map-says-nothing",
            "warning",
            f"The fit is hardly better than a uniform that knows nothing of the map ({score.behind_fit:+.2f} nats per "
            "held-out beam): most likely it is the wrong map, or the poses are not in its frame.",
            {"behind_fit": score.behind_fit},
        )
        for score in scores[1:]
        if score.name == "uniform" and score.behind_fit < LEAST_GAIN_OVER_UNIFORM
    ]
    return found


def _cone_findings(log: SensorLog) -> list[Finding]:
    opening = log.finder.opening_angle
    if opening == 0.0:
        return []
    return [
        Finding(
            "cones",
            "info",
            f"The sensor's readings are taken as cones of {math.degrees(opening):.3g} degrees: the expected range is "
            "that of the nearest obstacle in the cone. Use the parameters with SonarModel.",
            {"opening_angle": opening},
        )
    ]


def _selection_findings(selection: Selection) -> list[Finding]:
    off = selection.dropped.get("off the map", 0)
    share = off / len(selection.used)
    if share <= 0.1:
        return []
    return [
        Finding(
            "poses-off-map",
            "warning",
            f"{off} of {len(selection.used)} reference poses ({share:.0%}) lie off the map: it does not cover the log, "
            "or the poses are not in its frame.",
            {"n": float(off), "share": share},
        )
    ]


def _table_findings(table: BeamTable) -> list[Finding]:
    nothing = int(table.hits_nothing.sum())
    total = len(table) + table.n_unknown
    found = []
    if total and (nothing + table.n_unknown) / total > 0.5:
        found.append(
            Finding(
                "few-expected-ranges",
                "warning",
                f"Only {1 - (nothing + table.n_unknown) / total:.0%} of the readings have an expected range: "
                f"{table.n_unknown} rays cross unknown space, {nothing} hit nothing within {table.max_range:.1f} m. "
                "Is the map complete, and are the poses in its frame?",
                {"n_unknown": float(table.n_unknown), "n_nothing": float(nothing)},
            )
        )
    return found
