"""The result in two sentences, for people who read nothing else."""

from __future__ import annotations

import math

import numpy as np

from beamfield.calibration.calibrate import Calibration
from beamfield.report.parameter_rows import parameter_rows

# Rivals that the verdict names, and what to call them; the uniform is in the table.
RIVALS = {"nav2 defaults": "nav2's defaults", "ROS 1 defaults": "ROS 1's"}

# An interval whose ends differ by more than this factor tells next to nothing.
VAGUE = 10.0


def verdict(calibration: Calibration) -> str:
    """Return whether the fit beats the defaults, by how much, and how noisy the sensor is in this map."""
    if _ignores_the_map(calibration):
        return (
            "The readings do not fit this map at these poses: the fit is hardly better than a uniform that knows "
            "nothing of the map. Do not use these parameters before you know why."
        )
    sentences = [_against_defaults(calibration), _noise(calibration), _warnings(calibration)]
    if not calibration.converged:
        sentences.append("The fit did not converge: do not use it as it is.")
    return " ".join(sentence for sentence in sentences if sentence)


def is_good(calibration: Calibration) -> bool:
    """Return whether the fit converged, learned from the map and beats every other model on held-out beams."""
    beats_all = all(score.behind_fit > 0 for score in calibration.scores[1:])
    return calibration.converged and beats_all and not _ignores_the_map(calibration)


def _ignores_the_map(calibration: Calibration) -> bool:
    return any(finding.name == "map-says-nothing" for finding in calibration.findings)


def _against_defaults(calibration: Calibration) -> str:
    gains = {RIVALS[s.name]: s.behind_fit for s in calibration.scores if s.name in RIVALS}
    if not gains:
        return ""
    worse = [name for name, gain in gains.items() if not gain > 0]
    if worse:
        return f"The fit does not beat {' and '.join(worse)} on held-out beams."
    amounts = [f"{name} by {_nats(gain)}" for name, gain in gains.items()]
    return f"The fit beats {' and '.join(amounts)} nats per held-out beam."


def _nats(gain: float) -> str:
    return f"{gain:.2f}" if gain >= 0.1 or not math.isfinite(gain) else f"{gain:.4f}"


def _noise(calibration: Calibration) -> str:
    parameters, rows = calibration.parameters, parameter_rows(calibration)
    sigma = next(row for row in rows if row.name == "sigma_hit")
    text = f"{sigma.name} is {sigma.value} m {sigma.interval_text}{_doubt(calibration)}"
    expected = calibration.table.expected_ranges[~calibration.table.hits_nothing]
    if parameters.sigma_slope == 0.0 or len(expected) == 0:
        return f"{text.rstrip(',')}."
    typical = float(np.median(expected))
    spread = math.hypot(parameters.sigma_hit, parameters.sigma_slope * typical)
    return f"{text} and grows with range, to a noise of {spread:.3f} m at {typical:.1f} m, the median expected range."


def _doubt(calibration: Calibration) -> str:
    interval = calibration.intervals.intervals.get("sigma_hit")
    return ", hardly determined by this log," if interval is not None and interval[1] > VAGUE * interval[0] else ""


def _warnings(calibration: Calibration) -> str:
    n = sum(finding.severity == "warning" for finding in calibration.findings)
    return "" if n == 0 else f"Read the {f'{n} warnings' if n > 1 else 'warning'} before you trust it."
