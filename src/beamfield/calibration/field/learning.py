"""Learn the likelihood field model from a log with reference poses and a map (section 6.4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import checked, require
from beamfield.calibration.context.exponent import (
    LEVEL,
    ExponentLearning,
    exponents_of,
    scan_log_likelihoods,
    score_exponents,
)
from beamfield.calibration.context.posterior_judge import PosteriorScores
from beamfield.calibration.evaluation import block_standard_error
from beamfield.calibration.field.axis_density import Mixture, fit_axis_density, log_axis_density
from beamfield.calibration.field.axis_intervals import axis_intervals
from beamfield.calibration.field.axis_table import AxisTable, build_axis_table
from beamfield.calibration.field.findings import density_findings, exponent_findings
from beamfield.calibration.pose_windows import (
    HELD_OUT,
    Window,
    WindowOptions,
    cut_windows,
    draw_rivals_of_each,
    window_block_s,
)
from beamfield.calibration.selection import SelectionOptions, select_scans
from beamfield.calibration.time_split import of_held_out, time_blocks
from beamfield.errors import TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import EXTENSIONS, BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.short_repr import short_repr

# Three parameters from fewer readings than this are noise.
FEWEST_READINGS = 100


@dataclass(frozen=True)
class FieldScore:
    """How well one field does on blocks of time that nothing was learned from.

    Parameters
    ----------
    name
        Which field.
    log_density, log_density_se
        Mean log density of a reading along its axis, given that it is a range, and its standard error; nats.
    posterior, posterior_se
        Mean log of the posterior's density at the reference pose over the prior's, per window, and its standard error,
        nats; 0 for a field that says nothing. None if the log has no windows to judge by.
    coverage
        Share of the windows whose 90% region holds the truth around the reference; None likewise.
    """

    name: str
    log_density: float
    log_density_se: float
    posterior: float | None
    posterior_se: float | None
    coverage: float | None


@dataclass(frozen=True, eq=False)
class FieldLearning:
    """A learned likelihood field.

    Parameters
    ----------
    parameters
        z_hit and z_rand, and sigma_hit with the reference poses' error added: what `LikelihoodFieldModel` takes.
    exponent
        How much each of n_beams beams counts in a filter; 1 if the log is too short to learn it, which a finding says.
    exponents
        The same with what it rests on, and the exponent for one scan on its own; None if the log is too short.
    n_beams
        Beams of a scan that the exponent is for.
    intervals
        95% intervals by name, "exponent" too; (0, inf) where a parameter is undetermined.
    density_sigma
        sigma_hit that makes the readings most likely along their axes, metres, before the references' error is added.
    log_likelihood, trace, converged
        Of the readings along their axes, nats per reading; the trace never falls.
    n_readings, n_excluded
        Readings fitted to, and ranges left out because no obstacle is on their axis.
    n_blocks
        Blocks of time that the intervals rest on.
    scores
        On held-out blocks: this field, the same with exponent 1, the beam model's if one was given, a uniform.
    findings
        What the log leaves open.
    finder
        The sensor.
    """

    parameters: LikelihoodFieldParameters
    exponent: float
    exponents: ExponentLearning | None
    n_beams: int
    intervals: Mapping[str, tuple[float, float]]
    density_sigma: float
    log_likelihood: float
    trace: tuple[float, ...]
    converged: bool
    n_readings: int
    n_excluded: int
    n_blocks: int
    scores: tuple[FieldScore, ...]
    findings: tuple[Finding, ...]
    finder: RangeFinder

    __repr__ = short_repr

    def summary(self) -> str:
        """Return the parameters with 95% intervals, held-out scores and warnings, as text to print."""
        from beamfield.report.results import field_summary

        return field_summary(self)

    def save(self, path: str | Path) -> None:
        """Write a likelihood_field.yaml, which `read_likelihood_field` and the commands read.

        Parameters
        ----------
        path
            The file; one that is there is replaced.
        """
        from beamfield.report.results import save_field

        save_field(self, path)


@checked
def learn_field_parameters(
    log: SensorLog,
    grid: OccupancyGrid,
    *,
    beam_parameters: BeamParameters | None = None,
    n_beams: int = 60,
    reference_error: float = 0.04,
    selection: SelectionOptions | None = None,
    block_s: float | None = None,
    seed: int = 0,
) -> FieldLearning:
    """Return the parameters of the likelihood field that suit a log and its map, and how much its beams may count.

    z_hit, z_rand and sigma_hit make the readings most likely along the axes of their beams, where the field can be
    normalised: (6.33), (6.34). Multiplied over a scan as Table 6.3 does, such values would be far too certain, since
    the beams' errors hang together: the exponent (the alpha of 6.3.4) is the one whose posteriors around the reference
    poses hold the truth as often as they say, see `learn_exponent`. docs/evidence/likelihood_field.md compares it with
    other ways.

    Parameters
    ----------
    log
        Scans of one sensor with reference poses in the map frame.
    grid
        The map.
    beam_parameters
        A beam model to compare with.
    n_beams
        Beams of each scan that the model will use, as its option of that name; fewer if the sensor has fewer.
    reference_error
        How wrong the reference poses may be, standard deviation per axis, metres, and a quarter of it in radians. It is
        added to sigma_hit: poses that come from the same scans and map agree with them better than with the truth.
    selection
        Which scans are used.
    block_s
        Length of the blocks of time that are fitted or held out whole, seconds; None: 20, or more if windows need it.
    seed
        Of what is drawn.

    Raises
    ------
    InvalidInputError
        If the log has no reference poses, the map no obstacle, or an option is out of range.
    TooLittleDataError
        If fewer than 100 readings with an obstacle on their axis remain to fit to, or to judge by.

    References
    ----------
    Probabilistic Robotics, 6.4.1: (6.33), (6.34), Table 6.3; 6.3.4 for the exponent.
    """
    require(n_beams >= 1, "n_beams", "at least 1", n_beams)
    n_beams = min(n_beams, log.finder.n_beams)
    options = WindowOptions(reference_error=reference_error, seed=seed)
    length = window_block_s(log, grid, options, selection) if block_s is None else block_s
    blocks = time_blocks(log.stamps, length)
    held_out = of_held_out(blocks)

    # 1. z_hit, z_rand and sigma_hit by the density along each beam's axis.
    table = build_axis_table(log, grid, select_scans(log, grid, selection).used, seed=seed)
    fitted, judged = table.of_scans(~held_out), table.of_scans(held_out)
    _require_readings(fitted, judged)
    fit = fit_axis_density(fitted)
    parameters = _parameters(fitted, fit.mixture)
    intervals, n_blocks = axis_intervals(fitted, fit, blocks)

    # 2. The exponent by the posteriors of windows of the log.
    low, high = intervals["sigma_hit"]
    intervals["sigma_hit"] = (float(np.hypot(low, reference_error)), float(np.hypot(high, reference_error)))
    widened = replace(parameters, sigma_hit=float(np.hypot(parameters.sigma_hit, reference_error)))
    windows: Sequence[Window] = ()
    exponent, intervals["exponent"], reason = 1.0, (0.0, np.inf), ""
    try:
        windows = cut_windows(log, grid, draw_rivals_of_each(options, grid), options, selection, length)
    except TooLittleDataError as error:
        reason = str(error)
    judge = _Judge(log, grid, windows, n_beams)
    values = judge.log_likelihoods(widened, windows)
    exponents = exponents_of(values, windows, blocks, options, n_beams, log) if windows else None
    if exponents is not None:
        exponent, intervals["exponent"] = exponents.drive.value, exponents.drive.interval
        intervals["single_scan_exponent"] = exponents.single.interval

    # 3. Judge it on held-out blocks.
    judging = [window for window in windows if window.fold == HELD_OUT]
    values = values[[window.fold == HELD_OUT for window in windows]]
    fields: dict[str, tuple[FloatArray, float, Mixture]] = {"learned": (values, exponent, fit.mixture)}
    if windows:
        fields["learned, exponent 1"] = (values, 1.0, fit.mixture)
    if beam_parameters is not None and beam_parameters.z_hit + beam_parameters.z_rand > 0.0:
        of_beam = LikelihoodFieldParameters.from_beam_parameters(beam_parameters, drop=EXTENSIONS)
        fields["beam model's, exponent 1"] = (judge.log_likelihoods(of_beam, judging), 1.0, _mixture(of_beam))
    scores = [_score(name, *of, judged, blocks, judge) for name, of in fields.items()]
    nothing = 0.0 if windows else None
    scores.append(FieldScore("uniform", -float(np.log(table.span)), 0.0, nothing, nothing, None))
    return FieldLearning(
        parameters=widened,
        exponent=exponent,
        exponents=exponents,
        n_beams=n_beams,
        intervals=intervals,
        density_sigma=parameters.sigma_hit,
        log_likelihood=fit.trace[-1],
        trace=fit.trace,
        converged=fit.converged,
        n_readings=len(fitted),
        n_excluded=table.n_excluded,
        n_blocks=n_blocks,
        scores=tuple(scores),
        findings=(
            *density_findings(fitted, fit, n_blocks),
            *exponent_findings(
                reason, scores[0].posterior, scores[0].posterior_se, cones=log.finder.opening_angle > 0.0
            ),
        ),
        finder=log.finder,
    )


def _require_readings(fitted: AxisTable, judged: AxisTable) -> None:
    for name, table in (("fit", fitted), ("held-out", judged)):
        if len(table) < FEWEST_READINGS:
            raise TooLittleDataError(
                f"{len(table)} readings with an obstacle on their axis in the {name} blocks, need {FEWEST_READINGS} to "
                f"learn a likelihood field; {table.n_excluded} have none"
            )


def _parameters(table: AxisTable, mixture: Mixture) -> LikelihoodFieldParameters:
    n_returned, n_max = len(table), len(table.no_return_scan)
    returned = n_returned / (n_returned + n_max)
    return LikelihoodFieldParameters(mixture.hit_share * returned, (1.0 - mixture.hit_share) * returned, mixture.sigma)


def _mixture(parameters: LikelihoodFieldParameters) -> Mixture:
    return Mixture(parameters.z_hit / (parameters.z_hit + parameters.z_rand), parameters.sigma_hit)


@dataclass(frozen=True, eq=False)
class _Judge:
    """Windows of the log, and how their posteriors are made."""

    log: SensorLog
    grid: OccupancyGrid
    windows: Sequence[Window]
    n_beams: int

    def log_likelihoods(self, parameters: LikelihoodFieldParameters, windows: Sequence[Window]) -> FloatArray:
        """Return those of windows, see `scan_log_likelihoods`."""
        model = LikelihoodFieldModel(self.grid, parameters, n_beams=self.n_beams)
        return scan_log_likelihoods(model, self.log, windows)

    def score(self, values: FloatArray, exponent: float) -> PosteriorScores:
        """Return the scores of the held-out windows, given their log-likelihoods."""
        rivals = [window.rivals for window in self.windows if window.fold == HELD_OUT]
        return score_exponents(values.sum(axis=1), np.array([exponent]), rivals)[0]


def _score(
    name: str,
    values: FloatArray,
    exponent: float,
    mixture: Mixture,
    judged: AxisTable,
    blocks: NDArray[np.int64],
    judge: _Judge,
) -> FieldScore:
    density = log_axis_density(judged, mixture)
    error = block_standard_error(density, blocks[judged.scan])
    if not judge.windows:
        return FieldScore(name, float(density.mean()), error, None, None, None)
    scores = judge.score(values, exponent)
    held_out = [blocks[window.scans[0]] for window in judge.windows if window.fold == HELD_OUT]
    posterior_error = block_standard_error(scores.log_score, np.array(held_out))
    return FieldScore(name, float(density.mean()), error, scores.mean, posterior_error, scores.coverage_at(LEVEL))
