"""What fitting the poses of a log to the map did to the parameters: a sentence, and a section of the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from beamfield.calibration.calibrate import Calibration
from beamfield.localization.fitted_poses import CrossFittedPoses
from beamfield.models.beam_parameters import WEIGHTS, BeamParameters
from beamfield.report.as_json import plain
from beamfield.report.escape import escaped
from beamfield.report.page import table
from beamfield.report.page_section import PageSection

TITLE = "Poses fitted to the map"
# The parameters that are used, and two that show what would be hidden.
USED, SWAPPED, SAME = "used", "swapped", "same"
ROWS = {USED: ("even (used)", "odd beams"), SWAPPED: ("odd", "even beams"), SAME: ("odd", "the same odd beams")}
NUMBERS = (2, 3, 4, 5, 6)


def fitted_poses_sentence(fitted: CrossFittedPoses, reference_error: float) -> str:
    """Return in a sentence or two which beams made the poses, and how wrong they are taken to be, metres."""
    count = f"count as {reference_error:.3g} m wrong (--reference-error)"
    if fitted.swapped is None:
        return (
            f"With {fitted.log.finder.n_beams} beams the poses were fitted to all of them, and the parameters learned "
            f"from the same: they flatter the sensor. The poses {count}."
        )
    return f"Every other beam made the poses, which {count}; the parameters are learned from the beams between."


def fitted_poses_section(
    sentence: str, fitted: CrossFittedPoses, results: Mapping[str, Calibration], *, given: bool
) -> PageSection:
    """Return the section of the report.

    The sentence says where the poses come from, and what stays hidden. The results are by `USED`, `SWAPPED` and `SAME`;
    only the first where the beams were not halved. `given`: the user said how wrong the poses are.
    """
    markup = f"<p>{escaped(sentence)}</p><p>{escaped(_details(fitted, results, given=given))}</p>"
    markup += table(_header(results), _rows(results), right=NUMBERS)
    return PageSection("fitted-poses", TITLE, markup, folded=True)


def _details(fitted: CrossFittedPoses, results: Mapping[str, Calibration], *, given: bool) -> str:
    """Return what was measured about the fit."""
    how = "as given" if given else "from the fit's covariance, and at least half a cell of the map"
    error = (
        f"How wrong the poses count: {how}. In simulated maps whose walls were up to 5 cm off, sigma_hit came out 10 "
        "to 28% too small."
    )
    if fitted.swapped is None:
        return error
    swapped, same = (f"{_noise(results, name):.4f} m, z_hit {_of(results, name).z_hit:.3f}" for name in (SWAPPED, SAME))
    return (
        f"On the beams that made the poses, the noise of a hit is {same} at these poses, and {swapped} at poses from "
        f"the other half: so much would be hidden. {error}"
    )


def fitted_poses_as_dict(
    fitted: CrossFittedPoses, results: Mapping[str, Calibration], reference_error: float
) -> dict[str, Any]:
    """Return plain values for JSON."""
    return {
        "n_scans": len(fitted.log),
        "n_trusted": fitted.n_trusted,
        "deviation_m": fitted.deviation,
        "reference_error_m": reference_error,
        "start": plain(fitted.fit.poses[0]),
        "hypotheses": plain(fitted.fit.hypotheses),
        "cross_fitted": fitted.swapped is not None,
        "halves": {
            name: {"noise_m": _noise(results, name), "at_range_m": _range(results), **plain(asdict(_of(results, name)))}
            for name in results
        },
    }


def _of(results: Mapping[str, Calibration], name: str) -> BeamParameters:
    return results[name].parameters


def _range(results: Mapping[str, Calibration]) -> float:
    return float(np.median(results[USED].table.expected_ranges))


def _noise(results: Mapping[str, Calibration], name: str) -> float:
    """Return the noise of a hit at the median range, by which forms with and without a slope compare."""
    found = _of(results, name)
    return float(np.hypot(found.sigma_hit, found.sigma_slope * _range(results)))


def _header(results: Mapping[str, Calibration]) -> tuple[str, ...]:
    return ("beams", "poses from", f"noise at {_range(results):.1f} m", *WEIGHTS)


def _rows(results: Mapping[str, Calibration]) -> list[tuple[str, ...]]:
    return [
        (*(ROWS[name] if len(results) > 1 else ("all", "the same beams")), f"{_noise(results, name):.4f}",
         *(f"{getattr(_of(results, name), weight):.4f}" for weight in WEIGHTS))
        for name in results
    ]  # fmt: skip
