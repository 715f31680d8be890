"""Which model localizes better in our own filter: text for the terminal, a section of the page, plain values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from beamfield.localization.model_choice import ModelChoice
from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.report.escape import escaped
from beamfield.report.page import table
from beamfield.report.page_section import PageSection
from beamfield.report.text_table import aligned

ANCHOR, TITLE = "own-filter", "Which file localizes better"
HEADER = ("", "beamfield localize with", "mean error [m]", "95% [m]", "heading [deg]", "lost runs")


def choice_table(choice: ModelChoice, files: Mapping[str, str]) -> str:
    """Return what is printed; `files` has the names of the models that are written, and where."""
    told = f"{choice_sentence(choice, files)} The files have the exponents marked *."
    return f"{aligned(HEADER, _rows(choice, files), right=(2, 3, 4, 5))}\n\n{told}"


def choice_sentence(choice: ModelChoice, files: Mapping[str, str]) -> str:
    """Return in words which file to take."""
    name = _best(choice, files)
    best = choice.trials[name]
    said = f"Localize with {files[name]}: in beamfield's own filter it errs least on this log"
    if 2 * best.n_lost < len(best):
        return f"{said}."
    return (
        f"{said}, but is lost all the same in {best.n_lost} of {len(best)} runs: odometry may be worse than usual "
        "(beamfield localize --odometry-error 2)."
    )


def choice_section(choice: ModelChoice, files: Mapping[str, str]) -> PageSection:
    """Return the section of the report."""
    markup = (
        f"<p>{escaped(choice_sentence(choice, files))}</p>"
        f"{table(HEADER, _rows(choice, files), right=(2, 3, 4, 5))}"
        "<p>Distance to the reference poses of this log, from which both were learned, of <code>beamfield localize"
        "</code> with the usual noise of odometry; means over runs from a start known to 0.5 m and 15 degrees. The "
        "files have the exponents marked *: that of single scans where the error is smaller by 5% or more.</p>"
    )
    return PageSection(ANCHOR, TITLE, markup)


def choice_as_dict(choice: ModelChoice, files: Mapping[str, str]) -> dict[str, Any]:
    """Return plain values for JSON."""
    return {
        "best": files[_best(choice, files)],
        "runs": {file: _numbers(choice.trials[name]) for name, file in files.items()},
        "tried": {name: _numbers(trials) for name, trials in choice.trials.items()},
    }


def _best(choice: ModelChoice, files: Mapping[str, str]) -> str:
    return min(files, key=lambda name: choice.trials[name].mean("mean"))


def _numbers(trials: ReplayTrials) -> dict[str, Any]:
    measures = ("mean", "p95", "yaw_mean_deg")
    return {**{name: trials.mean(name) for name in measures}, "lost": trials.n_lost, "n_runs": len(trials)}


def _rows(choice: ModelChoice, files: Mapping[str, str]) -> list[tuple[str, ...]]:
    measures = ("mean", "p95", "yaw_mean_deg")
    return [
        (
            "*" if name in files else "",
            name,
            *(f"{trials.mean(measure):.3f}" for measure in measures),
            f"{trials.n_lost} of {len(trials)}",
        )
        for name, trials in choice.trials.items()
    ]
