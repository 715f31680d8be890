"""A calibration as plain JSON values, complete but for the beams themselves."""

from __future__ import annotations

import dataclasses
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
from beamfield.report.parameter_rows import UNITS, finite_interval
from beamfield.report.score_figures import PIT_BINS, pit_band
from beamfield.report.verdict import verdict

SCHEMA = "beamfield-calibration/1"


def calibration_as_dict(calibration: Calibration) -> dict[str, Any]:
    """Return everything that a calibration says, as values that strict JSON can hold.

    Numbers are SI and nats. What is not known (an infinite or undefined number, a missing interval) is None: JSON has
    no token for NaN. The arrays with one entry per beam are summarised.

    Parameters
    ----------
    calibration
        The result of `calibrate`.
    """
    return {
        "schema": SCHEMA,
        "program": f"beamfield {__version__}",
        "verdict": verdict(calibration),
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
        "options": plain(calibration.options),
    }


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
            "unit": UNITS[item.name] or "1",
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
        "n_readings": table.n_readings,
        "n_table": len(table),
        "n_fit": int(calibration.n_fit),
        "n_held_out": int((calibration.held_out & ~nothing).sum()),
        "n_hits_nothing": int(nothing.sum()),
        "n_no_measurement": int(table.n_no_measurement),
        "n_nan": int(table.n_nan),
        "n_too_close": int(table.n_too_close),
        "n_unknown": int(table.n_unknown),
        "n_unsure": int(table.n_unsure),
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
