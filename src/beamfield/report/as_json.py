"""A calibration as plain JSON values, complete but for the beams themselves."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from beamfield import __version__
from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.hit_forms import Candidate
from beamfield.calibration.selection import Selection
from beamfield.models.beam_density import CAUSES
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.parameter_rows import MEANINGS, finite_interval
from beamfield.report.pit_figure import PIT_BINS, pit_band
from beamfield.report.verdict import verdict, verdict_level
from beamfield.scan_fit.calibration_fit import CalibrationFit
from beamfield.scan_fit.reference import ScanFitReference
from beamfield.scan_fit.scan_fit import PROBLEMS, ScanFits

SCHEMA = "beamfield-calibration/1"
COUNTS = ("n_readings", "n_no_measurement", "n_nan", "n_too_close", "n_unknown", "n_unsure")
# A scan fits if this share of the good scans fits as badly.
LEVEL = 0.05


def calibration_as_dict(calibration: Calibration, scan_fit: CalibrationFit | None = None) -> dict[str, Any]:
    """Return everything that a calibration says, as values that strict JSON can hold.

    Numbers are SI and nats. What is not known (an infinite or undefined number, a missing interval) is None: JSON has
    no token for NaN. The arrays with one entry per beam are summarised.
    """
    return {
        "schema": SCHEMA,
        "program": f"beamfield {__version__}",
        "verdict": verdict(calibration),
        "verdict_level": verdict_level(calibration),
        "converged": bool(calibration.converged),
        "parameters": _parameters(calibration),
        "max_range": float(calibration.table.max_range),
        "min_range": float(calibration.table.min_range),
        "intervals": plain(calibration.intervals),
        "learning": plain(calibration.learning),
        "candidates": [_candidate(candidate) for candidate in calibration.candidates],
        "scores": plain(calibration.scores),
        "selection": _selection(calibration.selection),
        "beams": _beams(calibration),
        "pit": _pit(calibration),
        "timeline": plain(calibration.timeline),
        "opposite_beams": plain(calibration.opposite),
        "pose_refinement": plain(calibration.refinement),
        "findings": plain(calibration.findings),
        "map_from_log": calibration.map_from_log,
        "scan_fit": None if scan_fit is None else _scan_fit(scan_fit),
        "options": plain(calibration.options),
    }


def _scan_fit(scan_fit: CalibrationFit) -> dict[str, Any]:
    fits, reference = scan_fit.fits, scan_fit.reference
    if fits is None or reference is None:
        return {"missing": scan_fit.missing}
    series = {"stamps": fits.stamps, "p_value": fits.p_value, "lost_probability": fits.lost}
    return {**scan_fits_as_dict(fits, reference, own=True), **plain(series)}


def scan_fits_as_dict(fits: ScanFits, reference: ScanFitReference, *, own: bool) -> dict[str, Any]:
    """Return how well scans fit as values that strict JSON can hold.

    `own`: the reference is learned from the same log.
    """
    span = fits.longest_lost()
    counts = {name: int((fits.problem == i).sum()) for i, name in enumerate(PROBLEMS) if i}
    return {
        "n_scans": len(fits),
        "n_judged": int((~np.isnan(fits.p_value)).sum()),
        "level": LEVEL,
        "share_that_fits": plain(fits.share_that_fits(LEVEL)),
        "longest_lost": None if span is None else {"from": span[0], "to": span[1], "seconds": span[1] - span[0]},
        "highest_lost_probability": plain(float(fits.lost.max())) if len(fits) else None,
        "problems": {name: n for name, n in counts.items() if n},
        "reference": {
            "own_log": own,
            "n_scans": len(reference),
            "n_effective": reference.n_effective,
            "smallest_p_value": reference.smallest_p_value,
            "correlation_s": reference.correlation_s,
            "evidence_correlation_s": reference.evidence.correlation_s,
            "gap_s": reference.gap_s,
            "reliability": plain(reference.reliability),
        },
    }


def json_text(document: Mapping[str, Any]) -> str:
    """Return plain values as the text of a file in strict JSON."""
    return json.dumps(document, indent=1, allow_nan=False) + "\n"


def plain(value: Any) -> Any:
    """Return dataclasses, mappings, sequences and NumPy values as plain ones; None for numbers that are not finite."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def _parameters(calibration: Calibration) -> dict[str, Any]:
    table = {}
    for item in dataclasses.fields(BeamParameters):
        interval = finite_interval(calibration, item.name)
        table[item.name] = {
            "value": plain(getattr(calibration.parameters, item.name)),
            "interval_95": None if interval is None else list(interval),
            "unit": MEANINGS[item.name][0] or "1",
            "held": item.name in calibration.options.hold,
        }
    return table


def _candidate(candidate: Candidate) -> dict[str, Any]:
    document: dict[str, Any] = plain(candidate)
    # The chosen candidate's trace stands under "learning"; the others' say nothing more.
    document["result"].pop("trace", None)
    return document


def _selection(selection: Selection) -> dict[str, Any]:
    return {
        "n_scans": len(selection.used),
        "n_used": int(selection.used.sum()),
        "dropped": dict(selection.dropped),
        "text": selection.describe(),
    }


def _beams(calibration: Calibration) -> dict[str, Any]:
    table = calibration.table
    nothing = table.hits_nothing
    counts = np.bincount(calibration.causes[~nothing], minlength=len(CAUSES))
    return {
        **{name: int(getattr(table, name)) for name in COUNTS},
        "n_table": len(table),
        "n_fit": int(calibration.n_fit),
        "n_held_out": int((calibration.held_out & ~nothing).sum()),
        "n_hits_nothing": int(nothing.sum()),
        "n_no_return": int(((table.ranges >= table.max_range) & ~nothing).sum()),
        "n_most_likely": {name: int(n) for name, n in zip(CAUSES, counts, strict=True)},
    }


def _pit(calibration: Calibration) -> dict[str, Any]:
    counts, edges = np.histogram(calibration.pit, np.linspace(0.0, 1.0, PIT_BINS + 1))
    band, from_blocks = pit_band(calibration)
    return {
        "n": len(calibration.pit),
        "largest_distance": plain(float(calibration.pit_deviation)),
        "edges": plain(edges),
        "counts": plain(counts),
        "band_95_half_width_of_density": plain(band),
        "band_from_time_blocks": from_blocks,
    }
