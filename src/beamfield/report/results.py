"""Results as people look at them from Python: a text, a picture, a notebook's cell, a file.

The methods of the results come here when they are called, so that learning needs no drawing.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.context.exponent import ExponentLearning
from beamfield.calibration.field.learning import FieldLearning
from beamfield.errors import InvalidInputError
from beamfield.io.files.atomic import write_file
from beamfield.io.parameters.beam_model_file import beam_model_text
from beamfield.io.parameters.landmark_model_file import landmark_model_text
from beamfield.io.parameters.likelihood_field_file import likelihood_field_text
from beamfield.report.density_figures import draw_histogram
from beamfield.report.drawing import WIDE, new_figure
from beamfield.report.escape import escaped
from beamfield.report.field_section import field_tables
from beamfield.report.landmark_table import landmark_parameter_table
from beamfield.report.page import table
from beamfield.report.panel import svg_panel
from beamfield.report.parameter_rows import HEADER, parameter_rows
from beamfield.report.range_bins import telling_bin, typical_bins
from beamfield.report.scan_fit_figures import draw_fit
from beamfield.report.scan_fit_page import fit_csv, fit_table
from beamfield.report.text_table import form_line, parameter_table, readings_line, score_table, warning_lines
from beamfield.report.verdict import verdict
from beamfield.scan_fit.scan_fit import ScanFits

if TYPE_CHECKING:
    from beamfield.landmark_noise.learning import LandmarkLearningResult


def calibration_summary(result: Calibration) -> str:
    """Return what a calibration found: the verdict, and the details."""
    return f"{verdict(result)}\n\n{calibration_details(result)}"


def calibration_details(result: Calibration, *, width: int | None = None, wording: Callable[[str], str] = str) -> str:
    """Return the data, parameters with intervals, held-out scores, and warnings.

    Lines are `width` characters long, for a terminal; `wording` turns the names of arguments in a warning into those of
    the reader.
    """
    used, readings, form = (
        line if width is None else textwrap.fill(line, width)
        for line in (result.selection.describe(), readings_line(result), form_line(result))
    )
    data, scores = f"{used}\n{readings}", f"{score_table(result)}\n{form}"
    warnings = warning_lines(result.findings, width=width, wording=wording)
    return "\n\n".join([data, parameter_table(result, width=width), scores, *warnings])


def plot_calibration(result: Calibration) -> Figure:
    """Draw measured ranges around one expected range and the fitted density over them: Figure 6.6."""
    figure = new_figure(WIDE, 5.0)
    draw_histogram(figure, result, telling_bin(typical_bins(result.table)))
    return figure


def calibration_markup(result: Calibration) -> str:
    """Return the table of the parameters, the warnings and the main picture as HTML for a notebook."""
    parameters = table(HEADER, parameter_rows(result), right=(1,))
    warnings = "".join(f"<p>{escaped(line)}</p>" for line in warning_lines(result.findings))
    picture = svg_panel(plot_calibration(result), "readings", "Measured ranges and the fitted density").markup
    return f'{parameters}{warnings}<div style="max-width: 700px; background: white">{picture}</div>'


def save_calibration(result: Calibration, path: str | Path, exponent: ExponentLearning | None) -> None:
    """Write a beam_model.yaml, with the exponent that `learn_exponent` found if there is one."""
    write_file(path, calibration_text(result, exponent))


def calibration_text(
    result: Calibration, exponent: ExponentLearning | None, *, provenance: Mapping[str, Any] | None = None
) -> str:
    """Return the text of a beam_model.yaml; without an exponent, beams count as if they were independent."""
    intervals = dict(result.intervals.intervals)
    if exponent is None:
        return beam_model_text(result.parameters, result.finder, intervals=intervals, provenance=provenance)
    return beam_model_text(
        result.parameters,
        result.finder,
        exponent=exponent.in_filter.value,
        single_scan_exponent=exponent.single.value,
        n_beams=exponent.n_beams,
        intervals=intervals | exponent_intervals(exponent),
        provenance=provenance,
    )


def exponent_intervals(learned: ExponentLearning) -> dict[str, tuple[float, float]]:
    """Return the intervals of both exponents by their names in files."""
    return {"exponent": learned.in_filter.interval, "single_scan_exponent": learned.single.interval}


def field_summary(result: FieldLearning) -> str:
    """Return the parameters with intervals, held-out scores and warnings."""
    return "\n\n".join([field_tables(result), *warning_lines(result.findings)])


def save_field(result: FieldLearning, path: str | Path) -> None:
    """Write a likelihood_field.yaml."""
    write_file(path, field_text(result))


def field_text(result: FieldLearning, *, provenance: Mapping[str, Any] | None = None) -> str:
    """Return the text of a likelihood_field.yaml."""
    return likelihood_field_text(
        result.parameters,
        result.finder,
        exponent=result.exponent,
        single_scan_exponent=None if result.exponents is None else result.exponents.single.value,
        n_beams=result.n_beams,
        intervals=result.intervals,
        provenance=provenance,
    )


def landmark_summary(result: LandmarkLearningResult) -> str:
    """Return the parameters with intervals, and warnings."""
    return "\n\n".join([landmark_parameter_table(result), *warning_lines(result.findings)])


def save_landmarks(result: LandmarkLearningResult, path: str | Path) -> None:
    """Write a landmark_model.yaml."""
    write_file(path, landmark_model_text(result.parameters, intervals=result.intervals))


def fits_summary(fits: ScanFits) -> str:
    """Return how many scans fit, whether the robot was lost, and the five worst scans."""
    return fit_table(fits, fits.worst())


def plot_fits(fits: ScanFits) -> Figure:
    """Draw p-value and lost probability over time; InvalidInputError if no scan could be judged."""
    if np.isnan(fits.p_value).all():
        raise InvalidInputError("fits: expected a scan that could be judged, got none")
    figure = new_figure(WIDE, 4.6)
    draw_fit(figure, fits, float(np.nanmin(fits.p_value)))
    return figure


def save_fits(fits: ScanFits, path: str | Path) -> None:
    """Write one line per scan as CSV."""
    write_file(path, fit_csv(fits))
