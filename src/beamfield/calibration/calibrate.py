"""The main job: from a log and a map to the parameters of a beam model, with proof."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import checked
from beamfield.calibration.beam_table import BeamTable, build_beam_table
from beamfield.calibration.cross_fit import CrossFitMaps, cross_fit_table
from beamfield.calibration.cross_fit_result import cross_fit_findings, wall_variance, with_clutter, without_wall_error
from beamfield.calibration.evaluation import (
    DEFAULTS,
    ModelScore,
    Timeline,
    likely_causes,
    pit_deviation,
    randomized_pit,
    score_models,
    timeline,
    uniform_parameters,
)
from beamfield.calibration.findings import (
    blind_findings,
    cone_findings,
    left_out_findings,
    noise_findings,
    place_findings,
    score_findings,
    selection_findings,
    table_findings,
)
from beamfield.calibration.hit_forms import Candidate, Progress, fit_candidates, form_intervals, learn_form
from beamfield.calibration.intrinsic.block_intervals import IntervalResult
from beamfield.calibration.intrinsic.em import LearningResult
from beamfield.calibration.opposite_beams import OppositeBeams, map_findings, opposite_beams
from beamfield.calibration.options import CalibrationOptions
from beamfield.calibration.pose_error import as_pose_covariances, with_error_again, with_pose_error
from beamfield.calibration.pose_refinement import PoseRefinement, refine_poses, refinement_findings
from beamfield.calibration.reference_checks import pose_findings
from beamfield.calibration.selection import Selection, select_scans, thinned
from beamfield.calibration.time_split import of_held_out, time_blocks
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.finding import Finding, worst_first
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.sensors.robot_in_sight import robot_in_sight
from beamfield.short_repr import short_repr

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from beamfield.calibration.context.exponent import ExponentLearning

__all__ = ["Calibration", "CalibrationOptions", "calibrate"]

FEWEST_BEAMS = 500


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of `calibrate`.

    Parameters
    ----------
    parameters
        The fitted parameters.
    intervals
        95% intervals by parameter, and what they rest on.
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
    finder
        The sensor.
    map_from_log
        Whether there was no map, and each half of the scans was judged by what the other half drew.
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
    finder: RangeFinder
    map_from_log: bool = False

    __repr__ = short_repr

    @property
    def converged(self) -> bool:
        """Whether the fit converged."""
        return self.learning.converged

    @property
    def n_fit(self) -> int:
        """Number of beams the parameters were fitted to."""
        return self.learning.n_beams

    def summary(self) -> str:
        """Return the data used, the parameters with 95% intervals, held-out scores and warnings, as text to print."""
        from beamfield.report.results import calibration_summary

        return calibration_summary(self)

    def plot(self) -> Figure:
        """Return a Matplotlib figure: measured ranges and the fitted density."""
        from beamfield.report.results import plot_calibration

        return plot_calibration(self)

    def save(self, path: str | Path, *, exponent: ExponentLearning | None = None) -> None:
        """Write a beam_model.yaml, which `read_beam_model` and the commands read.

        Parameters
        ----------
        path
            The file; one that is there is replaced.
        exponent
            The result of `learn_exponent`, to be written beside the parameters.
        """
        from beamfield.report.results import save_calibration

        save_calibration(self, path, exponent)

    def _repr_html_(self) -> str:
        """Return what a notebook shows: the parameters, warnings and the main picture."""
        from beamfield.report.results import calibration_markup

        return calibration_markup(self)


@checked
def calibrate(
    log: SensorLog,
    grid: OccupancyGrid | CrossFitMaps,
    options: CalibrationOptions | None = None,
    *,
    covariances: ArrayLike | None = None,
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
    covariances
        (t, 3, 3) of the log's poses, in the map frame, as `fit_trajectory` gives them: intervals then hold what errors
        of the poses do to the parameters. None, and without a map: poses count as exact.
    progress
        Called with (stage, done, total).

    Raises
    ------
    InvalidInputError
        If the log has no reference poses, lies off the map, or the map has no obstacle; or if the covariances have
        another shape, are not finite where there is a pose, or not positive semi-definite.
    TooLittleDataError
        If too few scans or beams remain; the text says where they went.

    References
    ----------
    Sections 6.3.2 and 6.3.3, Table 6.2. For covariances: Cook and Stefanski 1994, simulation and extrapolation.
    """
    options = options or CalibrationOptions()
    report = progress or (lambda _stage, _done, _total: None)
    is_drawn = isinstance(grid, CrossFitMaps)
    whole = grid.whole if isinstance(grid, CrossFitMaps) else grid
    if not whole.occupied.any():
        raise InvalidInputError("the map has no occupied cell: no ray has an expected range")

    # 1. Scans that moved, lie on the map and have a plausible reference pose; no more than a fit needs.
    selection = thinned(select_scans(log, whole, options.selection), log.finder.n_beams)

    # 2. Expected ranges.
    table, clutter = _cast(log, grid, selection.used, options, partial(report, "casting rays"))

    # 3. Whole blocks of time are held out.
    blocks = time_blocks(table.stamps, options.block_s)
    held_out = of_held_out(blocks)
    _require_beams(table, held_out, selection, drawn=is_drawn)

    # 4. Learn each form of the hit component, keep the one that held-out likelihood asks for.
    candidates = fit_candidates(table, blocks, held_out, options, report)
    chosen = next(c for c in candidates if c.chosen)
    fit = chosen.result.parameters
    fitted = table.select(~held_out & ~table.hits_nothing)
    report("intervals", 0, 1)
    intervals = form_intervals(
        fitted, fit, options.hold, options.block_s, offset=chosen.has_offset, slope=chosen.has_slope
    )
    report("intervals", 1, 1)
    from_table: Iterable[Finding] = table_findings(table)
    if isinstance(grid, CrossFitMaps):
        if clutter is not None:
            seen = clutter.select(~np.isin(clutter.scan, table.scan[held_out]))
            fit, intervals = with_clutter(fit, intervals, len(fitted), seen, options)
            fit, intervals = without_wall_error(fit, intervals, wall_variance(log, grid, table, fit.sigma_hit))
        from_table = cross_fit_findings(grid, table, 0 if clutter is None else len(clutter), fit, intervals)
    elif covariances is not None:
        off = with_error_again(log, as_pose_covariances(log, covariances), options.seed)
        more, _ = _cast(off, grid, selection.used, options, partial(report, "intervals, for the error of the poses"))
        more = more.select(~np.isin(more.scan, table.scan[held_out]) & ~more.hits_nothing)
        again = learn_form(more, options.hold, offset=chosen.has_offset, slope=chosen.has_slope).parameters
        intervals = with_pose_error(intervals, fit, again)

    # 5. Judge it on the held-out blocks.
    judged = table.select(held_out)
    max_share = float((fitted.ranges >= table.max_range).mean())
    models = {"fit": fit, **DEFAULTS, "uniform": uniform_parameters(max_share)}
    scores = score_models(models, judged, blocks[held_out])
    pit = randomized_pit(judged, fit, np.random.default_rng(options.seed))

    # 6. Check what it rests on: the map and the reference poses.
    opposite = opposite_beams(log, table, blocks)
    refinement = _refine(log, grid, selection.used, fit, options, report) if options.refine else None
    findings = [
        *map_findings(opposite, whole.resolution, drawn=is_drawn),
        *pose_findings(log, whole, drawn=is_drawn),
        *refinement_findings(refinement, drawn=is_drawn),
        *selection_findings(selection),
        *place_findings(log, selection),
        *score_findings(scores),
        *noise_findings(fit, table),
        *robot_in_sight(log),
        *cone_findings(log),
        *left_out_findings(table, log),
        *blind_findings(table, log),
        *chosen.result.findings,
        *intervals.findings,
        *from_table,
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
        findings=worst_first(findings),
        options=options,
        finder=log.finder,
        map_from_log=is_drawn,
    )


def _cast(
    log: SensorLog,
    grid: OccupancyGrid | CrossFitMaps,
    scans: NDArray[np.bool_],
    options: CalibrationOptions,
    progress: Callable[[int, int], None],
) -> tuple[BeamTable, BeamTable | None]:
    """Cast the beams of the chosen scans in the map, or in the map that the other half drew, as `cross_fit_table`."""
    if isinstance(grid, CrossFitMaps):
        return cross_fit_table(log, grid, scans, unknown=options.unknown, progress=progress)
    return build_beam_table(log, grid, scans, unknown=options.unknown, progress=progress), None


def _require_beams(table: BeamTable, held_out: NDArray[np.bool_], selection: Selection, *, drawn: bool) -> None:
    usable = ~table.hits_nothing
    for name, rows in (("fit", ~held_out), ("held-out", held_out)):
        n = int((usable & rows).sum())
        if n < FEWEST_BEAMS:
            nothing = int(table.hits_nothing.sum())
            without = table.n_unknown + nothing
            question = "; is it the map of this place, and are the poses in its frame?" if without > n else ""
            if drawn:
                question = (
                    f", {table.n_unsure} meet something that the other half of the scans has not drawn exactly; give a "
                    "map, or a log that sees each place more often"
                )
            raise TooLittleDataError(
                f"{n} beams in the {name} blocks, need {FEWEST_BEAMS}: {selection.describe()}; of their beams "
                f"{table.n_nan} are NaN, {table.n_too_close} too close, {table.n_unknown} cross unknown space, "
                f"{nothing} hit nothing{question}"
            )


def _refine(
    log: SensorLog,
    grid: OccupancyGrid | CrossFitMaps,
    scans: NDArray[np.bool_],
    parameters: BeamParameters,
    options: CalibrationOptions,
    report: Progress,
) -> PoseRefinement | None:
    """Refine reference poses in the map; of two maps, those of the first half in the map that the second drew."""
    if isinstance(grid, CrossFitMaps):
        scans = scans & (grid.half == 0)
        grid = grid.halves[1]
    return refine_poses(
        log,
        grid,
        np.flatnonzero(scans),
        parameters,
        unknown_occupied=options.unknown == "occupied",
        progress=partial(report, "refining poses"),
    )
