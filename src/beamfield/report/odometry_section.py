"""What calibrating odometry found: tables for the terminal, a section of the page, JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from beamfield.calibration.odometry.result import Estimate, OdometryCalibration
from beamfield.report.as_json import plain
from beamfield.report.escape import escaped
from beamfield.report.page import finding_list, table
from beamfield.report.page_section import PageSection
from beamfield.report.text_table import aligned, plus_minus, warning_lines

ANCHOR, TITLE = "odometry", "Odometry"
NOISE_HEADER = ("odometry noise", "levels with 95% intervals", "nats per held-out window", "gain over the default")
SYSTEMATIC_HEADER = ("systematic error", "value", "95% interval", "unit", "meaning")
MEANINGS = {
    "distance_scale": ("-", "true distance over odometry's, minus 1"),
    "turn_scale": ("-", "true turn over odometry's, minus 1"),
    "drift": ("rad/m", "heading gained per metre ahead that odometry does not see"),
    "yaw": ("rad", "direction of motion by the reference, from that by odometry"),
}
# An interval that spans more than this factor says nothing of a level.
WIDEST = 1000.0
Programs = Mapping[str, Mapping[str, Mapping[str, float]]]


def odometry_tables(result: OdometryCalibration, programs: Programs | None = None, *, width: int | None = None) -> str:
    """Return the tables for the terminal: noise, systematic errors, the advised values, and warnings.

    The programs are values by parameter, by motion model and program. Lines are `width` characters long.
    """
    # Up to four levels with their intervals are too wide for a terminal; the page shows those of each.
    noise = [(name, score, gain) for name, _, score, gain in _noise_rows(result)]
    parts = [
        aligned((NOISE_HEADER[0], *NOISE_HEADER[2:]), noise, right=(1, 2), width=width),
        *_levels_lines(result),
        aligned(SYSTEMATIC_HEADER, _systematic_rows(result), right=(1,), width=width),
        _length_line(result),
        _advice_line(result),
    ]
    if programs:
        parts.append(aligned(("program", "motion model", "values"), _program_rows(programs), right=(), width=width))
    return "\n\n".join([*parts, *warning_lines(result.findings)])


def odometry_section(result: OdometryCalibration, programs: Programs) -> PageSection:
    """Return the section of the report; parameters as `odometry_tables`."""
    markup = (
        f"{table(NOISE_HEADER, _noise_rows(result), right=(2, 3))}"
        f"<p>{escaped(_advice_line(result))} {escaped(_length_line(result))}</p>"
        f"{table(SYSTEMATIC_HEADER, _systematic_rows(result), right=(1,))}"
        f"{table(('program', 'motion model', 'values'), _program_rows(programs))}"
        f"{finding_list(result.findings)}"
    )
    return PageSection(ANCHOR, TITLE, markup)


def odometry_as_dict(result: OdometryCalibration, programs: Programs) -> dict[str, Any]:
    """Return what was learned as values that strict JSON can hold; parameters as `odometry_tables`."""
    return {
        "systematic": plain({name: asdict(error) for name, error in result.systematic.items()}),
        "alphas": {f"alpha{i}": getattr(result.alphas, f"alpha{i}") for i in range(1, 5)},
        "chosen": result.chosen.name,
        "candidates": [
            {
                "name": one.name,
                "levels": plain([asdict(level) for level in one.levels]),
                **plain({"score": one.score, "gain": one.gain, "gain_se": one.gain_se}),
            }
            for one in result.candidates
        ],
        "corrected_alpha": result.corrected_alpha,
        "by_length": [{"steps": steps, "alpha": alpha} for steps, alpha in result.by_length],
        "coverage": result.coverage,
        "n_windows": result.n_windows,
        "n_faults": len(result.fault_stamps),
        "n_steps": result.n_steps,
        "n_blocks": result.n_blocks,
        "options": {**asdict(result.options), "window": result.windows.length},
        "programs": {name: {model: dict(values) for model, values in of.items()} for name, of in programs.items()},
        "findings": plain(result.findings),
    }


def _levels_lines(result: OdometryCalibration) -> list[str]:
    levels = ", ".join(map(_level_text, result.chosen.levels))
    return [f"Chosen {NOISE_HEADER[1]}: {levels}."] if levels else []


def _noise_rows(result: OdometryCalibration) -> list[tuple[str, ...]]:
    return [
        (
            one.name + (" (chosen)" if one is result.chosen else ""),
            ", ".join(_level_text(level) for level in one.levels),
            plus_minus(one.score, math.inf),
            "" if not one.levels else plus_minus(one.gain, one.gain_se, sign=True),
        )
        for one in result.candidates
    ]


def _level_text(level: Estimate) -> str:
    if level.value == 0.0:
        return "0 (does not show)"
    if not level.high < WIDEST * level.low:
        return f"{level.value:.2g} (not determined)"
    return f"{level.value:.2g} [{level.low:.2g}, {level.high:.2g}]"


def _systematic_rows(result: OdometryCalibration) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for name, (unit, meaning) in MEANINGS.items():
        error = result.systematic.get(name)
        if error is None:
            rows.append((name, "", "not shown by this drive", unit, meaning))
            continue
        known = math.isfinite(error.high)
        interval = f"[{error.low:+.3g}, {error.high:+.3g}]" if known else "not determined"
        rows.append((name, f"{error.value:+.3g}", interval, unit, meaning))
    return rows


def _length_line(result: OdometryCalibration) -> str:
    lengths = ", ".join(f"{alpha:.2g} over {steps}" for steps, alpha in result.by_length)
    return (
        f"One common alpha by the update steps of a window: {lengths}; with systematic errors put right "
        f"{result.corrected_alpha:.2g} over {result.windows.length}."
    )


def _advice_line(result: OdometryCalibration) -> str:
    values = ", ".join(f"alpha{i} {getattr(result.alphas, f'alpha{i}'):.3g}" for i in range(1, 5))
    options = result.options
    return (
        f"Advised at updates every {options.update_min_d:g} m or {options.update_min_a:g} rad: {values} (none below "
        f"{options.floor:g}). {result.n_windows} windows of {result.windows.length} steps, "
        f"{len(result.fault_stamps)} of them faults; 95% regions hold the reference in {result.coverage:.0%} of the "
        "others."
    )


def _program_rows(programs: Programs) -> list[tuple[str, ...]]:
    return [
        (name, model, ", ".join(f"{key} {value:.3g}" for key, value in values.items()))
        for name, models in programs.items()
        for model, values in models.items()
    ]
