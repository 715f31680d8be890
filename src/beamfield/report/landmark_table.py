"""Learned landmark noise as plain-text tables for the terminal."""

from __future__ import annotations

import math

from beamfield.landmark_noise.learning import LandmarkLearningResult
from beamfield.report.parameter_rows import decimals_for
from beamfield.report.text_table import aligned, plus_minus

MEANINGS = {
    "sigma_range": ("m", "standard deviation of a measured range"),
    "sigma_bearing": ("rad", "standard deviation of a measured bearing"),
    "range_bias": ("m", "mean of measured minus true range, at distance 0 if there is a scale"),
    "range_scale": ("m/m", "growth of the measured range per metre of true range"),
    "bearing_bias": ("rad", "mean of measured minus true bearing"),
    "spurious_rate": ("-", "share of sightings that are not of their landmark"),
}


def landmark_parameter_table(result: LandmarkLearningResult) -> str:
    """Return a table of the learned parameters, each with its interval and its unit.

    Parameters
    ----------
    result
        From `learn_landmark_parameters`.
    """
    rows = []
    for name, (unit, meaning) in MEANINGS.items():
        value = getattr(result.parameters, name)
        # What was held at its neutral value, or never measured, says nothing.
        if value is None or (name not in result.intervals and value in (0.0, 1.0)):
            continue
        low, high = result.intervals.get(name, (math.nan, math.nan))
        decimals = decimals_for((high - low) / 2.0)
        interval = f"[{low:.{decimals}f}, {high:.{decimals}f}]" if math.isfinite(low) else "not determined"
        rows.append((name, f"{value:.{decimals}f}", interval, unit, meaning))
    return aligned(("parameter", "value", f"{100.0 * result.level:g} % interval", "unit", "meaning"), rows, right=(1,))


def landmark_form_table(result: LandmarkLearningResult) -> str:
    """Return a table of what bias and scale are worth on held-out sightings; empty with too few blocks.

    Parameters
    ----------
    result
        From `learn_landmark_parameters`.
    """
    if not result.forms:
        return ""
    rows = [
        (
            form.name + (" (chosen)" if form.chosen else ""),
            f"{form.log_likelihood:.4f}",
            "" if i == 0 else plus_minus(form.gain, form.gain_se, sign=True),
        )
        for i, form in enumerate(result.forms)
    ]
    return aligned(("held-out sightings", "nats each", "gain over no bias ± s.e."), rows, right=(1, 2))
