"""Learned landmark noise as a plain-text table for the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from beamfield.report.parameter_rows import decimals_for
from beamfield.report.text_table import aligned

if TYPE_CHECKING:
    from beamfield.landmark_noise.learning import LandmarkLearningResult

MEANINGS = {
    "sigma_range": ("m", "standard deviation of a measured range"),
    "sigma_bearing": ("rad", "standard deviation of a measured bearing"),
    "range_bias": ("m", "mean of measured minus true range, at distance 0 if there is a scale"),
    "range_scale": ("m/m", "growth of the measured range per metre of true range"),
    "bearing_bias": ("rad", "mean of measured minus true bearing"),
    "spurious_rate": ("-", "share of sightings that are not of their landmark"),
}


def landmark_parameter_table(result: LandmarkLearningResult) -> str:
    """Return a table of the learned parameters, each with its interval and its unit."""
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
    return aligned(("parameter", "value", "95% interval", "unit", "meaning"), rows, right=(1,))
