"""The JSON document."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.as_json import calibration_as_dict, plain
from beamfield.scan_fit.calibration_fit import fit_of_calibration


def strict(document):
    """Through strict JSON and back."""
    return json.loads(json.dumps(document, allow_nan=False))


def test_everything_a_calibration_says_is_in_the_document(case):
    calibration = case.calibration
    document = strict(calibration_as_dict(calibration))
    assert document["parameters"]["sigma_hit"] == {
        "value": 0.05,
        "interval_95": [0.96 * 0.05, 1.05 * 0.05],
        "unit": "m",
        "held": False,
    }
    assert document["parameters"]["range_offset"]["interval_95"] is None
    assert [c["name"] for c in document["candidates"]] == ["chapter", "range offset"]
    assert [c["chosen"] for c in document["candidates"]] == [True, False]
    assert [s["name"] for s in document["scores"]] == ["fit", "nav2 defaults", "ROS 1 defaults", "uniform"]
    assert document["scores"][0]["log_likelihood"] == calibration.scores[0].log_likelihood
    assert document["learning"]["trace"] == [0.1, 0.4, 0.49, 0.5]
    assert document["selection"]["dropped"] == {"standing still": 3}
    assert document["findings"][0] == {
        "name": "poor-map",
        "severity": "warning",
        "text": "The map is poor.",
        "values": {"share": 0.25},
        "why": "It matters.",
        "do": "Draw a better one.",
        "parameter": "",
        "line": None,
    }
    assert document["options"]["selection"]["min_travel"] == 0.02
    assert document["opposite_beams"]["n_pairs"] == calibration.opposite.n_pairs
    assert len(document["pose_refinement"]["shifts"]) == 30
    assert sum(document["pit"]["counts"]) == document["pit"]["n"] == len(calibration.pit)
    assert len(document["timeline"]["stamps"]) == len(calibration.timeline.scan)
    assert document["timeline"]["held_out"].count(True) == int(calibration.timeline.held_out.sum())
    assert document["converged"] is True


def test_beam_counts_add_up(case):
    beams = calibration_as_dict(case.calibration)["beams"]
    assert beams["n_table"] == len(case.calibration.table)
    assert sum(beams["n_most_likely"].values()) + beams["n_hits_nothing"] == beams["n_table"]
    assert beams["n_no_measurement"] == 5
    assert beams["n_unknown"] == 7
    assert beams["n_unsure"] == 0


def test_what_is_not_known_is_null(case):
    calibration = case.calibration
    scores = (replace(calibration.scores[0], standard_error=float("nan")), *calibration.scores[1:])
    scores = (*scores[:3], replace(scores[3], log_likelihood=-np.inf, behind_fit=np.inf))
    document = strict(
        calibration_as_dict(
            replace(calibration, scores=scores, opposite=None, refinement=None, pit_deviation=float("nan"))
        )
    )
    assert document["scores"][0]["standard_error"] is None
    assert document["scores"][3]["log_likelihood"] is None
    assert document["pit"]["largest_distance"] is None
    assert document["opposite_beams"] is None
    assert document["pose_refinement"] is None


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (np.float32(0.5), 0.5),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (np.array([1.0, np.nan]), [1.0, None]),
        ({"a": (1, float("inf"))}, {"a": [1, None]}),
        (BeamParameters(1, 0, 0, 0, 1, 0).z_hit, 1.0),
        (None, None),
    ],
)
def test_plain_values(value, expected):
    assert plain(value) == expected


def test_the_fit_of_each_scan_is_in_the_document_or_why_it_is_not(case):
    fit = fit_of_calibration(case.calibration, case.grid, case.log)
    document = strict(calibration_as_dict(case.calibration, fit))["scan_fit"]
    assert document["n_judged"] == np.isfinite(document["p_value"]).sum() == len(case.log)
    assert document["share_that_fits"] == np.mean(np.array(document["p_value"]) > document["level"])
    assert document["reference"]["own_log"] is True
    assert strict(calibration_as_dict(case.calibration))["scan_fit"] is None


def test_a_map_that_the_log_drew_is_not_judged_by_the_scans_that_drew_it(case):
    drawn = replace(case.calibration, map_from_log=True)
    fit = fit_of_calibration(drawn, case.grid, case.log)
    assert (fit.fits, fit.reference) == (None, None)
    document = strict(calibration_as_dict(drawn, fit))
    assert document["scan_fit"] == {"missing": fit.missing}
    assert "fits them whatever happens" in fit.missing
    assert document["map_from_log"] is True
