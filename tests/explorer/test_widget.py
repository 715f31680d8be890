"""The explorer in a notebook, and how a session is opened."""

import numpy as np
import pytest

from beamfield.explorer.open_session import open_session
from beamfield.explorer.shown_run import read_shown_run
from beamfield.explorer.widget import answered, explore
from beamfield.io.trajectory import write_tum
from beamfield.sensors import Track
from tests.few_poses import few_poses


def test_a_message_of_the_notebook_is_answered(session):
    answer = answered(session, {"id": 7, "message": {"name": "scan", "i": 0, "pose": [0.0, 0.3, 0.0], "shown": [0]}})
    assert answer["id"] == 7
    assert len(answer["answer"]["scores"]) == 3
    assert "object" in answered(session, {"id": 8})["error"]
    assert "object" in answered(session, "nonsense")["error"]


def test_the_widget_is_the_pages_component(log, grid, monkeypatch, tmp_path):
    pytest.importorskip("anywidget")
    write_tum(tmp_path / "run.tum", Track(log.stamps, log.odometry))
    widget = explore(log, grid, fit=False, run=tmp_path / "run.tum")
    assert "export default { render }" in widget._esm
    assert "import " not in widget._esm  # a notebook has one module
    sent = []
    monkeypatch.setattr(type(widget), "send", lambda _, content, *__: sent.append(content))
    widget._handle_custom_msg({"id": 1, "message": {"name": "start"}}, [])
    assert len(sent[0]["answer"]["poses"]) == len(sent[0]["answer"]["run"]["poses"]) == 12


def test_what_cannot_be_learned_is_said_and_the_rest_is_shown(log, grid):
    session, why = open_session(log, grid)
    assert why is not None
    assert [one.kind for one in session.sets] == ["beam", "field", "stack"]


def test_a_log_is_learned_from_and_its_scans_judged(drive, office, tmp_path):
    stages = []
    # A filter that loses its way after half of the log.
    off = np.where(np.arange(len(drive)) < 240, 0.0, 3.0)[:, None] * np.array([1.0, 0.3, 0.5])
    write_tum(tmp_path / "run.tum", Track(drive.stamps, drive.poses + off))
    run = read_shown_run(tmp_path / "run.tum", drive, office)
    with few_poses():
        session, why = open_session(drive, office, run=run, progress=lambda stage, *_: stages.append(stage))
    assert why is None
    assert [one.label for one in session.sets[:2]] == ["beam model, fitted", "likelihood field, fitted"]
    assert {"log likelihood of a reading [nats]", "p-value", "probability of being lost"} < set(session.numbers)
    lost = session.numbers["filter: probability of being lost"]
    assert np.nanmedian(lost[:240]) < 0.1
    assert np.nanmedian(lost[260:]) > 0.9
    assert "judging scans" in stages
    first, typical = (session.answer({"name": "judge", "set": number}) for number in (0, 2))
    assert first["held_out"]
    assert first["now"]["reading"] > typical["now"]["reading"]
    learned, usual = (session.answer({"name": "judge", "set": number})["now"]["pose"] for number in (1, 3))
    assert learned > usual + 0.5
