"""The result in two sentences, for people who read nothing else."""

from __future__ import annotations

import math

from beamfield.calibration.calibrate import Calibration
from beamfield.report.page_section import Level
from beamfield.report.parameter_rows import finite_interval, noise_at_ranges, parameter_rows

# Rivals that the verdict names, and what to call them; the uniform is in the table.
RIVALS = {"nav2 defaults": "nav2's defaults", "ROS 1 defaults": "ROS 1's"}

# Findings that take the ground from under all values, and what each means in a few words.
DOUBTS = {
    "map-says-nothing": "the readings do not fit this map at these poses, the fit is hardly better than a uniform",
    "map-disagrees": "most readings disagree with the map at the reference poses",
    "hits-anywhere": "hits scatter around the walls by much of their range",
    "map-scale": "the scale of the map is wrong",
    "poses-off-map": "many reference poses lie off the map",
    "reference-stands-still": "the reference poses stand still while the robot drives",
    "reference-slides": "the reference poses do not move as the odometry does",
    "few-poses-trusted": "less than half of the poses that were fitted to the map can be trusted",
    "field-says-nothing": "the readings hardly tell where the robot is in this map",
}

# An interval whose ends differ by more than this factor tells next to nothing.
VAGUE = 10.0


def verdict(calibration: Calibration) -> str:
    """Return whether to use the fit: why not, or by how much it beats the defaults and how noisy hits are."""
    doubt = doubts(calibration)
    sentences = [doubt] if doubt else [_against_defaults(calibration), _noise(calibration)]
    sentences += [_poses(calibration), _warnings(calibration)]
    if not calibration.converged:
        sentences.append("The fit did not converge: do not use it as it is.")
    return " ".join(sentence for sentence in sentences if sentence)


def verdict_level(calibration: Calibration) -> Level:
    """Return "bad" if map, poses or fit cannot be trusted, "care" with warnings or a better rival, else "good"."""
    if doubts(calibration) or not calibration.converged:
        return "bad"
    warned = any(finding.severity != "info" for finding in calibration.findings)
    return "care" if warned or any(not score.behind_fit > 0 for score in calibration.scores[1:]) else "good"


def doubts(calibration: Calibration) -> str:
    """Return why no value may be used yet: map or poses cannot be trusted; empty if they can."""
    found = {finding.name for finding in calibration.findings}
    if found & {"cones", "moving-objects"}:
        # A field takes cones for rays, and people for walls: it may say little in the right map, too.
        found.discard("field-says-nothing")
    reasons = [words for name, words in DOUBTS.items() if name in found]
    return f"Do not use these values yet: {'; '.join(reasons)}." if reasons else ""


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
    if calibration.parameters.sigma_slope != 0.0:
        return f"The noise of a hit grows with range: {noise_at_ranges(calibration)}."
    sigma = next(row for row in parameter_rows(calibration) if row.name == "sigma_hit")
    interval = calibration.intervals.intervals.get("sigma_hit")
    vague = ", hardly determined by this log" if interval is not None and interval[1] > VAGUE * interval[0] else ""
    bounds = sigma.interval if finite_interval(calibration, sigma.name) else f"({sigma.interval})"
    return f"{sigma.name} is {sigma.value} m {bounds}{vague}."


def _poses(calibration: Calibration) -> str:
    fitted = any(finding.name == "poses-fitted" for finding in calibration.findings)
    return "The poses were fitted to this map, whose errors then do not show." if fitted else ""


def _warnings(calibration: Calibration) -> str:
    n = sum(finding.severity == "warning" for finding in calibration.findings)
    return "" if n == 0 else f"Read the {f'{n} warnings' if n > 1 else 'warning'} before you trust it."
