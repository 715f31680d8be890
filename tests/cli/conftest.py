"""What the tests of commands share."""

from __future__ import annotations

import pytest


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the figures of reports out: drawing them takes most of the time of a short calibration."""
    monkeypatch.setattr("beamfield.report.html.report_figures", lambda *_: [])
