"""What the tests of commands share."""

from __future__ import annotations

import pytest

from beamfield.stacks.fit import fit_space, motion_candidates, replay_choice


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures of reports out: drawing them takes most of the time of a short calibration."""
    monkeypatch.setattr("beamfield.report.html.report_figures", lambda *_, **__: [])


@pytest.fixture
def short_stack_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Try few settings and numbers of beams for a stack: which are tried is tested elsewhere."""
    few = replay_choice.ReplayOptions(runs=10, most_stretches=2, longest=12)
    monkeypatch.setattr(replay_choice, "OF_FIELDS", few)
    monkeypatch.setattr(replay_choice, "OF_RAYS", few)
    monkeypatch.setattr(motion_candidates, "ALPHAS", ((0.05, 0.05),))
    monkeypatch.setattr(fit_space, "BEAM_COUNTS", (9,))
