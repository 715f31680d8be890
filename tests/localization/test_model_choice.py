"""Which model localizes better: by what the filter does, on a drive with exact truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray
from beamfield.localization.model_choice import _stretches, choose_model
from beamfield.models.beam import BeamModel
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan, SensorLog


@dataclass(frozen=True)
class Indifferent:
    """Says nothing of any pose."""

    is_normalized = False

    def log_likelihood(self, z: Scan, poses: FloatArray) -> FloatArray:  # noqa: ARG002
        return np.zeros(len(np.atleast_2d(poses)))


def test_the_model_with_which_the_filter_errs_least_is_best(office, drive, truth):
    models = {
        "says nothing": Indifferent(),
        "field": LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.1, 0.1), n_beams=30, exponent=0.05),
        "beam model": BeamModel(office, truth, n_beams=15, exponent=0.1),
    }
    steps = []
    choice = choose_model(models, office, drive[:160], n_seeds=2, progress=lambda *step: steps.append(step))
    errors = {name: trials.mean("mean") for name, trials in choice.trials.items()}
    assert list(errors) == list(models)
    assert errors["beam model"] < errors["field"] < 0.1 < errors["says nothing"]
    assert choice.best == "beam model"
    assert [len(trials) for trials in choice.trials.values()] == [2, 2, 2]
    assert [line.split(":")[0] for line in choice.summary().splitlines()] == ["beam model", "field", "says nothing"]
    assert steps == [(0, 3), (1, 3), (2, 3)]


@pytest.mark.parametrize(("metres", "n_scans"), [(190.0, [951]), (600.0, [200] * 5)])
def test_of_a_long_way_stretches_count_from_its_beginning_to_its_end(metres, n_scans):
    stamps = np.arange(5.0 * metres + 1) / 5.0  # at 1 m/s
    poses = np.stack([stamps, np.zeros_like(stamps), np.zeros_like(stamps)], axis=1)
    finder = RangeFinder.from_bearings([-1.5, 1.5], 5.0)
    parts = _stretches(SensorLog(finder, stamps, np.full((len(stamps), 2), 4.0), poses, poses))
    assert [len(part) for part in parts] == pytest.approx(n_scans, abs=1)
    assert parts[0].stamps[0] == 0.0
    assert parts[-1].stamps[-1] == pytest.approx(metres, abs=0.3)


def test_scans_without_odometry_or_reference_do_not_count(office, drive):
    log = drive[:60]
    odometry, poses = np.array(log.odometry), np.array(log.poses)
    odometry[::3], poses[1::3] = np.nan, np.nan
    choice = choose_model({"one": Indifferent()}, office, replace(log, odometry=odometry, poses=poses), n_seeds=1)
    assert choice.trials["one"].mean("mean") < 1.0


def test_what_cannot_be_chosen_is_refused(office, drive):
    with pytest.raises(InvalidInputError, match="models: expected at least one"):
        choose_model({}, office, drive)
    with pytest.raises(InvalidInputError, match="n_seeds"):
        choose_model({"one": Indifferent()}, office, drive, n_seeds=0)
    for column in ("poses", "odometry"):
        unknown = replace(drive, **{column: np.full_like(drive.poses, np.nan)})
        with pytest.raises(TooLittleDataError, match="no scan has both a reference pose and odometry"):
            choose_model({"one": Indifferent()}, office, unknown)
